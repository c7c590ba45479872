"""Arrows of the current: which cells show one, where it points, how strong it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.planning.fields import Field

_FILL = 0.85


@dataclass(frozen=True, eq=False)
class Arrows:
    """Arrows in cells.

    `tail` (n, 2): cells that show an arrow; `vector` (n, 2): its components in axis units; all are equally long when
    measured in cells; `decades` (n,): log10 of the current through the cell, in units of supply / resistance.
    """

    tail: NDArray[np.int64]
    vector: NDArray[np.float64]
    decades: NDArray[np.float64]


def current_arrows(field: Field, block: int) -> Arrows:
    """Choose cells and find the direction of their current.

    The direction is that of the velocity at the cell's centre, the mean of opposite faces (Pollock 1988); it is
    computed from logarithms, so that currents of 1e-400 still have one.
    """
    cells = nearest_to_middles(field.space.goal_connected, block)
    log_face, sign = _faces_of(field, cells)
    largest = log_face.max(axis=(1, 2))
    flowing = np.isfinite(largest)
    cells, log_face, sign, largest = cells[flowing], log_face[flowing], sign[flowing], largest[flowing]
    mean = (sign * np.exp(log_face - largest[:, None, None])).mean(axis=2)
    length = np.linalg.norm(mean, axis=1)
    moving = length > 0
    vector = mean[moving] / length[moving, None] * field.space.spacing * block * _FILL
    return Arrows(cells[moving], vector, (largest[moving] + np.log(length[moving])) / np.log(10.0))


def nearest_to_middles(eligible: NDArray[np.bool_], block: int) -> NDArray[np.int64]:
    """In every block of cells, the eligible one nearest to the middle.  Returns (n, 2)."""
    padded = np.pad(eligible, [(0, -size % block) for size in eligible.shape])
    rows, columns = padded.shape[0] // block, padded.shape[1] // block
    blocks = padded.reshape(rows, block, columns, block).swapaxes(1, 2).reshape(rows * columns, block * block)
    offset = np.arange(block) - (block - 1) / 2
    distance = (offset[:, None] ** 2 + offset**2).ravel()
    best = np.where(blocks, distance, np.inf).argmin(axis=1)
    found = np.flatnonzero(blocks.any(axis=1))
    row, column = np.divmod(found, columns)
    inner_row, inner_column = np.divmod(best[found], block)
    return np.stack([row * block + inner_row, column * block + inner_column], axis=1).astype(np.int64)


def _faces_of(field: Field, cells: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Log current and sign on the lower and upper faces of cells, shapes (n, ndim, 2)."""
    log_face, sign = np.empty((len(cells), 2, 2)), np.empty((len(cells), 2, 2))
    for axis in range(2):
        for side in range(2):
            at = [cells[:, 0], cells[:, 1]]
            at[axis] = at[axis] + side
            log_face[:, axis, side] = field.face_log_current[axis][tuple(at)]
            sign[:, axis, side] = field.face_direction[axis][tuple(at)]
    return log_face, sign
