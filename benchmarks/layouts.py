"""Obstacles of the benchmark grids: random rectangles or boxes, and mazes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace


def boxes(size: int, dimensions: int, seed: int, share: float = 0.2) -> ConfigurationSpace:
    """Return a square or cube with a fraction of its cells covered by random boxes, and the goal in a corner."""
    rng = np.random.default_rng(seed)
    cell = np.zeros((size,) * dimensions, dtype=np.uint8)
    smallest, largest = (size // 64 + 1, size // 12 + 2) if dimensions == 2 else (max(size // 32, 1), size // 8 + 1)
    while np.count_nonzero(cell) < share * cell.size:
        low = rng.integers(0, size, dimensions)
        side = rng.integers(smallest, largest, dimensions)
        cell[tuple(slice(a, a + b) for a, b in zip(low, side, strict=True))] = Cell.OBSTACLE
    cell[(slice(0, 3),) * dimensions] = Cell.FREE
    cell[(1,) * dimensions] = Cell.GOAL
    return as_space(cell)


def maze(size: int, width: int, seed: int) -> ConfigurationSpace:
    """Return a perfect maze with corridors ``width`` cells wide and walls one cell thick, the goal in a corner."""
    pitch = width + 1
    count = (size - 1) // pitch
    cell = np.full((size, size), Cell.OBSTACLE, dtype=np.uint8)
    for (i, j), (k, m) in passages(count, seed):
        low, high = (min(i, k) * pitch + 1, min(j, m) * pitch + 1), (max(i, k) * pitch + 1, max(j, m) * pitch + 1)
        cell[low[0] : high[0] + width, low[1] : high[1] + width] = Cell.FREE
    cell[1, 1] = Cell.GOAL
    return as_space(cell)


def passages(count: int, seed: int) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return the open doors of a maze of ``count`` by ``count`` rooms: a depth-first tree, with long corridors."""
    rng = np.random.default_rng(seed)
    dice = iter(rng.permuted(np.tile(np.arange(4), (2 * count * count, 1)), axis=1).tolist())
    steps = ((1, 0), (-1, 0), (0, 1), (0, -1))
    seen: NDArray[np.bool_] = np.zeros((count + 2, count + 2), dtype=np.bool_)
    seen[0], seen[-1], seen[:, 0], seen[:, -1] = True, True, True, True
    seen[1, 1] = True
    stack, doors = [(0, 0)], []
    while stack:
        i, j = stack[-1]
        for turn in next(dice):
            k, m = i + steps[turn][0], j + steps[turn][1]
            if not seen[k + 1, m + 1]:
                seen[k + 1, m + 1] = True
                doors.append(((i, j), (k, m)))
                stack.append((k, m))
                break
        else:
            stack.pop()
    return doors


def as_space(cell: NDArray[np.uint8]) -> ConfigurationSpace:
    """Return a space with unit cells."""
    names = "xyzw"
    return ConfigurationSpace([Axis(names[a], 0, n, n) for a, n in enumerate(cell.shape)], cell)
