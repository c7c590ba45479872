"""The union type of all kinds of paths, and functions of all of them: unwrapping at seams, and the robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.validation import with_article
from resgrid.errors import InputError
from resgrid.planning.node_paths import NodePath
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Polyline, Streamline
from resgrid.robots import PointRobot, Robot

AnyPath = Streamline | ShortPath | Polyline | NodePath


def unwrap(path: AnyPath) -> NDArray[np.float64]:
    """Return a path's points in world coordinates that are continuous across periodic seams.

    The points differ from ``path.points`` by multiples of the period of each periodic axis; the start is unchanged.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or NodePath
        The path.

    Returns
    -------
    ndarray of float64, shape (n, ndim)
        World coordinates.

    Examples
    --------
    >>> ring = rg.ConfigurationSpace([rg.Axis("theta", 0.0, 1.0, 4, periodic=True)], [0, 0, 1, 2])
    >>> path = rg.plan(ring).path((0.1,))
    >>> path.points[:, 0], rg.planning.unwrap(path)[:, 0]
    (array([0.1, 1. ]), array([0.1, 0. ]))
    """
    return path.space.to_world(path.line)


def robot_of(path: AnyPath) -> Robot:
    """Return the robot of a path's space; a point robot of radius 0 if the space has no robot."""
    robot = path.space.robot
    if robot is None:
        return PointRobot()
    if not isinstance(robot, Robot):
        raise InputError(f"the robot of this space must be a resgrid.Robot, not {with_article(type(robot).__name__)}")
    return robot
