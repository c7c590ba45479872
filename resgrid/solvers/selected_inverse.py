"""Factors by columns, and the diagonal of an inverse: effective resistances and impedances to the rails.

`inverse_diagonal` and `positive_inverse_diagonal` are exact and cost about as much as the factors themselves;
`estimate_diagonal` needs only products with the inverse and tells how far it may be off.

`symmetric_factors` are made by differences (SuperLU; Li 2005), for what is not positive throughout, or needs a few
digits alone: admittances and quadratic forms are complex, or have entries of both signs; levels scaled by a potential
have ground conductances of both signs; preconditioners need few digits.  All other factors are made in positive numbers
alone (`resgrid.solvers.supernodal`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import AccuracyError
from resgrid.solvers.laplacian import MOST_NUMBERED
from resgrid.solvers.supernodal import SupernodalFactors

if TYPE_CHECKING:
    from resgrid.solvers.column_kernels import Columns

Indices = NDArray[np.int32]
Integers = NDArray[np.int64]

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


def _diagonal(starts: Indices | Integers, rows: Indices, lower: NDArray[Any], pivot: NDArray[Any]) -> NDArray[Any]:
    """Diagonal of ``(L D L^T)^-1``, shape (n,), from the columns of ``L``, the diagonal entry first in each."""
    from resgrid.solvers.column_kernels import selected_inverse

    inverse = np.empty_like(lower)
    selected_inverse(starts, rows, lower, pivot, inverse)
    return inverse[starts[:-1]]
