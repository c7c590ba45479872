"""Consistency checks between parts of a scene: robot, axes, edges, boundary, drive, control, numbers of coordinates."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

from resgrid.core.axis import Axis
from resgrid.core.cell import MAX_DIMENSIONS
from resgrid.errors import InputError
from resgrid.robots import Ball, Box, HalfSpace, Polygon, Robot, Shape, Voxels
from resgrid.robots.shapes import SpaceSolid
from resgrid.scene.goals import CostArea, GoalCell, GoalJoints
from resgrid.scene.messages import Problem
from resgrid.scene.toml_lines import Path


def inconsistencies(
    settings: Any,
    robot: Robot | type[Robot] | None,
    axes: Sequence[Axis] | None,
    names: Sequence[str | None],
    values: Mapping[Path, Any],
    *,
    has_wall: bool,
) -> list[Problem]:
    """Return all inconsistencies between parts of a scene, as pairs of key path and message.

    A key path is a tuple of names and indices, such as ``("obstacle", 2, "radius")``.  `settings`: the scene, or the
    typed document of its file; `robot`: the robot, its class if other keys of the table ``[robot]`` are invalid, or
    None if its type is invalid; `axes`: axes of the space, None if some are invalid; `names`: names of all axes, None
    for an axis without a valid name; `values`: shapes, goals, areas and starts, by key path, such as ``("goal", 0)``;
    `has_wall`: whether the chip description gives a wall resistance.
    """
    ndim = len(names)
    return [
        *_duplicate_names(names),
        *_axes_problems(robot, axes),
        *_edge_problems(settings, axes, ndim),
        *_boundary_problems(settings, values, has_wall),
        *_coordinate_problems(robot, ndim, values),
        *_half_space_problems(robot, axes, values),
        *((("control", *path), message) for path, message in (settings.control.problems(ndim) if ndim else ())),
    ]


def _duplicate_names(names: Sequence[str | None]) -> Iterator[Problem]:
    for number, name in enumerate(names):
        if name is not None and name in names[:number]:
            yield ("grid", "axes", number, "name"), f"another axis is called {name!r} already; choose another name"


def _axes_problems(robot: Robot | type[Robot] | None, axes: Sequence[Axis] | None) -> Iterator[Problem]:
    if axes is not None and not 1 <= len(axes) <= MAX_DIMENSIONS:
        yield ("grid", "axes"), f"a scene has 1 to {MAX_DIMENSIONS} axes, got {len(axes)}"
    elif isinstance(robot, Robot) and axes is not None:
        try:
            robot.check_axes(axes)
        except InputError as error:
            yield ("grid",), str(error)


def _edge_problems(settings: Any, axes: Sequence[Axis] | None, ndim: int) -> Iterator[Problem]:
    edge: Sequence[str] = settings.edge
    if ndim and len(edge) not in (1, ndim):
        yield ("edge",), f"needs one entry for each of the {ndim} axes (or one text for all), got {len(edge)}"
        return
    rules = edge if len(edge) > 1 else [*edge] * len(axes or ())
    wrong = [n for n, axis in enumerate(axes or ()) if rules[n] == "periodic" and not axis.periodic]
    if axes and wrong:
        remedy = "set periodic = true on the axis"
        if settings.map is not None and getattr(settings, "grid", None) is None:  # axes of a map have no table
            names = [axis.name for axis, rule in zip(axes, rules, strict=True) if rule == "periodic" or axis.periodic]
            value = names[0] if len(names) == 1 else "'" + json.dumps(names) + "'"
            remedy = f"--set map.periodic={value} makes it periodic (in Python: periodic={names} of read_scene)"
        words = f"axis {wrong[0]} is not periodic; {remedy}, or choose obstacle or open"
        yield ("edge",) if len(edge) == 1 else ("edge", wrong[0]), words


def _boundary_problems(settings: Any, values: Mapping[Path, Any], has_wall: bool) -> Iterator[Problem]:
    boundary, drive = settings.boundary, settings.drive
    if boundary == "wall" and not has_wall:
        yield ("boundary",), 'boundary = "wall" needs wall_resistance in [chip], in ohms'
    if drive is not None and settings.leak:
        yield (
            ("leak",),
            f"leak = {settings.leak:g} drives open obstacles from the obstacle rail, and drive = {drive!r} would be a "
            "second source; remove drive, or set leak = 0",
        )
    elif drive is not None and boundary in ("dirichlet", "wall") and not any(k < 1 for k in settings.k):
        yield (
            ("drive",),
            f"a drive needs open obstacles, but with boundary = {boundary!r} the obstacles drive the grid; "
            'remove drive, or choose boundary = "neumann"',
        )
    if drive == "start" and boundary == "neumann" and not any(path[0] in ("start", "starts") for path in values):
        yield ("drive",), 'drive = "start" needs a start; add starts = [[...]], or choose drive = "uniform"'


def _coordinate_problems(robot: Robot | type[Robot] | None, ndim: int, values: Mapping[Path, Any]) -> Iterator[Problem]:
    if robot is None or not ndim:
        return
    for path, value in values.items():
        allowed, meaning = _allowed(robot, ndim, str(path[0]), value)
        shape = value.shape if isinstance(value, CostArea) else value
        count, key = _count_of(shape)
        if count in allowed:
            continue
        if isinstance(shape, Box | Ball | Polygon) and count == 2:
            other = {Box: "box", Ball: "sphere"}.get(type(shape), "boxes")
            has = f"the scene has {ndim}" if robot.workspace_ndim == 2 else "this robot moves in space"
            yield path, f"a shape of the plane needs 2 axes, but {has}; use {other} instead"
        elif isinstance(shape, SpaceSolid | Voxels):
            yield path, f"a shape in space has 3 coordinates, but this workspace has {allowed[0]}; use another shape"
        else:
            hint = "; decimals have a point: 0.5, not 0,5" if count == 2 * allowed[0] else ""
            yield (*path, *key), f"needs {allowed[0]} coordinates{meaning}, got {count}{hint}"


def _allowed(robot: Robot | type[Robot], ndim: int, key: str, value: Any) -> tuple[tuple[int, ...], str]:
    """Return the allowed numbers of coordinates of a value, and words for their meaning in a message.

    A value is a place in the workspace, a configuration, or (for a goal) one of these two.  `robot`: robot or its
    class; `ndim`: number of axes; `key`: key of the scene file that holds the value, such as "goal"; `value`: shape,
    goal, cost area or start.
    """
    in_space = key in ("area", "start", "starts") or isinstance(value, GoalCell | GoalJoints)
    if robot.moves_in_workspace or in_space:
        return (ndim,), ", one for each axis"
    if key == "goal" and robot.base is None:
        return (2, ndim), f" (a place in the plane) or {ndim} (a configuration)"
    plane = robot.workspace_ndim == 2
    return (robot.workspace_ndim,), ", a place in the plane" if plane else ", a place in space"


def _count_of(value: Any) -> tuple[int, tuple[str, ...]]:
    """Return the number of coordinates of a shape, goal or start, and the key of the table that holds them.

    The key is a tuple of one name, such as ``("centre",)``; it is empty for a start, which has no table.
    """
    if isinstance(value, tuple):
        return len(value), ()
    first = fields(value)[0].name
    count = value.ndim if isinstance(value, Shape) else len(getattr(value, first))
    return count, ("joints" if isinstance(value, GoalJoints) else first,)


def _half_space_problems(
    robot: Robot | type[Robot] | None, axes: Sequence[Axis] | None, values: Mapping[Path, Any]
) -> Iterator[Problem]:
    if robot is None or axes is None:
        return
    for path, value in values.items():
        shape = value.shape if isinstance(value, CostArea) else value
        if not isinstance(shape, HalfSpace) or shape.ndim != len(axes):
            continue
        if not robot.moves_in_workspace and not isinstance(value, CostArea):
            continue
        if any(axis.periodic and part for axis, part in zip(axes, shape.normal, strict=True)):
            yield (*path, "normal"), "the normal of a half-plane must be 0 along a periodic axis; use a box instead"
