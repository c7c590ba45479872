"""Regions and slabs of a grid: face-connected cells, and ranges of cells or faces along one axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_SMALL = 5000
"""Cells up to which regions are walked cell by cell, in less time than scipy's labels take to be imported."""


def box_around(mask: NDArray[np.bool_]) -> tuple[slice, ...]:
    """The smallest box that holds all of a mask."""
    axes = range(mask.ndim)
    lines = [np.flatnonzero(mask.any(axis=tuple(other for other in axes if other != axis))) for axis in axes]
    return tuple(slice(int(line[0]), int(line[-1]) + 1) if len(line) else slice(0, 0) for line in lines)


def label_regions(mask: NDArray[np.bool_], periodic: ArrayLike, *, corners: bool = False) -> NDArray[np.int32]:
    """Connected components of a mask, numbered from 1 in C order of their first cell; 0 outside.

    Cells meet across faces; with corners across edges and corners too.
    """
    if mask.size <= _SMALL:
        return _walk_regions(mask, np.broadcast_to(np.asarray(periodic, dtype=np.bool_), mask.ndim), corners=corners)
    from scipy import ndimage

    labels = np.empty(mask.shape, dtype=np.int32)
    count = ndimage.label(mask, structure=np.ones((3,) * mask.ndim) if corners else None, output=labels)
    rings = np.asarray(periodic, dtype=np.bool_)
    if not rings.any() or count < 2:
        return labels
    pairs = [_across_seam(labels, axis, rings, corners=corners) for axis in np.flatnonzero(rings).tolist()]
    return _join(labels, count, np.concatenate(pairs, axis=1))


def _walk_regions(mask: NDArray[np.bool_], rings: NDArray[np.bool_], *, corners: bool) -> NDArray[np.int32]:
    """The same cell by cell, from the first of every region; `rings` (mask.ndim,)."""
    farthest = mask.ndim if corners else 1
    steps = [step for step in product((-1, 0, 1), repeat=mask.ndim) if 0 < np.count_nonzero(step) <= farthest]
    margins = [(1, 1)] * mask.ndim
    inside = np.pad(mask, margins)
    number = np.pad(np.arange(mask.size).reshape(mask.shape), margins)
    for axis in np.flatnonzero(rings):
        for here, there in ((0, -2), (-1, 1)):
            for wide in (inside, number):
                lines = np.moveaxis(wide, axis, 0)
                lines[here] = lines[there]
    middle = tuple(slice(1, -1) for _ in mask.shape)
    beside = np.stack([_shifted(np.where(inside, number, -1), step)[middle].ravel() for step in steps], axis=1).tolist()
    labels, count = [0] * mask.size, 0
    for first in np.flatnonzero(mask).tolist():
        if labels[first]:
            continue
        count += 1
        labels[first] = count
        waiting = [first]
        while waiting:
            for other in beside[waiting.pop()]:
                if other >= 0 and not labels[other]:
                    labels[other] = count
                    waiting.append(other)
    return np.array(labels, dtype=np.int32).reshape(mask.shape)


def _shifted(wide: NDArray[np.int64], step: tuple[int, ...]) -> NDArray[np.int64]:
    """What lies one step farther; nothing wraps but margins."""
    return np.roll(wide, [-by for by in step], tuple(range(wide.ndim)))


def _across_seam(labels: NDArray[np.int32], axis: int, rings: NDArray[np.bool_], *, corners: bool) -> NDArray[np.int32]:
    """Labels of cells that meet across the seam of an axis, shape (2, n)."""
    first, last = labels.take(0, axis), labels.take(-1, axis)
    if not corners or labels.ndim == 1:
        return np.stack([first.ravel(), last.ravel()])
    others = np.delete(rings, axis).astype(int).tolist()
    wide = np.pad(np.pad(last, [(ring, ring) for ring in others], mode="wrap"), [(1 - ring,) * 2 for ring in others])
    shape: tuple[int, ...] = last.shape
    windows = product(*([slice(by, by + cells) for by in range(3)] for cells in shape))
    beside = [wide[window].ravel() for window in windows]
    return np.stack([np.tile(first.ravel(), len(beside)), np.concatenate(beside)])


def _join(labels: NDArray[np.int32], count: int, pairs: NDArray[np.int32]) -> NDArray[np.int32]:
    """The same with pairs of labels (2, n) made one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, last = pairs
    both = (first > 0) & (last > 0)
    graph = coo_array((np.ones(both.sum()), (first[both], last[both])), shape=(count + 1, count + 1))
    _, group = connected_components(graph, directed=False)
    # Old labels come in C order of first cells, so a group's smallest label orders the groups.
    _, order = np.unique(group[1:], return_index=True)
    rank = np.zeros(group.max() + 1, dtype=np.int32)
    rank[group[1:][np.sort(order)]] = np.arange(1, len(order) + 1, dtype=np.int32)
    new_label = rank[group]
    new_label[0] = 0
    return np.asarray(new_label[labels])


def slab(array: NDArray[Any], axis: int, start: int, stop: int) -> NDArray[Any]:
    """A view of a range along an axis."""
    return array[(slice(None),) * axis + (slice(start, stop),)]


def with_margin(
    array: NDArray[Any], periodic: NDArray[np.bool_], box: Sequence[tuple[int, int]] = (), beyond: Any = None
) -> NDArray[Any]:
    """A copy of a box (all by default) with one more cell on every side, wrapped where an axis is periodic.

    At borders it is what lies `beyond`, or the cell repeated.  `box`: ranges of cells of the first axes; others are
    taken whole.
    """
    at_border: dict[str, Any] = {"mode": "edge"} if beyond is None else {"constant_values": beyond}
    wide = array
    for axis, size in enumerate(array.shape):
        first, last = box[axis] if axis < len(box) else (0, size)
        if periodic[axis] and (first, last) != (0, size):
            wide = np.take(wide, np.arange(first - 1, last + 1) % size, axis=axis)
            continue
        inside = slab(wide, axis, max(first - 1, 0), min(last + 1, size))
        margins = [(0, 0)] * array.ndim
        margins[axis] = (int(first == 0), int(last == size))
        wide = np.pad(inside, margins, **({"mode": "wrap"} if periodic[axis] else at_border))
    return wide


def before_and_behind(wide: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Views of what lies before and behind every face across an axis, of an array with a margin of one cell."""
    inside = [slice(1, -1)] * wide.ndim
    ends = [(*inside[:axis], part, *inside[axis + 1 :]) for part in (slice(0, -1), slice(1, None))]
    return wide[ends[0]], wide[ends[1]]


def sides_of_cells(faces: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Views of what belongs to the lower and to the upper face of every cell across an axis."""
    along = np.moveaxis(faces, axis, 0)
    return np.moveaxis(along[:-1], 0, axis), np.moveaxis(along[1:], 0, axis)


def face_shape(shape: tuple[int, ...], axis: int) -> tuple[int, ...]:
    """Shape of the array of faces across an axis: one more than the cells along it."""
    return (*shape[:axis], shape[axis] + 1, *shape[axis + 1 :])


def face_counts(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Number of faces across every axis."""
    return tuple(math.prod(face_shape(shape, axis)) for axis in range(len(shape)))


def by_axis(faces: NDArray[Any], shape: tuple[int, ...]) -> tuple[NDArray[Any], ...]:
    """Values of all faces, flat, as views of one array an axis."""
    parts = np.split(faces, np.cumsum(face_counts(shape))[:-1])
    return tuple(part.reshape(face_shape(shape, axis)) for axis, part in enumerate(parts))


def crossed_faces(
    face: NDArray[np.integer[Any]], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The axis (n,) across which faces (n,) lie, -1 for a face of -1, and their index (n, ndim) in the axis' array."""
    starts = np.cumsum([0, *face_counts(shape)])
    across = np.searchsorted(starts, face, side="right") - 1
    index = np.zeros((len(face), len(shape)), dtype=np.int64)
    for axis in range(len(shape)):
        own = across == axis
        index[own] = np.stack(np.unravel_index(face[own] - starts[axis], face_shape(shape, axis)), axis=1)
    return across, index
