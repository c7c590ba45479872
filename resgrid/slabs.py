"""Slabs of a grid: ranges of cells or faces along one axis."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def slab(array: NDArray[Any], axis: int, start: int, stop: int) -> NDArray[Any]:
    """A view of a range along an axis."""
    return array[(slice(None),) * axis + (slice(start, stop),)]


def places_in_slab(
    kept: NDArray[np.bool_], shape: tuple[int, ...], axis: int, ends: tuple[int, int]
) -> NDArray[np.int64]:
    """Flat indices (C order) of what is kept in a slab of an array of that shape."""
    whole = np.zeros(shape, dtype=np.bool_)
    slab(whole, axis, *ends)[...] = kept
    return np.flatnonzero(whole)


def faces_ahead(
    here: NDArray[np.integer[Any]], shape: tuple[int, ...], axis: int, ahead: int
) -> NDArray[np.integer[Any]]:
    """Flat indices of the faces ``ahead`` faces behind the first one of every cell, among those across the axis.

    Of the same type as the cells' own indices, which must have room for them.
    """
    inner = int(np.prod(shape[axis + 1 :]))
    faces = here + ahead * inner
    if axis > 0:
        faces += here // (shape[axis] * inner) * inner
    return faces


def face_counts(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Number of faces across every axis, one more than the cells along it."""
    return tuple(math.prod(shape) // cells * (cells + 1) for cells in shape)
