"""Trajectories of robot arms as ``trajectory_msgs/JointTrajectory`` messages for ROS 2, and the choice of a message."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from resgrid._internal.validation import with_article
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.io.ros_paths import Timed, require_reached, ros_time, to_ros_path
from resgrid.planning.time_parameterization import Trajectory


def message_of(path: Timed, *, heading: float | None = None, fixed_joints: bool = False) -> str:
    """Return a path as the text of a message for ROS: a JointTrajectory for robots with named joints, else a Path.

    `heading`: heading of the last pose of a Path in radians, None for the direction of motion; `fixed_joints`: whether
    a JointTrajectory also has the joints that do not move and have a value in the robot's `at`.
    """
    if has_joints(path.space):
        return to_ros_trajectory(path, fixed_joints=fixed_joints)
    return to_ros_path(path, heading=heading)


def to_ros_trajectory(path: Timed, *, frame_id: str = "", fixed_joints: bool = False) -> str:
    """Return the text of a ``trajectory_msgs/JointTrajectory`` message, as ``ros2 topic pub`` reads it.

    A ``joint_trajectory_controller`` interpolates points with positions by lines, and points with positions and
    velocities by cubic splines.  A message has velocities if, and only if, the velocities do not jump, which
    requires acceleration limits: the splines are then exactly the motion of the trajectory.  In a message without
    velocities, the lines are exactly the path.  Accelerations are left out, because they jump between knots, and
    quintic splines through them would leave the path.  CSV, JSON and NPZ files have the velocities of all trajectories.

    Parameters
    ----------
    path : Trajectory
        Of a robot from a URDF file; its streamline must have reached a goal.  Angles of continuous joints do not jump
        at their seam.
    frame_id : str
        Coordinate frame in the header; a controller of joints needs none.
    fixed_joints : bool
        Whether to include the joints that do not move and have a value in the robot's mapping `at`, for controllers
        that need all joints of an arm in every message.

    Returns
    -------
    str
        YAML text.  The time stamp 0 lets the motion begin at once.

    Raises
    ------
    InputError
        If the robot has no named joints, the path has no times, or it reached no goal (the message has no field for an
        outcome).

    Examples
    --------
    >>> robot = rg.URDFRobot("examples/robots/scara.urdf", moving=("shoulder", "elbow"))
    >>> space = rg.ConfigurationSpace(robot.axes(8), np.zeros((8, 8)), robot=robot)
    >>> motion = rg.time_parameterize(rg.Polyline([(0.0, 0.0), (1.0, 0.5)], space), velocity_limits=0.5)
    >>> print(rg.maps.to_ros_trajectory(motion))
    header:
      stamp: {sec: 0, nanosec: 0}
      frame_id: ''
    joint_names: [shoulder, elbow]
    points:
    - positions: [0.0, 0.0]
      velocities: []
      accelerations: []
      effort: []
      time_from_start: {sec: 0, nanosec: 0}
    - positions: [1.0, 0.5]
      velocities: []
      accelerations: []
      effort: []
      time_from_start: {sec: 2, nanosec: 0}
    <BLANKLINE>
    """
    require_joints(path.space, timed=isinstance(path, Trajectory))
    assert isinstance(path, Trajectory)
    require_reached(path)
    robot = path.space.robot
    fixed = dict(robot.fixed_joints) if fixed_joints else {}
    nanoseconds, rows = _distinct_times(path.times)
    positions = np.column_stack([path.positions, np.tile([*fixed.values()], (len(path.times), 1))])[rows]
    velocities = np.column_stack([path.velocities, np.zeros((len(path.times), len(fixed)))])[rows]
    smooth = _is_smooth(path.motion or path)
    points = [
        {
            "positions": position.tolist(),
            "velocities": velocity.tolist() if smooth else [],
            "accelerations": [],
            "effort": [],
            "time_from_start": ros_time(time),
        }
        for position, velocity, time in zip(positions, velocities, nanoseconds.tolist(), strict=True)
    ]
    message = {
        "header": {"stamp": ros_time(0), "frame_id": frame_id},
        "joint_names": [*robot.joint_names, *fixed],
        "points": points,
    }
    return _as_yaml(message)


def has_joints(space: ConfigurationSpace) -> bool:
    """Return whether the robot of a space has named joints, as a robot from a URDF file."""
    return space.robot is not None and bool(space.robot.joint_names)


def require_joints(space: ConfigurationSpace, *, timed: bool) -> None:
    """Raise InputError unless a path can be a JointTrajectory: its robot has named joints, and it has times.

    `space`: space of the path; `timed`: whether the path has times.
    """
    if not has_joints(space):
        kind = "a point" if space.robot is None else with_article(type(space.robot).__name__)
        raise InputError(f"a JointTrajectory holds the joints of a robot from a URDF file, not {kind}; write .csv")
    if not timed:
        raise InputError(
            "a JointTrajectory needs times: give a trajectory (rg.time_parameterize(path); on the command line --speed "
            "V), or write .csv, .json or .npz"
        )


def _is_smooth(motion: Trajectory) -> bool:
    """Return whether the velocities of a trajectory do not jump, which is so if and only if it starts at rest."""
    return not motion.velocities[0].any()


def _distinct_times(times: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return ascending times in nanoseconds (m,), and the indices (m,) of the knots at these times.

    `times` (n,): times of the knots in seconds. Of knots with the same time in nanoseconds the last one is kept,
    because controllers require increasing times.
    """
    rounded = np.round(times * 10**9).astype(np.int64)
    rows = np.flatnonzero(np.append(np.diff(rounded) > 0, True))
    return rounded[rows], rows


def _as_yaml(message: dict[str, Any]) -> str:
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    return yaml.dump(
        message, Dumper=dumper, sort_keys=False, default_flow_style=None, width=1_000_000, allow_unicode=True
    )
