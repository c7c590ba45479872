"""Paths in the workspace: positions of the robot, clearance from obstacles, and collisions, with exact geometry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import Positive
from resgrid._internal.values import frozen
from resgrid.errors import InputError
from resgrid.planning.streamline import AnyPath, robot_of, unwrap
from resgrid.robots import RigidPart, Shape
from resgrid.robots.geometry import Obstacle, obstacles_of
from resgrid.scene.world_coordinates import to_space

_MOST = 5_000_000
"""Maximum number of sampled configurations of a path."""

_BATCH = 4096
"""Number of configurations per vectorized distance computation."""


@frozen
@dataclass(frozen=True, eq=False)
class Collision:
    """First collision of a robot with an obstacle along a path.

    Returned by `resgrid.check_collisions`.  Indices start at 0.

    Attributes
    ----------
    segment : int
        Index of the segment of the path.
    configuration : ndarray of float64, shape (ndim,)
        Configuration of the robot, in world coordinates.
    part : int
        Index of the rigid part of the robot, such as the link of an arm.
    obstacle : int
        Index of the obstacle in the given sequence.

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
    obstacle: int


def workspace_path(path: AnyPath) -> NDArray[np.float64]:
    """Return the path of the robot's reference point (an arm's tip) in the workspace.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
        The path, in the space of the robot.

    Returns
    -------
    ndarray of float64, shape (n, d)
        World coordinates, one position per point of the path; d is 2 for arms and turning polygons, and ndim for point
        robots, whose path is returned unchanged.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 1.0))
    >>> space = rg.ConfigurationSpace(arm.axes(16), np.zeros((16, 16)), robot=arm)
    >>> rg.planning.workspace_path(rg.Polyline([(0.0, 0.0), (0.0, np.pi / 2)], space)).round(3)
    array([[2., 0.],
           [1., 1.]])
    """
    return robot_of(path).reference_point(unwrap(path))


def workspace_clearance(path: AnyPath, obstacles: Sequence[Shape], *, step: Positive = 0.01) -> float:
    """Compute the smallest distance from the whole robot to the obstacles along a path, with exact geometry.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
        The path, in the space of the robot.
    obstacles : sequence of Shape
        Shapes in world coordinates; a `CellSet` has the axes of the space.
    step : float
        Maximum motion of any point of the robot between two sampled configurations, in workspace units.  Between them
        the distance is at least the result minus half a step.

    Returns
    -------
    float
        Smallest distance in workspace units; 0 at a contact, infinite without obstacles.

    Raises
    ------
    InputError
        If the robot has no geometry in the plane, the step is not positive, or it gives more than 5,000,000
        configurations.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 1.0))
    >>> space = rg.ConfigurationSpace(arm.axes(16), np.zeros((16, 16)), robot=arm)
    >>> path = rg.Polyline([(0.0, 0.0), (0.0, np.pi / 2)], space)
    >>> round(rg.planning.workspace_clearance(path, [rg.Ball((0.5, 1.0), 0.25)]), 3)
    0.25
    """
    nearest = np.inf
    for _, _, parts, solids in _poses(path, obstacles, step):
        nearest = min([nearest, *(float(solid.distance(part).min()) for solid in solids for part in parts)])
    return nearest


def check_collisions(path: AnyPath, obstacles: Sequence[Shape], *, step: Positive = 0.01) -> Collision | None:
    """Return the first collision of the whole robot with an obstacle along a path, with exact geometry.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
        The path, in the space of the robot.
    obstacles : sequence of Shape
        Shapes in world coordinates; a `CellSet` has the axes of the space.
    step : float
        Maximum motion of any point of the robot between two tested configurations, in workspace units.

    Returns
    -------
    Collision or None
        None without a collision.  Touching an obstacle, to within 1e-9, is not a collision.

    Raises
    ------
    InputError
        If the robot has no geometry in the plane, the step is not positive, or it gives more than 5,000,000
        configurations.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 1.0))
    >>> space = rg.ConfigurationSpace(arm.axes(16), np.zeros((16, 16)), robot=arm)
    >>> path = rg.Polyline([(0.0, 0.0), (0.0, np.pi / 2)], space)
    >>> rg.check_collisions(path, [rg.Ball((0.5, 1.0), 0.25)]) is None
    True
    >>> rg.check_collisions(path, [rg.Ball((1.5, 1.0), 0.25)])
    Collision(segment=0, configuration=float64(2,), part=1, obstacle=0)
    """
    for configurations, segment, parts, solids in _poses(path, obstacles, step):
        hits = [
            (int(np.argmax(hit)), number, solid.number)
            for number, part in enumerate(parts)
            for solid in solids
            if (hit := solid.collides(part)).any()
        ]
        if hits:
            at, part, obstacle = min(hits)
            return Collision(int(segment[at]), path.space.to_world(configurations[at]), part, obstacle)
    return None


def _poses(
    path: AnyPath, obstacles: Sequence[Shape], step: float
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64], list[RigidPart], list[Obstacle]]]:
    """Yield tuples ``(configurations, segments, parts, obstacles)`` for consecutive batches of poses along a path.

    ``configurations`` (m, ndim): in axis units; ``segments`` (m,): index of each configuration's segment of the path;
    ``parts``: rigid bodies of the robot, placed in these configurations; ``obstacles``: all obstacles, in every batch.
    `path`: path; `obstacles`: shapes in world coordinates; `step`: largest distance that a point of the robot moves
    between two configurations, in workspace units.
    """
    robot, space = robot_of(path), path.space
    solids = obstacles_of((to_space(shape, space.frame) for shape in obstacles), robot.workspace_axes(space.axes))
    configurations, segment = sample_path(path, step)
    own = robot.within_seams(space.axes, configurations)
    for first in range(0, len(own), _BATCH):
        some = slice(first, first + _BATCH)
        yield configurations[some], segment[some], robot.parts(own[some]), solids


def sample_path(path: AnyPath, step: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return configurations (m, ndim) along a path, in axis units, and the index of the path's segment of each (m,).

    `step`: largest distance that a point of the robot moves between two configurations, in workspace units.
    """
    points, robot = path.line, robot_of(path)
    robot.check_axes(path.space.axes)
    pieces = np.maximum(np.ceil(robot.travel(points[:-1], points[1:]) / step), 1.0)
    if pieces.sum() > _MOST:
        raise InputError(
            f"step = {step:g} gives {pieces.sum():,.0f} configurations, more than {_MOST:,}; choose a longer step"
        )
    count = pieces.astype(np.int64)
    segment = np.repeat(np.arange(len(count)), count)
    fraction = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    inner = points[segment] + fraction[:, np.newaxis] * (points[segment + 1] - points[segment])
    last = max(len(count) - 1, 0)
    return np.concatenate([inner, points[-1:]]), np.append(segment, last).astype(np.int64)
