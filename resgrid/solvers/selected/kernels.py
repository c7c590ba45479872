"""Compiled loops of the selected inverse."""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.integer[Any]]
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


@nb.njit(cache=True)
def column_structure(indptr: Indices, indices: Indices) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Where the factor of a symmetric matrix may have entries, by the elimination tree (Liu 1990)."""
    n = len(indptr) - 1
    parent, mark = np.full(n, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    starts = np.zeros(n + 1, dtype=np.int32)
    rows = np.empty(0, dtype=np.int32)
    filled = starts
    for counting in (True, False):
        mark[:] = -1
        for i in range(n):
            mark[i] = i
            if not counting:
                rows[filled[i]] = i
                filled[i] += 1
            for p in range(indptr[i], indptr[i + 1]):
                j = int(indices[p])
                while j < i and mark[j] != i:
                    mark[j] = i
                    if counting:
                        parent[j] = i if parent[j] < 0 else parent[j]
                        starts[j + 1] += 1
                    else:
                        rows[filled[j]] = i
                        filled[j] += 1
                    j = int(parent[j])
        if counting:
            for j in range(n):
                starts[j + 1] += starts[j] + 1
            rows = np.empty(starts[n], dtype=np.int32)
            filled = starts[:-1].copy()
    return starts, rows


@nb.njit(cache=True)
def eliminate(
    indptr: Indices,
    indices: Indices,
    coupling: NDArray[np.float64],
    excess: NDArray[np.float64],
    starts: NDArray[np.int32],
    rows: NDArray[np.int32],
    lower: NDArray[np.float64],
    pivot: NDArray[np.float64],
) -> None:
    """Factor an M-matrix ``L D L^T`` without a subtraction, column by column from those to the left of it.

    Shapes: `excess` (n,).
    """
    n = len(pivot)
    work = np.zeros(n)
    # Columns wait in a list for the next row that they have an entry in.
    first, following, at = np.full(n, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64), starts[:-1].astype(np.int64)
    for j in range(n):
        for p in range(indptr[j], indptr[j + 1]):
            if indices[p] > j:
                work[indices[p]] = coupling[p]
        k = int(first[j])
        while k >= 0:
            later = int(following[k])
            p = int(at[k])
            share = -lower[p]
            excess[j] += share * excess[k]
            for q in range(p + 1, starts[k + 1]):
                work[rows[q]] -= share * pivot[k] * lower[q]
            _wait(k, p + 1, starts, rows, first, following, at)
            k = later
        total = excess[j]
        for q in range(starts[j] + 1, starts[j + 1]):
            total += work[rows[q]]
        pivot[j] = total
        lower[starts[j]] = 1.0
        for q in range(starts[j] + 1, starts[j + 1]):
            lower[q] = -work[rows[q]] / total
            work[rows[q]] = 0.0
        _wait(j, starts[j] + 1, starts, rows, first, following, at)


@nb.njit(cache=True)
def _wait(
    k: int,
    p: int,
    starts: NDArray[np.int32],
    rows: NDArray[np.int32],
    first: NDArray[np.int64],
    following: NDArray[np.int64],
    at: NDArray[np.int64],
) -> None:
    at[k] = p
    if p < starts[k + 1]:
        following[k], first[rows[p]] = first[rows[p]], k
