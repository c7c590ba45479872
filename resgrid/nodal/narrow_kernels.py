"""Compiled loops over factors of narrow circuits: their order, their pattern and their numbers.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]

_MANY = 16


@njit(cache=True, nogil=True)
def grow_tree(indptr: Indices, indices: Indices, order: Indices, rank: Indices, parent: Indices) -> None:
    """The elimination tree: the first later row that every row is joined to once it is eliminated; -1 for none."""
    n = len(order)
    ancestor = np.full(n, -1, np.int32)
    for k in range(n):
        parent[k] = -1
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            j = rank[indices[entry]]
            while j < k:
                above = ancestor[j]
                ancestor[j] = k
                if above < 0:
                    parent[j] = k
                if above < 0 or above == k:
                    break
                j = above


@njit(cache=True, nogil=True)
def branch_by_branch(parent: Indices, order: Indices, rank: Indices) -> None:
    """Renumber the rows so that every branch of the elimination tree stands together; it fills as before."""
    n = len(parent)
    child, sibling = np.full(n, -1, np.int32), np.empty(n, np.int32)
    for k in range(n - 1, -1, -1):
        if parent[k] >= 0:
            sibling[k] = child[parent[k]]
            child[parent[k]] = k
    before, path, number = order.copy(), np.empty(n, np.int32), np.empty(n, np.int32)
    count = 0
    for root in range(n):
        if parent[root] >= 0:
            continue
        path[0], length = root, 1
        while length > 0:
            k = path[length - 1]
            if child[k] >= 0:
                path[length] = child[k]
                length += 1
                child[k] = sibling[child[k]]
            else:
                length -= 1
                number[k] = count
                order[count], rank[before[k]] = before[k], count
                count += 1
    for k in range(n):
        sibling[number[k]] = number[parent[k]] if parent[k] >= 0 else -1
    parent[:] = sibling


@njit(cache=True, nogil=True)
def list_rows(
    indptr: Indices, indices: Indices, order: Indices, rank: Indices, parent: Indices, end: Indices, columns: Indices
) -> bool:
    """Columns left of the diagonal that the rows of the factor have entries in.

    They are what the elimination tree leads through from a row's neighbours up to it (Liu 1990).  ``end`` says where
    the list of every row ends.  Returns False where there is no room for all, or where there will not be, to judge by
    more than an eighth of the rows.
    """
    n, total = len(order), 0
    seen, share = np.full(n, -1, np.int32), len(columns) / (n + n // 8)
    for k in range(n):
        if total > share * (k + n // 8):
            return False
        seen[k] = k
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            j = rank[indices[entry]]
            while j < k and seen[j] != k:
                if total == len(columns):
                    return False
                seen[j] = k
                columns[total] = j
                total += 1
                j = parent[j]
        end[k] = total
    return True


@njit(cache=True, nogil=True)
def eliminate(
    indptr: Indices, indices: Indices, data: Floats, excess: Floats, order: Indices, rank: Indices, end: Indices,
    columns: Indices, start: Indices, after: Indices, below: Indices, lower: Floats, pivot: Floats, held: Floats,
    joined: Floats, begin: int, behind: int,
) -> bool:  # fmt: skip
    """Factors ``L D L^T`` of some rows in order, in sums, products and quotients of positive numbers alone.

    A row that is eliminated joins those it was joined to, and the rails, by ``c_i c_j / d``; its pivot ``d`` is the sum
    of its conductances to later rows and to the rails, never a difference (Grassmann, Taksar & Heyman 1985).  So every
    entry is right to some roundings, whatever the conductances.  Across a corridor rows mostly follow one upon another,
    which fills the vector registers where they are many; as a function of its own, that loop takes three times as long.

    Parameters
    ----------
    indptr, indices, data : ndarray
        Conductances between rows by rows, in siemens.
    excess : ndarray of float64, shape (n,)
        Conductances to the rails, in siemens.
    order, rank : ndarray of int32, shape (n,)
    end, columns : ndarray of int32
        As of `list_rows`.
    start : ndarray of int32, shape (n + 1,)
        Where the columns of ``L`` begin, their diagonals included.
    after : ndarray of int32, shape (n,)
        Where columns have been used up to: their beginnings, before the first row.
    below : ndarray of int32
        The rows of ``L``, as of `list_columns`.
    lower : ndarray of float64
        Filled with its values, the diagonal first in every column.
    pivot, held : ndarray of float64, shape (n,)
        Filled with ``D``, and with the conductances to the rails of every row when its turn comes.
    joined : ndarray of float64, shape (n,)
        Zeros before the first row; what rows behind these are joined to, afterwards.
    begin, behind : int
        The rows, from ... to before ...; those before have been eliminated.

    Returns
    -------
    bool
        Whether all pivots are positive and finite.
    """
    first = end[begin - 1] if begin > 0 else 0
    for k in range(begin, behind):
        to_rails = excess[order[k]]
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            joined[rank[indices[entry]]] = data[entry]
        for m in range(first, end[k]):
            j = columns[m]
            after[j] += 1
            share = -lower[after[j]]
            to_rails += share * held[j]
            conductance, here, count = share * pivot[j], np.uint64(after[j] + 1), start[j + 1] - after[j] - 1
            if count >= _MANY and below[start[j + 1] - 1] - below[after[j] + 1] == count - 1:
                there = np.uint64(below[after[j] + 1])
                for i in range(count):
                    joined[there + np.uint64(i)] -= conductance * lower[here + np.uint64(i)]
            else:
                for i in range(count):
                    joined[np.uint32(below[here + np.uint64(i)])] -= conductance * lower[here + np.uint64(i)]
        first = end[k]
        total = to_rails + _take(below, lower, start[k] + 1, start[k + 1], joined)
        if not (total > 0.0 and math.isfinite(total)):
            return False
        pivot[k], held[k] = total, to_rails
        lower[start[k]] = 1.0
        for entry in range(start[k] + 1, start[k + 1]):
            lower[entry] /= -total
    return True


@njit(cache=True, nogil=True)
def list_columns(end: Indices, columns: Indices, start: Indices, below: Indices) -> None:
    """Rows of the columns, the diagonal first, from the columns of the rows."""
    first, after = 0, start.copy()
    for k in range(len(end)):
        below[after[k]] = k
        after[k] += 1
        for m in range(first, end[k]):
            j = columns[m]
            below[after[j]] = k
            after[j] += 1
        first = end[k]


@inner
def _take(below: Indices, lower: Floats, begin: int, end: int, joined: Floats) -> float:
    """Take what a row is joined to over into its column; returns the sum."""
    total = 0.0
    for entry in range(begin, end):
        conductance = joined[np.uint32(below[entry])]
        joined[np.uint32(below[entry])] = 0.0
        lower[entry] = conductance
        total += conductance
    return total
