"""Time constants: the eigenvalues ``tau`` of ``C v = tau G v``.

They are the reciprocals of the eigenvalues of ``C^-1 G``, in a form that also holds where nodes lack capacitance (their
``tau`` is 0).  Small circuits are resolved whole (`resgrid.chip.modal`).  In others, with ``C = F^T F``, the slowest
ones come from Lanczos iteration on ``F G^-1 F^T`` (ARPACK; Lehoucq, Sorensen & Yang 1998), and again on what is left
once the modes found are projected out, until nothing slower appears: an iteration from one vector sees one copy only of
a multiple eigenvalue (Parlett 1998, section 12.4), and symmetric grids have many.  The fastest one comes from Lanczos
iteration on ``C^-1 G``, in which no ``G`` is solved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.chip.modal import Modes, all_modes, check_modes
from resgrid.chip.roots import Solver, accurate_solver, laplacian_root
from resgrid.errors import AccuracyError, InputError
from resgrid.nodal.dynamics import Dynamics, charge_basis, factor_resolvent
from resgrid.nodal.superlu import symmetric_factors

Floats = NDArray[np.float64]

DENSE = 200
"""Rows up to which all modes are found."""

_RTOL = 1e-12
_PROBE_RTOL = 1e-3
_FASTEST_RTOL = 5e-3
"""Residuals at which the iterations stop: all but rounding for the slow ones, loose for one that only tells whether
anything slower is left, and for the fastest, whose error is of the order of the square."""

_NOISE = 1e-12
"""Iterated time constants, relative to the slowest one, that rounding decides."""

_KRYLOV, _PROBE_KRYLOV = 20, 10
"""Least vectors that an iteration keeps, and those of the loose one."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Time constants of a circuit.

    `tau` (k,): the slowest ones, slowest first, in seconds; `mode` (n, k): ``mode.T @ G @ mode`` is the identity, in
    siemens; `fastest`: the shortest one, to 1 % or better, in seconds; `modes`: all of them, where the circuit is
    small.
    """

    tau: Floats
    mode: Floats
    fastest: float
    modes: Modes | None


def find_spectrum(dynamics: Dynamics, count: int, solve: Solver) -> Spectrum:
    """Slowest time constants with their modes, and the fastest one."""
    live = require_charge(dynamics)
    if dynamics.size <= max(DENSE, 2 * count):
        modes = all_modes(dynamics)
        check_modes(dynamics, modes, solve)
        slow = modes.tau[:count]
        return Spectrum(slow, modes.shape[:, :count] * np.sqrt(slow), float(modes.tau[-1]), modes)
    tau, mode = _slowest(dynamics, count, live, solve)
    return Spectrum(tau, mode, fastest_time_constant(dynamics), None)


def slowest_modes(dynamics: Dynamics, count: int, method: str = "auto") -> tuple[Floats, Floats]:
    """Slowest time constants and their modes.  Returns `time_constant` (k,), `mode` (n, k)."""
    if count < 1:
        raise InputError(f"{count} modes were asked for; at least 1 makes sense")
    live = require_charge(dynamics)
    solve = accurate_solver(factor_resolvent(dynamics, 0.0, method), dynamics.capacitance)
    if dynamics.size <= max(DENSE, 2 * count):
        modes = all_modes(dynamics)
        check_modes(dynamics, modes, solve)
        slow = modes.tau[:count]
        return slow, modes.shape[:, :count] * np.sqrt(slow)
    return _slowest(dynamics, count, live, solve)


def fastest_time_constant(dynamics: Dynamics) -> float:
    """The shortest time constant, to 1 % or better, in seconds.

    Nodes without capacitance are eliminated first, for they follow at once.
    """
    require_charge(dynamics)
    if dynamics.size <= DENSE:
        return float(all_modes(dynamics).tau[-1])
    basis = charge_basis(dynamics)
    charged = basis.charged
    G = dynamics.conductance.matrix
    own, across = G[charged][:, charged], (G @ basis.spread)[charged]
    capacitance = dynamics.capacitance.matrix[charged][:, charged]
    return _iterated(own, across, sparse.csc_matrix(basis.spread.T @ G @ basis.spread), capacitance)


def require_charge(dynamics: Dynamics) -> int:
    """Refuse a circuit without modes; how many there are."""
    live = int(charge_basis(dynamics).charged.sum())
    if not live:
        raise InputError("the netlist has no capacitance that could charge, so it has no time constants")
    return live


def _slowest(dynamics: Dynamics, count: int, live: int, solve: Solver) -> tuple[Floats, Floats]:
    """Iterate on ``K = F G^-1 F^T``, whose eigenvectors are orthonormal, until nothing slower is left."""
    F = laplacian_root(dynamics.capacitance)
    count = min(count, live)

    def apply(u: Floats) -> Floats:
        return np.asarray(F @ solve(F.T @ np.ravel(u)))

    random = np.random.default_rng(0)
    tau, U = _top(apply, F @ random.uniform(0.5, 1.5, dynamics.size), count, _RTOL, _KRYLOV)
    while len(tau) < live:
        rest, start = _without(U, apply), _orthogonal(U, F @ random.uniform(0.5, 1.5, dynamics.size))
        if _top(rest, start, 1, _PROBE_RTOL, _PROBE_KRYLOV)[0][0] * (1.0 + 2.0 * _PROBE_RTOL) < tau[count - 1]:
            break
        more, u = _top(rest, start, 1, _RTOL, _KRYLOV)
        tau, U = _sorted(np.append(tau, more), np.hstack([U, u]))
        if more[0] <= tau[count - 1]:
            break
    slow = tau[:count] > _NOISE * tau[0]
    tau, U = tau[:count][slow], U[:, :count][:, slow]
    return tau, np.stack([solve(F.T @ u) for u in U.T], axis=1) / np.sqrt(tau)


def _top(apply: Any, start: Floats, count: int, rtol: float, least: int) -> tuple[Floats, Floats]:
    """Largest eigenvalues, largest first, and their eigenvectors."""
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

    n, vectors = len(start), max(2 * count + 1, least)
    if n <= vectors:
        tau, U = np.linalg.eigh(np.stack([apply(u) for u in np.eye(n)]))
        return _sorted(tau[-count:], U[:, -count:])
    operator = LinearOperator((n, n), matvec=apply, dtype=np.float64)
    try:
        tau, U = eigsh(operator, count, which="LA", v0=start, tol=rtol, ncv=vectors)
    except ArpackError as error:
        raise AccuracyError(f"the time constants did not converge: {error}") from error
    return _sorted(tau, U)


def _sorted(tau: Floats, U: Floats) -> tuple[Floats, Floats]:
    order = np.argsort(-tau, kind="stable")
    return tau[order], U[:, order]


def _orthogonal(U: Floats, u: Floats) -> Floats:
    return np.asarray(u - U @ (U.T @ u))


def _without(U: Floats, apply: Any) -> Any:
    """The operator on what is orthogonal to some of its eigenvectors."""
    return lambda u: _orthogonal(U, apply(_orthogonal(U, np.ravel(u))))


def _iterated(
    own: sparse.csr_array, across: sparse.csr_array, loose: sparse.csc_matrix, capacitance: sparse.csr_array
) -> float:
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

    inner = symmetric_factors(loose) if loose.shape[0] else None

    def reduced(x: Floats) -> Floats:
        x = np.ravel(x)
        followed = 0.0 if inner is None else across @ inner.solve(across.T @ x)
        return np.asarray(own @ x - followed)

    n = own.shape[0]
    if n <= DENSE:
        from scipy.linalg import eigh

        held = np.stack([reduced(x) for x in np.eye(n)])
        return float(1.0 / eigh(held, capacitance.toarray(), eigvals_only=True, subset_by_index=[n - 1, n - 1])[0])
    charge = symmetric_factors(capacitance)
    try:
        rate = eigsh(
            LinearOperator((n, n), matvec=reduced, dtype=np.float64),
            1,
            M=capacitance,
            Minv=LinearOperator((n, n), matvec=lambda b: charge.solve(np.ravel(b)), dtype=np.float64),
            which="LA",
            v0=np.random.default_rng(0).uniform(0.5, 1.5, n),
            tol=_FASTEST_RTOL,
            return_eigenvectors=False,
        )
    except ArpackError as error:
        raise AccuracyError(f"the fastest time constant did not converge: {error}") from error
    return float(1.0 / rate[0])
