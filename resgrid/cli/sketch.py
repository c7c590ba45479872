"""A small map of a space in letters, to choose goals and starts from."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
from numpy.typing import NDArray

from resgrid.space import Cell, ConfigurationSpace

WIDTH, HEIGHT = 64, 24
KEY = "# obstacle, + partly, . free, G goal, S start"


def sketch(space: ConfigurationSpace, starts: Sequence[Sequence[float]] = ()) -> list[str]:
    """Rows of letters, the top one first: the first axis to the right, the second one upwards."""
    columns, rows = _size(space)
    blocked, goal = space.cell == Cell.OBSTACLE, space.cell == Cell.GOAL
    share = _means(blocked.astype(np.float64), columns, rows)
    letters = np.where(share == 1.0, "#", np.where(share == 0.0, ".", "+"))
    letters[_means(goal.astype(np.float64), columns, rows) > 0] = "G"
    for start in starts:
        x, y = ((value - axis.lower) / (axis.upper - axis.lower) for value, axis in zip(start, space.axes, strict=True))
        letters[min(int(x % 1.0 * columns), columns - 1), min(int(y % 1.0 * rows), rows - 1)] = "S"
    return ["".join(row) for row in letters.T[::-1].tolist()]


def _size(space: ConfigurationSpace) -> tuple[int, int]:
    """Columns and rows; a letter is twice as high as it is wide, and axes of unlike units share the space evenly."""
    x, y = space.axes
    shape = (y.upper - y.lower) / (x.upper - x.lower) if x.unit == y.unit else 0.75
    columns = min(WIDTH, 2 * x.cells, ceil(2 * HEIGHT / shape))
    return max(columns, 1), min(max(round(columns * shape / 2), 1), HEIGHT, y.cells)


def _means(values: NDArray[np.float64], columns: int, rows: int) -> NDArray[np.float64]:
    """Means over as many blocks of cells along each axis; a block holds at least one cell."""
    for axis, count in enumerate((columns, rows)):
        edges = np.arange(count) * values.shape[axis] / count
        first = np.floor(edges).astype(np.int64)
        last = np.maximum(np.ceil(edges + values.shape[axis] / count - 1e-9).astype(np.int64), first + 1)
        total = np.insert(np.cumsum(values, axis=axis), 0, 0.0, axis=axis)
        width = (last - first).reshape((-1, 1) if axis == 0 else (1, -1))
        values = (np.take(total, last, axis=axis) - np.take(total, first, axis=axis)) / width
    return values
