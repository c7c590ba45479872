"""Paths of a configuration space seen in the workspace: where the robot itself goes, and what it comes near."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.validation import Positive
from resgrid._internal.values import frozen
from resgrid.errors import InputError
from resgrid.planning.streamline import AnyPath, robot_of, unwrap
from resgrid.robots import RigidPart, Shape
from resgrid.robots.geometry import Obstacle, obstacles_of
from resgrid.scene.world_coordinates import to_space

_MOST = 5_000_000
_BATCH = 4096


@frozen
@dataclass(frozen=True, eq=False)
class Collision:
    """The first place of a path where the robot enters an obstacle.

    `segment`: number of the path's segment, from 0; `configuration` (ndim,): in world coordinates; `part`: which
    rigid part of the robot: of an arm, the link, from 0; `obstacle`: which of the obstacles, from 0.
    """

    segment: int
    configuration: NDArray[np.float64]
    part: int
    obstacle: int


def workspace_path(path: AnyPath) -> NDArray[np.float64]:
    """Where the robot's reference point goes in the workspace: of an arm, its tip.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline

    Returns
    -------
    ndarray of float64, shape (n, d)
        In the world: one place per point of the path; d is 2 for arms and turning polygons, ndim for points, whose
        path this is.

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
    """Smallest distance from the whole robot to the obstacles along a path, with exact geometry.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
    obstacles : sequence of Shape
        In world coordinates; a `CellSet` lies along the axes of the space.
    step : float
        No point of the robot moves farther than this between two configurations looked at, in workspace units; so
        the distance on the way between them is at least the result less half a step.

    Returns
    -------
    float
        0 where they meet, infinite without obstacles.

    Raises
    ------
    InputError
        If the robot's geometry is not known, or the step is not positive or far too small.

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
    """Drive the whole robot along a path, with exact geometry, until it enters an obstacle.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
    obstacles : sequence of Shape
        In world coordinates; a `CellSet` lies along the axes of the space.
    step : float
        As in `workspace_clearance`.

    Returns
    -------
    Collision or None
        None where nothing is entered; to touch a border (within 1e-9) is not to enter.

    Raises
    ------
    InputError
        As `workspace_clearance`.

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
    """A few thousand configurations at a time, the segments they lie on, the robot's parts there, and the obstacles."""
    robot, space = robot_of(path), path.space
    solids = obstacles_of((to_space(shape, space.frame) for shape in obstacles), robot.workspace_axes(space.axes))
    configurations, segment = dense(path, step)
    own = robot.within_seams(space.axes, configurations)
    for first in range(0, len(own), _BATCH):
        some = slice(first, first + _BATCH)
        yield configurations[some], segment[some], robot.parts(own[some]), solids


def dense(path: AnyPath, step: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Configurations (m, ndim) along a path, in axis units, at most a step of the robot apart; segments (m,)."""
    points, robot = path.line, robot_of(path)
    robot.check_axes(path.space.axes)
    pieces = np.maximum(np.ceil(robot.travel(points[:-1], points[1:]) / step), 1.0)
    if pieces.sum() > _MOST:
        raise InputError(f"a step of {step:g} makes {pieces.sum():,.0f} configurations; choose a longer one")
    count = pieces.astype(np.int64)
    segment = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    inner = points[segment] + share[:, np.newaxis] * (points[segment + 1] - points[segment])
    last = max(len(count) - 1, 0)
    return np.concatenate([inner, points[-1:]]), np.append(segment, last).astype(np.int64)
