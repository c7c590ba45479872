"""Entries of inverses computed without subtraction, compared with exact fractions and numpy.

Tests internals: `resgrid.solvers.laplacian`, `resgrid.solvers.selected_inverse`, `resgrid.solvers.supernodal`,
`resgrid.solvers.symbolic`.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import sparse

from resgrid.solvers.laplacian import Laplacian, Rows
from resgrid.solvers.selected_inverse import inverse_diagonal, positive_inverse_diagonal
from resgrid.solvers.supernodal import factor_supernodes
from resgrid.solvers.symbolic import Symbolic, order_by_distance, order_by_fill


def exact_inverse(coupling: np.ndarray, excess: np.ndarray) -> list[list[Fraction]]:
    """Inverse of an M-matrix by Gauss-Jordan elimination in fractions."""
    n = len(excess)
    rows = [[Fraction(0)] * n + [Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    for i in range(n):
        for j in range(n):
            rows[i][j] -= Fraction(coupling[i, j])
            rows[i][i] += Fraction(coupling[i, j])
        rows[i][i] += Fraction(excess[i])
    for k in range(n):
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(n):
            if i != k:
                factor = rows[i][k]
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


@pytest.mark.parametrize("order", [order_by_distance, order_by_fill])
@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), decades=st.sampled_from([0, 4, 24]), size=st.integers(1, 9))
def test_inverse_entries_are_accurate_for_all_conductances(
    order: Callable[[Laplacian], Symbolic], seed: int, decades: int, size: int
) -> None:
    rng = np.random.default_rng(seed)
    coupling = np.zeros((size, size))
    for i in range(1, size):
        for j in {int(rng.integers(0, i)), int(rng.integers(0, i))}:
            coupling[i, j] = coupling[j, i] = 10 ** rng.uniform(-decades / 2, decades / 2)
    excess = np.where(rng.random(size) < 0.3, 10 ** rng.uniform(-decades / 2, decades / 2, size), 0.0)
    excess[rng.integers(0, size)] = 10.0 ** -rng.integers(0, 20)
    laplacian = Laplacian(excess, compressed=Rows.of(sparse.csr_array(coupling)))
    factors = factor_supernodes(laplacian, order(laplacian))
    wanted = exact_inverse(coupling, excess)
    assert positive_inverse_diagonal(factors) == pytest.approx([float(wanted[i][i]) for i in range(size)], rel=1e-14)
    rhs = np.zeros(size)
    rhs[seed % size] = 1.0
    assert factors.solve(rhs) == pytest.approx([float(row[seed % size]) for row in wanted], rel=1e-14)


def test_the_inverse_diagonal_of_an_admittance_equals_numpy() -> None:
    rng = np.random.default_rng(3)
    coupling = sparse.random_array((40, 40), density=0.08, rng=rng)
    coupling = sparse.csr_array(coupling + coupling.T)
    matrix = sparse.diags_array(coupling.sum(axis=1) + 0.1 + 1j * rng.random(40)) - coupling * (1 + 0.3j)
    expected = np.linalg.inv(matrix.toarray()).diagonal()
    np.testing.assert_allclose(inverse_diagonal(sparse.csr_array(matrix)), expected, rtol=1e-12)
