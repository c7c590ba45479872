"""Paths as files: tables, records, arrays, and plans for ROS."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.io.tables import Views, require_names, suffix_of, write
from resgrid.planning.streamline import AnyPath, ShortPath, Streamline, unwrap
from resgrid.planning.timing import Trajectory
from resgrid.robots import PointRobot
from resgrid.space import ConfigurationSpace

Timed = AnyPath | Trajectory


def write_path(path: Timed, file: str | os.PathLike[str]) -> Path:
    """Write a path, whole or not at all, as the end of the file's name says.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or Trajectory
        An arm's files say where its tip is.
    file : path-like
        ``.csv``, or ``-`` for standard output: a table with a header; ``.json``: one list a column; ``.npz``: one
        array a column; ``.yaml``: a ``nav_msgs/Path`` for ROS.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        If the name ends otherwise, the path does not fit, an axis has the name of another column, or the file cannot
        be written.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((5.5, 2.5))
    >>> rg.write_path(path, "path.csv").read_text().splitlines()[:2]
    ['x,y', '5.5,2.5']
    """
    space, suffix = path.space, suffix_of(file, _VIEWS, "a path")
    if suffix == ".json":
        require_names(space.axes, ["schema", *(axis.name for axis in space.axes)])

    columns = partial(path_columns, path)
    views: Views = {"table": columns, "record": columns, "arrays": columns, "message": partial(ros_plan, path)}
    return write(file, views, "a path")


_VIEWS = ("table", "record", "arrays", "message")


def path_columns(path: Timed) -> dict[str, NDArray[np.float64]]:
    """A path as named columns, one entry a point, in world coordinates that are continuous across periodic seams.

    Shapes: returns (n,).
    """
    space, points = path.space, _points(path)
    names = column_names(space, timed=isinstance(path, Trajectory))
    require_names(space.axes, names)
    columns = [*points.T]
    if space.robot is not None and space.robot.base is not None:
        columns += [*space.robot.reference_point(points).T]
    if isinstance(path, Trajectory):
        columns = [path.times, *columns, *path.velocities.T]
    return dict(zip(names, columns, strict=True))


def column_names(space: ConfigurationSpace, *, timed: bool) -> list[str]:
    """Names of the columns of a path."""
    axes = [axis.name for axis in space.axes]
    mounted = space.robot is not None and space.robot.base is not None
    tip = [f"{space.robot.reference}_{name}" for name in "xy"] if mounted else []
    return ["t", *axes, *tip, *(f"{name}_rate" for name in axes)] if timed else [*axes, *tip]


def _points(path: Timed) -> NDArray[np.float64]:
    return path.positions if isinstance(path, Trajectory) else unwrap(path)


@dataclass(frozen=True, eq=False)
class Route:
    """The way from a start: a streamline, and what was made of it.

    `start`: as it was asked for, in world coordinates; `short`: its shortcut; `motion`: when it is where.
    """

    streamline: Streamline
    start: tuple[float, ...]
    short: ShortPath | None = None
    motion: Trajectory | None = None

    @property
    def reached(self) -> bool:
        """Whether it ends in a goal."""
        return self.streamline.outcome == "reached"

    @property
    def final(self) -> Streamline | ShortPath | Trajectory:
        """What the robot is to follow."""
        return self.motion or self.short or self.streamline


def write_routes(routes: Sequence[Route], target: str | os.PathLike[str]) -> Path:
    """Write routes, whole or not at all: a table or a record of all, arrays with numbers, a document for ROS each."""
    views: Views = {
        "table": lambda: _routes_table(routes),
        "record": lambda: {"paths": [_with_columns(route) for route in routes]},
        "arrays": lambda: _routes_arrays(routes),
        "message": lambda: _documents(routes),
    }
    return write(target, views, "paths")


def check_routes_file(target: str, space: ConfigurationSpace | None = None, *, timed: bool = False) -> None:
    """Refuse a file that routes cannot be written to."""
    suffix = suffix_of(target, _VIEWS, "paths")
    if space is not None and suffix != ".yaml":
        own = {".csv": ["path", "k", "outcome"], ".npz": ["points", "cells"]}.get(suffix, [])
        require_names(space.axes, [*own, *column_names(space, timed=timed)])


def route_record(route: Route, *, points: bool = True) -> dict[str, Any]:
    """What is known of a route; points in world coordinates."""
    path = route.streamline
    record: dict[str, Any] = {
        "outcome": str(path.outcome),
        "goal": path.goal,
        "length": path.length,
        "clearance": path.clearance,
        "log_duration": path.log_duration,
        "start": list(route.start),
        "k": route.streamline.field.k,
        "certified": True,
    }
    if not route.reached:
        record["message"] = path.reason
    if points:
        record |= {"points": path.points, "cells": path.cells}
    if route.short is not None:
        record["short"] = {"length": route.short.length, "clearance": route.short.clearance}
    if route.motion is not None:
        record["duration"] = route.motion.duration
    return record


def _routes_table(routes: Sequence[Route]) -> dict[str, list[Any]]:
    """One row a point, route after route."""
    table: dict[str, list[Any]] = {name: [] for name in ("path", "k", "outcome")}
    for number, route in enumerate(routes):
        columns: dict[str, list[Any]] = {name: column.tolist() for name, column in _columns(route).items()}
        count = len(next(iter(columns.values())))
        head: dict[str, list[Any]] = {
            "path": [number] * count,
            "k": [route.streamline.field.k] * count,
            "outcome": [str(route.streamline.outcome)] * count,
        }
        for name, column in (head | columns).items():
            table.setdefault(name, []).extend(column)
    return table


def _columns(route: Route) -> dict[str, NDArray[np.float64]]:
    """A streamline's points as they are; shortened or timed ones continuous across seams."""
    columns = path_columns(route.final)
    if route.final is route.streamline:
        path = route.streamline
        columns |= {axis.name: path.points[:, number] for number, axis in enumerate(path.space.axes)}
    return columns


def _with_columns(route: Route) -> dict[str, Any]:
    """A route's record, with the columns that its points do not hold."""
    columns = _columns(route)
    if route.final is route.streamline:
        axes = {axis.name for axis in route.streamline.space.axes}
        columns = {name: column for name, column in columns.items() if name not in axes}
    return route_record(route) | ({"columns": columns} if columns else {})


def _routes_arrays(routes: Sequence[Route]) -> dict[str, Any]:
    paths = [route.streamline for route in routes]
    arrays: dict[str, Any] = {
        "outcome": [str(path.outcome) for path in paths],
        "goal": [-1 if path.goal is None else path.goal for path in paths],
        "length": [path.length for path in paths],
        "clearance": [path.clearance for path in paths],
        "k": [route.streamline.field.k for route in routes],
        "start": [route.start for route in routes],
    }
    for number, route in enumerate(routes):
        columns = {"points": route.streamline.points, "cells": route.streamline.cells, **_columns(route)}
        arrays |= {f"{name}_{number}": column for name, column in columns.items()}
    return arrays


def _documents(routes: Sequence[Route]) -> str:
    """A message for each route; one that reaches no goal has no poses."""
    for route in routes:
        _require_plane(route.streamline.space)
    return "---\n".join(ros_plan(route.final) if route.reached else _message([], [], [], "map") for route in routes)


def ros_plan(path: Timed, *, frame_id: str = "map") -> str:
    """A path as the text of a ``nav_msgs/Path`` message, which ``ros2 topic pub`` takes.

    Every pose looks towards the next, the last one as the one before; a turning polygon as its angle says.  A
    trajectory's times are the stamps.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or Trajectory
        In a space of two axes with one unit, or of a turning polygon.
    frame_id : str
        The frame that the poses are given in.

    Returns
    -------
    str

    Raises
    ------
    InputError
        If the robot does not move in the plane.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((5.5, 2.5))
    >>> print(rg.ros_plan(path, frame_id="odom")[:60])
    header:
      stamp: {sec: 0, nanosec: 0}
      frame_id: odom
    poses
    """
    space, points = path.space, _points(path)
    _require_plane(space)
    places, own = points[:, :2], (space.robot or PointRobot()).heading(points)
    yaws = headings(places) if own is None else own
    times = path.times if isinstance(path, Trajectory) else np.zeros(len(points))
    return _message(times.tolist(), places.tolist(), yaws.tolist(), frame_id)


def _message(times: Sequence[float], places: Sequence[Sequence[float]], yaws: Sequence[float], frame_id: str) -> str:
    """A ``nav_msgs/Path`` as YAML."""

    def header(time: float) -> dict[str, Any]:
        seconds, nanoseconds = divmod(round(time * 1e9), 10**9)
        return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id}

    def pose(place: Sequence[float], yaw: float) -> dict[str, Any]:
        position = {"x": place[0], "y": place[1], "z": 0.0}
        return {"position": position, "orientation": {"x": 0.0, "y": 0.0, "z": sin(yaw / 2), "w": cos(yaw / 2)}}

    rows = zip(times, places, yaws, strict=True)
    poses = [{"header": header(time), "pose": pose(place, yaw)} for time, place, yaw in rows]
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    return yaml.dump({"header": header(0.0), "poses": poses}, Dumper=dumper, sort_keys=False, default_flow_style=None)


def _require_plane(space: ConfigurationSpace) -> None:
    """Refuse a plan for ROS of what does not move in the plane."""
    robot = space.robot or PointRobot()
    flat = space.ndim == 2 and space.axes[0].unit == space.axes[1].unit and robot.moves_in_workspace
    if not flat and robot.heading(np.zeros((1, space.ndim))) is None:
        what = f"a {type(robot).__name__} with axes {', '.join(axis.name for axis in space.axes)}"
        raise InputError(f"a plan for ROS holds poses in the plane, not {what}; write .csv, .json or .npz")


def headings(place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Direction from every place to the next that differs, in radians; the last as the one before, alone 0."""
    step = np.diff(place, axis=0)
    moved = np.flatnonzero(np.any(step != 0, axis=1))
    if not len(moved):
        return np.zeros(len(place))
    angle = np.arctan2(step[moved, 1], step[moved, 0])
    return np.asarray(angle[np.minimum(np.searchsorted(moved, np.arange(len(place))), len(moved) - 1)])
