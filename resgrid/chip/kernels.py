"""Compiled loops: when sums of exponentials last leave a band, and where a robot goes that sees the read-out only."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inner, kernel

Floats = NDArray[np.float64]

_FINE = 1e-9
"""Step, relative to the time, below which a sum that touches the band is not told from one that crosses it."""

_EXACT = 1e-13
"""Distance from the band, relative to it, at which a crossing is found."""

_MOST_STEPS = 100

_GONE = 700.0
"""Time constants after which an exponential is no double."""


@inner
def _sums(share: Floats, rate: Floats, time: float) -> tuple[float, float]:
    """A sum of exponentials, and no less than its second derivative's magnitude from that time on."""
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
    """Where the magnitude falls through the band, by false position (Illinois; Dowell & Jarratt 1971)."""
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
    """When the magnitude last falls through the band; ``first`` if it stays below, ``end`` being what it ends with."""
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
    """When rows come into a band for good, in ``result[rows]``; left alone where they are inside all the while.

    After the last of the ``times`` they must be inside.  The way back from there is walked in steps, from one time to
    the one before or shorter, so that the line between a step's ends, and as much as the curve can leave it (``h**2 /
    8`` times its second derivative), are inside: nothing is missed between them.  A step that cannot be so short holds
    the crossing.
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


@inner
def _reading(height: float, steps: float) -> float:
    """What a converter makes of a voltage, as a share of its range: whole steps, or the share itself (``steps`` 0)."""
    if steps == 0.0 or math.isnan(height):
        return height
    # Clipped first: the floor is an integer of 64 bits.
    return float(math.floor(min(max(height * steps, 0.0), steps - 1.0)))


@kernel
def step_down(
    height: Floats, noise: Floats, draw: Floats, steps: float, falling: float, around: Integers, following: Integers
) -> None:
    """The neighbour of every cell that measures lowest, the first of equal ones; -1 where none is lower.

    ``height`` is the voltage of every cell as a share of the converter's range, ``noise`` its deviation; ``draw`` has
    one number per cell and reading (its neighbours in order, then itself), or no rows where there is no noise.
    ``falling`` is 1, or -1 where the goal rail lies above the other.
    """
    last = around.shape[1]
    noisy = len(draw) > 0
    for cell in range(len(around)):
        following[cell] = -1
        own = height[cell] + (noise[cell] * draw[cell, last] if noisy else 0.0)
        lowest = falling * _reading(own, steps)
        for way in range(last):
            there = around[cell, way]
            if there < 0:
                continue
            seen = height[there] + (noise[there] * draw[cell, way] if noisy else 0.0)
            reading = falling * _reading(seen, steps)
            if reading < lowest:
                lowest, following[cell] = reading, there


@kernel
def follow(following: Integers, goal: NDArray[np.bool_], reached: NDArray[np.bool_]) -> None:
    """Which cells lead to a goal; one that leads to a dead end, or back to a cell passed before, does not."""
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
