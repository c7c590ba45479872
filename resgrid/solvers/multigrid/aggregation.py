"""Compiled loops that make one level of the hierarchy from the one above: aggregation and summation."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner
from resgrid.solvers.row_kernels import find, join, sort_row

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Integers = NDArray[np.int64]

_SAMPLE = 50_000


@njit(cache=True)
def coordinates(cell: Integers, shape: Integers) -> Indices:
    """Indices of cells given by their place in C order."""
    out = np.empty((len(cell), len(shape)), np.int32)
    for node in range(len(cell)):
        rest = cell[node]
        for axis in range(len(shape) - 1, -1, -1):
            out[node, axis] = rest % shape[axis]
            rest //= shape[axis]
    return out


@njit(cache=True)
def mean_along(indptr: Indices, indices: Indices, conductance: Floats, coordinate: Indices) -> Floats:
    """Mean conductance along every axis, of a sample; 0 where there is none."""
    total, entries = np.zeros(coordinate.shape[1]), np.zeros(coordinate.shape[1])
    for node in range(0, len(indptr) - 1, max(1, len(indptr) // _SAMPLE)):
        for k in range(indptr[node], indptr[node + 1]):
            for axis in range(coordinate.shape[1]):
                if coordinate[node, axis] != coordinate[indices[k], axis]:
                    total[axis] += conductance[k]
                    entries[axis] += 1.0
    return total / np.maximum(entries, 1.0)


@njit(cache=True)
def aggregate_blocks(
    indptr: Indices, indices: Indices, conductance: Floats, coordinate: Indices, shift: Integers, weak: float
) -> tuple[Indices, int]:
    """Aggregates: the connected parts of the graph within blocks of ``2**shift`` cells along every axis.

    A conductance connects unless it is less than ``weak`` times the strongest one at either end.
    """
    parent = np.arange(len(indptr) - 1).astype(np.int32)
    strongest = np.zeros(len(parent))
    if weak > 0.0:
        for node in range(len(parent)):
            for k in range(indptr[node], indptr[node + 1]):
                strongest[node] = max(strongest[node], conductance[k])
    for node in range(len(parent)):
        for k in range(indptr[node], indptr[node + 1]):
            other = indices[k]
            if other >= node:
                break
            together = conductance[k] >= weak * max(strongest[node], strongest[other])
            for axis in range(coordinate.shape[1]):
                together &= coordinate[node, axis] >> shift[axis] == coordinate[other, axis] >> shift[axis]
            if together:
                join(parent, node, other)
    return _numbered_by_colour(parent, coordinate, shift)


@inner
def _numbered_by_colour(parent: Indices, coordinate: Indices, shift: Integers) -> tuple[Indices, int]:
    """Number the trees, those in blocks of even index sum first: resistors join the two halves only."""
    aggregate = np.empty(len(parent), np.int32)
    count = 0
    for colour in range(2):
        for node in range(len(parent)):
            if parent[node] != node:
                continue
            total = 0
            for axis in range(coordinate.shape[1]):
                total += coordinate[node, axis] >> shift[axis]
            if total & 1 == colour:
                aggregate[node] = count
                count += 1
    for node in range(len(parent)):
        aggregate[node] = aggregate[find(parent, node)]
    return aggregate, count


@njit(cache=True)
def coarsen(
    indptr: Indices, indices: Indices, conductance: Floats, leak: Floats, aggregate: Indices, count: int
) -> tuple[Indices, Indices, Floats, Floats]:
    """Sum conductances between aggregates, and leaks within them; rows come out sorted."""
    n = len(indptr) - 1
    start = np.zeros(count + 1, np.int64)
    for node in range(n):
        start[aggregate[node] + 1] += 1
    start = np.cumsum(start)
    member = np.empty(n, np.int64)
    fill = start[:-1].copy()
    for node in range(n):
        member[fill[aggregate[node]]] = node
        fill[aggregate[node]] += 1
    new_indptr = np.zeros(count + 1, np.int32)
    new_indices = np.empty(len(indices), np.int32)
    new_conductance = np.empty(len(indices))
    new_leak = np.zeros(count)
    place = np.full(count, -1, np.int64)
    size = 0
    for row in range(count):
        begin = size
        for m in range(start[row], start[row + 1]):
            node = member[m]
            new_leak[row] += leak[node]
            for k in range(indptr[node], indptr[node + 1]):
                column = aggregate[indices[k]]
                if column == row:
                    continue
                if place[column] < begin:
                    place[column] = size
                    new_indices[size] = column
                    new_conductance[size] = 0.0
                    size += 1
                new_conductance[place[column]] += conductance[k]
        sort_row(new_indices, new_conductance, begin, size)
        new_indptr[row + 1] = size
    return new_indptr, new_indices[:size].copy(), new_conductance[:size].copy(), new_leak


@njit(cache=True)
def lengthen(
    indptr: Indices,
    indices: Indices,
    conductance: Floats,
    leak: Floats,
    coordinate: Indices,
    inner: Floats,
    members: Integers,
    mean: Floats,
) -> None:
    """Make coarse conductances know length, in place.

    From the middle of one block to the middle of the next lies half of either block's own resistance, in series with
    what joins the two; a pinned point is reached through the block around it.
    """
    for row in range(len(leak)):
        for k in range(indptr[row], indptr[row + 1]):
            column = indices[k]
            axis = 0
            for candidate in range(coordinate.shape[1]):
                if coordinate[row, candidate] != coordinate[column, candidate]:
                    axis = candidate
            resistance = 1.0 / conductance[k]
            if inner[row, axis] > 0.0:
                resistance += 0.5 / inner[row, axis]
            if inner[column, axis] > 0.0:
                resistance += 0.5 / inner[column, axis]
            conductance[k] = 1.0 / resistance
        if leak[row] > 0.0 and members[row] > 1 and mean[row] > 0.0:
            leak[row] = 1.0 / (1.0 / leak[row] + 0.25 / (max(1.0, 0.5 * members[row]) * mean[row]))


@njit(cache=True)
def block_shape(
    indptr: Indices,
    indices: Indices,
    conductance: Floats,
    aggregate: Indices,
    coordinate: Indices,
    shift: Integers,
    count: int,
) -> tuple[Indices, Floats, Integers, Floats]:
    """Coarse coordinates, conductances within aggregates along every axis, member counts and mean conductances."""
    ndim = coordinate.shape[1]
    coarse = np.zeros((count, ndim), np.int32)
    inner = np.zeros((count, ndim))
    members = np.zeros(count, np.int64)
    total, entries = np.zeros(count), np.zeros(count)
    for node in range(len(aggregate)):
        row = aggregate[node]
        members[row] += 1
        for axis in range(ndim):
            coarse[row, axis] = coordinate[node, axis] >> shift[axis]
        for k in range(indptr[node], indptr[node + 1]):
            other = indices[k]
            total[row] += conductance[k]
            entries[row] += 1.0
            if other > node and aggregate[other] == row:
                for axis in range(ndim):
                    if coordinate[node, axis] != coordinate[other, axis]:
                        inner[row, axis] += conductance[k]
    return coarse, inner, members, total / np.maximum(entries, 1.0)
