"""Kernels over the conductances of a matrix: conversion to compressed sparse rows (CSR), statistics, and residuals.

The module also contains device functions for sorting and for union-find.
"""

from __future__ import annotations

import math

import numpy as np

from resgrid._internal.jit import inner, interruptible, kernel
from resgrid.solvers.scaled import Floats, Indices, Reals


@interruptible
@kernel
def conductances_by_row(
    pairs: Indices, conductance: Floats, row: Indices, size: int
) -> tuple[Indices, Indices, Floats]:
    """Return the conductances between rows as sorted symmetric CSR arrays: begins of rows, columns and conductances.

    The arrays have shapes (size + 1,), (entries,) and (entries,). Parallel conductances are summed; there is no
    diagonal. Resistors with an end at a known voltage, or with both ends in one row, are skipped. Resistors are
    processed in their order: a column beyond the diagonal is written at the last free place of its row, a column before
    the diagonal at the first free one. Resistors of a grid are listed axis by axis, so that their columns are then
    already sorted.

    `pairs` (m, 2), `conductance` (m,): vertices at the ends of every resistor, and its conductance in siemens; `row`
    (vertices,): row of every vertex, negative for a known voltage; `size`: number of rows.
    """
    indptr = np.zeros(size + 1, np.int32)
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            indptr[i + 1] += 1
            indptr[j + 1] += 1
    for i in range(size):
        indptr[i + 1] += indptr[i]
    front, back = indptr[:-1].copy(), indptr[1:].copy()
    indices, data = np.empty(indptr[size], np.int32), np.empty(indptr[size])
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            lower, upper = min(i, j), max(i, j)
            back[lower] -= 1
            indices[back[lower]], data[back[lower]] = upper, conductance[k]
            indices[front[upper]], data[front[upper]] = lower, conductance[k]
            front[upper] += 1
    repeats = 0
    for i in range(size):
        wrong = 0
        for k in range(indptr[i] + 1, indptr[i + 1]):
            wrong += indices[k] <= indices[k - 1]
        if wrong > 0:
            sort(indices, data, indptr[i], indptr[i + 1])
            for k in range(indptr[i] + 1, indptr[i + 1]):
                repeats += indices[k] == indices[k - 1]
    if repeats > 0:
        end = _sum_repeats(indptr, indices, data)
        indices, data = indices[:end].copy(), data[:end].copy()
    return indptr, indices, data


@inner
def sort(keys: Indices, values: Floats | Indices, begin: int, end: int) -> None:
    """Sort ``keys[begin:end]`` in place, ascending, and permute ``values[begin:end]`` alike (Shell 1959).

    `keys` and `values` may be one array.
    """
    gap = 1
    while 16 * gap < end - begin:
        gap = 3 * gap + 1
    while gap > 0:
        for k in range(begin + gap, end):
            key, value, at = keys[k], values[k], k
            while at >= begin + gap and keys[at - gap] > key:
                keys[at], values[at] = keys[at - gap], values[at - gap]
                at -= gap
            keys[at], values[at] = key, value
        gap //= 3


@inner
def _sum_repeats(indptr: Indices, indices: Indices, data: Floats) -> int:
    """Sum the entries of equal column within every sorted CSR row, in place; return the new number of entries.

    `indptr` (n + 1,): begin of every row; `indices, data` (entries,): columns and conductances.  All three receive the
    result; the entries of `indices` and `data` after the new number are unused.
    """
    end = 0
    for i in range(len(indptr) - 1):
        begin, indptr[i] = indptr[i], end
        for k in range(begin, indptr[i + 1]):
            if k > begin and indices[k] == indices[end - 1]:
                data[end - 1] += data[k]
            else:
                indices[end], data[end] = indices[k], data[k]
                end += 1
    indptr[-1] = end
    return end


@inner
def find(parent: Indices, node: int) -> int:
    """Return the root of the tree of ``node`` in a union-find, and halve the path to the root.

    `parent` (n,): parent of every node, updated. A root is its own parent, and the smallest node of its tree. Path
    halving links every other node of the path to its grandparent.
    """
    above = parent[node]
    while above != node:
        top = parent[above]
        if top != above:
            parent[node] = top
        node, above = top, parent[top]
    return node


@inner
def join(parent: Indices, a: int, b: int) -> None:
    """Merge the trees of nodes ``a`` and ``b`` of a union-find; the smaller root becomes the root.

    `parent` (n,): parent of every node, updated; a root is its own parent.
    """
    a, b = find(parent, a), find(parent, b)
    if a != b:
        parent[max(a, b)] = min(a, b)


@kernel
def compare_edges(
    pairs: Indices, conductance: Floats, row: Indices, strongest: Floats, weak: float
) -> tuple[int, float, float, float, int]:
    """Return number, minimum, maximum and sum of the conductances between rows in siemens, and the number of weak ones.

    A conductance is weak if it is below ``weak`` times the strongest of all conductances at its two rows. Parallel
    conductances count one by one. Without conductances the minimum is infinite and the other results are 0.

    `pairs` (m, 2), `conductance` (m,): vertices at the ends of every resistor, and its conductance in siemens; `row`
    (vertices,): row of every vertex, negative for a known voltage; `strongest` (n,): 0 on entry, receives the largest
    conductance to another row at every row, in siemens.
    """
    count, smallest, largest, total, weak_count = 0, np.inf, 0.0, 0.0, 0
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            count += 1
            g = conductance[k]
            smallest, largest, total = min(smallest, g), max(largest, g), total + g
            strongest[i], strongest[j] = max(strongest[i], g), max(strongest[j], g)
    if smallest < weak * largest:
        for k in range(len(pairs)):
            i, j = row[pairs[k, 0]], row[pairs[k, 1]]
            if i >= 0 and j >= 0 and i != j and conductance[k] < weak * max(strongest[i], strongest[j]):
                weak_count += 1
    return count, smallest, largest, total, weak_count


@kernel
def row_residual(
    matrix: tuple[Indices, Indices, Reals, Floats], slot: Indices, b: Floats, x: Floats, r: Floats
) -> float:
    """Compute the residual ``b - A x`` in amperes from differences of `x`, and return its Euclidean norm.

    `matrix`: the fields of `Graph`, which are the CSR arrays of the conductances and the conductance of every row to
    nodes of known voltage; `slot` (n,): for every row, the index in ``r`` at which its residual is stored; `b, x` (n,):
    right-hand side in amperes and solution in volts, by row; `r` (n,): residual, overwritten.
    """
    indptr, indices, conductance, ground = matrix
    total = 0.0
    for i in range(len(slot)):
        v = b[i] - ground[i] * x[i]
        for k in range(indptr[i], indptr[i + 1]):
            v += conductance[k] * (x[np.uint32(indices[k])] - x[i])
        r[slot[i]] = v
        total += v * v
    return math.sqrt(total)
