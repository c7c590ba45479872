"""Diagonal of the inverse of a symmetric matrix: exact by the selected inverse, or estimated by random signs.

`inverse_diagonal` and `positive_inverse_diagonal` are exact and cost about as much as the factors themselves.
`estimate_diagonal` needs only products with the inverse, and estimates its own error.

`symmetric_factors` are ordinary factors with subtractions (SuperLU; Li 2005), for matrices that are not M-matrices, or
where a few digits suffice: admittances and quadratic forms are complex or have entries of both signs; preconditioners
need few digits. All other factors are subtraction-free (`resgrid.solvers.supernodal`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid._internal.jit import kernel
from resgrid.errors import AccuracyError
from resgrid.solvers.scaled import Floats, Indices, Integers

if TYPE_CHECKING:
    from resgrid.solvers.supernodal_factors import SupernodalFactors

_PANEL, _RELAXED = 3, 1
"""SuperLU's parameters: columns that it processes together, and columns of a subtree that it merges into a supernode.

Columns of a grid's factors are short, and few have equal rows. With SuperLU's defaults, 20 and 10, planes and mazes
take 1.7 times as long as with these values, and volumes take equally long.
"""


def symmetric_factors(matrix: Any) -> Any:
    """Return SuperLU's factors of a symmetric matrix (n, n), real or complex, with pivots on the diagonal.

    The result is a scipy.sparse.linalg.SuperLU object.

    Raises
    ------
    AccuracyError
        If the matrix is singular in double precision.
    """
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
            "the matrix is singular in double precision: its conductances span too many orders of magnitude for a "
            "direct solution; check the largest and the smallest conductance"
        ) from error
    if np.any(factors.perm_r != factors.perm_c):
        raise AccuracyError(
            "a pivot vanished in double precision: the conductances span too many orders of magnitude for a direct "
            "solution; check the largest and the smallest conductance"
        )
    return factors


def inverse_diagonal(matrix: Any) -> NDArray[Any]:
    """Return the diagonal (n,) of the inverse of a symmetric sparse matrix (n, n), real or complex.

    The diagonal is exact except for rounding; its unit is the reciprocal of the matrix's unit. Raises AccuracyError if
    the matrix is singular in double precision.
    """
    factors = symmetric_factors(matrix)
    return _diagonal(np.argsort(factors.perm_c), factors.L, factors.U.diagonal())


def positive_inverse_diagonal(factors: SupernodalFactors) -> Floats:
    """Return the diagonal (n,) of the inverse of an M-matrix in ohms, every entry with a small relative error.

    `factors`: subtraction-free factors of the matrix.
    """
    symbolic, nodes, matrix = factors.symbolic, factors.symbolic.nodes, factors.matrix
    size, gone = len(symbolic.order), len(symbolic.order) - symbolic.kept
    order, pivot = np.roll(symbolic.order, gone), np.roll(factors.pivot, gone)  # in the order of elimination
    rows_gone = sparse.csr_array(matrix[2::-1], shape=(size, size))[order[:gone]]
    degree = np.diff(rows_gone.indptr)
    length = np.repeat(symbolic.lengths, symbolic.widths)
    behind = np.arange(symbolic.entries) - np.repeat(np.cumsum(length) - length, length)
    inside = nodes.rows[np.repeat(np.repeat(nodes.start[:-1], symbolic.widths), length) + behind]
    row = np.append(np.argsort(order)[rows_gone.indices], gone + inside)
    column = np.repeat(np.arange(size), np.append(degree, length))
    weight = np.append(rows_gone.data / np.repeat(pivot[:gone], degree), factors.values)
    below, each = row > column, np.arange(size)
    entries = np.append(np.ones(size), -weight[below]), (np.append(each, row[below]), np.append(each, column[below]))
    return _diagonal(order, sparse.csc_array(entries, shape=(size, size)), pivot)


def random_signs(size: int, samples: int, seed: int) -> Floats:
    """Return `samples` vectors of random signs 1 and -1 as doubles, shape (size, samples), from the seed `seed`."""
    return np.asarray(np.random.default_rng(seed).integers(0, 2, (size, samples)) * 2.0 - 1.0, dtype=np.float64)


def estimate_diagonal(signs: Floats, products: Floats) -> tuple[Floats, Floats]:
    """Return an estimate of a matrix diagonal, shape (n,), and its standard error, shape (n,), in the matrix's unit.

    The estimate is the mean over the samples of sign times product (Bekas, Kokiopoulou & Saad 2007). `signs` (n,
    samples): vectors of random signs 1 and -1; `products` (n, samples): the matrix times these vectors.
    """
    each = signs * products
    return each.mean(axis=1), each.std(axis=1, ddof=1) / np.sqrt(each.shape[1])


def _diagonal(order: NDArray[Any], lower: sparse.csc_array, pivot: NDArray[Any]) -> NDArray[Any]:
    """Return the diagonal of the inverse of the matrix with factors ``L D L^T``, shape (n,).

    `order` (n,): rows of the matrix in the order of elimination; `lower` (n, n): ``L`` with its diagonal of ones;
    `pivot` (n,): diagonal of ``D``.
    """
    lower.sort_indices()
    starts = lower.indptr.astype(np.int64)
    inverse, diagonal = np.empty_like(lower.data), np.empty_like(lower.data, shape=len(order))
    selected_inverse(starts, lower.indices, lower.data, pivot, inverse)
    diagonal[order] = inverse[starts[:-1]]
    return diagonal


@kernel
def selected_inverse(
    starts: Integers, rows: Indices, lower: Floats | NDArray[np.complex128], pivot: Floats, inverse: Floats
) -> None:
    """Write the entries of the inverse of ``L D L^T`` on the pattern of ``L`` to ``inverse`` (Takahashi et al. 1973).

    ``Z_ij = -sum_k Z_ik L_kj`` for ``i > j`` and ``Z_jj = 1 / D_j - sum_k Z_kj L_kj``, column by column, the last one
    first. All required entries lie on the pattern, since it is closed under elimination (Takahashi, Fagan & Chen 1973).

    `starts` (n + 1,): begin of every column; `rows, lower` (entries,): rows and values of ``L`` by columns, sorted,
    with the diagonal; `pivot` (n,): diagonal of ``D``; `inverse` (entries,): result.
    """
    n = len(pivot)
    place = np.full(n, -1, dtype=np.int64)
    for j in range(n - 1, -1, -1):
        first, last = starts[j] + 1, starts[j + 1]
        for p in range(first, last):
            place[rows[p]] = p
            inverse[p] = 0.0
        for p in range(first, last):
            k = rows[p]
            inverse[p] -= inverse[starts[k]] * lower[p]
            for q in range(starts[k] + 1, starts[k + 1]):
                at = place[rows[q]]
                if at >= 0:
                    inverse[at] -= inverse[q] * lower[p]
                    inverse[p] -= inverse[q] * lower[at]
        diagonal = 1.0 / pivot[j]
        for p in range(first, last):
            diagonal -= inverse[p] * lower[p]
            place[rows[p]] = -1
        inverse[starts[j]] = diagonal
