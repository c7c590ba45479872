"""Compiled loops of the selected inverse."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int32]
Values = NDArray[np.float64] | NDArray[np.complex128]


@nb.njit(cache=True)
def selected_inverse(starts: Indices, rows: Indices, lower: Values, pivot: Values, inverse: Values) -> None:
    """Entries of the inverse of ``L D L^T`` on the pattern of ``L`` (Takahashi, Fagan & Chen 1973).

    ``Z_ij = -sum_k Z_ik L_kj`` for ``i > j`` and ``Z_jj = 1 / D_j - sum_k Z_kj L_kj``, column by column from the last
    one back.  All entries needed lie on the pattern, for it is closed under elimination.

    Shapes: `pivot` (n,), `inverse` of ``lower``.
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
