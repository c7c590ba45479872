"""Paths as files: tables, records, arrays, and messages for ROS.

All of them hold the same columns and values: world coordinates that are continuous across periodic seams.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.io.ros_paths import Timed, points_of, require_plane, streamline_of, to_ros_path
from resgrid.io.tables import Views, require_names, suffix_of, write
from resgrid.planning.clearance import clearance_of
from resgrid.planning.streamline import Outcome, Polyline, ShortPath, Streamline, length_of
from resgrid.planning.time_parameterization import Trajectory

_VIEWS = ("table", "record", "arrays", "message")
_OWN = {".csv": ["path", "k", "outcome"], ".json": ["schema", "k", "outcome"], ".npz": ["k", "outcome"]}
"""Columns, keys and arrays of a file of one path beside those of `column_names`."""


def write_path(path: Timed, file: str | os.PathLike[str]) -> Path:
    """Write a path, whole or not at all, in the format that the end of the file's name says.

    Coordinates are those of the world, and continuous across periodic seams; a file of ``resgrid path -o`` has the same
    columns and values.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or Trajectory
        The files of an arm also have the place of its tip.
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
        If the name ends otherwise, the path does not fit, an axis has the name of another column, the file cannot be
        written, or a message for ROS is asked of a path that reached no goal.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((5.5, 2.5))
    >>> rg.save(path, "path.csv").read_text().splitlines()[:2]
    ['path,k,outcome,x,y', '0,1.0,reached,5.5,2.5']
    """
    route = Route(path, tuple(points_of(path)[0].tolist()))
    _check_names(path.space, suffix_of(file, _VIEWS, "a path"), _OWN, timed=isinstance(path, Trajectory))
    views: Views = {
        "table": lambda: _routes_table([route]),
        "record": lambda: {"k": route.k, "outcome": route.outcome, **route.columns},
        "arrays": lambda: {"k": _number(route.k), "outcome": route.outcome or "", **route.columns},
        "message": lambda: to_ros_path(path),
    }
    return write(file, views, "a path")


def path_columns(path: Timed) -> dict[str, NDArray[np.float64]]:
    """Return a path as named columns, one entry a point, in continuous world coordinates.

    Shapes: returns (n,).
    """
    space, points = path.space, points_of(path)
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


@dataclass(frozen=True, eq=False)
class Route:
    """A start and the path from it, as a robot is to follow it.

    Attributes
    ----------
    path : Streamline, ShortPath, Polyline or Trajectory
        The path that is written; its figures are those of the route.
    start : tuple of float
        The start that was asked for, in world coordinates.
    certified : bool
        Whether the streamline has passed `certify`.
    advice : str, optional
        Why no goal is reached, in place of `Streamline.reason`.
    """

    path: Timed
    start: tuple[float, ...]
    certified: bool = False
    advice: str | None = None

    @cached_property
    def streamline(self) -> Streamline | None:
        """The streamline that the path was made of; None for a path without a field."""
        return streamline_of(self.path)

    @property
    def outcome(self) -> str | None:
        """The outcome of the streamline; None without one."""
        return None if self.streamline is None else str(self.streamline.outcome)

    @property
    def reached(self) -> bool:
        """Whether the streamline ends in a goal."""
        return self.outcome == Outcome.REACHED

    @property
    def reason(self) -> str | None:
        """Why no goal is reached, and what to do; None where one is."""
        return self.advice or (None if self.streamline is None else self.streamline.reason)

    @property
    def k(self) -> float | None:
        """Fraction of the Dirichlet field; None without a field."""
        return None if self.streamline is None else self.streamline.field.k

    @cached_property
    def length(self) -> float:
        """Length of the polyline through the points that are written, in axis units."""
        path = self.path
        return path.length if isinstance(path, Streamline | ShortPath) else length_of(_line(path))

    @cached_property
    def clearance(self) -> float | None:
        """Least distance from that polyline to an obstacle cell, in axis units; None without a field."""
        path = self.path
        if isinstance(path, Streamline | ShortPath):
            return path.clearance
        if self.streamline is None:
            return None
        field = self.streamline.field
        return clearance_of(_line(path), path.space, field.edge, field.obstacle_reach)

    @property
    def duration(self) -> float | None:
        """Time from start to end, in seconds; None for a path without times."""
        return self.path.duration if isinstance(self.path, Trajectory) else None

    @cached_property
    def columns(self) -> dict[str, NDArray[np.float64]]:
        """The columns of the path, `path_columns`."""
        return path_columns(self.path)


def _line(path: Polyline | Trajectory) -> NDArray[np.float64]:
    """The points that are written, in axis units, shape (n, ndim)."""
    return path.line if isinstance(path, Polyline) else path.space.from_world(path.positions)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def write_routes(routes: Sequence[Route], target: str | os.PathLike[str]) -> Path:
    """Write routes, whole or not at all: one table, record or set of arrays for all, or one message for ROS each.

    Messages of several routes name their starts in comments; a route that reaches no goal has its outcome there
    instead of a message.  Raises InputError where no route has a message.
    """
    views: Views = {
        "table": lambda: _routes_table(routes),
        "record": lambda: {"paths": [route_record(route) | {"columns": route.columns} for route in routes]},
        "arrays": lambda: _routes_arrays(routes),
        "message": lambda: _documents(routes),
    }
    return write(target, views, "paths")


def check_routes_file(target: str, space: ConfigurationSpace | None = None, *, timed: bool = False) -> None:
    """Raise InputError for a file that routes cannot be written to."""
    suffix = suffix_of(target, _VIEWS, "paths")
    if space is not None:
        _check_names(space, suffix, {".csv": _OWN[".csv"], ".npz": ["points", "cells"]}, timed=timed)


def _check_names(space: ConfigurationSpace, suffix: str, own: dict[str, list[str]], *, timed: bool) -> None:
    """Raise InputError if an axis has the name of another column, or the robot no poses for a message."""
    if suffix == ".yaml":
        require_plane(space)
    else:
        require_names(space.axes, [*own.get(suffix, []), *column_names(space, timed=timed)])


def route_record(route: Route, *, points: bool = True) -> dict[str, Any]:
    """Return the figures of a route, and its points in continuous world coordinates.

    `length`, `clearance` and `points` are those of the path that is written; of a shortened or timed one `streamline`
    holds those of the streamline.
    """
    path = route.streamline
    record: dict[str, Any] = {
        "outcome": route.outcome,
        "goal": None if path is None else path.goal,
        "length": route.length,
        "clearance": route.clearance,
        "log_duration": None if path is None else path.log_duration,
        "start": list(route.start),
        "k": route.k,
        "certified": route.certified,
    }
    if route.reason is not None:
        record["message"] = route.reason
    if points:
        record |= {"points": points_of(route.path), "cells": None if path is None else path.cells}
    if path is not None and route.path is not path:
        record["streamline"] = {"length": path.length, "clearance": path.clearance}
    short = route.path.path if isinstance(route.path, Trajectory) else route.path
    if isinstance(short, ShortPath):
        record["short"] = {"length": short.length, "clearance": short.clearance}
    if route.duration is not None:
        record["duration"] = route.duration
    return record


def _routes_table(routes: Sequence[Route]) -> dict[str, list[Any]]:
    """One row a point, route after route; empty where a route has no such column."""
    names = max((list(route.columns) for route in routes), key=len, default=[])
    table: dict[str, list[Any]] = {name: [] for name in (*_OWN[".csv"], *names)}
    for number, route in enumerate(routes):
        count = len(points_of(route.path))
        for name, value in (("path", number), ("k", _number(route.k)), ("outcome", route.outcome or "")):
            table[name] += [value] * count
        for name in names:
            table[name] += route.columns[name].tolist() if name in route.columns else [math.nan] * count
    return table


def _routes_arrays(routes: Sequence[Route]) -> dict[str, Any]:
    goals = [None if route.streamline is None else route.streamline.goal for route in routes]
    arrays: dict[str, Any] = {
        "outcome": [route.outcome or "" for route in routes],
        "goal": [-1 if goal is None else goal for goal in goals],
        "length": [route.length for route in routes],
        "clearance": [_number(route.clearance) for route in routes],
        "k": [_number(route.k) for route in routes],
        "start": [route.start for route in routes],
    }
    for number, route in enumerate(routes):
        columns: dict[str, Any] = {"points": points_of(route.path)}
        if route.streamline is not None:
            columns["cells"] = route.streamline.cells
        arrays |= {f"{name}_{number}": column for name, column in (columns | route.columns).items()}
    return arrays


def _documents(routes: Sequence[Route]) -> str:
    """A message for each route that reaches a goal; comments name the starts and the outcomes of the others."""
    if len(routes) == 1:
        return to_ros_path(routes[0].path)
    if not any(route.reached for route in routes):
        raise InputError("no path reaches a goal, so there is no message to write; write .csv, .json or .npz")
    text, begin = "", ""
    for route in routes:
        place = ", ".join(f"{value:.6g}" for value in route.start)
        comment = f"# start ({place}), k = {_number(route.k):g}: {route.outcome}\n"
        text += f"{begin}{comment}{to_ros_path(route.path)}" if route.reached else comment
        begin = "---\n" if route.reached else begin
    return text
