"""Compiled kernels of the chip analyses: settling times of sums of exponentials, next cells by read-out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inner, kernel

Floats = NDArray[np.float64]

_FINE = 1e-9
"""Smallest step of the search for a band crossing, as a fraction of the time at the end of the step.

A band crossing is the time at which the magnitude of a sum of exponentials falls below a limit. If the sum is at this
limit within a step of the smallest length, the search takes the end of the step as the crossing.
"""

_EXACT = 1e-13
"""Accepted distance of a sum of exponentials from the edge of the band at a computed crossing.

The unit is the half width of the band, the interval around 0 that the sum enters at the crossing.
"""

_MOST_STEPS = 100
"""Maximum number of iterations of the root search for one time at which a sum of exponentials enters a band around 0.

The search then takes the last known time at which the sum is in the band.
"""

_GONE = 700.0
"""Exponent (decay rate times time) above which an exponential ``exp(-rate time)`` counts as 0, without unit."""


@inner
def _sums(share: Floats, rate: Floats, time: float) -> tuple[float, float]:
    """Return ``sum_j share_j exp(-rate_j time)``, and a bound of the magnitude of its second derivative from `time` on.

    `share, rate` (m,): coefficients, and decay rates in 1/s; `time`: in seconds.
    """
    value, bend = 0.0, 0.0
    for j in range(len(rate)):
        if rate[j] * time > _GONE:
            continue
        term = share[j] * math.exp(-rate[j] * time)
        value += term
        bend += abs(term) * rate[j] * rate[j]
    return value, bend


@inner
def _crossing(share: Floats, rate: Floats, out: float, above: float, into: float, below: float, band: float) -> float:
    """Return the time in seconds at which the magnitude of a sum of exponentials falls below `band`.

    The sum is ``sum_j share_j exp(-rate_j time)``. The method is false position (Illinois; Dowell & Jarratt 1971).
    `share, rate` (m,): coefficients, and decay rates in 1/s; `out, into`: times in seconds that enclose the crossing;
    `above, below`: magnitudes of the sum at the times `out` and `into`, above and below `band`; `band`: half width of
    the band around 0, in the unit of the coefficients.
    """
    above, below = above - band, below - band
    for _ in range(_MOST_STEPS):
        time = out + (into - out) * (above / (above - below))
        excess = abs(_sums(share, rate, time)[0]) - band
        if abs(excess) <= _EXACT * band or not out < time < into:
            return time
        if excess > 0.0:
            out, above, below = time, excess, 0.5 * below
        else:
            into, below, above = time, excess, 0.5 * above
    return into


@inner
def _last_between(
    share: Floats, rate: Floats, first: float, last: float, end: float, band: float
) -> float:  # fmt: skip
    """Return the last time at which the magnitude of a sum of exponentials falls below `band`, in seconds.

    The sum is ``sum_j share_j exp(-rate_j time)``. The result is `first` if the sum stays below `band` from `first` to
    `last`. `share, rate` (m,): coefficients, and decay rates in 1/s; `first, last`: limits of the search, in seconds;
    `end`: magnitude of the sum at the time `last`, at most `band`; `band`: half width of the band around 0, in the unit
    of the coefficients.
    """
    b = last
    h = b - first
    while b > first:
        a = max(b - h, first)
        value, bend = _sums(share, rate, a)
        begin, slack = abs(value), 0.125 * (b - a) * (b - a) * bend
        if max(begin, end) + slack <= band:
            b, end, h = a, begin, 2.0 * (b - a)
        elif begin > band >= end and begin - end > 8.0 * slack:
            return _crossing(share, rate, a, begin, b, end, band)
        elif b - a <= _FINE * b:
            return b
        else:
            h = 0.5 * (b - a)
    return first


@kernel
def last_outside(
    shape: Floats, weight: Floats, rate: Floats, times: Floats, band: float, rows: NDArray[np.int64], result: Floats
) -> None:  # fmt: skip
    """Find for each row the last time at which its magnitude falls below `band`; write it into ``result[rows]``.

    The value of row ``i`` at time ``t`` is ``sum_j shape[i, j] weight[j] exp(-rate[j] t)``.  The entry of a row that
    stays below `band` between the first and the last of the `times` does not change.  At the last of the `times` all
    rows must be below.  The search goes backwards from there, in steps of at most the distance of two of the `times`.
    A step without a crossing is recognized by a bound: the line between its ends, plus the largest deviation of the
    curve from that line (``h**2 / 8`` times its second derivative, with the step ``h``), lies below `band`.  Other
    steps are shortened until they contain exactly one crossing.

    `shape` (n, m), `weight` (m,): coefficients of the exponentials, whose products have the unit of the values; `rate`
    (m,): decay rates, in 1/s; `times` (t,): ascending, in seconds; `band`: half width of the band around 0, in the unit
    of the values; `rows` (k,): numbers of the rows to examine; `result` (n,): output array of times, in seconds.
    """
    count = len(times)
    decay = np.empty((count, len(rate)))
    for k in range(count):
        for j in range(len(rate)):
            decay[k, j] = weight[j] * math.exp(-min(rate[j] * times[k], _GONE))
    share = np.empty(len(rate))
    for row in rows:
        for j in range(len(rate)):
            share[j] = shape[row, j] * weight[j]
        end = abs(_sums(share, rate, times[count - 1])[0])
        for k in range(count - 2, -1, -1):
            value, bend = 0.0, 0.0
            for j in range(len(rate)):
                term = decay[k, j] * shape[row, j]
                value += term
                bend += abs(term) * rate[j] * rate[j]
            h = times[k + 1] - times[k]
            if not max(abs(value), end) + 0.125 * h * h * bend <= band:
                found = _last_between(share, rate, times[k], times[k + 1], end, band)
                if found > times[k]:
                    result[row] = found
                    break
            end = abs(value)


Integers = NDArray[np.int64]

_UNKNOWN, _REACHED, _LOST, _WALKING = 0, 1, 2, 3
"""States of a cell while walks are followed, in the order of the names: not visited; on a walk that reaches a goal; on
a walk that does not; on the walk that is being followed.
"""


@inner
def _reading(height: float, steps: float) -> float:
    """Return the output of the converter, the number of whole steps; without a converter (`steps` 0), `height` itself.

    `height`: voltage above the lower end of the converter's range, as a fraction of the range; `steps`: number of steps
    of the range, ``2**bits``.
    """
    if steps == 0.0 or math.isnan(height):
        return height
    # Clip first: the floor is a 64-bit integer, which could overflow.
    return float(math.floor(min(max(height * steps, 0.0), steps - 1.0)))


@kernel
def lowest_neighbours(
    height: Floats, noise: Floats, draw: Floats, steps: float, falling: float, around: Integers, following: Integers
) -> None:
    """Find the neighbour of every cell with the lowest reading; -1 where no neighbour reads lower than the cell.

    Among equal readings the first is taken.  `height` (cells,): voltage above the lower end of the converter's range,
    as a fraction of the range; `noise` (cells,): standard deviation of one measurement of `height`; `draw` (cells, 2
    ndim + 1): standard normal numbers for the readings of the neighbours and, last, of the cell itself, without rows if
    there is no noise; `steps`: number of steps of the range, 0 without a converter; `falling`: factor of the readings
    before they are compared: 1, or -1 if the goal rail lies above the obstacle rail; `around` (cells, 2 ndim): flat
    indices of the neighbours, -1 for none; `following` (cells,): output array, flat indices of the lowest neighbours.
    """
    last = around.shape[1]
    noisy = len(draw) > 0
    for cell in range(len(around)):
        following[cell] = -1
        own = height[cell] + (noise[cell] * draw[cell, last] if noisy else 0.0)
        lowest = falling * _reading(own, steps)
        for side in range(last):
            there = around[cell, side]
            if there < 0:
                continue
            seen = height[there] + (noise[there] * draw[cell, side] if noisy else 0.0)
            reading = falling * _reading(seen, steps)
            if reading < lowest:
                lowest, following[cell] = reading, there


@kernel
def reach_goals(following: Integers, goal: NDArray[np.bool_], reached: NDArray[np.bool_]) -> None:
    """Find the cells from which a walk along `following` reaches a goal; write the mask to `reached` (cells,).

    A walk fails at a cell without successor (-1), and where it returns to a cell that it has passed.  `following`
    (cells,): flat index of the next cell; `goal` (cells,): mask of the goal cells.
    """
    count = len(following)
    state = np.zeros(count, np.int8)
    passed = np.empty(count, np.int64)
    for start in range(count):
        cell, length = start, 0
        while state[cell] == _UNKNOWN and not goal[cell]:
            state[cell] = _WALKING
            passed[length] = cell
            length += 1
            if following[cell] < 0:
                break
            cell = following[cell]
        outcome = _REACHED if goal[cell] or state[cell] == _REACHED else _LOST
        for k in range(length):
            state[passed[k]] = outcome
        reached[start] = outcome == _REACHED
