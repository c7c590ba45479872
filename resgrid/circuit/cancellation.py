"""The difference of two solutions that may nearly cancel: refined, with a bound on its error.

Currents of both signs are solved for apart, and either solution is right entry by entry, which says little of their
difference.  But ``A^-1`` has no negative entry: the error is at most ``A^-1 |r|``, with the residual ``r``, and what
``A^-1`` makes of both signs of it corrects the difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.extended import NOISE, Scaled, logarithm
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.laplacian import Laplacian

_CERTAIN = 1e-9
"""Errors relative to the largest value that need no closer look."""

_MOST_CORRECTIONS = 5


def subtract(
    factors: Factor,
    drive: NDArray[np.float64],
    rounding: NDArray[np.float64],
    rising: Scaled,
    falling: Scaled,
    bound: float,
) -> tuple[Scaled, float, float]:
    """Subtract the solutions for the currents of either sign; ``rounding`` is what these may be off by themselves.

    Shapes: `drive, rounding` (n,), `rising, falling` (n,); returns `difference` (n,).
    """
    difference, doubt, parts = _minus(rising, falling), 0.0, [rising, falling]
    if bound * _quotient(parts, difference) > _CERTAIN:
        difference, doubt = _refined(factors, drive, rounding, difference)
        parts = [difference]
    grain = max(NOISE, doubt) * np.exp(max(map(_largest_log, parts)))
    return difference, doubt, float(grain)


def _minus(a: Scaled, b: Scaled) -> Scaled:
    from resgrid.solvers.refine_kernels import correct

    hi, lo, exponent = a.hi.copy(), a.lo.copy(), a.exponent.copy()
    correct(hi, lo, exponent, -b.hi, b.exponent)
    correct(hi, lo, exponent, -b.lo, b.exponent)
    return Scaled(hi, lo, exponent)


def _refined(
    factors: Factor, drive: NDArray[np.float64], rounding: NDArray[np.float64], x: Scaled
) -> tuple[Scaled, float]:
    """Make a difference better; returns what it may be off by at most, relative to its largest entry."""
    best, doubt = x, np.inf
    for _ in range(_MOST_CORRECTIONS):
        rise, fall = (factors.solve_nonnegative(part)[0] for part in _residual(factors.laplacian, drive, rounding, x))
        found = 2.0 * _quotient([rise, fall], x)
        if not found < doubt:
            break
        best, doubt = x, found
        if doubt <= _CERTAIN:
            break
        x = _minus(x, _minus(fall, rise))
    return best, float(doubt)


def _residual(
    laplacian: Laplacian, drive: NDArray[np.float64], rounding: NDArray[np.float64], x: Scaled
) -> tuple[Scaled, Scaled]:
    """The residual's positive part, and what is negative of it; both with what the drive's own rounding may hide."""
    from resgrid.solvers.refine import scaled_currents
    from resgrid.solvers.refine_kernels import correct, exact_residual

    edges, (amps, scale) = laplacian.edges, scaled_currents(drive)
    r, e = np.empty(laplacian.size), np.empty(laplacian.size, dtype=np.int64)
    exact_residual(edges.indptr, edges.indices, edges.data, laplacian.ground, amps, scale, x.hi, x.lo, x.exponent, r, e)
    none = np.zeros_like(e)
    parts = [Scaled(np.maximum(sign * r, 0.0), np.zeros_like(r), np.where(sign * r > 0.0, e, 0)) for sign in (1, -1)]
    for part in parts:
        correct(part.hi, part.lo, part.exponent, rounding, none)
    return parts[0], parts[1]


def _quotient(parts: list[Scaled], x: Scaled) -> float:
    """The largest value of any part relative to that of ``x``; 0 where all parts vanish."""
    largest, most = _largest_log(x), max(_largest_log(part) for part in parts)
    with np.errstate(over="ignore"):
        return 0.0 if most == -np.inf else float(np.exp(most - largest))


def _largest_log(values: Scaled) -> float:
    return float(logarithm(np.abs(values.hi), values.exponent).max(initial=-np.inf))
