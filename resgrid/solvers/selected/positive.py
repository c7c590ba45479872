"""Factors of an M-matrix in positive numbers alone, and the diagonal of its inverse, right entry by entry.

A pivot is the sum of what is left of its row: the couplings to later rows, and the excess, which is carried along
instead of being read off the diagonal (Grassmann, Taksar & Heyman 1985; O'Cinneide 1993).  Nothing is subtracted, so
that a part that 1e-17 S tie to a rail, among conductances of 1 S, keeps its digits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.solvers.extended import power
from resgrid.solvers.superlu import symmetric_factors


@dataclass(frozen=True, eq=False)
class PositiveFactors:
    """Factors ``P A P^T = L D L^T`` of a symmetric M-matrix.

    `starts, rows`: compressed columns of ``L``, the diagonal entry first and rows ascending in each; `lower`: its
    entries; negative but for the diagonal, which is 1; `pivot` (n,); `order` (n,): row ``order[k]`` of the matrix is
    row ``k`` of the factors.
    """

    starts: NDArray[np.int32]
    rows: NDArray[np.int32]
    lower: NDArray[np.float64]
    pivot: NDArray[np.float64]
    order: NDArray[np.int64]

    def inverse_diagonal(self) -> NDArray[np.float64]:
        """All diagonal entries of the inverse, shape (n,)."""
        from resgrid.solvers.selected.kernels import selected_inverse

        inverse = np.empty_like(self.lower)
        selected_inverse(self.starts, self.rows, self.lower, self.pivot, inverse)
        diagonal = np.empty(len(self.order))
        diagonal[self.order] = inverse[self.starts[:-1]]
        return diagonal

    def solve_nonnegative(self, rhs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve for a right-hand side without negative entries, entry by entry; shape (n,)."""
        from resgrid.solvers.extended_kernels import substitute

        m, e = rhs[self.order], np.zeros(len(rhs), dtype=np.int64)
        substitute(self.starts, self.rows, self.lower, self.pivot, m, e)
        solution = np.empty_like(m)
        solution[self.order] = m * power(e)
        return solution


def positive_factors(coupling: sparse.csr_array, excess: NDArray[np.float64]) -> PositiveFactors:
    """Factor a symmetric M-matrix.  Shapes: `coupling` (n, n), `excess` (n,)."""
    from resgrid.solvers.selected import kernels

    order = _fill_reducing(coupling)
    own = sparse.csr_array(coupling[order][:, order])
    own.sort_indices()
    starts, rows = kernels.column_structure(own.indptr, own.indices)
    lower, pivot = np.zeros(len(rows)), np.empty(len(order))
    kernels.eliminate(own.indptr, own.indices, own.data, excess[order], starts, rows, lower, pivot)
    return PositiveFactors(starts, rows, lower, pivot, order)


def _fill_reducing(coupling: sparse.csr_array) -> NDArray[np.int64]:
    """An order in which factors stay sparse, from a matrix of the same pattern whose pivots are harmless."""
    pattern = sparse.csr_array((np.ones(coupling.nnz), coupling.indices, coupling.indptr), shape=coupling.shape)
    factors = symmetric_factors(sparse.diags_array(np.diff(coupling.indptr) + 1.0) - pattern)
    return np.argsort(factors.perm_c).astype(np.int64)
