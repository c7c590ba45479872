"""Elimination orders, and the sparsity pattern of the factors of a matrix.

Every other layer of rows is eliminated beforehand if its rows are independent (odd-even reduction): the factors of the
reduced matrix have half of the entries and take half of the products. The other rows come in one of two orders:

- *by distance* from the row with the largest ground conductance, far ends first: along the corridors of a maze only
  rows across the corridor are joined, and the factorization takes fewer operations than the search for a general order;
- *by fill*, rows of least fill first, for wide spaces.

The import of numba takes seconds: only functions that are about to solve import this module.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import ZERO, inlined, interruptible, kernel
from resgrid.errors import BudgetError
from resgrid.solvers.csr_kernels import sort
from resgrid.solvers.laplacian import MOST_NUMBERED, Laplacian
from resgrid.solvers.ordering_kernels import minimum_fill, quotient_graph, with_room
from resgrid.solvers.scaled import Indices, Integers

_MOST_FILL, _MOST_FILL_OF_VOLUMES = 60, 600
"""Largest number of entries of the factors per row if rows are eliminated by distance, for planes and for volumes.

The distance is counted from the row with the largest ground conductance. A matrix with more entries is ordered by
minimum fill, which is then faster.
"""

_DENSE = 10.0
"""Number of neighbours, in multiples of the square root of the number of rows, above which a row is eliminated last.

It applies to the order by fill. The number of rows is that after odd-even reduction; the limit is 16 neighbours or
more.
"""

_MOST_NEIGHBOURS = 8
"""Largest number of neighbours of a row that odd-even reduction eliminates; the elimination joins all pairs of them."""

_WIDEST, _FEW, _SHARE = 16, 20.0, 0.2
"""Limits on a supernode: number of columns; constant and proportional part of the allowed zeros among its entries.

The zeros are at most `_FEW` plus `_SHARE` times all entries.
"""


class Pattern(NamedTuple):
    """Neighbours of the rows of a matrix, and the order of the rows.

    `indptr` (n + 1,), `indices` (entries,): compressed rows of the neighbours of every row; `order` (n,): row at every
    position, where the rows that odd-even reduction eliminates come after all others; `place` (n,): position of every
    row, the inverse of `order`.
    """

    indptr: Indices
    indices: Indices
    order: Indices
    place: Indices


class Supernodes(NamedTuple):
    """Supernodes of a unit lower triangular matrix: runs of columns stored as dense blocks (Ashcraft & Grimes 1989).

    `first` (supernodes + 1,): first column of every supernode, then the number of columns; `start` (supernodes + 1,):
    begin of every supernode in `rows`; `rows`: rows of all supernodes, as positions in the elimination order, ascending
    in each supernode, and beginning with its own columns; `offset` (supernodes + 1,): begin of every supernode in the
    array of entries, where columns follow each other, each with an entry for every row of the supernode.
    """

    first: Indices
    start: Indices
    rows: Indices
    offset: Integers


class Symbolic(NamedTuple):
    """An elimination order, and the sparsity pattern of the factors.

    `order` (n,): row at every position: the rows that odd-even reduction keeps, in the order of elimination, then the
    rows that it eliminates beforehand; `place` (n,): position of every row, the inverse of `order`; `nodes`: supernodes
    of the factor of the kept rows.
    """

    order: Indices
    place: Indices
    nodes: Supernodes

    @property
    def kept(self) -> int:
        """Number of rows that odd-even reduction keeps."""
        return int(self.nodes.first[-1])

    @property
    def entries(self) -> int:
        """Number of stored entries of all supernodes, including zeros."""
        return int(self.nodes.offset[-1])

    @property
    def products(self) -> float:
        """Approximate number of multiplications of a numerical factorization with this pattern."""
        return float(0.5 * np.sum(self.widths * self.lengths.astype(np.float64) ** 2))

    @property
    def widths(self) -> Indices:
        """Number of columns of every supernode, shape (supernodes,)."""
        return np.diff(self.nodes.first)

    @property
    def lengths(self) -> Indices:
        """Number of rows of every supernode, shape (supernodes,), including the rows of its own columns."""
        return np.diff(self.nodes.start)


def order_rows(laplacian: Laplacian) -> Symbolic:
    """Return an elimination order, by distance for a matrix with narrow corridors, otherwise by fill.

    Raises
    ------
    BudgetError
        If the lists of rows of all supernodes have more entries than 32-bit indices can number.
    """
    symbolic = order_by_distance(laplacian) or order_by_fill(laplacian)
    if symbolic is None:
        raise BudgetError(
            f"the factors of {laplacian.size:,} rows have more entries than 32 bits can number: choose larger cells, "
            "or method = 'multigrid'"
        )
    return symbolic


def order_by_distance(laplacian: Laplacian) -> Symbolic | None:
    """Return the order of rows by distance from the ground, farthest first; None if the factors have many entries.

    Many are more than 60 entries per row, or 600 for a matrix with three or more dimensions. The distance is counted in
    steps from the row with the largest conductance to the ground (to the low rail if there are two rails).
    """
    most = _MOST_FILL_OF_VOLUMES if laplacian.dimensions > 2 else _MOST_FILL
    return _order(laplacian, float(most * laplacian.size), by_fill=False)


def order_by_fill(laplacian: Laplacian, most: float = np.inf) -> Symbolic | None:
    """Return the order of the rows by approximate minimum fill.

    `most`: maximum number of entries of the factors. Returns None if the factors would have more entries, or if the
    lists of rows of all supernodes would have more than 32-bit indices can number.
    """
    return _order(laplacian, float(most), by_fill=True)


def _order(laplacian: Laplacian, most: float, *, by_fill: bool) -> Symbolic | None:
    """Return an elimination order after odd-even reduction; None if the factors would have more than `most` entries.

    Odd-even reduction eliminates every other layer of rows by distance from the row with the largest ground conductance
    (with two rails: conductance to the low rail). `by_fill`: order the other rows by approximate minimum fill instead
    of by distance, farthest first.
    """
    matrix, n = laplacian.graph, laplacian.size
    tied = laplacian.ground if laplacian.rails is None else laplacian.rails.to_low
    nearest_first, depth = np.empty(n + 1, dtype=np.int32), np.full(n, -1, dtype=np.int32)
    pattern = Pattern(matrix.indptr, matrix.indices, *np.empty((2, n), dtype=np.int32))
    kept = order_far_first(pattern, int(np.argmax(tied)), nearest_first, depth)
    if by_fill:
        dense, step = max(16, int(_DENSE * np.sqrt(kept))), np.empty(n, dtype=np.int32)
        graph = quotient_graph(matrix.indptr, matrix.indices)
        if not minimum_fill(graph, pattern.place, kept, dense, most, MOST_NUMBERED, step):
            return None
        pattern.order[:kept] = pattern.order[np.argsort(step[pattern.order[:kept]], kind="stable")]
        pattern.place[pattern.order] = np.arange(n, dtype=np.int32)
    postorder(pattern, pattern.order[:kept].copy(), *np.empty((3, kept + 1), dtype=np.int32))
    first, start, seen, branch, sibling = np.full((5, kept + 1), -1, dtype=np.int32)
    count, rows = list_supernodes(pattern, kept, most, MOST_NUMBERED, first, start, seen, branch, sibling)
    if count < 0:
        return None
    first, start = first[: count + 1].copy(), start[: count + 1].copy()
    offset = np.append(0, np.cumsum(np.diff(first) * np.diff(start).astype(np.int64)))
    return Symbolic(pattern.order, pattern.place, Supernodes(first, start, rows[: start[-1]].copy(), offset))


@kernel
def order_far_first(pattern: Pattern, root: int, nearest_first: Indices, depth: Indices) -> int:
    """Order the rows that odd-even reduction keeps, farthest from a root first, then the others; return their number.

    The returned number is that of the kept rows. A row at an odd distance from the root, or from the first row of
    another component, is eliminated by the reduction, and not kept, if the row has at most 8 neighbours and none at an
    equal distance. On a grid the eliminated rows are all cells of one colour.

    `pattern`: neighbours of every row; its arrays `order` and `place` receive the order and its inverse; `root`: row at
    distance 0; `nearest_first` (n + 1,): work array; `depth` (n,): -1 on entry, receives the distance of every row in
    steps.
    """
    indptr, indices, order, place = pattern
    n, size = len(order), 0
    for other in range(-1, n):
        first = root if other < 0 else other
        if depth[first] >= 0:
            continue
        depth[first], nearest_first[size] = 0, first
        head = size
        size += 1
        while head < size:
            i = nearest_first[head]
            head += 1
            for entry in range(indptr[i], indptr[i + 1]):
                j = indices[entry]
                new = depth[j] < 0
                depth[j], nearest_first[size] = depth[i] + 1 if new else depth[j], j
                size += new
    kept = 0
    for k in range(n - 1, -1, -1):
        i = nearest_first[k]
        alone = depth[i] % 2 == 1 and indptr[i + 1] - indptr[i] <= _MOST_NEIGHBOURS
        for entry in range(indptr[i], indptr[i + 1]):
            alone = alone and depth[indices[entry]] != depth[i]
        place[i], order[kept] = -1 if alone else kept, i
        kept += not alone
    gone = kept
    for i in range(n):
        if place[i] < 0:
            place[i], order[gone] = gone, i
            gone += 1
    return kept


@inlined
def reached(pattern: Pattern, entry: int, kept: int) -> tuple[int, int]:
    """Return begin and end of the range of ``pattern.indices`` that replaces an entry after odd-even reduction.

    `entry`: index into ``pattern.indices``; `kept`: number of rows that odd-even reduction keeps. If the row of the
    entry is kept, the range contains this entry only; otherwise it contains the neighbours of that row.
    """
    j = pattern.indices[entry]
    if pattern.place[j] < kept:
        return entry, entry + 1
    return pattern.indptr[j], pattern.indptr[j + 1]


@kernel
def postorder(pattern: Pattern, before: Indices, parent: Indices, last: Indices, branch: Indices) -> None:
    """Renumber the rows that odd-even reduction keeps in postorder of the elimination tree, which keeps the fill.

    The parent of a row is the first later row that is its neighbour when it is eliminated (Liu 1990). The branch of a
    row contains the row and its descendants.

    `pattern`: neighbours of every row; its arrays `order` and `place` contain the previous order on entry, and the new
    order on exit; `before` (kept,): copy of the first entries of `order`, made by the caller and not modified: the row
    at every position of the previous order; `parent, last, branch` (kept + 1,): work arrays, uninitialized, for the
    parent of a row, for its latest known ancestor (path compression) and then the end of its branch in the new order,
    and for the size of its branch.
    """
    indptr, indices, order, place = pattern
    n = len(before)
    for k in range(n):
        parent[k], last[k], branch[k] = n, n, 1
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            first, end = reached(pattern, entry, n)
            for other in range(first, end):
                j = place[indices[other]]
                while j < k:
                    above = last[j]
                    last[j] = k
                    if above == n:
                        parent[j] = k
                    j = above
    branch[n], last[n] = 1, n
    for k in range(n):
        branch[parent[k]] += branch[k]
    for k in range(n - 1, -1, -1):
        above = parent[k]
        last[k] = last[above] - 1
        last[above] -= branch[k]
        place[before[k]] = last[k]
        order[last[k]] = before[k]


@interruptible
@kernel
def list_supernodes(
    pattern: Pattern, kept: int, most: float, most_rows: int, first: Indices, start: Indices, seen: Indices,
    branch: Indices, sibling: Indices,
) -> tuple[int, Indices]:  # fmt: skip
    """Merge columns of the factor into supernodes; return the number of supernodes, and the rows of all supernodes.

    A column has entries in the rows of its neighbours and of its children. A child is a supernode whose first row below
    its own columns is this column (Liu 1990). A column joins the previous supernode if that supernode has an entry in
    the row of the column and at most 16 columns afterwards, and if at most ``20 + 0.2 entries`` of its entries are then
    zeros.

    `pattern`: neighbours and order of the rows; `kept`: number of columns; `most, most_rows`: maximum number of
    entries, and of rows of all supernodes; `first, start` (kept + 1,): receive the fields of `Supernodes`; `seen,
    branch, sibling` (kept + 1,): work arrays, for the last supernode in which a row was listed, the first child of a
    column, and the next child of the same column. All arrays are -1 on entry. The returned array of rows is filled up
    to the end of the last supernode in `start`. The returned number is -1 if a maximum is exceeded, or if the entries
    of the first columns already exceed about their part of the maximum.
    """
    n = kept
    rows = np.empty(10 * n, np.int32)
    node, area, end, columns, zeros = ZERO - 1, 0.0, ZERO, 0, 0
    per_row = most / (n + n // 8)
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
            if area > per_row * (k + n // 8) or end + n > most_rows:
                return -1, rows
            rows = with_room(rows, end, 2 * n)
            sort(rows, rows, start[node], end)
            if end > start[node] + columns:
                up = rows[start[node] + columns]
                sibling[node], branch[up] = branch[up], node
        node += 1
        first[node], start[node], columns, zeros = k, end, 1, 0
        rows[end], seen[k] = k, node
        end = _add_rows(pattern, k, node, seen, branch, sibling, start, rows, end + 1)
    sort(rows, rows, start[node], end)
    first[node + 1], start[node + 1] = n, end
    return node + 1, rows


@inlined
def _add_rows(
    pattern: Pattern, k: int, node: int, seen: Indices, branch: Indices, sibling: Indices, start: Indices,
    rows: Indices, end: int,
) -> int:  # fmt: skip
    """Append the rows below the diagonal of column ``k`` to those of supernode ``node``; return the end of ``rows``.

    The rows are those of the column's children and of its neighbours that ``seen`` does not mark as listed. A child is
    an earlier supernode whose first row below its own columns is this column.

    `pattern`: neighbours and order of the rows; `seen` (kept + 1,): last supernode in which a row was listed, updated;
    `branch, sibling` (kept + 1,): first child of a column, and next child; `start` (kept + 1,): begin of every
    supernode in ``rows``; `end`: end of ``rows`` on entry.
    """
    indptr, indices, order, place = pattern
    kept = len(seen) - 1
    child = branch[k]
    while child >= 0:
        for r in range(start[child], start[child + 1]):
            row = rows[r]
            if row > k and seen[row] != node:
                seen[row], rows[end] = node, row
                end += 1
        child = sibling[child]
    for entry in range(indptr[order[k]], indptr[order[k] + 1]):
        first, last = reached(pattern, entry, kept)
        for other in range(first, last):
            row = place[indices[other]]
            if row > k and seen[row] != node:
                seen[row], rows[end] = node, row
                end += 1
    return end
