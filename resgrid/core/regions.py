"""Connected components of graphs and cells, numbers of cell faces, and parts of arrays over cells or faces."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy import sparse

_SMALL = 5000
"""Largest number of cells for which regions are labelled in Python, to avoid the slow import of scipy.ndimage."""


def label_components(
    graph: NDArray[np.integer[Any]] | sparse.csr_array, node_count: int | None = None
) -> NDArray[np.int64]:
    """Return the number of the connected component of every node, (nodes,).

    Edges have no direction.  Components are numbered from 0 in the order of their smallest node.

    `graph`: pairs of nodes (m, 2), one per edge, or a square sparse matrix whose stored entries are the edges;
    `node_count`: number of nodes, needed for pairs and ignored for a matrix.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not isinstance(graph, np.ndarray):
        matrix: sparse.csr_array | sparse.coo_array = graph
    else:
        assert node_count is not None
        entries = np.ones(len(graph), dtype=np.int8), tuple(graph.T)
        matrix = coo_array(entries, shape=(node_count, node_count))
    return np.asarray(connected_components(matrix, directed=False)[1], dtype=np.int64)


def box_around(mask: NDArray[np.bool_]) -> tuple[slice, ...]:
    """Return the smallest box with all True cells of a mask, as one slice per axis; empty slices without such cells."""
    axes = range(mask.ndim)
    lines = [np.flatnonzero(mask.any(axis=tuple(other for other in axes if other != axis))) for axis in axes]
    return tuple(slice(int(line[0]), int(line[-1]) + 1) if len(line) else slice(0, 0) for line in lines)


def label_regions(mask: NDArray[np.bool_], periodic: ArrayLike, *, corners: bool = False) -> NDArray[np.int32]:
    """Return the number of the connected component of every cell of a mask, shape of the mask; 0 outside the mask.

    `mask`: cells to label; `periodic`: whether axes are periodic, one bool per axis, or one for all; `corners`: whether
    cells that share only an edge or a corner are neighbours; by default neighbours share a face.  Components are
    numbered from 1 in C order of their first cell.
    """
    if mask.size <= _SMALL and "scipy.ndimage" not in sys.modules:
        return _flood_fill(mask, np.broadcast_to(np.asarray(periodic, dtype=np.bool_), mask.ndim), corners=corners)
    from scipy import ndimage

    labels = np.empty(mask.shape, dtype=np.int32)
    count = ndimage.label(mask, structure=np.ones((3,) * mask.ndim) if corners else None, output=labels)
    rings = np.asarray(periodic, dtype=np.bool_)
    if not rings.any() or count < 2:
        return labels
    pairs = [_across_seam(labels, axis, rings, corners=corners) for axis in np.flatnonzero(rings).tolist()]
    touching = np.concatenate(pairs, axis=1)
    touching = touching[:, (touching > 0).all(axis=0)]
    # Label 0, outside the mask, is a component of its own and stays 0.
    return np.asarray(label_components(touching.T, count + 1).astype(np.int32)[labels])


def _flood_fill(mask: NDArray[np.bool_], rings: NDArray[np.bool_], *, corners: bool) -> NDArray[np.int32]:
    """Return the number of the connected component of every cell of a small mask, by flood fill in Python.

    Components are numbered from 1 in C order of their first cell; 0 outside the mask.  `rings` (ndim,): whether axes
    are periodic; `corners`: whether cells that share only an edge or a corner are neighbours.  A grid of 70 x 70 cells
    takes 1.7 ms, and importing `scipy.ndimage` 190 ms: commands on small maps do not import it.
    """
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
    """Return a copy of `wide` in which every cell has the value of its neighbour at the index offset `step` (ndim,).

    The shift is cyclic along every axis.  `wide`: one value per cell.
    """
    return np.roll(wide, [-by for by in step], tuple(range(wide.ndim)))


def _across_seam(labels: NDArray[np.int32], axis: int, rings: NDArray[np.bool_], *, corners: bool) -> NDArray[np.int32]:
    """Return the labels of all pairs of cells that touch across the seam of a periodic axis, shape (2, n).

    Row 0 has the labels of the cells at the lower end of the axis, row 1 those at the upper end.  `labels`: component
    of every cell, 0 for cells in no component; `axis`: index of the periodic axis; `rings` (ndim,): whether axes are
    periodic; `corners`: whether cells that share only an edge or a corner touch, too.
    """
    first, last = labels.take(0, axis), labels.take(-1, axis)
    if not corners or labels.ndim == 1:
        return np.stack([first.ravel(), last.ravel()])
    others = np.delete(rings, axis).astype(int).tolist()
    wide = np.pad(np.pad(last, [(ring, ring) for ring in others], mode="wrap"), [(1 - ring,) * 2 for ring in others])
    shape: tuple[int, ...] = last.shape
    windows = product(*([slice(by, by + cells) for by in range(3)] for cells in shape))
    beside = [wide[window].ravel() for window in windows]
    return np.stack([np.tile(first.ravel(), len(beside)), np.concatenate(beside)])


def slab(array: NDArray[Any], axis: int, start: int, stop: int) -> NDArray[Any]:
    """Return a view of an array, restricted to the indices `start` to `stop` (exclusive) along an axis."""
    return array[(slice(None),) * axis + (slice(start, stop),)]


def with_margin(
    array: NDArray[Any], periodic: NDArray[np.bool_], box: Sequence[tuple[int, int]] = (), beyond: Any = None
) -> NDArray[Any]:
    """Return a copy of a box of cells with a margin of one cell on every side, wrapped on periodic axes.

    `array`: one value per cell of the grid; `periodic` (ndim,): whether axes are periodic; `box`: range (first, end),
    without end, of cells along each of the first axes; the other axes are complete; `beyond`: value of the margin
    outside the grid; None repeats the value of the border cell.  Inside the grid, the margin has the cells' values.
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


def cells_at_faces(wide: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the values of the cells below and above every face perpendicular to an axis, as views of `wide`.

    Below is the cell with the lower index.  Both views have one entry per face: the shape of the grid without the
    margin, plus one along the axis.  `wide`: one value per cell, with a margin of one cell on every side.
    """
    inside = [slice(1, -1)] * wide.ndim
    ends = [(*inside[:axis], part, *inside[axis + 1 :]) for part in (slice(0, -1), slice(1, None))]
    return wide[ends[0]], wide[ends[1]]


def sides_of_cells(faces: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the values of the lower and of the upper face of every cell along an axis, as views, shape of the grid.

    `faces`: one value per face perpendicular to the axis: shape of the grid, plus one along the axis.
    """
    along = np.moveaxis(faces, axis, 0)
    return np.moveaxis(along[:-1], 0, axis), np.moveaxis(along[1:], 0, axis)


def face_shape(shape: tuple[int, ...], axis: int) -> tuple[int, ...]:
    """Return the shape of an array of the faces perpendicular to an axis: one more face than cells along this axis.

    `shape`: number of cells along every axis.
    """
    return (*shape[:axis], shape[axis] + 1, *shape[axis + 1 :])


def face_counts(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the number of faces perpendicular to each axis; `shape`: number of cells along every axis."""
    return tuple(math.prod(face_shape(shape, axis)) for axis in range(len(shape)))


def by_axis(faces: NDArray[Any], shape: tuple[int, ...]) -> tuple[NDArray[Any], ...]:
    """Return one view per axis of a flat array of face values, in the shape of the grid plus one along this axis.

    `faces` (faces,): values of the faces perpendicular to the first axis, then to the second, and so on; `shape`:
    number of cells along every axis.
    """
    parts = np.split(faces, np.cumsum(face_counts(shape))[:-1])
    return tuple(part.reshape(face_shape(shape, axis)) for axis, part in enumerate(parts))


def crossed_faces(
    face: NDArray[np.integer[Any]], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the axis perpendicular to each face, (n,), and the face's index among the faces of that axis, (n, ndim).

    `face` (n,): face numbers, counted axis by axis in C order; a negative number, for no face, gets the axis -1 and the
    index 0; `shape`: number of cells along every axis.
    """
    starts = np.cumsum([0, *face_counts(shape)])
    across = np.searchsorted(starts, face, side="right") - 1
    index = np.zeros((len(face), len(shape)), dtype=np.int64)
    for axis in range(len(shape)):
        own = across == axis
        index[own] = np.stack(np.unravel_index(face[own] - starts[axis], face_shape(shape, axis)), axis=1)
    return across, index
