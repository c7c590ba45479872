"""Compiled loops of the robot that sees the read-out only: every cell's next one, and who reaches the goal."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_UNKNOWN, _REACHED, _LOST, _WALKING = 0, 1, 2, 3


@inner
def _reading(height: float, steps: float) -> float:
    """What a converter makes of a voltage, as a share of its range: whole steps, or the share itself (``steps`` 0)."""
    if steps == 0.0 or math.isnan(height):
        return height
    # Clipped first: the floor is an integer of 64 bits.
    return float(math.floor(min(max(height * steps, 0.0), steps - 1.0)))


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
