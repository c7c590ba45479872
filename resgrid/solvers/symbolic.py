"""Orders of elimination, and where the factors of a matrix have entries.

Every other layer of rows is eliminated beforehand, where they are independent (odd-even reduction): factors of what is
left have half of the entries, and take half of the products.  The others come in one of two orders:

- *by distance* from the ground, far ends first: along the corridors of a maze a row is joined to those across the
  corridor alone, and fewer operations come of it than a general order takes to be found;
- *by degree*, the least first, for all that is wide.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import BudgetError
from resgrid.jit import ZERO, inlined, inner, kernel, makes_arrays
from resgrid.solvers.laplacian import MOST_NUMBERED, Conductances, Laplacian
from resgrid.solvers.ordering_kernels import breadth_first, minimum_degree, quotient_graph, with_room

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]

_MOST_FILL, _MOST_FILL_OF_VOLUMES = 60, 600
"""Entries a row above which a circuit is not narrow, and factors in the order by degree are sooner made."""

_DENSE = 10.0
"""A row of more than so many times the square root of all is eliminated last."""

_MOST_NEIGHBOURS = 8
"""Of a row that is reduced away: they are joined to each other."""

_WIDEST, _FEW, _SHARE = 16, 20.0, 0.2
"""Most columns of a supernode, and how many of its entries may be zeros: so many, and such a share of all."""


class Pattern(NamedTuple):
    """The graph of the rows that odd-even reduction keeps, and an order of them.

    `indptr` (kept + 1,), `indices`: neighbours of every row; `order` (kept,): row ``order[k]`` is the ``k``-th; `rank`
    (kept,): its inverse.
    """

    indptr: Indices
    indices: Indices
    order: Indices
    rank: Indices


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


@dataclass(frozen=True, eq=False)
class Symbolic:
    """An order of elimination, and where the factors have entries.

    `matrix`: all rows; `number` (n,): of the rows that odd-even reduction keeps; -1 for the others; `pivot` (n,): of
    the others, in siemens; `left`: what their elimination leaves; `pattern`: its graph and order; `nodes`: supernodes
    in that order; `order` (n,): the rows kept as they are eliminated, and all others behind them; `place` (n,): its
    inverse.
    """

    matrix: Conductances
    number: Indices
    pivot: Floats
    left: Conductances
    pattern: Pattern
    nodes: Supernodes
    order: Integers
    place: Integers

    def of(self, matrix: Conductances) -> Symbolic:
        """The same order for other conductances between the same rows."""
        kept = self.order[self.pattern.rank].astype(np.int32)
        pivot, left = _reduced(matrix, self.number, kept, len(self.left.edges))
        return replace(self, matrix=matrix, pivot=pivot, left=left)

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
    symbolic = order_by_distance(laplacian) or order_by_degree(laplacian)
    if symbolic is None:
        raise BudgetError(
            f"the factors of {laplacian.size:,} rows have more entries than 32 bits can number: choose larger cells, "
            "or method = 'multigrid'"
        )
    return symbolic


def order_by_distance(laplacian: Laplacian) -> Symbolic | None:
    """Order the rows of a matrix by their distance from the ground; None where it is not narrow."""
    most = _MOST_FILL_OF_VOLUMES if laplacian.dimensions > 2 else _MOST_FILL
    return _order(laplacian, float(most * laplacian.size), by_degree=False)


def order_by_degree(laplacian: Laplacian, most: float = np.inf) -> Symbolic | None:
    """Order the rows of a matrix by approximate minimum degree.

    None for more than ``most`` entries of the factors, or more of their rows than can be numbered.
    """
    return _order(laplacian, float(most), by_degree=True)


def _order(laplacian: Laplacian, most: float, *, by_degree: bool) -> Symbolic | None:
    """Reduce every other layer by distance from the row most tied to the lower rail, and order the other rows."""
    matrix, n = laplacian.conductances, laplacian.size
    tied = laplacian.ground if laplacian.rails is None else laplacian.rails.to_low
    number, kept, depth = np.empty((3, n), dtype=np.int32)
    nearest_first = breadth_first(matrix.indptr, matrix.indices, int(np.argmax(tied)))
    size = number_kept(matrix.indptr, matrix.indices, nearest_first, number, kept, depth)
    gone = np.flatnonzero(number < 0)
    degree = np.diff(matrix.indptr)[gone].astype(np.int64)
    room = len(matrix.indices) + int(np.sum(degree * (degree - 3)))
    if room > MOST_NUMBERED:
        return None
    kept = kept[:size]
    pivot, left = _reduced(matrix, number, kept, room)
    order = np.arange(size, dtype=np.int32)
    if by_degree:
        dense, step = max(16, int(_DENSE * np.sqrt(size))), np.empty(size, dtype=np.int32)
        if not minimum_degree(quotient_graph(left.indptr, left.indices), dense, most, MOST_NUMBERED, step):
            return None
        order = np.argsort(step, kind="stable").astype(np.int32)
    pattern = Pattern(left.indptr, left.indices, order, np.empty(size, dtype=np.int32))
    nodes = _find_supernodes(pattern, most)
    if nodes is None:
        return None
    rows = np.append(kept[pattern.order], gone).astype(np.int64)
    place = np.empty_like(rows)
    place[rows] = np.arange(n)
    return Symbolic(matrix, number, pivot, left, pattern, nodes, rows, place)


def _reduced(matrix: Conductances, number: Indices, kept: Indices, room: int) -> tuple[Floats, Conductances]:
    """Eliminate the rows that are not numbered, (n,): their pivots (n,), and the rows kept, of so many entries."""
    size = len(kept)
    left = Conductances(np.empty(size + 1, np.int32), np.empty(room, np.int32), np.empty(room), np.empty(size))
    pivot = np.zeros(len(number))
    join_kept(matrix, number, kept, pivot, left, np.full(size, -1, dtype=np.int32))
    entries = left.indptr[-1]
    return pivot, left._replace(indices=left.indices[:entries], edges=left.edges[:entries])


def _find_supernodes(pattern: Pattern, most: float) -> Supernodes | None:
    """List the supernodes of an order, which is made a postorder; None for more entries than ``most``."""
    size = len(pattern.order)
    pattern.rank[pattern.order] = np.arange(size, dtype=np.int32)
    postorder(pattern, pattern.order.copy(), *np.empty((3, size + 1), dtype=np.int32))
    first, start, seen, branch, sibling = np.full((5, size + 1), -1, dtype=np.int32)
    count, rows = list_supernodes(pattern, most, MOST_NUMBERED, first, start, seen, branch, sibling)
    if count < 0:
        return None
    first, start = first[: count + 1].copy(), start[: count + 1].copy()
    offset = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(np.diff(first).astype(np.int64) * np.diff(start), out=offset[1:])
    return Supernodes(first, start, rows[: start[-1]].copy(), offset)


@kernel
def number_kept(
    indptr: Indices, indices: Indices, nearest_first: Indices, number: Indices, kept: Indices, depth: Indices
) -> int:
    """Number the rows that are kept, the farthest first, and list them; -1 for the others.  Returns how many.

    Not kept are the rows an odd number of steps from the first one that have few neighbours, and none as far from it:
    of a grid's cells, all of one colour.

    Shapes: `nearest_first, number, kept, depth` (n,): the first in breadth-first order.
    """
    n, count = len(number), 0
    for i in range(n):
        depth[i] = -1
    for i in nearest_first:
        depth[i] = max(depth[i], 0)
        for entry in range(indptr[i], indptr[i + 1]):
            if depth[indices[entry]] < 0:
                depth[indices[entry]] = depth[i] + 1
    for k in range(n - 1, -1, -1):
        i = nearest_first[k]
        alone = depth[i] % 2 == 1 and indptr[i + 1] - indptr[i] <= _MOST_NEIGHBOURS
        for entry in range(indptr[i], indptr[i + 1]):
            alone = alone and depth[indices[entry]] != depth[i]
        number[i], kept[count] = -1 if alone else count, i
        count += not alone
    return count


@kernel
def join_kept(
    matrix: Conductances, number: Indices, kept: Indices, pivot: Floats, left: Conductances, place: Indices
) -> None:
    """Eliminate all rows that are not kept, ``g_ij += g_ik g_kj / d_k``; fills `pivot` (n,), ``d``, and `left`.

    Shapes: `number` (n,), `kept, place` (kept,): the last comes as -1.
    """
    indptr, indices, edges, ground = matrix
    for i in range(len(number)):
        if number[i] < 0:
            pivot[i] = ground[i]
            for entry in range(indptr[i], indptr[i + 1]):
                pivot[i] += edges[entry]
    count = 0
    left.indptr[0] = 0
    for row in range(len(kept)):
        i, begin, grounded = kept[row], count, ground[kept[row]]
        for entry in range(indptr[i], indptr[i + 1]):
            j, first, last, share = indices[entry], entry, entry + 1, 1.0
            if number[j] < 0:
                first, last, share = indptr[j], indptr[j + 1], edges[entry] / pivot[j]
                grounded += share * ground[j]
            for other in range(first, last):
                column = number[indices[other]]
                if column == row:
                    continue
                if place[column] < begin:
                    place[column], left.indices[count], left.edges[count] = count, column, 0.0
                    count += 1
                left.edges[place[column]] += share * edges[other]
        left.indptr[row + 1], left.ground[row] = count, grounded


@kernel
def postorder(pattern: Pattern, before: Indices, parent: Indices, last: Indices, branch: Indices) -> None:
    """Renumber the rows so that every branch of the elimination tree stands together; it fills as before.

    Shapes: `before` (n,): the order so far; `parent, last, branch` (n + 1,): rows below every row, itself included, are
    its branch; ``last``: where the next one below it ends.
    """
    order, rank, n = pattern.order, pattern.rank, len(before)
    _elimination_tree(pattern, parent, last)
    for k in range(n + 1):
        branch[k] = 1
    for k in range(n):
        branch[parent[k]] += branch[k]
    last[n] = n
    for k in range(n - 1, -1, -1):
        above = parent[k]
        last[k] = last[above] - 1
        last[above] -= branch[k]
        rank[before[k]] = last[k]
    for i in range(n):
        order[rank[i]] = i


@inner
def _elimination_tree(pattern: Pattern, parent: Indices, ancestor: Indices) -> None:
    """The first later row that every row is joined to once it is eliminated; ``n`` for none (Liu 1990)."""
    indptr, indices, order, rank = pattern
    n = len(order)
    for k in range(n):
        parent[k], ancestor[k] = n, n
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            j = rank[indices[entry]]
            while j < k:
                above = ancestor[j]
                ancestor[j] = k
                if above == n:
                    parent[j] = k
                j = above


@kernel
@makes_arrays
def list_supernodes(
    pattern: Pattern, most: float, most_rows: int, first: Indices, start: Indices, seen: Indices, branch: Indices,
    sibling: Indices,
) -> tuple[int, Indices]:  # fmt: skip
    """Gather columns of the factor into supernodes, and list their rows.

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
