"""Compiled loops over narrow circuits: the order of their elimination, and the pattern of its factors.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import ZERO, inlined

Indices = NDArray[np.int32]

_WIDEST, _FEW, _SHARE = 16, 20.0, 0.2
"""Most columns of a panel, and how many of its entries may be zeros: so many, and such a share of all."""


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
    before, path = order.copy(), np.empty(n, np.int32)
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
                order[count], rank[before[k]] = before[k], count
                count += 1


@njit(cache=True, nogil=True)
def list_panels(
    indptr: Indices, indices: Indices, order: Indices, rank: Indices, most: int, first: Indices, start: Indices,
    rows: Indices,
) -> int:  # fmt: skip
    """Gather columns of the factor into panels, and list their rows (`resgrid.solvers.narrow.panel_kernels.Panels`).

    A column has entries in the rows that it is joined to, and in those of the panels whose first row behind their own
    it is (Liu 1990).  It goes with the panel before where that fills few rows of the others with zeros.

    Shapes: `order, rank` (n,), `first, start` (n + 1,).
    """
    n = len(order)
    seen, branch, sibling = np.full(n, -1, np.int32), np.full(n, -1, np.int32), np.empty(n, np.int32)
    panel, area, end, columns, zeros = ZERO - 1, ZERO, ZERO, 0, 0
    share = most / (n + n // 8)
    for k in range(n):
        if panel >= 0:
            if columns < _WIDEST and seen[k] == panel:
                longer = _add_rows(indptr, indices, order, rank, k, panel, seen, branch, sibling, start, rows, end)
                filled = zeros + columns * (longer - end)
                entries = (columns + 1) * (longer - start[panel]) - columns * (columns + 1) // 2
                if filled <= _FEW + _SHARE * entries:
                    zeros, columns, end = filled, columns + 1, longer
                    continue
                for r in range(end, longer):
                    seen[rows[r]] = -1
            area += columns * (end - start[panel])
            if area > share * (k + n // 8) or end + n > len(rows):
                return -1
            _sort(rows, start[panel], end)
            if end > start[panel] + columns:
                up = rows[start[panel] + columns]
                sibling[panel], branch[up] = branch[up], panel
        panel += 1
        first[panel], start[panel], columns, zeros = k, end, 1, 0
        rows[end], seen[k] = k, panel
        end = _add_rows(indptr, indices, order, rank, k, panel, seen, branch, sibling, start, rows, end + 1)
    _sort(rows, start[panel], end)
    first[panel + 1], start[panel + 1] = n, end
    return panel + 1


@inlined
def _add_rows(
    indptr: Indices, indices: Indices, order: Indices, rank: Indices, k: int, panel: int, seen: Indices,
    branch: Indices, sibling: Indices, start: Indices, rows: Indices, end: int,
) -> int:  # fmt: skip
    """Add the rows that a column has entries in to those of its panel; returns where they end."""
    child = branch[k]
    while child >= 0:
        for r in range(start[child], start[child + 1]):
            row = rows[r]
            if row > k and seen[row] != panel:
                seen[row], rows[end] = panel, row
                end += 1
        child = sibling[child]
    for entry in range(indptr[order[k]], indptr[order[k] + 1]):
        row = rank[indices[entry]]
        if row > k and seen[row] != panel:
            seen[row], rows[end] = panel, row
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
