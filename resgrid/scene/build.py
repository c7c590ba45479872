"""From a raw scene document to a `Scene`, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.robots import Ball, Box, HalfSpace, Polygon, Robot, Shape
from resgrid.scene.maps.data import MapData
from resgrid.scene.maps.formats import read_map
from resgrid.scene.robot_document import robot_table, with_robot_axes
from resgrid.scene.scene import CostArea, Goal, GoalCell, GoalJoints, GoalPoint, MapCells, Scene
from resgrid.scene.toml_lines import Path as KeyPath
from resgrid.scene.validate import validate
from resgrid.space import Axis

if TYPE_CHECKING:
    from resgrid.robots.shapes import Point
    from resgrid.scene.document import SceneDocument

PLAIN = ("title", "boundary", "drive", "sampling")


def build_scene(
    raw: Mapping[str, Any],
    source: str,
    folder: Path,
    lines: dict[KeyPath, int] | None = None,
    known: MapData | None = None,
) -> Scene:
    """Check a document and make the scene it describes."""
    raw = with_robot_axes(raw)
    document = validate(raw, source, lines, len(known.axes) if known else None)
    if document.map is None:
        return _scene(document, source, _grid_axes(document), Frame(), None)
    table = {key: value for key, value in document.map.model_dump().items() if value is not None}
    if "\0" in document.map.file:
        raise InputError(f"{source}: map.file: {document.map.file!r} is no name of a file")
    table["file"] = str((folder / document.map.file).resolve())
    data = known or read_map(Path(table["file"]), table)
    validate(raw, source, lines, len(data.axes))
    return _scene(document, source, data.axes, data.frame, MapCells(data.cell, table))


def rebuilt(scene: Scene) -> Scene:
    """The same scene, checked like a file."""
    build_scene(document_of(scene), scene.source or "scene", Path(), known=map_data(scene))
    return scene


def map_data(scene: Scene) -> MapData | None:
    """What a map's reader gave, taken from the scene made of it."""
    return None if scene.map is None else MapData(scene.axes, scene.frame, scene.map.cell)


def document_of(scene: Scene) -> dict[str, Any]:
    """The document that describes a scene; the inverse of `build_scene`."""
    document: dict[str, Any] = {"schema": 1}
    document |= {key: getattr(scene, key) for key in PLAIN if getattr(scene, key) is not None}
    document |= {"edge": list(scene.edge), "k": list(scene.k)}
    document["robot"] = robot_table(scene.robot)
    if scene.map is None:
        document["grid"] = {"axes": [dataclasses.asdict(axis) for axis in scene.axes]}
    else:
        document["map"] = dict(scene.map.table)
    document["obstacle"] = [_table(shape) for shape in scene.obstacles]
    document["hidden"] = [_table(shape) for shape in scene.hidden]
    document["goal"] = [_table(goal) for goal in scene.goals]
    document["starts"] = [list(start) for start in scene.starts]
    document["area"] = [_table(area.shape) | {"conductivity": area.conductivity} for area in scene.areas]
    document["chip"] = _said(dataclasses.asdict(scene.chip))
    return document


def _said(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table without the keys that say nothing, tuples as lists."""
    said = {key: _said(value) if isinstance(value, Mapping) else value for key, value in table.items()}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in said.items() if value is not None}


def _scene(document: SceneDocument, source: str, axes: tuple[Axis, ...], frame: Frame, cells: MapCells | None) -> Scene:
    wanted = document.edge * len(axes) if len(document.edge) == 1 else document.edge
    return Scene(
        axes=axes,
        title=document.title,
        robot=_robot(document, source, axes),
        obstacles=tuple(table.value() for table in document.obstacle),
        hidden=tuple(table.value() for table in document.hidden),
        goals=tuple(table.value() for table in document.goal),
        starts=(*map(tuple, document.starts), *(_start(t.value(), axes, frame) for t in document.start)),
        areas=tuple(CostArea(table.value(), table.conductivity) for table in document.area),
        map=cells,
        frame=frame,
        boundary=document.boundary,
        drive=document.drive,
        edge=tuple("periodic" if axis.periodic else rule for axis, rule in zip(axes, wanted, strict=True)),
        k=tuple(document.k),
        chip=document.chip.value(),
        sampling=document.sampling,
        source=source,
    )


def _robot(document: SceneDocument, source: str, axes: tuple[Axis, ...]) -> Robot:
    robot = document.robot.value()
    if not robot.moves_in_workspace:
        try:
            robot.check_axes(axes)
        except InputError as error:
            raise InputError(f"{source}: grid: {error}") from None
    return robot


def _grid_axes(document: SceneDocument) -> tuple[Axis, ...]:
    tables = document.grid.axes if document.grid else []
    return tuple(
        Axis(table.name, float(table.lower), float(table.upper), table.count(), table.periodic, table.unit)
        for table in tables
    )


def _start(place: GoalPoint | GoalCell, axes: tuple[Axis, ...], frame: Frame) -> Point:
    if isinstance(place, GoalPoint):
        return place.point
    if not all(0 <= index < axis.cells for index, axis in zip(place.cell, axes, strict=True)):
        size = " x ".join(str(axis.cells) for axis in axes)
        raise InputError(f"the start cell {list(place.cell)} is not in the grid of {size} cells (counted from 0)")
    inside = [axis.lower + (index + 0.5) * axis.spacing for index, axis in zip(place.cell, axes, strict=True)]
    return tuple(np.asarray(frame.to_world(inside)).tolist())


def _table(goal: Goal) -> dict[str, Any]:
    match goal:
        case GoalPoint(point):
            return {"point": list(point)}
        case GoalCell(cell):
            return {"cell": list(cell)}
        case GoalJoints(lower, upper):
            box = {"joints_lower": list(lower), "joints_upper": list(upper)}
            return {"joints": list(lower)} if lower == upper else box
    return _shape_table(goal)


def _shape_table(shape: Shape) -> dict[str, Any]:
    plane = shape.ndim == 2
    match shape:
        case Box(lower, upper):
            return {"shape": "rectangle" if plane else "box", "lower": list(lower), "upper": list(upper)}
        case Ball(centre, radius):
            return {"shape": "circle" if plane else "sphere", "centre": list(centre), "radius": radius}
        case Polygon(vertices, holes):
            rings = [[list(point) for point in ring] for ring in (vertices, *holes)]
            return {"shape": "polygon", "vertices": rings[0], "holes": rings[1:]}
        case HalfSpace(normal, offset):
            return {"shape": "half_plane", "normal": list(normal), "offset": offset}
    raise InputError(f"a scene file cannot describe a {type(shape).__name__}")
