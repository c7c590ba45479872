"""Orders of elimination, and where the factors of a matrix have entries.

Every other layer of rows is eliminated beforehand, where they are independent (odd-even reduction): factors of what is
left have half of the entries, and take half of the products.  The others come in one of two orders:

- *by distance* from the ground, far ends first: along the corridors of a maze a row is joined to those across the
  corridor alone, and fewer operations come of it than a general order takes to be found;
- *by fill*, those first that fill least, for all that is wide.

Numba takes seconds to import: only functions that are about to solve import this module.
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
"""Entries a row above which a circuit is not narrow, and factors in the order by fill are sooner made."""

_DENSE = 10.0
"""A row of more than so many times the square root of all is eliminated last."""

_MOST_NEIGHBOURS = 8
"""Of a row that is reduced away: they are joined to each other."""

_WIDEST, _FEW, _SHARE = 16, 20.0, 0.2
"""Most columns of a supernode, and how many of its entries may be zeros: so many, and such a share of all."""


class Pattern(NamedTuple):
    """The graph of all rows, and an order of them: those that odd-even reduction keeps, and behind them the others.

    `indptr` (n + 1,), `indices`: neighbours of every row; `order` (n,): row ``order[k]`` is the ``k``-th; `place` (n,):
    its inverse.
    """

    indptr: Indices
    indices: Indices
    order: Indices
    place: Indices


class Supernodes(NamedTuple):
    """Supernodes of a unit lower triangular matrix: runs of columns kept as dense blocks (Ashcraft & Grimes 1989).

    `first` (supernodes + 1,): their first columns, and the number of all; `start` (supernodes + 1,): where their rows
    begin in ``rows``; `rows`: their rows, ascending: first those of their own columns; `offset` (supernodes + 1,):
    where their entries begin among the values: column by column, all as long as there are rows.
    """

    first: Indices
    start: Indices
    rows: Indices
    offset: Integers


class Symbolic(NamedTuple):
    """An order of elimination, and where the factors have entries.

    `order` (n,): the rows that odd-even reduction keeps as they are eliminated, and all others behind them; `place`
    (n,): its inverse; `nodes`: supernodes of the rows kept.
    """

    order: Indices
    place: Indices
    nodes: Supernodes

    @property
    def kept(self) -> int:
        """Number of rows kept."""
        return int(self.nodes.first[-1])

    @property
    def entries(self) -> int:
        """Entries of all supernodes."""
        return int(self.nodes.offset[-1])

    @property
    def products(self) -> float:
        """Products that elimination takes, about."""
        return float(0.5 * np.sum(self.widths * self.lengths.astype(np.float64) ** 2))

    @property
    def widths(self) -> Indices:
        """Columns of every supernode."""
        return np.diff(self.nodes.first)

    @property
    def lengths(self) -> Indices:
        """Rows of every supernode."""
        return np.diff(self.nodes.start)


def order_rows(laplacian: Laplacian) -> Symbolic:
    """Order the rows of a matrix as suits it; BudgetError where the factors would have too many entries."""
    symbolic = order_by_distance(laplacian) or order_by_fill(laplacian)
    if symbolic is None:
        raise BudgetError(
            f"the factors of {laplacian.size:,} rows have more entries than 32 bits can number: choose larger cells, "
            "or method = 'multigrid'"
        )
    return symbolic


def order_by_distance(laplacian: Laplacian) -> Symbolic | None:
    """Order the rows of a matrix by their distance from the ground; None where it is not narrow."""
    most = _MOST_FILL_OF_VOLUMES if laplacian.dimensions > 2 else _MOST_FILL
    return _order(laplacian, float(most * laplacian.size), by_fill=False)


def order_by_fill(laplacian: Laplacian, most: float = np.inf) -> Symbolic | None:
    """Order the rows of a matrix by approximate minimum fill.

    None for more than ``most`` entries of the factors, or more of their rows than can be numbered.
    """
    return _order(laplacian, float(most), by_fill=True)


def _order(laplacian: Laplacian, most: float, *, by_fill: bool) -> Symbolic | None:
    """Reduce every other layer by distance from the row most tied to the lower rail, and order the other rows."""
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
    """Order the rows that are kept, the farthest from a root first, and behind them the others.  Returns how many.

    Not kept are the rows an odd number of steps from the root, or from the first row of another part, that have few
    neighbours, and none as far from it: of a grid's cells, all of one colour.

    Shapes: `nearest_first` (n + 1,); `depth` (n,): comes as -1.
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
    """Which entries stand for one: those of its row if that is not kept, whose neighbours are joined; else itself."""
    j = pattern.indices[entry]
    if pattern.place[j] < kept:
        return entry, entry + 1
    return pattern.indptr[j], pattern.indptr[j + 1]


@kernel
def postorder(pattern: Pattern, before: Indices, parent: Indices, last: Indices, branch: Indices) -> None:
    """Renumber the rows kept so that every branch of the elimination tree stands together; it fills as before.

    A row's parent is the first later one that it is joined to once it is eliminated (Liu 1990); rows below every row,
    itself included, are its branch.

    Shapes: `before` (kept,): their order so far; `parent, last, branch` (kept + 1,): ``last``: on the way up the latest
    ancestor known, then where the next row below one ends.
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
    """Gather columns of the factor into supernodes, and list their rows.

    A column has entries in the rows that it is joined to, and in those of the supernodes whose first row behind their
    own it is (Liu 1990).  It goes with the supernode before where that fills few rows of the others with zeros.

    Shapes: `first, start, seen, branch, sibling` (kept + 1,): all come as -1.  Returns the number of supernodes; -1
    where they come to have more entries than ``most``, or more rows than ``most_rows``; and their rows.
    """
    n = kept
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
    """Add the rows that a column has entries in to those of its supernode; returns where they end."""
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
