"""Supernodal factors ``P A P^T = L D L^T`` of an M-matrix, in sums, products and quotients of positive numbers alone.

Every entry is right to some roundings, whatever the conductances (Grassmann, Taksar & Heyman 1985; O'Cinneide 1993).
Every other layer of rows is eliminated beforehand, where they are independent (odd-even reduction): factors of what is
left have half of the entries, and take half of the products.  The others come in one of two orders:

- *by distance* from the ground, far ends first: along the corridors of a maze a row is joined to those across the
  corridor alone, and fewer operations come of it than a general order takes to be found;
- *by degree*, the least first, for all that is wide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError, BudgetError
from resgrid.solvers.extended import unscaled
from resgrid.solvers.laplacian import MOST_NUMBERED, Conductances, Laplacian
from resgrid.solvers.refine import Numbers

if TYPE_CHECKING:
    from resgrid.solvers.supernodal_kernels import Supernodes
    from resgrid.solvers.symbolic_kernels import Pattern

_MOST_FILL, _MOST_FILL_OF_VOLUMES = 60, 600
"""Entries a row above which a circuit is not narrow, and factors in the order by degree are sooner made."""

ON_ROWS = 500.0
"""Peak memory of a solution besides its factors, in bytes a row."""

_DENSE = 10.0
"""A row of more than so many times the square root of all is eliminated last."""

_STRETCH = 2_000
"""Supernodes eliminated at a time."""


@dataclass(frozen=True, eq=False)
class OddEven:
    """A matrix of which every other layer of rows has been eliminated: of a grid, the cells of one colour.

    `whole`: all rows (n,); `left`: the rows kept (kept,), entries in any order; `number` (n,): of the rows kept; -1 for
    the others; `kept` (kept,): which they are; `pivot` (n,): of the rows eliminated, in siemens; 0 for the others.
    """

    whole: Conductances
    left: Conductances
    number: NDArray[np.int32]
    kept: NDArray[np.int32]
    pivot: NDArray[np.float64]

    @property
    def size(self) -> int:
        """Number of rows kept."""
        return len(self.kept)


@dataclass(frozen=True, eq=False)
class Symbolic:
    """An order of elimination, and where the factors have entries.

    `reduced`: what odd-even reduction leaves; `pattern`: its graph and the order of its rows (kept,); `nodes`: columns
    of the factor that are kept together, and their rows.
    """

    reduced: OddEven
    pattern: Pattern
    nodes: Supernodes

    @property
    def entries(self) -> int:
        """Entries of all supernodes."""
        return int(self.nodes.offset[-1])

    @property
    def products(self) -> float:
        """Products that elimination takes, about."""
        return float(0.5 * np.sum(self.widths * self.lengths.astype(np.float64) ** 2))

    @property
    def widths(self) -> NDArray[np.int32]:
        """Columns of every supernode."""
        return np.diff(self.nodes.first)

    @property
    def lengths(self) -> NDArray[np.int32]:
        """Rows of every supernode."""
        return np.diff(self.nodes.start)

    def of(self, matrix: Conductances) -> Symbolic:
        """The same order for other conductances between the same rows."""
        return replace(self, reduced=_joined(matrix, self.reduced.number, self.reduced.kept))

    @property
    def memory(self) -> float:
        """Peak memory of a solution in this order, in bytes, about."""
        return 8.0 * (self.entries + len(self.nodes.rows)) + ON_ROWS * len(self.reduced.number)

    @property
    def place(self) -> NDArray[np.int32]:
        """Where every row that is kept stands in the order, (n,); -1 for the others."""
        number = self.reduced.number
        return np.where(number >= 0, np.append(self.pattern.rank, -1)[number], -1).astype(np.int32)


@dataclass(frozen=True, eq=False)
class SupernodalFactors:
    """Factors ``L D L^T`` in such an order.

    `values`: the entries of ``-L`` below the diagonal, supernode by supernode; `pivot` (kept,): ``D``, in siemens.
    """

    symbolic: Symbolic
    values: NDArray[np.float64]
    pivot: NDArray[np.float64]

    def substitute(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """Both substitutions, in scaled numbers; ``m`` and ``e``, shape (n,), stay as they are."""
        from resgrid.solvers.supernodal_kernels import Reduced, substitute

        symbolic, x = self.symbolic, (m.copy(), e.copy())
        reduced, size = symbolic.reduced, symbolic.reduced.size
        kept = np.empty(size), np.empty(size, dtype=np.int64)
        where = Reduced(symbolic.place, reduced.pivot)
        column = np.empty(_longest(symbolic))
        substitute(reduced.whole, where, symbolic.nodes, self.values, self.pivot, *x, *kept, column)
        return x

    def solve(self, rhs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve for doubles, shape (n,); entry by entry right where none of them is negative."""
        m, e = self.substitute(rhs, np.zeros(len(rhs), dtype=np.int64))
        return unscaled(m, e)


def factor_supernodes(laplacian: Laplacian, symbolic: Symbolic | None = None) -> SupernodalFactors:
    """Factor a matrix, in an order that is there, or the one that suits it."""
    return factor_in_order(symbolic or order_rows(laplacian))


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
    reduced = _reduce_odd_even(laplacian)
    if reduced is None:
        return None
    return _analyse(reduced, np.arange(reduced.size, dtype=np.int32), _room(laplacian))


def order_by_degree(laplacian: Laplacian, most: float = np.inf) -> Symbolic | None:
    """Order the rows of a matrix by approximate minimum degree.

    None for more than ``most`` entries of the factors, or more of their rows than can be numbered.
    """
    from resgrid.solvers.ordering_kernels import minimum_degree, quotient_graph

    reduced = _reduce_odd_even(laplacian)
    if reduced is None:
        return None
    n, indptr = reduced.size, reduced.left.indptr
    quotient = quotient_graph(indptr, reduced.left.indices[: indptr[-1]])
    step = np.empty(n, dtype=np.int32)
    if not minimum_degree(quotient, max(16, int(_DENSE * np.sqrt(n))), float(most), MOST_NUMBERED, step):
        return None
    return _analyse(reduced, np.argsort(step, kind="stable").astype(np.int32), most)


def _reduce_odd_even(laplacian: Laplacian) -> OddEven | None:
    """Eliminate every other layer of rows, by their distance from the one that is most tied to the lower rail.

    None where what is left may have more entries than can be numbered.
    """
    from resgrid.solvers import symbolic_kernels as kernels
    from resgrid.solvers.ordering_kernels import breadth_first

    tied = laplacian.ground if laplacian.rails is None else laplacian.rails.to_low
    whole, n = laplacian.conductances, laplacian.size
    order = np.ascontiguousarray(breadth_first(whole.indptr, whole.indices, int(np.argmax(tied)))[::-1])
    number, kept = np.empty((2, n), dtype=np.int32)
    kept = kept[: kernels.number_kept(whole.indptr, whole.indices, order, number, kept, _none(n))].copy()
    return _joined(whole, number, kept) if _most_entries(whole, number) <= MOST_NUMBERED else None


def _most_entries(whole: Conductances, number: NDArray[np.int32]) -> int:
    """Entries of a matrix at most, once the rows that are not numbered, (n,), are eliminated."""
    degree = np.diff(whole.indptr)[number < 0].astype(np.int64)
    return len(whole.indices) + int(np.sum(degree * (degree - 3)))


def _joined(whole: Conductances, number: NDArray[np.int32], kept: NDArray[np.int32]) -> OddEven:
    """Eliminate the rows that are not numbered, (n,)."""
    from resgrid.solvers.symbolic_kernels import join_kept

    size, most = len(kept), _most_entries(whole, number)
    left = Conductances(
        np.empty(size + 1, dtype=np.int32), np.empty(most, dtype=np.int32), np.empty(most), np.empty(size)
    )
    pivot = np.zeros(len(number))
    join_kept(whole, number, kept, pivot, left, _none(size))
    return OddEven(whole, left, number, kept, pivot)


def _none(n: int) -> NDArray[np.int32]:
    return np.full(n, -1, dtype=np.int32)


def _analyse(reduced: OddEven, order: NDArray[np.int32], most: float) -> Symbolic | None:
    """List the supernodes of an order (kept,).

    None where they come to have more entries than ``most``, or more rows than can be numbered.
    """
    from resgrid.solvers import symbolic_kernels as kernels
    from resgrid.solvers.supernodal_kernels import Supernodes

    size, (indptr, indices, _, _) = reduced.size, reduced.left
    rank, parent = np.empty(size, dtype=np.int32), np.empty(size, dtype=np.int32)
    rank[order] = np.arange(size, dtype=np.int32)
    pattern = kernels.Pattern(indptr, indices, order, rank)
    kernels.postorder(pattern, order.copy(), parent, _none(size), np.empty(size, dtype=np.int32))
    first, start = np.empty((2, size + 1), dtype=np.int32)
    limits, work = (float(most), MOST_NUMBERED), (_none(size) for _ in range(3))
    count, rows = kernels.list_supernodes(pattern, *limits, first, start, *work)
    if count < 0:
        return None
    first, start = first[: count + 1].copy(), start[: count + 1].copy()
    offset = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(np.diff(first).astype(np.int64) * np.diff(start), out=offset[1:])
    return Symbolic(reduced, pattern, Supernodes(first, start, rows[: start[-1]].copy(), offset))


def _room(laplacian: Laplacian) -> int:
    """Entries that the factor of a narrow circuit may have."""
    most = _MOST_FILL_OF_VOLUMES if laplacian.dimensions > 2 else _MOST_FILL
    return most * laplacian.size


def _longest(symbolic: Symbolic) -> int:
    return int(symbolic.lengths.max(initial=0))


def factor_in_order(symbolic: Symbolic) -> SupernodalFactors:
    """Factor a matrix in an order."""
    from resgrid.solvers.supernodal_kernels import Entries, Workspace, eliminate

    n, count, widest = symbolic.reduced.size, len(symbolic.widths), int(symbolic.widths.max(initial=0))
    entries = Entries(np.empty(symbolic.entries), np.empty(n), np.empty(n))
    work = Workspace(
        node_of=np.repeat(np.arange(count, dtype=np.int32), symbolic.widths),
        waiting=np.full(count, -1, dtype=np.int32),
        following=np.empty(count, dtype=np.int32),
        after=np.empty(count, dtype=np.int32),
        place=np.empty(n, dtype=np.int32),
        column=np.empty(_longest(symbolic)),
        weight=np.empty(widest),
    )
    matrix, pattern, nodes = symbolic.reduced.left, symbolic.pattern, symbolic.nodes
    in_range = bool(np.all(np.isfinite(symbolic.reduced.pivot)))
    # In stretches, so that it can be interrupted.
    for begin in range(0, count, _STRETCH):
        end = min(begin + _STRETCH, count)
        in_range = in_range and eliminate(matrix, pattern, nodes, entries, work, begin, end)
    if not in_range:
        raise AccuracyError(
            "a pivot left the range of doubles: the conductances span too many decades for a direct solution"
        )
    return SupernodalFactors(symbolic, entries.values, entries.pivot)
