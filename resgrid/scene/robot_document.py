"""The robot of a raw scene document: the axes it brings along, and the table that describes it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from math import isclose, pi, tau
from typing import Any

from resgrid.errors import InputError
from resgrid.robots import Arm, DiscRobot, PointRobot, PolygonRobot, Robot

WORKSPACE_ROBOTS = ("arm", "polygon")
"""Robots whose configuration space is not the workspace."""


def with_robot_axes(raw: Mapping[str, Any]) -> Mapping[str, Any]:
    """A document whose axes say everything that its robot, and ``grid.cells``, imply."""
    grid, robot = raw.get("grid"), raw.get("robot")
    if not isinstance(grid, Mapping):
        return raw
    implied = _implied_axes(robot if isinstance(robot, Mapping) else {})
    cells = grid.get("cells")
    axes = grid.get("axes")
    if axes is None and implied and cells is not None:
        axes = [{} for _ in implied]
    if not isinstance(axes, list):
        return raw
    full = [
        _filled(axis, implied[number] if number < len(implied) else {}, _count(cells, number))
        for number, axis in enumerate(axes)
    ]
    return {**raw, "grid": {**grid, "axes": full}}


def robot_kind(raw: Mapping[str, Any]) -> str:
    """Type of the robot of a document; ``"point"`` where it does not say."""
    robot = raw.get("robot")
    return str(robot.get("type", "point")) if isinstance(robot, Mapping) else "point"


def robot_table(robot: Robot) -> dict[str, Any]:
    """The ``[robot]`` table of a robot."""
    match robot:
        case DiscRobot(radius):
            return {"type": "disc", "radius": radius}
        case PointRobot(radius):
            return {"type": "point", "radius": radius}
        case PolygonRobot(vertices, turning_length):
            return {
                "type": "polygon",
                "vertices": [list(point) for point in vertices],
                "turning_length": turning_length,
            }
        case Arm():
            return _arm_table(robot)
    raise InputError(f"a scene file cannot describe a {type(robot).__name__}")


def _arm_table(arm: Arm) -> dict[str, Any]:
    links = [
        {"length": length, "width": width} | ({"limits": list(limits)} if limits else {})
        for length, width, limits in zip(arm.lengths, arm.widths, arm.limits, strict=True)
    ]
    rest = dataclasses.asdict(arm)
    kept = ("base_angle", "angles", "self_collision", "singularity_width", "singularity_cells")
    table = {"type": "arm", "links": links, "base": list(arm.base)}
    return table | {key: rest[key] for key in kept if rest[key] is not None}


def _implied_axes(robot: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What is known of each axis before the scene says anything."""
    if robot.get("type") == "arm" and isinstance(robot.get("links"), list):
        return [_joint_axis(number, link) for number, link in enumerate(robot["links"], 1)]
    if robot.get("type") == "polygon":
        length = robot.get("turning_length", 1.0)
        length = length if isinstance(length, int | float) and length > 0 else 1.0
        turn = {"name": "theta", "lower": 0.0, "upper": tau * length, "periodic": True, "unit": "m"}
        return [{"name": "x"}, {"name": "y"}, turn]
    return []


def _joint_axis(number: int, link: Any) -> dict[str, Any]:
    limits = link.get("limits") if isinstance(link, Mapping) else None
    good = isinstance(limits, list) and len(limits) == 2
    lower, upper = limits if good and limits is not None else (-pi, pi)
    return {"name": f"theta_{number}", "lower": lower, "upper": upper, "periodic": not good, "unit": "rad"}


def _count(cells: Any, number: int) -> Any:
    if isinstance(cells, list):
        return cells[number] if number < len(cells) else None
    return cells


def _filled(axis: Any, implied: Mapping[str, Any], cells: Any) -> Any:
    if not isinstance(axis, Mapping):
        return axis
    full = {**implied, **axis}
    if implied.get("periodic") and "periodic" not in axis and ("lower" in axis or "upper" in axis):
        full["periodic"] = _same_span(full, implied)
    if cells is not None and not {"cells", "spacing"} & set(full):
        full["cells"] = cells
    return full


def _same_span(axis: Mapping[str, Any], implied: Mapping[str, Any]) -> bool:
    ends = axis["lower"], axis["upper"], implied["lower"], implied["upper"]
    if not all(isinstance(end, int | float) for end in ends):
        return False
    return isclose(ends[1] - ends[0], ends[3] - ends[2], rel_tol=1e-9)
