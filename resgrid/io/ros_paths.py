"""Paths as the text of ``nav_msgs/Path`` messages for ROS, their points and poses, and checks for such messages."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from resgrid._internal.validation import with_article
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.any_path import AnyPath, unwrap
from resgrid.planning.node_paths import NodePath
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.planning.time_parameterization import Trajectory
from resgrid.robots import PointRobot

Timed = AnyPath | Trajectory
"""Type of a path with or without times."""


def points_of(path: Timed) -> NDArray[np.float64]:
    """Return the points (n, ndim) of a path in world coordinates, continuous across the seams of periodic axes."""
    return path.positions if isinstance(path, Trajectory) else unwrap(path)


def streamline_of(path: Timed) -> Streamline | NodePath | None:
    """Return the streamline or node path from which a path was made; None for a path that was not made from a field."""
    if isinstance(path, Trajectory):
        path = path.path
    if isinstance(path, ShortPath):
        path = path.original
    return path if isinstance(path, Streamline | NodePath) else None


def to_ros_path(path: Timed, *, frame_id: str = "map", heading: float | None = None) -> str:
    """Return the text of a ``nav_msgs/Path`` message of a path, as ``ros2 topic pub`` reads it.

    Every pose is oriented towards the next one, the last pose like the one before; for a polygon that turns, the pose
    has the heading of the polygon.  The stamps are the times of a trajectory, and 0 for other paths.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or Trajectory
        In a space of two axes with the same unit, or of a turning polygon.  A streamline must have reached a goal.
    frame_id : str
        Coordinate frame of the poses.
    heading : float, optional
        Heading of the last pose in radians, for a robot without a heading of its own, which can turn in place; by
        default the direction of motion.

    Returns
    -------
    str
        YAML text.

    Raises
    ------
    InputError
        If the robot does not move in the plane, or the path reached no goal (the message has no field for an outcome).

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((5.5, 2.5))
    >>> print(rg.maps.to_ros_path(path, frame_id="odom")[:60])
    header:
      stamp: {sec: 0, nanosec: 0}
      frame_id: odom
    poses
    """
    require_plane(path.space)
    require_reached(path)
    poses = path_poses(path, heading=heading)
    times = path.times if isinstance(path, Trajectory) else np.zeros(len(poses))
    return _message(times.tolist(), poses[:, :2].tolist(), poses[:, 2].tolist(), frame_id)


def path_poses(path: Timed, *, heading: float | None = None) -> NDArray[np.float64]:
    """Return the poses of a path in the plane, as in its ``nav_msgs/Path`` message.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or Trajectory
        In a space of two axes with the same unit, or of a turning polygon.
    heading : float, optional
        Heading of the last pose in radians, for a robot without a heading of its own; by default the direction of
        motion.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        World coordinates x and y, and the heading in radians: towards the next point, or that of a turning robot.

    Raises
    ------
    InputError
        If the robot does not move in the plane.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((5.5, 2.5))
    >>> rg.maps.path_poses(path, heading=0.5)[[0, -1]].round(2)
    array([[ 5.5 ,  2.5 , -0.73],
           [ 6.01,  2.  ,  0.5 ]])
    """
    require_plane(path.space)
    points = points_of(path)
    places, own = points[:, :2], (path.space.robot or PointRobot()).heading(points)
    yaws = headings(places) if own is None else own
    if heading is not None and own is None:
        yaws[-1] = heading
    return np.column_stack([places, yaws])


def require_reached(path: Timed) -> None:
    """Raise InputError if the streamline from which a path was made reached no goal.

    A message cannot contain an outcome: without this check, it would look like the message of a path to a goal.
    """
    streamline = streamline_of(path)
    if streamline is not None and streamline.outcome is not Outcome.REACHED:
        raise InputError(
            f"this path ended with {str(streamline.outcome)!r} ({streamline.reason}), and a message for ROS cannot "
            "hold an outcome; test path.outcome first, or write .csv, .json or .npz, which hold it"
        )


def require_plane(space: ConfigurationSpace) -> None:
    """Raise InputError unless the configurations of a space are poses in the plane, with or without a heading."""
    if not has_poses(space):
        robot, axes = (
            with_article(type(space.robot or PointRobot()).__name__),
            ", ".join(axis.name for axis in space.axes),
        )
        raise InputError(
            f"a nav_msgs/Path holds poses in the plane, not {robot} with axes {axes}; write .csv, .json or .npz"
        )


def has_poses(space: ConfigurationSpace) -> bool:
    """Return whether the configurations of a space are poses in the plane, with or without a heading.

    This holds if the robot has a heading, or if its configurations are positions and the space has two axes with the
    same unit.
    """
    robot = space.robot or PointRobot()
    is_flat = space.ndim == 2 and space.axes[0].unit == space.axes[1].unit and robot.moves_in_workspace
    return is_flat or robot.heading(np.zeros((1, space.ndim))) is not None


def headings(place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the direction (n,) from every point to the next distinct point, in radians from the first axis.

    `place` (n, 2): the points.  A point without a later distinct point has the direction of the last motion; the
    direction is 0 if all points are equal.
    """
    step = np.diff(place, axis=0)
    moved = np.flatnonzero(np.any(step != 0, axis=1))
    if not len(moved):
        return np.zeros(len(place))
    angle = np.arctan2(step[moved, 1], step[moved, 0])
    return np.asarray(angle[np.minimum(np.searchsorted(moved, np.arange(len(place))), len(moved) - 1)])


def ros_time(nanoseconds: int) -> dict[str, int]:
    """Return the fields of a ``builtin_interfaces`` Time or Duration message, by name; `nanoseconds`: the time."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return {"sec": seconds, "nanosec": rest}


def ros_quaternion(yaw: float) -> dict[str, float]:
    """Return the fields of a ``geometry_msgs/Quaternion`` message, by name; `yaw`: heading in radians."""
    return {"x": 0.0, "y": 0.0, "z": sin(yaw / 2), "w": cos(yaw / 2)}


def _message(times: Sequence[float], places: Sequence[Sequence[float]], yaws: Sequence[float], frame_id: str) -> str:
    """Return a ``nav_msgs/Path`` message as YAML text.

    `times` (n,): time stamps in seconds; `places` (n, 2): positions; `yaws` (n,): headings in radians; `frame_id`: name
    of the coordinate frame.
    """

    def header(time: float) -> dict[str, Any]:
        return {"stamp": ros_time(round(time * 1e9)), "frame_id": frame_id}

    def pose(place: Sequence[float], yaw: float) -> dict[str, Any]:
        position = {"x": place[0], "y": place[1], "z": 0.0}
        return {"position": position, "orientation": ros_quaternion(yaw)}

    rows = zip(times, places, yaws, strict=True)
    poses = [{"header": header(time), "pose": pose(place, yaw)} for time, place, yaw in rows]
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    return yaml.dump({"header": header(0.0), "poses": poses}, Dumper=dumper, sort_keys=False, default_flow_style=None)
