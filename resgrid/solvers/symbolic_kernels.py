"""Compiled loops before factors: odd-even reduction of a matrix, its elimination tree, the supernodes of its factor.

Reduction eliminates rows that no conductance joins to each other.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import ZERO, inlined, inner, kernel, makes_arrays
from resgrid.solvers.laplacian import Conductances
from resgrid.solvers.ordering_kernels import with_room

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]

_MOST_NEIGHBOURS = 8
"""Of a row that is reduced away: they are joined to each other."""

_WIDEST, _FEW, _SHARE = 16, 20.0, 0.2
"""Most columns of a supernode, and how many of its entries may be zeros: so many, and such a share of all."""


class Pattern(NamedTuple):
    """The graph of a matrix, and an order of its rows.

    `indptr` (n + 1,), `indices`: neighbours of every row; `order` (n,): row ``order[k]`` is the ``k``-th; `rank` (n,):
    its inverse.
    """

    indptr: Indices
    indices: Indices
    order: Indices
    rank: Indices


@kernel
def number_kept(
    indptr: Indices, indices: Indices, order: Indices, number: Indices, kept: Indices, depth: Indices
) -> int:
    """Number the rows that are kept as they come in an order, and list them; -1 for the others.  Returns how many.

    The order is breadth first, backwards.  Not kept are the rows an odd number of steps from the last one that have
    few neighbours, and none as far from it: of a grid's cells, all of one colour.

    Shapes: `order, number, kept, depth` (n,): the last comes as -1.
    """
    n, count = len(order), 0
    for k in range(n - 1, -1, -1):
        i = order[k]
        depth[i] = max(depth[i], 0)
        for entry in range(indptr[i], indptr[i + 1]):
            if depth[indices[entry]] < 0:
                depth[indices[entry]] = depth[i] + 1
    for k in range(n):
        i = order[k]
        alone = depth[i] % 2 == 1 and indptr[i + 1] - indptr[i] <= _MOST_NEIGHBOURS
        for entry in range(indptr[i], indptr[i + 1]):
            alone = alone and depth[indices[entry]] != depth[i]
        number[i], kept[count] = -1 if alone else count, i
        count += not alone
    return count


@kernel
def join_kept(
    whole: Conductances, number: Indices, kept: Indices, pivot: Floats, left: Conductances, place: Indices
) -> None:
    """Eliminate all rows that are not kept, ``g_ij += g_ik g_kj / d_k``; fills `pivot` (n,), ``d``, and `left`.

    Shapes: `number` (n,), `kept, place` (kept,): the last comes as -1.
    """
    indptr, indices, data, ground = whole
    for i in range(len(number)):
        if number[i] < 0:
            total = ground[i]
            for entry in range(indptr[i], indptr[i + 1]):
                total += data[entry]
            pivot[i] = total
    count = 0
    left.indptr[0] = 0
    for row in range(len(kept)):
        i, begin, grounded = kept[row], count, ground[kept[row]]
        for entry in range(indptr[i], indptr[i + 1]):
            j, first, last, share = indices[entry], entry, entry + 1, 1.0
            if number[j] < 0:
                first, last, share = indptr[j], indptr[j + 1], data[entry] / pivot[j]
                grounded += share * ground[j]
            for other in range(first, last):
                column = number[indices[other]]
                if column == row:
                    continue
                if place[column] < begin:
                    place[column], left.indices[count], left.edges[count] = count, column, 0.0
                    count += 1
                left.edges[place[column]] += share * data[other]
        left.indptr[row + 1], left.ground[row] = count, grounded


@kernel
def postorder(pattern: Pattern, before: Indices, parent: Indices, ancestor: Indices, path: Indices) -> None:
    """Renumber the rows so that every branch of the elimination tree stands together; it fills as before.

    Shapes: `before` (n,): the order so far; `parent, ancestor, path` (n,): `ancestor` comes as -1.
    """
    _elimination_tree(pattern, parent, ancestor)
    order, rank, n = pattern.order, pattern.rank, len(parent)
    child, sibling = ancestor, order  # neither is of use any more
    for k in range(n):
        child[k] = -1
    for k in range(n - 1, -1, -1):
        if parent[k] >= 0:
            sibling[k] = child[parent[k]]
            child[parent[k]] = k
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
                rank[before[k]] = count
                count += 1
    for i in range(n):
        order[rank[i]] = i


@inner
def _elimination_tree(pattern: Pattern, parent: Indices, ancestor: Indices) -> None:
    """The first later row that every row is joined to once it is eliminated; -1 for none (Liu 1990)."""
    indptr, indices, order, rank = pattern
    for k in range(len(order)):
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


@kernel
@makes_arrays
def list_supernodes(
    pattern: Pattern, most: float, most_rows: int, first: Indices, start: Indices, seen: Indices, branch: Indices,
    sibling: Indices,
) -> tuple[int, Indices]:  # fmt: skip
    """Gather columns of the factor into supernodes, and list their rows (`resgrid.solvers.supernodal_kernels`).

    A column has entries in the rows that it is joined to, and in those of the supernodes whose first row behind their
    own it is (Liu 1990).  It goes with the supernode before where that fills few rows of the others with zeros.

    Shapes: `first, start` (n + 1,); `seen, branch, sibling` (n,): all come as -1.  Returns the number of supernodes; -1
    where they come to have more entries than ``most``, or more rows than ``most_rows``; and their rows.
    """
    n = len(pattern.order)
    rows = np.empty(10 * n, np.int32)
    node, area, end, columns, zeros = ZERO - 1, 0.0, ZERO, 0, 0
    share = most / (n + n // 8)
    for k in range(n):
        if node >= 0:
            if columns < _WIDEST and seen[k] == node:
                longer = _add_rows(pattern, k, node, seen, branch, sibling, start, rows, end)
                filled = zeros + columns * (longer - end)
                entries = (columns + 1) * (longer - start[node]) - columns * (columns + 1) // 2
                if filled <= _FEW + _SHARE * entries:
                    zeros, columns, end = filled, columns + 1, longer
                    continue
                for r in range(end, longer):
                    seen[rows[r]] = -1
            area += columns * (end - start[node])
            if area > share * (k + n // 8) or end + n > most_rows:
                return -1, rows
            rows = with_room(rows, end, 2 * n)
            _sort(rows, start[node], end)
            if end > start[node] + columns:
                up = rows[start[node] + columns]
                sibling[node], branch[up] = branch[up], node
        node += 1
        first[node], start[node], columns, zeros = k, end, 1, 0
        rows[end], seen[k] = k, node
        end = _add_rows(pattern, k, node, seen, branch, sibling, start, rows, end + 1)
    _sort(rows, start[node], end)
    first[node + 1], start[node + 1] = n, end
    return node + 1, rows


@inlined
def _add_rows(
    pattern: Pattern, k: int, node: int, seen: Indices, branch: Indices, sibling: Indices, start: Indices,
    rows: Indices, end: int,
) -> int:  # fmt: skip
    """Add the rows that a column has entries in to those of its supernode; returns where they end."""
    indptr, indices, order, rank = pattern
    child = branch[k]
    while child >= 0:
        for r in range(start[child], start[child + 1]):
            row = rows[r]
            if row > k and seen[row] != node:
                seen[row], rows[end] = node, row
                end += 1
        child = sibling[child]
    for entry in range(indptr[order[k]], indptr[order[k] + 1]):
        row = rank[indices[entry]]
        if row > k and seen[row] != node:
            seen[row], rows[end] = node, row
            end += 1
    return end


@inlined
def _sort(rows: Indices, begin: int, end: int) -> None:
    """Sort rows by insertion: most stand in order, and elimination takes longer than the worst case."""
    for r in range(begin + 1, end):
        row, k = rows[r], r
        while k > begin and rows[k - 1] > row:
            rows[k] = rows[k - 1]
            k -= 1
        rows[k] = row
