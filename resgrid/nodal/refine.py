"""Refinement in scaled double-double: from an approximate inverse to an answer that is right entry by entry.

The residual is computed with differences first, relative to each node's own exponent, so that every pass gains the
digits of the approximate inverse wherever it is any good, and goes on until nothing is left to gain.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.scaled import BITS, Scaled
from resgrid.nodal.system import NodalSystem

_MOST_STEPS = 60
_LEAST_GAIN = 0.5


Numbers = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Scaled numbers in single doubles: mantissas and exponents."""


def refine(
    system: NodalSystem,
    rhs: NDArray[np.float64] | Scaled,
    approximate: Callable[[NDArray[np.float64], NDArray[np.int64]], Numbers],
    target: float,
) -> tuple[Scaled, float]:
    """Solve for a right-hand side without negative entries.

    Parameters
    ----------
    system : NodalSystem
    rhs : ndarray of float64 or Scaled, shape (n,)
        Currents in amperes, none negative; of scaled ones ``lo`` is not used.
    approximate : callable
        Takes and returns scaled numbers: about ``A^-1`` times its argument.
    target : float
        Componentwise backward error at which to stop.

    Returns
    -------
    solution : Scaled, shape (n,)
        Voltages in volts.
    error : float
        Its componentwise backward error.
    """
    from resgrid.nodal import kernels

    coupling = system.coupling
    n = system.size
    answer = Scaled.of(np.zeros(n))
    current, scale = scaled_currents(rhs)
    row_error, exponent = current.copy(), scale.copy()
    best, error, size = answer, np.inf, np.inf
    for _ in range(_MOST_STEPS):
        m, e = approximate(row_error, exponent)
        answer = Scaled(answer.hi.copy(), answer.lo.copy(), answer.exponent.copy())
        kernels.correct(answer.hi, answer.lo, answer.exponent, m, e)
        now = kernels.residual(
            coupling.indptr, coupling.indices, coupling.data, system.excess, current, scale,
            answer.hi, answer.lo, answer.exponent, row_error, exponent,
        )  # fmt: skip
        log_size = _log_largest(row_error, exponent)
        if not (now < _LEAST_GAIN * error or log_size < size + np.log(_LEAST_GAIN)):
            break
        best, error, size = answer, now, log_size
        if error <= target:
            break
    return best, float(error)


def _log_largest(m: NDArray[np.float64], e: NDArray[np.int64]) -> float:
    """Logarithm of the largest magnitude."""
    with np.errstate(divide="ignore"):
        return float(np.max(np.log(np.abs(m)) + e * (BITS * np.log(2.0)), initial=-np.inf))


def scaled_currents(rhs: NDArray[np.float64] | Scaled) -> Numbers:
    """Currents as canonical scaled numbers of their own; ``lo`` is left out."""
    from resgrid.nodal.kernels import canonical

    if isinstance(rhs, Scaled):
        current, scale = rhs.hi.copy(), rhs.exponent.copy()
    else:
        current, scale = np.array(rhs, dtype=np.float64), np.zeros(len(rhs), dtype=np.int64)
    canonical(current, scale)
    return current, scale
