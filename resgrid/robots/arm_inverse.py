"""Inverse kinematics of an arm with two links."""

from __future__ import annotations

from itertools import product
from math import acos, atan2, ceil, cos, floor, hypot, pi, sin, tau
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.robots.arm import Arm

TOLERANCE = 1e-12

MOST = 1_000_000
"""More solutions are not listed."""


def inverse_of_two_links(arm: Arm, point: ArrayLike) -> NDArray[np.float64]:
    """All configurations that bring the tip of an arm with two links to a point; see `Arm.inverse`.

    The cosine rule gives the elbow's angle: ``cos q = (d^2 - a^2 - b^2) / (2 a b)`` (Craig, Introduction to
    Robotics, section 4.4).

    Shapes: `point` (2,); returns (s, 2).
    """
    if arm.ndim != 2:
        raise InputError(f"only an arm of two links has a closed inverse; this one has {arm.ndim}")
    target = np.asarray(point, dtype=np.float64)
    if target.shape != (2,) or not np.isfinite(target).all():
        raise InputError(f"a point of the workspace has two finite coordinates, got {target.tolist()}")
    x, y = (target - arm.base).tolist()
    first, second = arm.lengths
    cosine = (x * x + y * y - first**2 - second**2) / (2 * first * second)
    if abs(cosine) > 1 + TOLERANCE:
        return np.empty((0, 2))
    bend = acos(max(-1.0, min(1.0, cosine)))
    solutions: list[tuple[float, ...]] = []
    for elbow in (bend, -bend) if sin(bend) > TOLERANCE else (bend,):
        towards = atan2(y, x) if hypot(x, y) > TOLERANCE * arm.reach else arm.base_angle
        shoulder = towards - atan2(second * sin(elbow), first + second * cos(elbow)) - arm.base_angle
        angles = (shoulder, elbow if arm.angles == "relative" else shoulder + elbow)
        turned = [_within(angle, limits) for angle, limits in zip(angles, arm.limits, strict=True)]
        if len(turned[0]) * len(turned[1]) > MOST:
            raise InputError(f"the limits hold more than {MOST:,} solutions, so many turns are they wide; narrow them")
        solutions += product(*turned)
    return np.array(solutions, dtype=np.float64).reshape(-1, 2)


def _within(angle: float, limits: tuple[float, float] | None) -> list[float]:
    """The angle, by whole turns wherever it fits into the limits."""
    if limits is None:
        return [(angle + pi) % tau - pi]
    lower, upper = limits
    turns = range(ceil((lower - TOLERANCE - angle) / tau), floor((upper + TOLERANCE - angle) / tau) + 1)
    return [min(max(angle + turn * tau, lower), upper) for turn in turns]
