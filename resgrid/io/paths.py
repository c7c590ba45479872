"""Writers of paths: tables (CSV), records (JSON), arrays (NPZ), and messages for ROS.

All formats contain the same columns and values; world coordinates are continuous across seams of periodic axes.
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

from resgrid._internal.coordinates import coordinate_text
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.io.ros_paths import Timed, points_of, require_plane, streamline_of
from resgrid.io.ros_trajectories import has_joints, message_of, require_joints
from resgrid.io.tables import Views, require_names, suffix_of, write
from resgrid.planning.clearance import clearance_of
from resgrid.planning.node_paths import NodePath
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Outcome, Polyline, Streamline, length_of
from resgrid.planning.time_parameterization import Trajectory
from resgrid.planning.workspace import Collision

_VIEWS = ("table", "record", "arrays", "message")
"""Names of the contents of a path, which determine its file formats: CSV, JSON, NPZ and ROS message."""
_FIXED_NAMES = {".csv": ["path", "k", "outcome"], ".json": ["schema", "k", "outcome"], ".npz": ["k", "outcome"]}
"""Names of the columns (CSV), keys (JSON) or arrays (NPZ) in a file of one path that an axis may not have, by suffix.

The names of the other columns depend on the axes.
"""


def write_path(path: Timed, file: str | os.PathLike[str], *, fixed_joints: bool = False) -> Path:
    """Write a path in the format that the file's suffix selects.  The file is written atomically.

    The coordinates are world coordinates, continuous across the seams of periodic axes.  A file that the command
    ``resgrid path -o`` writes has the same columns and values.

    Parameters
    ----------
    path : Streamline, NodePath, ShortPath, Polyline or Trajectory
        Path to write.  For an arm, the file also contains the positions of its tip.
    file : path-like
        ``.csv``, or ``-`` for standard output: table with a header; ``.json``: one list per column; ``.npz``: one
        array per column; ``.yaml``: a ``nav_msgs/Path`` message for ROS, or, of a trajectory of a robot from a URDF
        file, a ``trajectory_msgs/JointTrajectory``.
    fixed_joints : bool
        Whether a JointTrajectory also has the joints that do not move and have a value in the robot's mapping `at`.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        If the suffix is unknown, an axis has the name of another column, the file cannot be written, or the format is a
        message for ROS and the path reached no goal, its configurations are neither poses in the plane nor joints of a
        robot from a URDF file, or it is a path of such a robot without times.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((5.5, 2.5))
    >>> rg.save(path, "path.csv").read_text().splitlines()[:2]
    ['path,k,outcome,x,y', '0,1.0,reached,5.5,2.5']
    """
    route = Route(path, tuple(points_of(path)[0].tolist()))
    suffix = suffix_of(file, _VIEWS, "a path")
    _check_names(path.space, suffix, _FIXED_NAMES, timed=isinstance(path, Trajectory))
    if fixed_joints:
        _require_joints_file(suffix, path.space, "fixed_joints")
    views: Views = {
        "table": lambda: _routes_table([route]),
        "record": lambda: {"k": route.k, "outcome": route.outcome, **route.columns},
        "arrays": lambda: {"k": _number(route.k), "outcome": route.outcome or "", **route.columns},
        "message": lambda: message_of(path, fixed_joints=fixed_joints),
    }
    return write(file, views, "a path")


def path_columns(path: Timed) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a path by name, arrays (n,) with one entry per point.

    The columns are: ``t`` (time in seconds) for a trajectory; one per axis, with its name: world coordinates,
    continuous across seams; the position in metres of an arm's tip (``tip_x``, ``tip_y``) or a URDF robot's tool
    (``tool_x`` to ``tool_z``); for a trajectory velocities in world coordinates per second, such as ``x_rate``.
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
    """Return the names of the columns of a path: time, position, tip of an arm (or tool of a URDF robot), velocity.

    Examples: ``t``, ``theta_1``, ``tip_x``, ``theta_1_rate``. `space`: space of the path; `timed`: whether the path is
    a trajectory; only a trajectory has time and velocity.
    """
    axes = [axis.name for axis in space.axes]
    mounted = space.robot is not None and space.robot.base is not None
    tip = [f"{space.robot.reference}_{name}" for name in "xyz"[: space.robot.workspace_ndim]] if mounted else []
    return ["t", *axes, *tip, *(f"{name}_rate" for name in axes)] if timed else [*axes, *tip]


@dataclass(frozen=True, eq=False)
class Route:
    """A requested start and the path from this start.

    Attributes
    ----------
    path : Streamline, NodePath, ShortPath, Polyline or Trajectory
        The path that is written; length and clearance are those of this path.
    start : tuple of float
        The requested start, in world coordinates.
    certified : bool
        Whether the streamline from which the path was made has a valid certificate.
    advice : str, optional
        Reason why no goal is reached, in place of the reason that the streamline gives.
    heading : float, optional
        Heading at the reached goal, in radians, that the scene demands of a robot without a heading of its own.
    workspace_clearance : float or None
        Smallest distance of an arm from obstacles along the path, in metres; None if it was not computed.
    is_tested : bool
        Whether the path was tested for collisions of the exact solids of a robot in space.
    collision : Collision or None
        First collision that this test found; None without a collision or a test.
    """

    path: Timed
    start: tuple[float, ...]
    certified: bool = False
    advice: str | None = None
    heading: float | None = None
    workspace_clearance: float | None = None
    is_tested: bool = False
    collision: Collision | None = None

    @cached_property
    def streamline(self) -> Streamline | NodePath | None:
        """Streamline or node path from which the path was made; None for a path that was not made from a field."""
        return streamline_of(self.path)

    @property
    def outcome(self) -> str | None:
        """Outcome of the streamline as text, such as ``"reached"``; None without a streamline."""
        return None if self.streamline is None else str(self.streamline.outcome)

    @property
    def reached(self) -> bool:
        """Whether the streamline from which the path was made ends in a goal; False without a streamline."""
        return self.outcome == Outcome.REACHED

    @property
    def reason(self) -> str | None:
        """Reason why no goal is reached, with a remedy; None if a goal is reached, or without a streamline."""
        return self.advice or (None if self.streamline is None else self.streamline.reason)

    @property
    def k(self) -> float | None:
        """Weight of the Dirichlet field in the blend, 0 to 1; None for a path that was not made from a field."""
        return None if self.streamline is None else self.streamline.field.k

    @cached_property
    def length(self) -> float:
        """Length of the polyline through the written points, in axis units."""
        path = self.path
        return path.length if isinstance(path, Streamline | NodePath | ShortPath) else length_of(_line(path))

    @cached_property
    def clearance(self) -> float | None:
        """Smallest distance from the polyline through the written points to an obstacle cell, in axis units.

        It is infinite without obstacles, NaN without motion, and None for a path that was not made from a field.
        """
        path = self.path
        if isinstance(path, Streamline | NodePath | ShortPath):
            return path.clearance
        if self.streamline is None:
            return None
        field = self.streamline.field
        return clearance_of(_line(path), path.space, field.edge, field.obstacle_reach)

    @property
    def duration(self) -> float | None:
        """Duration of a trajectory, in seconds; None for a path without times."""
        return self.path.duration if isinstance(self.path, Trajectory) else None

    @cached_property
    def columns(self) -> dict[str, NDArray[np.float64]]:
        """Columns of the path by name, arrays (n,) with one entry per point.

        The columns are: ``t`` (time in seconds) for a trajectory; one per axis, with its name, in continuous world
        coordinates; in metres ``tip_x`` and ``tip_y`` of an arm, or ``tool_x`` to ``tool_z`` of a URDF robot; for a
        trajectory velocities in world coordinates per second, such as ``x_rate``.
        """
        return path_columns(self.path)


def _line(path: Polyline | Trajectory) -> NDArray[np.float64]:
    """Return the points of a path that are written to the file, in axis coordinates, shape (n, ndim).

    The axes of the space have their ranges in axis coordinates; the frame of the space maps these to world coordinates.
    """
    return path.line if isinstance(path, Polyline) else path.space.from_world(path.positions)


def _number(value: float | None) -> float:
    """Return `value` unchanged; NaN for None."""
    return math.nan if value is None else value


def write_routes(routes: Sequence[Route], target: str | os.PathLike[str], *, fixed_joints: bool = False) -> Path:
    """Write several routes to one file atomically, and return the file.

    `target`: name of the file, whose suffix selects the format: one table, one record or one set of arrays for all
    routes, or one message for ROS per route.  With several routes, a comment before each message gives start, k and
    outcome; a route that reaches no goal has only the comment.  Raises InputError for messages if no route reaches a
    goal.  `fixed_joints`: whether messages also have the joints that do not move and have a value in the robot's `at`.
    """
    views: Views = {
        "table": lambda: _routes_table(routes),
        "record": lambda: {"paths": [route_record(route) | {"columns": route.columns} for route in routes]},
        "arrays": lambda: _routes_arrays(routes),
        "message": lambda: _documents(routes, fixed_joints=fixed_joints),
    }
    return write(target, views, "paths")


def _require_joints_file(suffix: str, space: ConfigurationSpace, option: str) -> None:
    """Raise InputError unless paths of a robot from a URDF file are written to a file for ROS (``.yaml``).

    `suffix`: suffix of the file; `space`: space of the paths; `option`: option of the command line that needs such a
    file, for the message.
    """
    if suffix != ".yaml" or not has_joints(space):
        raise InputError(f"{option} applies to .yaml files of robots from URDF files only; leave it out")


def check_fixed_joints(target: str | None, space: ConfigurationSpace) -> None:
    """Raise InputError unless routes of a space are written as messages that can contain fixed joints.

    `target`: name of the file, None for none; only a ``.yaml`` file of a robot from a URDF file has such messages.
    """
    _require_joints_file("" if target is None else suffix_of(target, _VIEWS, "paths"), space, "--fixed-joints")


def check_routes_file(target: str, space: ConfigurationSpace | None = None, *, timed: bool = False) -> None:
    """Raise InputError if routes cannot be written to a file named `target`, because of its suffix or a column name.

    `space`: space of the routes, None if unknown, which omits the check of the names; `timed`: whether the routes are
    trajectories.
    """
    suffix = suffix_of(target, _VIEWS, "paths")
    if space is not None:
        _check_names(space, suffix, {".csv": _FIXED_NAMES[".csv"], ".npz": ["points", "cells"]}, timed=timed)


def _check_names(space: ConfigurationSpace, suffix: str, fixed: dict[str, list[str]], *, timed: bool) -> None:
    """Raise InputError if an axis has the name of another column, or a message for ROS cannot represent the poses.

    `space`: space of the paths; `suffix`: suffix of the file, such as ``.csv``; `fixed`: for each suffix, names of
    columns in addition to time, axes, tip and velocities; `timed`: whether the paths are trajectories.
    """
    if suffix == ".yaml" and has_joints(space):
        require_joints(space, timed=timed)
    elif suffix == ".yaml":
        require_plane(space)
    else:
        require_names(space.axes, [*fixed.get(suffix, []), *column_names(space, timed=timed)])


def route_record(route: Route, *, points: bool = True) -> dict[str, Any]:
    """Return the results of a route as a dictionary for JSON.

    Keys: ``outcome``, ``goal`` (index of the region, or None), ``log_duration`` (log of the streamline's time),
    ``start``, ``k``, ``certified``; ``length``, ``clearance`` in axis units, ``points`` (continuous world coordinates)
    of the written path; ``cells`` (indices of the cells that the streamline crosses); where they apply, ``message``
    (reason), ``goal_heading`` in radians, ``duration`` in seconds, and ``streamline`` and ``short`` with length and
    clearance of the original and the shortened path.  `points`: whether to include points and cells.
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
    if route.heading is not None:
        record["goal_heading"] = route.heading
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
    return record | _workspace_record(route)


def _workspace_record(route: Route) -> dict[str, Any]:
    """Return ``workspace_clearance`` in metres and ``collision`` as a dictionary for JSON, without unknown entries.

    The collision is None or a dictionary of ``configuration`` and ``bodies`` (names); a route that was not tested has
    no such key.
    """
    record: dict[str, Any] = {}
    if route.workspace_clearance is not None:
        record["workspace_clearance"] = route.workspace_clearance
    if route.is_tested:
        hit = route.collision
        record["collision"] = None if hit is None else {"configuration": hit.configuration, "bodies": hit.names}
    return record


def _routes_table(routes: Sequence[Route]) -> dict[str, list[Any]]:
    """Return the columns of a table of all routes by name, with one row per point of a route.

    The first columns are ``path`` (index of the route), ``k`` and ``outcome``.  A route without a column that others
    have, such as a time, has NaN there.
    """
    names = max((list(route.columns) for route in routes), key=len, default=[])
    table: dict[str, list[Any]] = {name: [] for name in (*_FIXED_NAMES[".csv"], *names)}
    for number, route in enumerate(routes):
        count = len(points_of(route.path))
        for name, value in (("path", number), ("k", _number(route.k)), ("outcome", route.outcome or "")):
            table[name] += [value] * count
        for name in names:
            table[name] += route.columns[name].tolist() if name in route.columns else [math.nan] * count
    return table


def _routes_arrays(routes: Sequence[Route]) -> dict[str, Any]:
    """Return the arrays of all routes by name.

    Arrays such as outcome and length have one entry per route; the columns of route ``i`` are arrays with the suffix
    ``_i``. Missing numbers are NaN, a missing goal is -1, and a missing outcome is an empty text.
    """
    goals = [None if route.streamline is None else route.streamline.goal for route in routes]
    arrays: dict[str, Any] = {
        "outcome": [route.outcome or "" for route in routes],
        "goal": [-1 if goal is None else goal for goal in goals],
        "length": [route.length for route in routes],
        "clearance": [_number(route.clearance) for route in routes],
        "k": [_number(route.k) for route in routes],
        "start": [route.start for route in routes],
    }
    if any(route.workspace_clearance is not None for route in routes):
        arrays["workspace_clearance"] = [_number(route.workspace_clearance) for route in routes]
    for number, route in enumerate(routes):
        columns: dict[str, Any] = {"points": points_of(route.path)}
        if route.streamline is not None:
            columns["cells"] = route.streamline.cells
        arrays |= {f"{name}_{number}": column for name, column in (columns | route.columns).items()}
    return arrays


def _documents(routes: Sequence[Route], *, fixed_joints: bool) -> str:
    """Return YAML text: for each route a comment with start, k and outcome, and a message if it reaches a goal.

    A single route has no comment.  Raises InputError if no route reaches a goal.  `fixed_joints`: whether messages also
    have the joints that do not move and have a value in the robot's `at`.
    """
    if len(routes) == 1:
        return message_of(routes[0].path, heading=routes[0].heading, fixed_joints=fixed_joints)
    if not any(route.reached for route in routes):
        raise InputError(
            "no path reaches a goal, and a message for ROS cannot hold an outcome; write .csv, .json or .npz"
        )
    text, begin = "", ""
    for route in routes:
        place = ", ".join(map(coordinate_text, route.start))
        comment = f"# start ({place}), k = {_number(route.k):g}: {route.outcome}\n"
        message = message_of(route.path, heading=route.heading, fixed_joints=fixed_joints) if route.reached else ""
        text += f"{begin}{comment}{message}" if route.reached else comment
        begin = "---\n" if route.reached else begin
    return text
