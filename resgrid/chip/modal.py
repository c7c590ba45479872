"""All modes of a small circuit, each to its own accuracy, however far apart the time constants are.

With ``G = B^T B`` and ``C = F^T F`` (`resgrid.chip.roots`) time constants are generalised singular values.  Neither
product is formed: rows sorted by size and columns pivoted, Householder's method is as accurate row by row as the data
(Cox & Higham 1998), and so is Jacobi's method for matrices that only scaling makes ill-conditioned (Drmac & Veselic
2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.roots import Solver, laplacian_root
from resgrid.errors import AccuracyError
from resgrid.nodal.dynamics import Dynamics, charge_basis

Floats = NDArray[np.float64]

_AGREED = 1e-8
"""Relative difference of delays from which modes are refused."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Every mode of a circuit.

    `tau` (k,): time constants, slowest first, in seconds; `shape` (n, k): ``shape.T @ C @ shape`` is the identity.
    """

    tau: Floats
    shape: Floats


def all_modes(dynamics: Dynamics) -> Modes:
    """Find every mode by dense algebra."""
    from scipy.linalg import solve_triangular
    from scipy.linalg.lapack import dgejsv

    basis = charge_basis(dynamics)
    charged = np.flatnonzero(basis.charged)
    B, F = laplacian_root(dynamics.conductance), laplacian_root(dynamics.capacitance)
    own, follow = _eliminated(B[:, charged].toarray(), (B @ basis.spread).toarray())
    R, order = _triangle(F[:, charged].toarray())
    X = solve_triangular(R, own[:, order].T, trans="T").T
    unit = 2.0 ** np.floor(np.log2(np.abs(X).max()))
    value, _, V, work, _, info = dgejsv(X / unit, joba=2, jobu=3, jobv=0, jobr=0, jobp=0)
    with np.errstate(all="ignore"):
        tau = (1.0 / (value * (work[0] / work[1]) * unit))[::-1] ** 2
    if info or not (np.isfinite(tau).all() and (tau > 0).all()):
        raise AccuracyError("the time constants span more decades than doubles hold; leave the smallest elements out")
    V = V[:, ::-1]
    y = np.empty_like(V)
    y[order] = solve_triangular(R, V)
    shape = basis.spread @ (follow @ y)
    shape[charged] += y
    return Modes(tau, shape)


def check_modes(dynamics: Dynamics, modes: Modes, solve: Solver) -> None:
    """Refuse modes that do not add up to ``G^-1`` of some charges.

    Rounding decides the slowest one where loops of very large conductances are tied very weakly.
    """
    F = laplacian_root(dynamics.capacitance)
    charge = F.T @ np.linspace(1.0, 2.0, F.shape[0])
    delay = solve(charge)
    summed = modes.shape @ (modes.tau * (modes.shape.T @ charge))
    if not np.abs(summed - delay).max() <= _AGREED * np.abs(delay).max():
        raise AccuracyError(
            "the conductances span too many decades to tell the slowest time constant; join the nodes that very large "
            "ones connect, or leave very small ones out"
        )


def _eliminated(own: Floats, loose: Floats) -> tuple[Floats, Floats]:
    """What is left of ``|own y + loose z|`` at the best ``z``, as a matrix of ``y``, and that ``z = follow @ y``."""
    from scipy.linalg import qr, solve_triangular
    from scipy.linalg.lapack import dormqr

    count = loose.shape[1]
    if not count:
        return own, np.zeros((0, own.shape[1]))
    rows = np.argsort(-np.abs(loose).max(axis=1), kind="stable")
    (reflectors, scale), R, order = qr(loose[rows], mode="raw", pivoting=True)
    turned, _, _ = dormqr("L", "T", reflectors, scale, own[rows], 64 * max(own.shape))
    follow = np.empty((count, own.shape[1]))
    follow[order] = -solve_triangular(R[:count], turned[:count])
    return turned[count:], follow


def _triangle(matrix: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """``R`` and the order of columns with ``R^T R`` equal to ``M^T M`` in that order."""
    from scipy.linalg import qr

    rows = np.argsort(-np.abs(matrix).max(axis=1), kind="stable")
    R, order = qr(matrix[rows], mode="r", pivoting=True)
    return np.asarray(R[: matrix.shape[1]], dtype=np.float64), np.asarray(order, dtype=np.int64)
