"""The diagonal of the inverse of a nodal matrix: effective resistances and impedances to the rails.

`inverse_diagonal` is exact and costs about as much as the factors themselves; `estimate_diagonal` needs only products
with it and tells how far it may be off.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.superlu import symmetric_factors


def inverse_diagonal(matrix: Any) -> NDArray[Any]:
    """All diagonal entries of the inverse of a symmetric sparse matrix, real or complex.

    Shapes: `matrix` (n, n); returns (n,).
    """
    from resgrid.solvers.selected.kernels import selected_inverse

    factors = symmetric_factors(matrix)
    lower = factors.L
    lower.sort_indices()
    inverse = np.empty_like(lower.data)
    selected_inverse(lower.indptr, lower.indices, lower.data, factors.U.diagonal(), inverse)
    diagonal = np.empty(matrix.shape[0], dtype=lower.dtype)
    diagonal[np.argsort(factors.perm_c)] = inverse[lower.indptr[:-1]]
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
