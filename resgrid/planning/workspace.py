"""Paths in the workspace: positions of the robot, clearance from obstacles, and collisions, with exact geometry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import Positive
from resgrid._internal.values import frozen
from resgrid.errors import InputError
from resgrid.planning.any_path import AnyPath, robot_of, unwrap
from resgrid.planning.time_parameterization import Trajectory
from resgrid.robots import Shape
from resgrid.robots.collision_tests import CollisionTest
from resgrid.scene.world_coordinates import to_space

_MOST = 5_000_000
"""Maximum number of sampled configurations of a path; for more, InputError is raised."""

_BATCH = 4096
"""Number of configurations per vectorized distance computation."""


@frozen
@dataclass(frozen=True, eq=False)
class Collision:
    """First collision of a robot with an obstacle, or of an arm in space with itself, along a path.

    Returned by `resgrid.check_collisions`.  Indices start at 0.

    Attributes
    ----------
    segment : int
        Index of the segment of the path, or of the part between two knots of a trajectory.
    configuration : ndarray of float64, shape (ndim,)
        Configuration of the robot, in world coordinates.
    part : int
        Index of the rigid part of the robot that collides, such as a link of an arm or a body of a robot from a URDF
        file.
    obstacle : int or None
        Index of the obstacle in the given sequence; None for a collision of the robot with itself.
    names : tuple of (str, str) or None
        Names of both bodies, such as ``("forearm_link", "obstacle[2]")``, of a robot from a URDF file; None for robots
        of the plane.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 1.0))
    >>> space = rg.ConfigurationSpace(arm.axes(16), np.zeros((16, 16)), robot=arm)
    >>> path = rg.Polyline([(0.0, 0.0), (0.0, np.pi / 2)], space)
    >>> hit = rg.check_collisions(path, [rg.Ball((1.5, 1.0), 0.25)])
    >>> hit.part, hit.configuration.round(2)
    (1, array([0. , 0.9]))
    """

    segment: int
    configuration: NDArray[np.float64]
    part: int
    obstacle: int | None
    names: tuple[str, str] | None = None


def workspace_path(path: AnyPath | Trajectory) -> NDArray[np.float64]:
    """Return the path of the robot's reference point (an arm's tip) in the workspace.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline, NodePath or Trajectory
        The path, in the space of the robot.

    Returns
    -------
    ndarray of float64, shape (n, d)
        World coordinates, one position per point of the path; d is 2 for arms of the plane and turning polygons, 3 for
        robots from URDF files, and ndim for point robots, whose path is returned unchanged.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 1.0))
    >>> space = rg.ConfigurationSpace(arm.axes(16), np.zeros((16, 16)), robot=arm)
    >>> rg.planning.workspace_path(rg.Polyline([(0.0, 0.0), (0.0, np.pi / 2)], space)).round(3)
    array([[2., 0.],
           [1., 1.]])
    """
    if isinstance(path, Trajectory):
        return robot_of(path.path).reference_point(path.positions)
    return robot_of(path).reference_point(unwrap(path))


def workspace_clearance(path: AnyPath | Trajectory, obstacles: Sequence[Shape], *, step: Positive = 0.01) -> float:
    """Compute the smallest distance from the whole robot to the obstacles along a path, with exact geometry.

    For a robot from a URDF file, distances between links that must not touch each other count too.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline, NodePath or Trajectory
        The path, in the space of the robot.
    obstacles : sequence of Shape
        Shapes in world coordinates; a `CellSet` has the axes of the space.
    step : float
        Maximum motion of any point of the robot between two sampled configurations, in workspace units.  Between them
        the distance is at least the result minus half a step.

    Returns
    -------
    float
        Smallest distance in workspace units; 0 if the robot touches an obstacle, infinite without obstacles.

    Raises
    ------
    InputError
        If an obstacle does not fit the robot's workspace, the step is not positive, or it gives more than 5,000,000
        configurations.
    ToolMissingError
        If a robot from a URDF file is tested without the extra ``robots``.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 1.0))
    >>> space = rg.ConfigurationSpace(arm.axes(16), np.zeros((16, 16)), robot=arm)
    >>> path = rg.Polyline([(0.0, 0.0), (0.0, np.pi / 2)], space)
    >>> round(rg.planning.workspace_clearance(path, [rg.Ball((0.5, 1.0), 0.25)]), 3)
    0.25
    """
    tested = _test_of(path, obstacles)
    configurations, _ = sample_path(path, step)
    return min(float(tested.clearances(some).min()) for some in _batches(configurations))


def check_collisions(
    path: AnyPath | Trajectory, obstacles: Sequence[Shape], *, step: Positive = 0.01
) -> Collision | None:
    """Return the first collision of the whole robot with an obstacle along a path, with exact geometry.

    Links of a robot from a URDF file must also not collide with each other, if the robot's `self_collision` is True.
    Its meshes are tested themselves, while the proof that a cell is free uses convex pieces that contain the meshes.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline, NodePath or Trajectory
        The path, in the space of the robot.
    obstacles : sequence of Shape
        Shapes in world coordinates; a `CellSet` has the axes of the space.
    step : float
        Maximum motion of any point of the robot between two tested configurations, in workspace units.

    Returns
    -------
    Collision or None
        None without a collision.  In the plane, touching an obstacle, to within 1e-9, is not a collision.  For a robot
        from a URDF file a touch is a collision, and distances below some 1e-6 m may be reported as collisions.

    Raises
    ------
    InputError
        If an obstacle does not fit the robot's workspace, the step is not positive, or it gives more than 5,000,000
        configurations.
    ToolMissingError
        If a robot from a URDF file is tested without the extra ``robots``.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 1.0))
    >>> space = rg.ConfigurationSpace(arm.axes(16), np.zeros((16, 16)), robot=arm)
    >>> path = rg.Polyline([(0.0, 0.0), (0.0, np.pi / 2)], space)
    >>> rg.check_collisions(path, [rg.Ball((0.5, 1.0), 0.25)]) is None
    True
    >>> rg.check_collisions(path, [rg.Ball((1.5, 1.0), 0.25)])
    Collision(segment=0, configuration=float64(2,), part=1, obstacle=0, names=None)
    """
    tested = _test_of(path, obstacles)
    configurations, segment = sample_path(path, step)
    for number, some in enumerate(_batches(configurations)):
        hit = tested.first_hit(some)
        if hit is not None:
            at = number * _BATCH + hit.row
            place = path.space.to_world(configurations[at])
            return Collision(int(segment[at]), place, hit.part, hit.obstacle, hit.names)
    return None


def _test_of(path: AnyPath | Trajectory, obstacles: Sequence[Shape]) -> CollisionTest:
    """Return the collision test of a path's robot among obstacles, given in world coordinates."""
    space = path.space
    robot = robot_of(path.path if isinstance(path, Trajectory) else path)
    return robot.collision_test(space.axes, [to_space(shape, space.frame) for shape in obstacles])


def _batches(configurations: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield consecutive batches, of at most `_BATCH` rows, of `configurations` (n, ndim)."""
    for first in range(0, len(configurations), _BATCH):
        yield configurations[first : first + _BATCH]


def sample_path(path: AnyPath | Trajectory, step: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return configurations (m, ndim) along a path, in axis units, and the index (m,) of the segment of each.

    The start and the end of the path are included; the end belongs to the last segment.  Of a trajectory, the
    configurations lie on the motion itself, and a segment is the part between two knots.  `step`: largest distance that
    a point of the robot moves between two configurations, in workspace units.
    """
    if isinstance(path, Trajectory):
        return _sample_motion(path.motion or path, step)
    points, robot = path.line, robot_of(path)
    robot.check_axes(path.space.axes)
    count = _parts(robot.travel(points[:-1], points[1:]), step)
    segment, fraction = _steps(count)
    inner = points[segment] + fraction[:, np.newaxis] * (points[segment + 1] - points[segment])
    last = max(len(count) - 1, 0)
    return np.concatenate([inner, points[-1:]]), np.append(segment, last).astype(np.int64)


def _sample_motion(motion: Trajectory, step: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return configurations (m, ndim) on a trajectory, in axis units, and the index (m,) of the knot before each.

    Between two knots no coordinate changes by more than the duration times the larger one of its speeds at both knots.
    The last configuration is the end, with the index of the last knot but one.  `step`: largest distance that a point
    of the robot moves between two configurations, in workspace units.
    """
    robot, space = robot_of(motion.path), motion.space
    robot.check_axes(space.axes)
    end = motion.velocities[:-1] + np.diff(motion.times)[:, np.newaxis] * motion.accelerations
    farthest = np.maximum(np.abs(motion.velocities[:-1]), np.abs(end)) * np.diff(motion.times)[:, np.newaxis]
    segment, fraction = _steps(_parts(robot.travel(np.zeros_like(farthest), farthest), step))
    times = motion.times[segment] + fraction * np.diff(motion.times)[segment]
    positions = np.concatenate([motion.at(times)[0], motion.positions[-1:]])
    last = max(len(motion.times) - 2, 0)
    return space.from_world(positions), np.append(segment, last).astype(np.int64)


def _parts(distance: NDArray[np.float64], step: float) -> NDArray[np.int64]:
    """Return the number of parts (n,), at most `step` long, of segments on which the robot moves a `distance` (n,)."""
    parts = np.maximum(np.ceil(distance / step), 1.0)
    if parts.sum() > _MOST:
        raise InputError(
            f"step = {step:g} gives {parts.sum():,.0f} configurations, more than {_MOST:,}; choose a longer step"
        )
    return np.asarray(parts.astype(np.int64))


def _steps(count: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the segment of every part (m,), and the position at which the part begins, as a fraction of the segment.

    `count` (n,): number of equal parts of every segment; m is their sum.
    """
    segment = np.repeat(np.arange(len(count)), count)
    return segment, (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
