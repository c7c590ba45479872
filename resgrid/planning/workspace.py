"""Paths of a configuration space seen in the workspace: where the robot itself goes, and what it comes near."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import check_number
from resgrid.errors import InputError
from resgrid.frozen import frozen
from resgrid.planning.streamline import ShortPath, Streamline, axis_path, unwrap
from resgrid.robots import Robot, Shape
from resgrid.robots.geometry import obstacles_of
from resgrid.scene.world import along_axes
from resgrid.space import ConfigurationSpace

Way = Streamline | ShortPath | ArrayLike

_MOST = 5_000_000
_BATCH = 4096


@frozen
@dataclass(frozen=True, eq=False)
class Collision:
    """The first place of a path where the robot enters an obstacle.

    Attributes
    ----------
    segment : int
        Number of the path's segment, from 0.
    configuration : ndarray of float64, shape (ndim,)
        In world coordinates.
    part : int
        Which rigid part of the robot: of an arm, the link, from 0.
    obstacle : int
        Which of the obstacles, from 0.
    """

    segment: int
    configuration: NDArray[np.float64]
    part: int
    obstacle: int


def workspace_path(path: Way, robot: Robot, space: ConfigurationSpace) -> NDArray[np.float64]:
    """Where the robot's reference point goes in the workspace: of an arm, its tip.

    Parameters
    ----------
    path : Streamline, ShortPath or array_like of float, shape (n, ndim)
        An array holds points of the world.
    robot : Robot
    space : ConfigurationSpace

    Returns
    -------
    ndarray of float64, shape (n, d)
        In the world: one place per point of the path; d is 2 for arms and turning polygons, ndim for points, whose
        path this is.

    Raises
    ------
    InputError
        If the path does not fit the space or the robot.
    """
    return robot.reference_point(unwrap(path, space))


def workspace_clearance(
    path: Way, robot: Robot, obstacles: Sequence[Shape], space: ConfigurationSpace, *, step: float = 0.01
) -> float:
    """Smallest distance from the whole robot to the obstacles along a path, with exact geometry.

    Parameters
    ----------
    path : Streamline, ShortPath or array_like of float, shape (n, ndim)
        An array holds points of the world.
    robot : Robot
    obstacles : sequence of Shape
        In world coordinates; a `CellSet` lies along the axes of the space.
    space : ConfigurationSpace
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
        If the path does not fit, the robot's geometry is not known, or the step is not positive or far too small.
    """
    configurations, _ = dense(path, robot, space, step)
    solids = obstacles_of(along_axes(obstacles, space.frame), robot.workspace_axes(space.axes))
    nearest = np.inf
    for batch in _batches(configurations, robot, space):
        parts = robot.parts(batch)
        nearest = min([nearest, *(float(solid.distance(part).min()) for solid in solids for part in parts)])
    return nearest


def replay(
    path: Way, robot: Robot, obstacles: Sequence[Shape], space: ConfigurationSpace, *, step: float = 0.01
) -> Collision | None:
    """Drive the whole robot along a path, with exact geometry, until it enters an obstacle.

    Parameters
    ----------
    path : Streamline, ShortPath or array_like of float, shape (n, ndim)
        An array holds points of the world.
    robot : Robot
    obstacles : sequence of Shape
        In world coordinates; a `CellSet` lies along the axes of the space.
    space : ConfigurationSpace
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
    """
    configurations, segment = dense(path, robot, space, step)
    solids = obstacles_of(along_axes(obstacles, space.frame), robot.workspace_axes(space.axes))
    seen = 0
    for batch in _batches(configurations, robot, space):
        hits = [
            (int(np.argmax(hit)), number, solid.number)
            for number, part in enumerate(robot.parts(batch))
            for solid in solids
            if (hit := solid.collides(part)).any()
        ]
        if hits:
            first, part_number, obstacle = min(hits)
            at = seen + first
            return Collision(int(segment[at]), space.to_world(configurations[at]), part_number, obstacle)
        seen += len(batch)
    return None


def dense(
    path: Way, robot: Robot, space: ConfigurationSpace, step: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Configurations along a path, so close that no point of the robot moves farther than a step between two.

    Shapes: `path` (n, ndim); returns `configurations` (m, ndim), `segment` (m,).
    """
    points = axis_path(path, space)
    check_number("step", step, "a positive length", above=0.0)
    robot.check_axes(space.axes)
    pieces = np.maximum(np.ceil(robot.travel(points[:-1], points[1:]) / step), 1.0)
    if pieces.sum() > _MOST:
        raise InputError(f"a step of {step:g} makes {pieces.sum():,.0f} configurations; choose a longer one")
    count = pieces.astype(np.int64)
    segment = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    inner = points[segment] + share[:, np.newaxis] * (points[segment + 1] - points[segment])
    last = max(len(count) - 1, 0)
    return np.concatenate([inner, points[-1:]]), np.append(segment, last).astype(np.int64)


def _batches(configurations: NDArray[np.float64], robot: Robot, space: ConfigurationSpace) -> list[NDArray[np.float64]]:
    """Configurations a few thousand at a time; those of a point are brought back into periodic axes."""
    own = robot.within_seams(space.axes, configurations)
    return [own[first : first + _BATCH] for first in range(0, len(own), _BATCH)]
