"""What holds between the keys of a scene, checked on the raw document so that no other error hides it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from resgrid.scene.robot_document import WORKSPACE_ROBOTS, robot_kind
from resgrid.scene.toml_lines import Path

Problem = tuple[Path, str]
PLANE_SHAPES = ("rectangle", "circle", "polygon")
COORDINATES = ("lower", "upper", "centre", "normal", "point")
CELLS = ("cell", "joints", "joints_lower", "joints_upper")


def broken_laws(raw: Mapping[str, Any], ndim: int | None = None) -> list[Problem]:
    """Everything in a document that does not fit together."""
    axes = _axes(raw)
    count = ndim if axes is None else len(axes)
    return [
        *_one_ground(raw),
        *_robot_axes(raw, axes),
        *_unique_names(axes or []),
        *_edges(raw, axes, count),
        *_boundary(raw),
        *(_coordinates(raw, count) if count else ()),
        *_leaning(raw, axes or []),
    ]


def _axes(raw: Mapping[str, Any]) -> list[Any] | None:
    grid = raw.get("grid")
    axes = grid.get("axes") if isinstance(grid, Mapping) else None
    return axes if isinstance(axes, list) and axes else None


def _one_ground(raw: Mapping[str, Any]) -> Iterator[Problem]:
    if "grid" in raw and "map" in raw:
        yield ("map",), "a scene has either a [grid] or a [map]; remove one of them"
    if "grid" not in raw and "map" not in raw:
        yield (), 'a scene needs a [grid] with axes, or a [map] with file = "..."'


def _unique_names(axes: list[Any]) -> Iterator[Problem]:
    seen: set[str] = set()
    for number, axis in enumerate(axes):
        name = axis.get("name") if isinstance(axis, Mapping) else None
        if isinstance(name, str) and name in seen:
            yield ("grid", "axes", number, "name"), f"another axis is called {name!r} already; choose another name"
        elif isinstance(name, str):
            seen.add(name)


def _edges(raw: Mapping[str, Any], axes: list[Any] | None, count: int | None) -> Iterator[Problem]:
    edge = raw.get("edge")
    if isinstance(edge, list) and count and len(edge) != count:
        yield ("edge",), f"needs one entry for each of the {count} axes (or one text for all), got {len(edge)}"
        return
    wanted = edge if isinstance(edge, list) else [edge] * (count or 0)
    for number, rule in enumerate(wanted):
        axis = axes[number] if axes and number < len(axes) else {}
        periodic = isinstance(axis, Mapping) and axis.get("periodic") is True
        if rule == "periodic" and not periodic:
            path: Path = ("edge", number) if isinstance(edge, list) else ("edge",)
            yield path, f"axis {number} is not periodic; set periodic = true on the axis, or choose obstacle or open"
            return


def _boundary(raw: Mapping[str, Any]) -> Iterator[Problem]:
    boundary = raw.get("boundary", "dirichlet")
    chip = raw.get("chip")
    if boundary == "wall" and not (isinstance(chip, Mapping) and "wall_resistance" in chip):
        yield ("boundary",), 'boundary = "wall" needs wall_resistance in [chip], in ohms'
    k = raw.get("k")
    blends = [value for value in (k if isinstance(k, list) else [k]) if isinstance(value, int | float)]
    if raw.get("drive") is not None and boundary in ("dirichlet", "wall") and not any(b < 1 for b in blends):
        yield (
            ("drive",),
            f"a drive belongs to open obstacles, and here boundary = {boundary!r} drives the grid; "
            'remove drive, or choose boundary = "neumann"',
        )
    if raw.get("drive") == "start" and boundary == "neumann" and not raw.get("start") and not raw.get("starts"):
        yield ("drive",), 'drive = "start" needs a start; add starts = [[...]], or choose drive = "uniform"'


def _robot_axes(raw: Mapping[str, Any], axes: list[Any] | None) -> Iterator[Problem]:
    kind = robot_kind(raw)
    if kind in WORKSPACE_ROBOTS and "map" in raw:
        yield ("map",), f"a robot of type {kind!r} needs a [grid]; only points and discs move on the cells of a map"
    robot = raw.get("robot")
    links = robot.get("links") if isinstance(robot, Mapping) else None
    wanted = {"polygon": 3, "disc": 2, "arm": len(links) if isinstance(links, list) else None}.get(kind)
    if axes and wanted and len(axes) != wanted:
        whose = {"polygon": "a turning polygon (x, y, theta)", "disc": "a disc"}.get(kind, f"an arm of {wanted} links")
        yield ("grid", "axes"), f"{whose} needs {wanted} axes, got {len(axes)}"
    grid = raw.get("grid")
    cells = grid.get("cells") if isinstance(grid, Mapping) else None
    if isinstance(cells, list) and axes and len(cells) != len(axes):
        yield ("grid", "cells"), f"needs one number for each of the {len(axes)} axes (or one for all), got {len(cells)}"


def _coordinates(raw: Mapping[str, Any], count: int) -> Iterator[Problem]:
    for key in ("obstacle", "hidden", "goal", "area", "start"):
        allowed = _counts(robot_kind(raw), key, count)
        for number, table in enumerate(_tables(raw, key)):
            shape = table.get("shape")
            if shape in PLANE_SHAPES and 2 not in allowed:
                other = {"rectangle": "box", "circle": "sphere"}.get(str(shape), "boxes")
                yield (key, number, "shape"), f"a {shape} needs 2 axes, and there are {count}; use {other} instead"
                continue
            for name in COORDINATES:
                value = table.get(name)
                if isinstance(value, list) and len(value) not in allowed and shape not in PLANE_SHAPES:
                    yield (key, number, name), _wanted(allowed, robot_kind(raw), value)
            for name in CELLS:
                value = table.get(name)
                if isinstance(value, list) and len(value) != count:
                    yield (key, number, name), _wanted((count,), "point", value)
    starts = raw.get("starts")
    for number, point in enumerate(starts if isinstance(starts, list) else []):
        if isinstance(point, list) and len(point) != count:
            yield ("starts", number), f"needs {count} coordinates, one for each axis, got {len(point)}"


def _counts(kind: str, key: str, count: int) -> tuple[int, ...]:
    """How many coordinates a shape or point may have: those of the workspace, of configuration space, or of both."""
    if kind not in WORKSPACE_ROBOTS or key in ("area", "start"):
        return (count,)
    return (2, count) if kind == "polygon" and key == "goal" else (2,)


def _wanted(allowed: tuple[int, ...], kind: str, value: list[Any]) -> str:
    if kind not in WORKSPACE_ROBOTS or allowed[0] != 2:
        return f"needs {allowed[0]} coordinates, one for each axis, got {len(value)}"
    other = " (a place in the plane) or 3 (a configuration)" if len(allowed) == 2 else ", a place in the plane"
    return f"needs 2 coordinates{other}, got {len(value)}"


def _leaning(raw: Mapping[str, Any], axes: list[Any]) -> Iterator[Problem]:
    in_workspace = robot_kind(raw) in WORKSPACE_ROBOTS
    periodic = [isinstance(axis, Mapping) and axis.get("periodic") is True for axis in axes]
    for key in ("area",) if in_workspace else ("obstacle", "hidden", "goal", "area"):
        for number, table in enumerate(_tables(raw, key)):
            normal = table.get("normal")
            if not isinstance(normal, list) or len(normal) != len(periodic):
                continue
            if any(ring and component for ring, component in zip(periodic, normal, strict=True)):
                yield (key, number, "normal"), "a half-plane cannot lean along a periodic axis; use a box instead"


def _tables(raw: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    value = raw.get(key)
    return [table if isinstance(table, Mapping) else {} for table in value] if isinstance(value, list) else []
