"""Means over blocks of cells: maps with more cells than a picture has dots are made smaller before they are drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def block_size(shape: tuple[int, ...], most: int) -> int:
    """Cells along each side of a block, so that there are at most ``most`` blocks along either axis."""
    return -(-max(shape[:2]) // most)


def block_means(values: NDArray[np.float64], block: int) -> NDArray[np.float64]:
    """Means over square blocks of cells."""
    if block == 1:
        return values
    known = np.isfinite(values)
    count = _block_sums(known.astype(np.float64), block)
    total = _block_sums(np.where(known, values, 0.0), block)
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)


def block_colours(colours: NDArray[np.uint8], block: int) -> NDArray[np.uint8]:
    """Blend colours over square blocks of cells; as `block_means` otherwise.  Shapes: `colours` (n, m, 4)."""
    if block == 1:
        return colours
    opacity = colours[..., 3].astype(np.float64)
    weight = _block_sums(opacity, block)
    parts = [_block_sums(colours[..., part] * opacity, block) / np.maximum(weight, 1.0) for part in range(3)]
    return np.round(np.stack([*parts, weight / block**2], axis=-1)).astype(np.uint8)


def _block_sums(values: NDArray[Any], block: int) -> NDArray[np.float64]:
    padded = np.pad(values, [(0, -size % block) for size in values.shape])
    rows, columns = (size // block for size in padded.shape)
    return np.asarray(padded.reshape(rows, block, columns, block).sum(axis=(1, 3)), dtype=np.float64)
