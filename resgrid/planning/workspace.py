"""Paths of a configuration space seen in the workspace: where the robot itself goes, and what it comes near."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import check_number
from resgrid.errors import InputError
from resgrid.planning.bodies import bodies_of, parts_of
from resgrid.planning.seams import axis_path, unwrap, wrap
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Streamline
from resgrid.robots import Arm, DiscRobot, PointRobot, PolygonRobot, Robot, Shape
from resgrid.scene.world import along_axes
from resgrid.space import ConfigurationSpace

Way = Streamline | ShortPath | ArrayLike

_MOST = 5_000_000
_BATCH = 4096


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
    points = unwrap(path, space)
    if isinstance(robot, Arm):
        return robot.tip(points)
    return points[:, :2] if isinstance(robot, PolygonRobot) else points


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
    bodies = bodies_of(along_axes(obstacles, space.frame), robot, space)
    nearest = np.inf
    for batch in _batches(configurations, robot, space):
        parts = parts_of(robot, batch)
        nearest = min([nearest, *(float(body.distance(part).min()) for body in bodies for part in parts)])
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
    bodies = bodies_of(along_axes(obstacles, space.frame), robot, space)
    seen = 0
    for batch in _batches(configurations, robot, space):
        hits = [
            (int(np.argmax(hit)), number, body.number)
            for number, part in enumerate(parts_of(robot, batch))
            for body in bodies
            if (hit := body.collides(part)).any()
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
    if isinstance(robot, Arm | PolygonRobot):
        robot.check_axes(space.axes)
    pieces = np.maximum(np.ceil(travel_bound(robot, points[:-1], points[1:]) / step), 1.0)
    if pieces.sum() > _MOST:
        raise InputError(f"a step of {step:g} makes {pieces.sum():,.0f} configurations; choose a longer one")
    count = pieces.astype(np.int64)
    segment = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    inner = points[segment] + share[:, np.newaxis] * (points[segment + 1] - points[segment])
    last = max(len(count) - 1, 0)
    return np.concatenate([inner, points[-1:]]), np.append(segment, last).astype(np.int64)


def travel_bound(robot: Robot, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bound of how far any point of a robot moves on straight lines in configuration space.

    A point of an arm's link j moves at most by the sum, over the links i before it, of their length times the change
    of their direction, and by its own link's length and half width times that link's.

    Shapes: `start, end` (n, ndim); returns (n,).
    """
    match robot:
        case Arm():
            turned = np.abs(robot.directions(end) - robot.directions(start))
            ends = np.cumsum(turned * np.asarray(robot.lengths), axis=1)
            return np.asarray((ends + turned * np.asarray(robot.widths) / 2).max(axis=1))
        case PolygonRobot():
            angle = np.abs(end[:, 2] - start[:, 2]) / robot.turning_length
            return np.asarray(np.linalg.norm((end - start)[:, :2], axis=1) + robot.farthest * angle)
        case PointRobot() | DiscRobot():
            return np.asarray(np.linalg.norm(end - start, axis=1))
    raise InputError(f"how a {type(robot).__name__} moves is not known: arm, polygon, disc and point are")


def _batches(configurations: NDArray[np.float64], robot: Robot, space: ConfigurationSpace) -> list[NDArray[np.float64]]:
    """Configurations a few thousand at a time; those of a point are brought back into periodic axes."""
    own = wrap(configurations, space) if isinstance(robot, PointRobot | DiscRobot) else configurations
    return [own[first : first + _BATCH] for first in range(0, len(own), _BATCH)]
