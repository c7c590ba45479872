"""Values beyond the walls and edges of a field, so that equipotentials are drawn right up to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def fill_open_walls(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give cells without a value the mean of their face neighbours that have one.

    This is the mirror image that an open (Neumann) wall stands for: no current crosses it, so equipotentials meet it at
    a right angle.
    """
    padded = np.pad(values, 1, constant_values=np.nan)
    around = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    known = np.isfinite(around)
    count = known.sum(axis=0)
    mean = np.where(known, around, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(np.isfinite(values) | (count == 0), values, mean)


def add_border(values: NDArray[np.float64], edge: tuple[str, ...], wall: float | None) -> NDArray[np.float64]:
    """Add one layer of cells around a field, as its edges have it."""
    padded = values
    for axis, rule in enumerate(edge):
        width = [(1, 1) if number == axis else (0, 0) for number in range(values.ndim)]
        if rule == "periodic":
            padded = np.pad(padded, width, mode="wrap")
        elif rule == "open" or wall is None:
            padded = np.pad(padded, width, mode="edge")
        else:
            padded = np.pad(padded, width, constant_values=wall)
    return padded
