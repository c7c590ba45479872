"""Sparse factors with diagonal pivots, by SuperLU (Li 2005) in symmetric mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import AccuracyError

_PANEL, _RELAXED = 3, 1
"""Columns that are worked on together, and those of a subtree that count as one.

Columns of a grid's factors are short, and few have the same rows: with SuperLU's own 20 and 10, planes and mazes take
1.7 times as long, and volumes no less.
"""


@dataclass(frozen=True, eq=False)
class SparseFactors:
    """Factors ``P A P^T = L D L^T`` of a symmetric positive definite matrix, right up to rounding.

    `lower`: unit lower triangular, the diagonal entry first in every column; `pivot` (n,); `order` (n,): row
    ``order[k]`` of the matrix is row ``k`` of the factors; `doubles`: superLU's own substitution, in doubles.
    """

    lower: sparse.csc_array
    pivot: NDArray[np.float64]
    order: NDArray[np.int64]
    doubles: Callable[[NDArray[np.float64]], NDArray[np.float64]]

    @classmethod
    def of(cls, matrix: Any) -> SparseFactors:
        """Factor a matrix (`symmetric_factors`)."""
        factors = symmetric_factors(matrix)
        lower = factors.L
        lower.sort_indices()
        # perm_c sends a column to its place; its inverse says which column stands there.
        order = np.argsort(factors.perm_c).astype(np.int64)
        return cls(lower, np.asarray(factors.U.diagonal()), order, factors.solve)

    def substitute(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Both substitutions, in scaled numbers; ``m`` and ``e``, shape (n,), stay as they are."""
        from resgrid.solvers.extended_kernels import substitute

        permuted, exponent = m[self.order], e[self.order]
        substitute(self.lower.indptr, self.lower.indices, self.lower.data, self.pivot, permuted, exponent)
        solution, scale = np.empty_like(permuted), np.empty_like(exponent)
        solution[self.order], scale[self.order] = permuted, exponent
        return solution, scale


def symmetric_factors(matrix: Any) -> Any:
    """Factor a symmetric positive definite matrix.  Shapes: `matrix` (n, n)."""
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
