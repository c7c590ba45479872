"""Time constants: the eigenvalues ``tau`` of ``C v = tau G v``.

They are the reciprocals of the eigenvalues of ``C^-1 G``, in a form that also holds where nodes lack capacitance (their
``tau`` is 0).  The slowest ones come from Lanczos iteration on ``G^-1 C`` (ARPACK; Lehoucq, Sorensen & Yang 1998),
``G`` being factored once; the fastest one from Lanczos iteration on ``C^-1 G``, in which no ``G`` is solved.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import AccuracyError, InputError
from resgrid.nodal.dynamics import Dynamics, charge_basis, factor_resolvent
from resgrid.nodal.superlu import symmetric_factors

DENSE = 200
"""Rows up to which a dense eigenproblem is quicker."""

_RTOL = 1e-12
_FASTEST_RTOL = 5e-3
"""Residuals at which the iterations stop: all but rounding for the slow ones, whose twins (symmetric grids have many)
come out late, and loose for the fastest, whose error is of the order of the square."""


def slowest_modes(
    dynamics: Dynamics, count: int, method: str = "auto"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slowest time constants and their modes.

    Parameters
    ----------
    dynamics : Dynamics
    count : int
        How many, at least 1; fewer come back if there are fewer.
    method : {"auto", "direct", "multigrid"}
        How ``G`` is solved.

    Returns
    -------
    time_constant : ndarray of float64, shape (k,)
        Slowest first, in seconds.
    mode : ndarray of float64, shape (n, k)
        ``mode.T @ G @ mode`` is the identity, in siemens.

    Raises
    ------
    InputError
        If there is no capacitance, or the count is not positive.
    CircuitError
        If a part never settles.
    AccuracyError
        If the iteration does not converge.
    """
    if count < 1:
        raise InputError(f"{count} modes were asked for; at least 1 makes sense")
    live = int(charge_basis(dynamics).charged.sum())
    if not live:
        raise InputError("the netlist has no capacitance that could charge, so it has no time constants")
    factors = factor_resolvent(dynamics, 0.0, method)
    G, C = dynamics.conductance.matrix, dynamics.capacitance.matrix
    count = min(count, live)
    if dynamics.size <= max(DENSE, 2 * count):
        from scipy.linalg import eigh

        tau, mode = eigh(C.toarray(), G.toarray())
    else:
        from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

        inverse = LinearOperator(G.shape, matvec=lambda b: factors.solve(np.ravel(b), rtol=1e-11), dtype=np.float64)
        try:
            tau, mode = eigsh(
                C, count, M=G, Minv=inverse, which="LA", v0=_seed(dynamics.size), tol=_RTOL, ncv=max(2 * count + 1, 20)
            )
        except ArpackError as error:
            raise AccuracyError(f"the time constants did not converge: {error}") from error
    order = np.argsort(-tau)[:count]
    return tau[order], mode[:, order]


def fastest_time_constant(dynamics: Dynamics) -> float:
    """The shortest time constant, to 1 % or better, in seconds.

    Nodes without capacitance are eliminated first, for they follow at once.

    Raises
    ------
    InputError
        If there is no capacitance.
    AccuracyError
        If the iteration does not converge.
    """
    basis = charge_basis(dynamics)
    charged = basis.charged
    if not charged.any():
        raise InputError("the netlist has no capacitance that could charge, so it has no time constants")
    G = dynamics.conductance.matrix
    own, across = G[charged][:, charged], (G @ basis.spread)[charged]
    capacitance = dynamics.capacitance.matrix[charged][:, charged]
    if own.shape[0] <= DENSE:
        from scipy.linalg import eigh

        loose = (basis.spread.T @ G @ basis.spread).toarray()
        eliminated = across.toarray() @ np.linalg.solve(loose, across.toarray().T) if loose.size else 0.0
        return float(1.0 / eigh(own.toarray() - eliminated, capacitance.toarray(), eigvals_only=True)[-1])
    return _iterated(own, across, sparse.csc_matrix(basis.spread.T @ G @ basis.spread), capacitance)


def _iterated(
    own: sparse.csr_array, across: sparse.csr_array, loose: sparse.csc_matrix, capacitance: sparse.csr_array
) -> float:
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

    inner = symmetric_factors(loose) if loose.shape[0] else None

    def reduced(x: NDArray[np.float64]) -> NDArray[np.float64]:
        x = np.ravel(x)
        followed = 0.0 if inner is None else across @ inner.solve(across.T @ x)
        return np.asarray(own @ x - followed)

    charge = symmetric_factors(capacitance)
    n = own.shape[0]
    try:
        rate = eigsh(
            LinearOperator((n, n), matvec=reduced, dtype=np.float64),
            1,
            M=capacitance,
            Minv=LinearOperator((n, n), matvec=lambda b: charge.solve(np.ravel(b)), dtype=np.float64),
            which="LA",
            v0=_seed(n),
            tol=_FASTEST_RTOL,
            return_eigenvectors=False,
        )
    except ArpackError as error:
        raise AccuracyError(f"the fastest time constant did not converge: {error}") from error
    return float(1.0 / rate[0])


def _seed(size: int) -> NDArray[np.float64]:
    """A start vector without symmetry, the same every time."""
    return np.random.default_rng(0).uniform(0.5, 1.5, size)
