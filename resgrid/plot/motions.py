"""Poses of a robot along its path for pictures of its workspace, and its positions at starts and goals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.any_path import AnyPath
from resgrid.planning.streamline import Polyline
from resgrid.planning.workspace import sample_path
from resgrid.scene.goals import GoalCell, GoalJoints, GoalPoint, GoalPose
from resgrid.scene.scene import Scene

Motion = AnyPath | ArrayLike
"""A path, or an array (n, ndim) of configurations in world coordinates."""


def empty_space(scene: Scene) -> ConfigurationSpace:
    """Return the configuration space of a scene in which all cells are free, without obstacles and goals."""
    return ConfigurationSpace(
        scene.axes, np.zeros([axis.cells for axis in scene.axes], np.uint8), frame=scene.frame, robot=scene.robot
    )


def goal_places(scene: Scene) -> NDArray[np.float64]:
    """Return the workspace positions (g, d) of the robot's reference point at goals.

    The number d is 3 for a robot in space, otherwise 2; g is the number of included goals.  Included are goals that are
    points, cells (position at the centre of the cell), ranges of joint values (position at the middle of the ranges),
    or poses without a radius; regions are omitted.
    """
    places: list[Any] = []
    ndim = scene.robot.workspace_ndim
    for goal in scene.goals:
        match goal:
            case GoalPoint(point):
                places.append(point[:ndim])
            case GoalCell(cell):
                places.append(reference_of(empty_space(scene).centre(np.array(cell)), scene))
            case GoalJoints(lower, upper):
                places.append(reference_of(np.add(lower, upper) / 2, scene))
            case GoalPose(position, radius) if not radius:
                places.append(position)
    return np.array(places).reshape(-1, ndim)


def reference_of(configuration: ArrayLike, scene: Scene) -> NDArray[np.float64]:
    """Return the workspace position (d,) of the robot's reference point in a configuration (ndim,).

    The number d is 3 for a robot in space, otherwise 2.
    """
    place = scene.robot.reference_point(np.reshape(configuration, (1, -1)))[0]
    return np.asarray(place[: scene.robot.workspace_ndim])


def dense_motion(path: Motion, scene: Scene) -> NDArray[np.float64]:
    """Return configurations (n, ndim) in world coordinates along a path, dense enough for a smooth picture.

    Between consecutive configurations, the points of the robot move at most 1/400 of their motion along the whole path.
    """
    own = path if isinstance(path, AnyPath) else Polyline(path, empty_space(scene))
    travel = float(scene.robot.travel(own.line[:-1], own.line[1:]).sum())
    return own.space.to_world(sample_path(own, travel / 400)[0] if travel else own.line)


def poses_along(motion: NDArray[np.float64], scene: Scene, count: int) -> NDArray[np.float64]:
    """Return at most `count` poses (m, ndim) of a motion (n, ndim), with its first and its last pose.

    The poses are evenly spaced by the distance that the robot's points move.  A `count` of 1 gives the first pose.
    """
    if not 1 <= count <= 1000:
        raise InputError(f"ghosts = {count} must lie between 1 and 1000: it is the number of poses")
    along = np.concatenate([[0.0], np.cumsum(scene.robot.travel(motion[:-1], motion[1:]))])
    rows = np.searchsorted(along, np.linspace(0.0, along[-1], count)).clip(0, len(motion) - 1)
    return np.asarray(motion[np.unique(rows)])
