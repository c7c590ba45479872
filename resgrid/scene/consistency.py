"""What must hold between the parts of a scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from resgrid.axis import Axis
from resgrid.errors import InputError
from resgrid.robots import Ball, Box, HalfSpace, Polygon, Robot
from resgrid.scene.control import Control
from resgrid.scene.goals import CostArea, GoalCell, GoalJoints, GoalPoint
from resgrid.scene.toml_lines import Path

Problem = tuple[Path, str]
_FIRST_KEY = {
    Box: "lower",
    Ball: "centre",
    Polygon: "vertices",
    HalfSpace: "normal",
    GoalPoint: "point",
    GoalCell: "cell",
}


@dataclass(frozen=True)
class Parts:
    """The parts of a scene as far as they are known: of a file with errors, those without.

    `robot`: its class, if only that is known; `ndim`, `names`: of the axes, even if some are wrong; `axes`: None then;
    `values`: shapes, goals, areas and starts, by the key path of each in a file.
    """

    robot: Robot | type[Robot] | None
    axes: tuple[Axis, ...] | None
    ndim: int | None
    boundary: str
    drive: str | None
    edge: Sequence[str]
    k: Sequence[float]
    has_wall: bool
    names: Sequence[str | None]
    values: Mapping[Path, Any]
    control: Control


def inconsistencies(parts: Parts) -> list[Problem]:
    """Everything in a scene that does not fit together, by key path."""
    return [
        *_unique_names(parts.names),
        *_robot_axes(parts),
        *_edges(parts),
        *_boundary(parts),
        *_coordinates(parts),
        *_leaning(parts),
        *_control(parts),
    ]


def _unique_names(names: Sequence[str | None]) -> Iterator[Problem]:
    for number, name in enumerate(names):
        if name is not None and name in names[:number]:
            yield ("grid", "axes", number, "name"), f"another axis is called {name!r} already; choose another name"


def _robot_axes(parts: Parts) -> Iterator[Problem]:
    if not isinstance(parts.robot, Robot) or parts.axes is None:
        return
    try:
        parts.robot.check_axes(parts.axes)
    except InputError as error:
        yield ("grid",), str(error)


def _edges(parts: Parts) -> Iterator[Problem]:
    if parts.ndim and len(parts.edge) not in (1, parts.ndim):
        words = f"needs one entry for each of the {parts.ndim} axes (or one text for all), got {len(parts.edge)}"
        yield ("edge",), words
        return
    for number, axis in enumerate(parts.axes or ()):
        rule = parts.edge[number if len(parts.edge) > 1 else 0]
        if rule == "periodic" and not axis.periodic:
            words = f"axis {number} is not periodic; set periodic = true on the axis, or choose obstacle or open"
            yield ("edge",) if len(parts.edge) == 1 else ("edge", number), words
            return


def _boundary(parts: Parts) -> Iterator[Problem]:
    if not all(0 <= share <= 1 for share in parts.k):
        yield ("k",), f"a share of the Dirichlet field lies between 0 and 1, got {list(parts.k)}"
    boundary, drive = parts.boundary, parts.drive
    if boundary == "wall" and not parts.has_wall:
        yield ("boundary",), 'boundary = "wall" needs wall_resistance in [chip], in ohms'
    if drive is not None and boundary in ("dirichlet", "wall") and not any(share < 1 for share in parts.k):
        yield (
            ("drive",),
            f"a drive belongs to open obstacles, and here boundary = {boundary!r} drives the grid; "
            'remove drive, or choose boundary = "neumann"',
        )
    if drive == "start" and boundary == "neumann" and not any(path[0] in ("start", "starts") for path in parts.values):
        yield ("drive",), 'drive = "start" needs a start; add starts = [[...]], or choose drive = "uniform"'


def _coordinates(parts: Parts) -> Iterator[Problem]:
    if parts.robot is None or not parts.ndim:
        return
    for path, value in parts.values.items():
        allowed, meaning = _allowed(parts.robot, parts.ndim, str(path[0]), value)
        shape = value.shape if isinstance(value, CostArea) else value
        count = _coordinate_count(shape)
        if count in allowed:
            continue
        if isinstance(shape, Box | Ball | Polygon) and count == 2:
            other = {Box: "box", Ball: "sphere"}.get(type(shape), "boxes")
            yield path, f"a shape of the plane needs 2 axes, and there are {parts.ndim}; use {other} instead"
        else:
            key = _FIRST_KEY.get(type(shape), "joints" if isinstance(shape, GoalJoints) else "")
            yield (*path, key) if key else path, f"needs {allowed[0]} coordinates{meaning}, got {count}"


def _allowed(robot: Robot | type[Robot], ndim: int, key: str, value: Any) -> tuple[tuple[int, ...], str]:
    """How many coordinates a value may have, and what they mean: of the workspace, of configuration space, or both."""
    in_space = key in ("area", "start", "starts") or isinstance(value, GoalCell | GoalJoints)
    if robot.moves_in_workspace or in_space:
        return (ndim,), ", one for each axis"
    if key == "goal" and robot.base is None:
        return (2, ndim), f" (a place in the plane) or {ndim} (a configuration)"
    return (2,), ", a place in the plane"


def _coordinate_count(value: Any) -> int:
    match value:
        case GoalPoint(point=coordinates) | GoalCell(cell=coordinates) | GoalJoints(lower=coordinates):
            return len(coordinates)
        case tuple():
            return len(value)
    return int(value.ndim)


def _control(parts: Parts) -> Iterator[Problem]:
    for path, message in parts.control.misfits(parts.ndim) if parts.ndim else ():
        yield ("control", *path), message


def _leaning(parts: Parts) -> Iterator[Problem]:
    if parts.robot is None or parts.axes is None:
        return
    for path, value in parts.values.items():
        shape = value.shape if isinstance(value, CostArea) else value
        if not isinstance(shape, HalfSpace) or shape.ndim != len(parts.axes):
            continue
        if not parts.robot.moves_in_workspace and not isinstance(value, CostArea):
            continue
        if any(axis.periodic and part for axis, part in zip(parts.axes, shape.normal, strict=True)):
            yield (*path, "normal"), "a half-plane cannot lean along a periodic axis; use a box instead"
