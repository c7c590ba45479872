"""The part of a streamline's certificate that looks within cells: the current carries it so, and as long as it says.

Between the two faces of a cell the velocity along an axis is linear, ``v(x) = lower (1 - x) + upper x``.  A position is
known to within rounding, and near a stagnation point that moves the exit, and the time, a lot: both are compared with
what they are for all positions that a point may stand for.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from resgrid.axis import rounding
from resgrid.errors import CertificateError
from resgrid.planning.streamline import Streamline

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SAME_TIME = 1e-9
_SLACK = 4.0
_LARGEST_LOG = 745.0
"""Natural logarithm of the largest ratio of two velocities that float64 can tell from infinity."""


def check_motion(path: Streamline, local: Floats, axis: Integers, side: Integers) -> None:
    """Check that the points of a streamline are where the current carries it, and its duration.

    Shapes: `local` (n, ndim), `axis, side` (steps,).
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        _check_steps(path, local, axis, side)


def _check_steps(path: Streamline, local: Floats, axis: Integers, side: Integers) -> None:
    """The same where what overflows counts as infinite."""
    steps, slack = np.arange(len(axis)), _SLACK * rounding(path.space.axes)
    direction, log_current = path.field.faces_of(path.cells[:-1].astype(np.int64))
    scale = log_current.max(axis=(0, 2))
    lower, upper = direction * np.exp(log_current - scale[:, np.newaxis])
    start, end = np.clip(local[: len(axis)], 0.0, 1.0), local[1 : len(axis) + 1]
    up = side > 0
    shortest, longest, sure = _times(
        np.where(up, start[steps, axis], 1.0 - start[steps, axis]),
        np.where(up, lower[steps, axis], -upper[steps, axis]),
        np.where(up, upper[steps, axis], -lower[steps, axis]),
        slack[axis],
    )
    low, high = _ends(start, lower, upper, (shortest, longest), slack)
    # Where the streamline may have left straight, it has not moved along the other axes.
    stays = ~sure[:, np.newaxis]
    low, high = np.where(stays, np.minimum(low, start), low), np.where(stays, np.maximum(high, start), high)
    off = ~((end >= low - slack) & (end <= high + slack))
    off[steps, axis] = False
    if off.any():
        step = int(np.argmax(off.any(axis=1)))
        raise CertificateError(f"point {step + 1} is not where the current carries the path from point {step}")
    _check_duration(path, np.log(shortest) - scale, np.log(longest) - scale)


def _times(x: Floats, enter: Floats, leave: Floats, slack: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Least and greatest time from ``x`` to the face at 1, where the velocity is ``leave > 0``; at 0 it is ``enter``.

    Where the velocity at ``x`` may vanish, within rounding, the streamline may go straight at the speed of the face:
    the third is whether it surely does not.
    """
    before, after = np.maximum(x - slack, 0.0), np.minimum(x + slack, 1.0)
    slowest, fastest = (enter * (1.0 - at) + leave * at for at in (before, after))
    straight = (1.0 - before) / leave
    sure = slowest > 0
    shortest, longest = _drift(after, fastest, leave), _drift(before, slowest, leave)
    # The velocity falls towards x: that at the face exceeds it.
    endless = np.maximum(_LARGEST_LOG / np.where(sure, 1.0, leave - enter), straight)
    least_straight = (1.0 - after) / leave
    return (
        np.where(sure, shortest, np.minimum(shortest, least_straight)),
        np.where(sure, longest, np.where(fastest > 0, endless, straight)),
        sure,
    )


def _drift(x: Floats, velocity: Floats, leave: Floats) -> Floats:
    """Time from ``x`` to 1 as the velocity grows linearly to ``leave``; infinite where it does not run there."""
    runs = velocity > 0
    z = np.where(runs, leave / np.where(runs, velocity, 1.0), 1.0) - 1.0
    factor = np.where(np.abs(z) < 1e-8, 1.0 - 0.5 * z, np.log1p(z) / np.where(z == 0, 1.0, z))
    return np.where(runs, (1.0 - x) / np.where(runs, velocity, 1.0) * factor, np.inf)


def _ends(
    start: Floats, lower: Floats, upper: Floats, times: tuple[Floats, Floats], slack: Floats
) -> tuple[Floats, Floats]:
    """Least and greatest position along every axis after the time to the exit: monotone in start and time."""
    ends = [
        _moved(np.clip(start + off, 0.0, 1.0), lower, upper, time[:, np.newaxis])
        for off, time in product((-slack, slack), times)
    ]
    return np.min(ends, axis=0), np.max(ends, axis=0)


def _moved(x: Floats, lower: Floats, upper: Floats, time: Floats) -> Floats:
    """Positions after a time, within the cell."""
    velocity, growth = lower * (1.0 - x) + upper * x, (upper - lower) * time
    step = np.where(
        np.abs(growth) < 1e-8, velocity * time * (1.0 + 0.5 * growth), velocity * np.expm1(growth) / (upper - lower)
    )
    return np.clip(x + np.where(velocity == 0, 0.0, step), 0.0, 1.0)


def _check_duration(path: Streamline, log_shortest: Floats, log_longest: Floats) -> None:
    unit = 2.0 * np.log(path.space.spacing.min())
    low, high = (float(np.logaddexp.reduce(logs, initial=-np.inf) + unit) for logs in (log_shortest, log_longest))
    told = float(path.log_duration)
    unmoved = np.isnan(told) and np.isneginf(low)
    if not unmoved and not low - _SAME_TIME <= told <= high + _SAME_TIME:
        raise CertificateError(f"the logarithm of the duration is {low}, not {told}")
