"""Square roots of Laplacians, and solutions that weak ties do not spoil.

A Laplacian is ``F^T F``, where ``F`` has a row for every element: the root of its conductance (or capacitance) times
the difference of its two voltages.  Differences come first there, so that what ties a stiffly joined island to a rail
is never rounded away in a summed diagonal.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import AccuracyError
from resgrid.nodal.dynamics import Laplacian
from resgrid.nodal.factors.factor import Factor
from resgrid.nodal.scaled import BITS
from resgrid.nodal.watch import Watch

Floats = NDArray[np.float64]
Solver = Callable[[Floats], Floats]

_RTOL = 1e-11
_SPOILT = 1e-9
"""Relative difference of two solutions from which rounding of the diagonal, or of pivots, is felt."""

_PROVED = 1e-3
"""Bound on the relative error of delays, a pessimistic one, above which they are refused."""

_ENTRYWISE = 1e-10
"""Componentwise backward error above which a solution is refused."""


def laplacian_root(laplacian: Laplacian) -> sparse.csr_array:
    """The root of a Laplacian, an element a row.  Returns (m, n)."""
    incidence, value = laplacian.elements
    return sparse.csr_array(sparse.diags_array(np.sqrt(value)) @ incidence)


def accurate_solver(factors: Factor, capacitance: Laplacian) -> Solver:
    """How to solve with a factor without loss.

    Elmore delays, the solution for all capacitances, are dominated by the slowest parts, which are also what rounding
    spoils first.  Where those of the plain solution differ from those found entry by entry, every solution is found
    entry by entry.
    """

    def plain(b: Floats) -> Floats:
        return factors.solve(np.ravel(b), rtol=_RTOL)

    charge, watch = capacitance.diagonal, Watch()
    charge = np.where(charge > 0.0, charge, charge[charge > 0.0].min(initial=np.inf))
    delay = entrywise_solution(factors, charge, watch)
    if not watch.bound <= _PROVED:
        raise AccuracyError(
            "the conductances span too many decades to tell how slowly weakly tied parts settle; join the nodes that "
            "very large ones connect, or leave very small ones out"
        )
    try:
        spoilt = np.abs(plain(charge) - delay).max(initial=0.0) > _SPOILT * delay.max(initial=0.0)
    except AccuracyError:
        spoilt = True
    return partial(entrywise_solution, factors) if spoilt else plain


def entrywise_solution(factors: Factor, b: Floats, watch: Watch | None = None) -> Floats:
    """Solve for positive and for negative currents apart, each right entry by entry, and subtract.

    Shapes: `b` (n,); returns (n,).
    """
    x, low = np.zeros(len(b)), np.zeros(len(b))
    for sign in (1.0, -1.0):
        currents = np.maximum(sign * b, 0.0)
        if not currents.any():
            continue
        part, error = factors.solve_nonnegative(currents, watch=watch)
        if not error <= _ENTRYWISE:
            raise AccuracyError(
                f"voltages are right to a componentwise backward error of {error:.1e} only: the conductances span too "
                "many decades, or lie beyond what is reckoned with; join the nodes that very large ones connect"
            )
        power = BITS * part.exponent
        x += sign * np.ldexp(part.hi, power)
        low += sign * np.ldexp(part.lo, power)
    x += low
    if not np.isfinite(x).all():
        raise AccuracyError("voltages are beyond what doubles hold; give sources in smaller numbers")
    return x
