"""Distances of all cells of a grid from its marked cells, by Euclidean distance transforms."""

from __future__ import annotations

from itertools import product
from math import ceil, prod
from typing import Literal

import numpy as np
from numpy.typing import NDArray

_CELLS_AT_ONCE = 1 << 20
"""Largest number of cells of one distance transform, which limits its memory: up to 70 bytes per cell."""


def near_boxes(
    mask: NDArray[np.bool_], spacing: NDArray[np.float64], reach: float, rule: Literal["conservative", "centre"]
) -> NDArray[np.bool_]:
    """Return the mask of cells whose box, or centre, lies within a distance of a marked cell's box; shape of `mask`.

    The box of a cell is the closed set of points that the cell covers.
    `mask`: marked cells of a grid; `spacing` (ndim,): cell widths in axis units; `reach`: distance in axis units;
    `rule`: ``"conservative"`` to measure from the box of a cell, ``"centre"`` to measure from its centre.  The grid is
    processed in bands along the first axis, together with the cells within the distance, to limit the memory.
    """
    halo = ceil(min(reach / float(spacing[0]), len(mask))) + 2
    transformed = prod(mask.shape[1:]) * (1 if rule == "conservative" else 2**mask.ndim)
    step = max(_CELLS_AT_ONCE // max(transformed, 1), halo)
    near = np.zeros_like(mask)
    for first in range(0, len(mask), step):
        low = max(first - halo, 0)
        band = mask[low : first + step + halo]
        if band.any():
            distance = distance_from_boxes(band, spacing, rule)
            near[first : first + step] = distance[first - low : first - low + step] <= reach
    return near


def distance_from_boxes(
    mask: NDArray[np.bool_], spacing: NDArray[np.float64], rule: Literal["conservative", "centre"]
) -> NDArray[np.float64]:
    """Return the distance, in axis units, from every cell's box or centre to the nearest marked cell's box.

    The result has the shape of `mask`.  The box of a cell is the closed set of points that the cell covers.
    `mask`: marked cells of a grid, at least one; `spacing` (ndim,): cell widths; `rule`: ``"conservative"`` to measure
    from the box of a cell, ``"centre"`` to measure from its centre.
    Along an axis, the gap of two boxes with index difference ``d`` is ``max(|d| - 1, 0)`` cells, which is the distance
    of ``d`` from the set ``{-1, 0, 1}``.  So the distance is a Euclidean distance transform of the mask dilated by one
    cell.  The gap of a centre and a box is ``max(|d| - 1/2, 0)``: the same transform on a grid of half the spacing.
    """
    from scipy import ndimage

    if rule == "conservative":
        grown = ndimage.binary_dilation(mask, structure=np.ones((3,) * mask.ndim, dtype=bool))
        return np.asarray(ndimage.distance_transform_edt(~grown, sampling=spacing))
    fine = np.zeros(tuple(2 * n + 1 for n in mask.shape), dtype=bool)
    for offset in product(range(3), repeat=mask.ndim):
        fine[tuple(slice(start, start + 2 * n, 2) for start, n in zip(offset, mask.shape, strict=True))] |= mask
    distance = ndimage.distance_transform_edt(~fine, sampling=spacing / 2)
    return np.asarray(distance[(slice(1, None, 2),) * mask.ndim])
