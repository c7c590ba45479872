"""Factors kept column by column (simplicial), and what is found column by column.

- *SuperLU's* (Li 2005), made by differences, for what is not positive throughout, or needs a few digits alone:
  admittances and quadratic forms are complex, or have entries of both signs; levels scaled by a potential have ground
  conductances of both signs; preconditioners need few digits.  All other factors are made in positive numbers alone
  (`resgrid.solvers.supernodal`).
- *The diagonal of an inverse*: effective resistances and impedances to the rails; exact, at about the cost of the
  factors themselves, or estimated by products with the inverse alone.
- *Differences between rows*, right where the voltages themselves differ by less than a double can tell.  Substitution
  is done in differences between the rows that elimination joins, each of them a sum of products
  (`resgrid.solvers.column_kernels.substitute_differences`): stiff ties, flat dead ends and loops keep their currents.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import AccuracyError
from resgrid.solvers.laplacian import MOST_NUMBERED
from resgrid.solvers.supernodal import SupernodalFactors

if TYPE_CHECKING:
    from resgrid.solvers.column_kernels import Columns, Gaps

_PANEL, _RELAXED = 3, 1
"""Columns that are worked on together, and those of a subtree that count as one.

Columns of a grid's factors are short, and few have the same rows: with SuperLU's own 20 and 10, planes and mazes take
1.7 times as long, and volumes no less.
"""


def symmetric_factors(matrix: Any) -> Any:
    """Factor a symmetric matrix, real or complex, with diagonal pivots.  Shapes: `matrix` (n, n)."""
    from scipy.sparse.linalg import splu

    try:
        factors = splu(
            sparse.csc_matrix(matrix),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            relax=_RELAXED,
            panel_size=_PANEL,
            options={"SymmetricMode": True, "Equil": False},
        )
    except RuntimeError as error:
        raise AccuracyError(
            "the matrix is singular in double precision: its conductances span too many decades for a direct solution"
        ) from error
    if np.any(factors.perm_r != factors.perm_c):
        raise AccuracyError("a pivot vanished in double precision: the conductances span too many decades")
    return factors


def inverse_diagonal(matrix: Any) -> NDArray[Any]:
    """All diagonal entries of the inverse of a symmetric sparse matrix, real or complex.

    Shapes: `matrix` (n, n); returns (n,).
    """
    factors = symmetric_factors(matrix)
    lower = factors.L
    lower.sort_indices()
    diagonal = np.empty(matrix.shape[0], dtype=lower.dtype)
    order = np.argsort(factors.perm_c)
    diagonal[order] = _diagonal(lower.indptr, lower.indices, lower.data, factors.U.diagonal())
    return diagonal


def positive_inverse_diagonal(factors: SupernodalFactors) -> NDArray[np.float64]:
    """All diagonal entries of the inverse of an M-matrix, right entry by entry; shape (n,)."""
    order, (starts, rows, weight, pivot) = columns_of(factors)
    diagonal = np.empty(len(order))
    diagonal[order] = _diagonal(starts, rows, -weight, pivot)
    return diagonal


def random_signs(size: int, samples: int, seed: int) -> NDArray[np.float64]:
    """Vectors of random signs, shape (size, samples)."""
    return np.asarray(np.random.default_rng(seed).integers(0, 2, (size, samples)) * 2.0 - 1.0, dtype=np.float64)


def estimate_diagonal(
    signs: NDArray[np.float64], products: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimate the diagonal of a matrix from its products with random signs (Bekas, Kokiopoulou & Saad 2007).

    Shapes: `signs` (n, samples), `products` (n, samples); returns `estimate` (n,), `error` (n,).
    """
    each = signs * products
    mean: NDArray[np.float64] = each.mean(axis=1)
    error: NDArray[np.float64] = each.std(axis=1, ddof=1) / np.sqrt(each.shape[1])
    return mean, error


def _diagonal(starts: NDArray[Any], rows: NDArray[np.int32], lower: NDArray[Any], pivot: NDArray[Any]) -> NDArray[Any]:
    """Diagonal of ``(L D L^T)^-1``, shape (n,), from the columns of ``L``, the diagonal entry first in each."""
    from resgrid.solvers.column_kernels import selected_inverse

    inverse = np.empty_like(lower)
    selected_inverse(starts, rows, lower, pivot, inverse)
    return inverse[starts[:-1]]


@dataclass(frozen=True, eq=False)
class Differences:
    """Factors by columns, with the rails as nodes of their own.

    `columns`: of ``-L`` and ``D``; `order` (n,): the row that is eliminated at every place; `ties` (n, rails): what
    joins a row to each rail when it is eliminated, in siemens.
    """

    columns: Columns
    order: NDArray[np.int64]
    ties: NDArray[np.float64]

    def solve(self, fed: NDArray[np.float64], volts: NDArray[np.float64]) -> Gaps:
        """Solve for what is fed into the rows (n,), in amperes, and the rails' voltages (rails,)."""
        from resgrid.solvers.column_kernels import Gaps, feed_forward, substitute_differences

        n, entries = len(self.order), len(self.columns.rows)
        carried = np.stack([fed, np.abs(fed)], axis=1)[self.order]
        feed_forward(self.columns, carried)
        (change, change_low), (apart, apart_low) = np.zeros((2, n)), np.zeros((2, entries))
        above, above_low = np.zeros((2, n, len(volts)))
        gaps = Gaps(change, change_low, apart, apart_low, above, above_low)
        substitute_differences(self.columns, carried, self.ties, volts, gaps, given=False)
        return gaps

    def correct(self, gaps: Gaps, more: Gaps, volts: NDArray[np.float64]) -> None:
        """Add the changes of other gaps, in place."""
        from resgrid.solvers.column_kernels import substitute_differences
        from resgrid.solvers.refine_kernels import corrected

        corrected(gaps.change.copy(), gaps.change_low.copy(), more.change, gaps.change, gaps.change_low)
        substitute_differences(self.columns, np.zeros((len(self.order), 2)), self.ties, volts, gaps, given=True)

    def places(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        """Where rows are in the order of elimination, shape of ``rows``; -1 for a row of -1."""
        place = np.full(len(self.order) + 1, -1, dtype=np.int32)
        place[self.order] = np.arange(len(self.order), dtype=np.int32)
        return place[rows]

    def falls(
        self, gaps: Gaps, ends: NDArray[np.int32], rail: NDArray[np.int32], lift: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Falls across edges beside their lifts, in double-double.

        Shapes: `ends` (m, 2): places, or -1 for a node of known voltage, `rail, lift` (m,); returns (m,), (m,).
        """
        from resgrid.solvers.column_kernels import add_falls

        falls, falls_low = lift.copy(), np.zeros_like(lift)
        add_falls(self.columns, gaps, ends, rail, falls, falls_low)
        return falls, falls_low

    def heights(self, gaps: Gaps) -> NDArray[np.float64]:
        """Heights of all rows above every rail, in volts, (n, rails)."""
        above = np.empty_like(gaps.above)
        above[self.order] = gaps.above
        return above


def differences(factors: SupernodalFactors, ties: NDArray[np.float64]) -> Differences:
    """Make factors ready for differences.  Shapes: `ties` (n, rails): conductance from every row to every rail."""
    from resgrid.solvers.column_kernels import feed_forward

    order, columns = columns_of(factors)
    carried = ties[order]
    feed_forward(columns, carried)
    return Differences(columns, order, carried)


def columns_of(factors: SupernodalFactors) -> tuple[NDArray[np.int64], Columns]:
    """The columns of ``-L``, `order` (n,) first: the row that is eliminated at every place."""
    from resgrid.solvers.column_kernels import Columns

    symbolic, nodes = factors.symbolic, factors.symbolic.nodes
    reduced, place = symbolic.reduced, symbolic.place
    order = np.argsort(place, kind="stable")
    gone = order[: len(place) - reduced.size]
    rows_gone = sparse.csr_array(reduced.whole[2::-1], shape=(len(place),) * 2)[gone]
    degree, pivot = np.diff(rows_gone.indptr), reduced.pivot[gone]
    entries = (rows_gone.data, place[rows_gone.indices], rows_gone.indptr)
    rows_gone = sparse.csr_array(entries, shape=(len(gone), max(reduced.size, 1)))
    rows_gone.sort_indices()
    node = np.repeat(np.arange(len(symbolic.widths)), symbolic.widths)
    behind = np.arange(reduced.size) - nodes.first[node] + 1
    below = symbolic.lengths[node] - behind
    each = np.arange(below.sum()) - np.repeat(np.cumsum(below) - below, below)
    row = nodes.rows[np.repeat(nodes.start[node] + behind, below) + each]
    at = nodes.offset[node] + (behind - 1) * symbolic.lengths[node] + behind
    starts = np.append(0, np.cumsum(np.append(degree, below) + 1))
    starts = starts.astype(np.int32 if starts[-1] <= MOST_NUMBERED else np.int64)
    rows, weight = np.empty(starts[-1], dtype=np.int32), np.full(starts[-1], -1.0)
    off = np.ones(len(rows), dtype=np.bool_)
    off[starts[:-1]] = False
    rows[starts[:-1]] = np.arange(len(starts) - 1)
    rows[off] = len(gone) + np.append(rows_gone.indices, row)
    weight[off] = np.append(rows_gone.data / np.repeat(pivot, degree), factors.values[np.repeat(at, below) + each])
    return order, Columns(starts, rows, weight, np.append(pivot, factors.pivot))
