"""Paths as files: tables, JSON, NumPy arrays, and plans for ROS."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping, Sequence
from math import cos, isfinite, sin
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError
from resgrid.files import atomic_path, write_text
from resgrid.planning.streamline import Path, robot_of, unwrap
from resgrid.planning.timing import Trajectory
from resgrid.robots import PointRobot, Robot
from resgrid.space import Axis, ConfigurationSpace

SUFFIXES = (".csv", ".json", ".npz", ".yaml")

_TAKEN = {".json": ("schema",), ".npz": ("file", "allow_pickle")}
"""Names that a format keeps for itself."""


def path_columns(path: Path | Trajectory) -> dict[str, NDArray[np.float64]]:
    """A path as named columns, one entry a point, shape (n,)."""
    space, robot, points = path.space, robot_of(_untimed(path)), _points(path)
    require_names(space.axes, other_columns(space.axes, robot, timed=isinstance(path, Trajectory)))
    columns = _named(space, points)
    if robot.base is not None:
        columns |= dict(zip(_reference_columns(robot), robot.reference_point(points).T, strict=True))
    if isinstance(path, Trajectory):
        columns = {"t": np.array(path.times)} | columns | _named(space, path.velocities, "_rate")
    return columns


def write_path(path: Path | Trajectory, target: str | os.PathLike[str]) -> FilePath:
    """Write a path, whole or not at all, as the suffix says.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or Trajectory
    target : path-like
        ``.csv``: a table with a header; ``.json``: one list a column; ``.npz``: one array a column; ``.yaml``: a
        ``nav_msgs/Path`` for ROS.  An arm's files say where its tip is.

    Returns
    -------
    Path
        The target.

    Raises
    ------
    InputError
        If the suffix is none of these, the path does not fit, an axis has the name of another column, or the file
        cannot be written.
    """
    file = FilePath(target)
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"cannot write a path as {str(target)!r}: its suffix must be one of {', '.join(SUFFIXES)}")
    if suffix == ".yaml":
        return write_text(file, ros_plan(path))
    columns = path_columns(path)
    require_names(path.space.axes, _TAKEN.get(suffix, ()))
    if suffix == ".npz":
        with atomic_path(file) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **columns)  # type: ignore[arg-type]
        return file
    return write_text(file, csv_table(columns) if suffix == ".csv" else _json(columns))


def other_columns(axes: Sequence[Axis], robot: Robot | None, *, timed: bool) -> set[str]:
    """Names of the columns that a path has beside those of its axes."""
    return set(_reference_columns(robot)) | ({"t", *(f"{axis.name}_rate" for axis in axes)} if timed else set())


def _reference_columns(robot: Robot | None) -> dict[str, None]:
    """Names of the columns that say where the end of a mounted robot is, in order."""
    return {} if robot is None or robot.base is None else dict.fromkeys(f"{robot.reference}_{name}" for name in "xy")


def require_names(axes: Sequence[Axis], others: Collection[str]) -> None:
    """Refuse a file in which the column of an axis would have the name of another one."""
    for axis in axes:
        if axis.name in others:
            raise InputError(
                f"axis {axis.name!r} has a name that this file needs for something else; rename the axis, or write "
                "another format"
            )


def _untimed(path: Path | Trajectory) -> Path:
    return path.path if isinstance(path, Trajectory) else path


def _points(path: Path | Trajectory) -> NDArray[np.float64]:
    """Points of the world, continuous across periodic seams."""
    return path.positions if isinstance(path, Trajectory) else unwrap(path)


def csv_table(columns: Mapping[str, ArrayLike]) -> str:
    """Named columns as comma-separated text with a header; numbers so that they are read back the same."""
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n"


def ros_plan(path: Path | Trajectory, *, frame_id: str = "map") -> str:
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
    """
    points, robot = _points(path), robot_of(_untimed(path))
    require_plan(path.space, robot)
    place = points[:, :2]
    own = robot.heading(points)
    yaw = headings(place) if own is None else own
    times = path.times if isinstance(path, Trajectory) else np.zeros(len(points))
    head = f"header:\n{_stamp(0.0, frame_id, '  ')}poses:"
    return "\n".join([head, *map(_pose, times, place, yaw, [frame_id] * len(place))]) + "\n"


def require_plan(space: ConfigurationSpace, robot: Robot | None) -> None:
    """Refuse a plan for ROS of what does not move in the plane."""
    mover = robot or PointRobot()
    flat = space.ndim == 2 and space.axes[0].unit == space.axes[1].unit and mover.moves_in_workspace
    if not flat and mover.heading(np.zeros((1, space.ndim))) is None:
        what = f"a {type(mover).__name__} with axes {', '.join(axis.name for axis in space.axes)}"
        raise InputError(f"a plan for ROS holds poses in the plane, not {what}; write .csv, .json or .npz")


def headings(place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Direction from every place to the next that differs, in radians; the last as the one before, alone 0."""
    step = np.diff(place, axis=0)
    moved = np.flatnonzero(np.any(step != 0, axis=1))
    if not len(moved):
        return np.zeros(len(place))
    angle = np.arctan2(step[moved, 1], step[moved, 0])
    return np.asarray(angle[np.minimum(np.searchsorted(moved, np.arange(len(place))), len(moved) - 1)])


def _named(space: ConfigurationSpace, values: NDArray[np.float64], end: str = "") -> dict[str, NDArray[np.float64]]:
    return {f"{axis.name}{end}": values[:, number] for number, axis in enumerate(space.axes)}


def _json(columns: Mapping[str, NDArray[np.float64]]) -> str:
    data: dict[str, Any] = {"schema": 1}
    data |= {name: [x if isfinite(x) else None for x in column.tolist()] for name, column in columns.items()}
    return json.dumps(data, allow_nan=False, indent=2) + "\n"


def _pose(time: float, place: Sequence[float], yaw: float, frame_id: str) -> str:
    x, y = (_number(value) for value in place)
    z, w = _number(sin(yaw / 2)), _number(cos(yaw / 2))
    return (
        f"- header:\n{_stamp(time, frame_id, '    ')}"
        f"  pose:\n    position: {{x: {x}, y: {y}, z: 0.0}}\n    orientation: {{x: 0.0, y: 0.0, z: {z}, w: {w}}}"
    )


def _stamp(time: float, frame_id: str, indent: str) -> str:
    seconds, nanoseconds = divmod(round(time * 1e9), 10**9)
    quoted = json.dumps(frame_id)
    return f"{indent}stamp: {{sec: {seconds}, nanosec: {nanoseconds}}}\n{indent}frame_id: {quoted}\n"


def _number(value: float) -> str:
    """A number that every reader of YAML takes for one: 1e-05 is text in YAML 1.1."""
    text = repr(float(value))
    head, power, tail = text.partition("e")
    return f"{head}.0e{tail}" if power and "." not in head else text
