"""Limits of velocity and acceleration along paths: given ones, or those of the robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import per_axis
from resgrid._internal.validation import with_article
from resgrid.errors import InputError
from resgrid.planning.any_path import AnyPath, robot_of

Limits = float | Sequence[float] | NDArray[np.float64]

LimitRatio = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Function that returns, for vectors (n, ndim) in world coordinates, the ratios (n,) of their magnitudes to a limit."""


def own_velocity_limits(points: NDArray[np.float64], path: AnyPath) -> Limits:
    """Return the robot's velocity limits of all coordinates, (ndim,), in world coordinates per second.

    The limit is 1 for a coordinate that does not change along `points` (n, ndim), since it is not used.  Raise
    InputError if the robot has no limit for a coordinate that changes.  `path`: gives the robot.
    """
    robot = robot_of(path)
    limits = robot.velocity_limits
    if limits is None:
        raise InputError(
            f"{with_article(type(robot).__name__)} has no velocity limits of its own; give velocity_limits, one for "
            "all coordinates or one for each"
        )
    moves = np.ptp(points, axis=0) > 0
    lacking = np.flatnonzero(moves & np.isinf(limits))
    if len(lacking):
        names = ", ".join((robot.joint_names or [axis.name for axis in path.space.axes])[at] for at in lacking)
        raise InputError(
            f"the robot's description has no velocity limit for {names}; give velocity_limits, or the key velocity of "
            "the robot"
        )
    return np.where(moves, limits, 1.0)


def limit_ratio(name: str, limits: Limits, path: AnyPath) -> LimitRatio:
    """Return a function that computes the ratios of the magnitudes of vectors (velocities, accelerations) to `limits`.

    The magnitude is the largest coordinate relative to its limit; for a single limit and a robot whose configurations
    are places, it is the Euclidean norm.  `name`: name of the limits, for messages; `limits`: one number for all
    coordinates or one for each; `path`: gives the robot.
    """
    each = per_axis(name, limits, path.space.ndim, "positive and finite", above=0.0)
    if np.size(limits) == 1 and robot_of(path).moves_in_workspace:
        return lambda vectors: np.asarray(np.linalg.norm(vectors, axis=1) / each[0])
    return lambda vectors: np.asarray((np.abs(vectors) / each).max(axis=1))
