"""Modal response: the approach to the operating point as a sum of exponentials, without time steps.

The deviation ``y`` from the operating point obeys ``C y' = -G y``.  Circuits of at most 200 unknown voltages use all
their modes (`resgrid.chip.time_constants`).  Larger circuits use one sum of exponentials for each window (interval of
times).  It comes from Lanczos iteration on ``(G + s C)^-1 C``, started from the deviation, with ``1/s`` a hundredth of
the end of the window (shift and invert; van den Eshof & Hochbruck 2006).  The number of vectors does not depend on the
spread of the time constants, because the method amounts to a rational approximation of ``exp(-t x)`` for all positive
``x``.  Vectors are orthonormal in the inner product of ``C``, in which every deviation shrinks.  They are stored as ``F
v``, with ``C = F^T F``, which does not involve nodes without capacitance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.chip.time_constants import LinearMap, Modes, accurate_solver, laplacian_root
from resgrid.circuit.dynamics import Dynamics, factor_resolvent
from resgrid.errors import AccuracyError

Floats = NDArray[np.float64]

SPAN = 256.0
"""Ratio of the last to the first time of a window that one sum of exponentials covers."""

_SHIFT = 100.0
"""Shift ``s`` of the resolvent ``(G + s C)^-1``, as a multiple of the reciprocal of the last time of the window."""

_BLOCK = 8
"""Number of Lanczos steps between two tests of convergence."""
_MOST_VECTORS = 400
"""Maximum number of Lanczos vectors for one window of times; if they do not suffice, AccuracyError is raised."""
_COMPLETE = 1e-13
"""Norm of a new Lanczos vector after orthogonalization, relative to its norm before, below which the Krylov space
contains the whole motion."""

_INSTANT = 1e-14
"""Size of a Ritz value (approximate eigenvalue), as a fraction of the largest, below which it counts as a rounding
error and is left out.
"""

_PROBES = 9
"""Number of times within a window of times at which the convergence of the Lanczos iteration is tested.

The first time of the window is tested in addition.
"""


@dataclass(frozen=True, eq=False)
class ExponentialSum:
    """A sum of exponentials: ``y(t) = shape @ (weight * exp(-rate t))``.

    `shape` (n, m): deviations of the n unknown voltages in each of m exponentials; `rate` (m,): decay rates, in 1/s;
    `weight` (m,): coefficients.  The product of `shape` and `weight` has the unit of ``y``.
    """

    shape: Floats
    rate: Floats
    weight: Floats

    def at(self, times: Floats) -> Floats:
        """Return the deviations ``y`` from the final voltages at `times` (t,) in seconds, shape (t, n)."""
        return np.asarray((self.weight * np.exp(-np.multiply.outer(times, self.rate))) @ self.shape.T)


def motions(
    dynamics: Dynamics, modes: Modes, deviation: Floats, accuracy: float, method: str = "auto"
) -> Callable[[float, float], ExponentialSum]:
    """Return a function from the first and the last time of a window, in seconds, to the exponentials in between.

    `dynamics`: circuit equations; `modes`: some or all modes of the circuit; `deviation` (n,): voltages at time 0 minus
    their final values; `accuracy`: largest error of a computed deviation, in the unit of `deviation`; `method`: linear
    solver, a method of `resgrid.solve`.
    """
    root = laplacian_root(dynamics.capacitance)
    if modes.whole:
        whole = ExponentialSum(modes.shape, 1.0 / modes.tau, (root @ modes.shape).T @ (root @ deviation))
        return lambda *_: whole

    def window(first: float, last: float) -> ExponentialSum:
        rate = _SHIFT / last
        solve = accurate_solver(factor_resolvent(dynamics, rate, method), dynamics.capacitance)
        begin = first if first > 0.0 else last / SPAN
        times = np.append(first, np.geomspace(begin, last, _PROBES))
        return _krylov(root, lambda x: solve(root.T @ x), rate, deviation, accuracy, times)

    return window


def _krylov(
    root: sparse.csr_array, solve: LinearMap, shift: float, deviation: Floats, accuracy: float, times: Floats
) -> ExponentialSum:
    """Return the motion at some times as a sum of at most 400 exponentials, by Lanczos iteration.

    `root` (m, n): ``F``, with ``C = F^T F``; `solve`: function that multiplies a vector by ``(G + shift C)^-1 F^T``;
    `shift`: in 1/s; `deviation` (n,): voltages at time 0 minus their final values; `accuracy`: largest error of a
    deviation at `times`, in the unit of `deviation`; `times` (t,): in seconds.
    """
    u = root @ deviation
    length = float(np.linalg.norm(u))
    if length == 0.0:
        return ExponentialSum(np.zeros((len(deviation), 1)), np.ones(1), np.zeros(1))
    size = min(_MOST_VECTORS, len(u))
    W, U = np.empty((size, len(deviation))), np.empty((size, len(u)))
    T = np.zeros((size, size))
    U[0] = u / length
    before: Floats | None = None
    for last in range(size):
        W[last] = solve(U[last])
        u = root @ W[last]
        scale = float(np.linalg.norm(u))
        T[: last + 1, last] = T[last, : last + 1] = U[: last + 1] @ u
        for _ in range(2):  # the second pass removes rounding errors of the first
            u -= (U[: last + 1] @ u) @ U[: last + 1]
        left = float(np.linalg.norm(u))
        complete = left <= _COMPLETE * scale or last + 1 == len(u)
        if complete or last % _BLOCK == _BLOCK - 1:
            motion = _reduced(W[: last + 1], T[: last + 1, : last + 1], length, shift)
            now = motion.at(times)
            if complete or (before is not None and np.abs(now - before).max() <= accuracy):
                return motion
            before = now
        if last + 1 < size:
            U[last + 1] = u / left
    raise AccuracyError(
        f"{size} exponentials do not describe the motion from {times[0]:.2g} s to {times[-1]:.2g} s; compute it by "
        "resgrid.circuit.transient"
    )


def _reduced(W: Floats, T: Floats, length: float, shift: float) -> ExponentialSum:
    """Return the motion as a sum of exponentials, from the Ritz pairs of the Lanczos matrix (Nour-Omid et al. 1987).

    The vectors are valid for nodes without capacitance, too.  `W` (k, n): ``(G + shift C)^-1 F^T v`` of every
    Lanczos vector ``v``, with ``C = F^T F``; `T` (k, k): Lanczos matrix; `length`: norm of ``F`` times the initial
    deviation; `shift`: shift of the resolvent, in 1/s.
    """
    value, S = np.linalg.eigh(T)
    keep = value > _INSTANT * value[-1]
    value, S = value[keep], S[:, keep]
    return ExponentialSum(W.T @ (S / value), np.maximum(1.0 / value - shift, 0.0), length * S[0])
