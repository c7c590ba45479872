"""The way to the operating point without time steps: Lanczos iteration started from the deviation itself.

The deviation ``y`` from the operating point obeys ``C y' = -G y``.  In the Krylov space of ``G^-1 C`` that starts from
``y(0)``, orthonormal in the inner product of ``G``, the circuit becomes a few exponentials (moments about zero
frequency; Odabasioglu, Celik & Pileggi 1998).  Each vector costs one solution with the same factor.  Slow modes,
which decide when a circuit has settled, come first; modes that are too fast for the space have died out by then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.nodal.dynamics import Dynamics
from resgrid.nodal.factors.factor import Factor

_BLOCK = 8
_MOST_VECTORS = 400
_RTOL = 1e-11
_COMPLETE = 1e-10
"""What is left of a vector, relative to its length, when the space holds the whole motion."""

_INSTANT = 1e-14
"""Time constants, relative to the slowest one, that are nothing but rounding."""

_TIMES = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 64.0])


@dataclass(frozen=True, eq=False)
class Motion:
    """A sum of exponentials: ``y(t) = shape @ (weight * exp(-t / tau))``.

    Attributes
    ----------
    shape : ndarray of float64, shape (n, m)
    tau : ndarray of float64, shape (m,)
        In seconds.
    weight : ndarray of float64, shape (m,)
        In volts.
    """

    shape: NDArray[np.float64]
    tau: NDArray[np.float64]
    weight: NDArray[np.float64]

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Deviations at times in seconds, shape (t, n), in volts."""
        return np.asarray((self.weight * np.exp(-np.divide.outer(times, self.tau))) @ self.shape.T)


def free_motion(
    dynamics: Dynamics, factors: Factor, deviation: NDArray[np.float64], accuracy: float, earliest: float
) -> Motion:
    """Reduce the way to the operating point to a few exponentials.

    Parameters
    ----------
    dynamics : Dynamics
    factors : Factor
        Of ``G``.
    deviation : ndarray of float64, shape (n,)
        ``y(0)``, in volts.
    accuracy : float
        Wanted of every node, in volts; judged by what the last eight vectors changed.
    earliest : float
        From when on it is wanted, in seconds.

    Returns
    -------
    Motion

    Raises
    ------
    AccuracyError
        If 400 vectors are not enough.
    """
    G, C = dynamics.conductance.matrix, dynamics.capacitance.matrix
    length = float(np.sqrt(deviation @ (G @ deviation)))
    if length == 0.0:
        return Motion(np.zeros((len(deviation), 1)), np.ones(1), np.zeros(1))
    times = earliest * _TIMES
    size = min(_MOST_VECTORS, len(deviation))
    V, GV = np.empty((size, len(deviation))), np.empty((size, len(deviation)))
    T = np.zeros((size, size))
    V[0] = deviation / length
    before: NDArray[np.float64] | None = None
    for last in range(size):
        GV[last] = G @ V[last]
        w = factors.solve(C @ V[last], rtol=_RTOL)
        scale = float(np.sqrt(w @ (G @ w)))
        T[: last + 1, last] = T[last, : last + 1] = GV[: last + 1] @ w
        for _ in range(2):  # once more, for what rounding leaves of the first
            w -= (GV[: last + 1] @ w) @ V[: last + 1]
        left = float(np.sqrt(max(w @ (G @ w), 0.0)))
        complete = left <= _COMPLETE * scale or last + 1 == len(deviation)
        if complete or last % _BLOCK == _BLOCK - 1:
            motion = _reduced(V[: last + 1], T[: last + 1, : last + 1], length)
            now = motion.at(times)
            if complete or (before is not None and np.abs(now - before).max() <= accuracy):
                return motion
            before = now
        if last + 1 < size:
            V[last + 1] = w / left
    raise AccuracyError(
        f"{size} exponentials do not tell the motion from {earliest:.2g} s on; follow it by resgrid.transient"
    )


def _reduced(V: NDArray[np.float64], T: NDArray[np.float64], length: float) -> Motion:
    tau, S = np.linalg.eigh(T)
    keep = tau > _INSTANT * tau[-1]
    return Motion((S[:, keep].T @ V).T, tau[keep], length * S[0, keep])
