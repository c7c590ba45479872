"""The direct method: supernodal factors, substitution in scaled numbers, refinement in double-double.

Factors are made in positive numbers alone (`resgrid.solvers.supernodal`), and substitution keeps an exponent beside
every number, for a potential that falls below 1e-308.  The answer is refined with residuals in which differences come
first, until the violations of KCL, summed, prove every entry right, or in small circuits until KCL holds to the
rounding of the voltages (`resgrid.solvers.refine`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.extended import Scaled
from resgrid.solvers.factors.factor import Factor, Residual, refine_normwise
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import Numbers, refine
from resgrid.solvers.supernodal import SupernodalFactors, Symbolic, factor_supernodes

REFINED = 1e-28
"""Componentwise backward error that is enough where no current flows: the noise of double-double arithmetic."""

EXACT_ROWS = 20_000
"""Rows up to which it is reached everywhere: their answers are the nearest doubles, on every machine the same."""

_ROUNDINGS = 16.0 * np.finfo(np.float64).eps
"""Share of itself by which factors and substitution in positive numbers put an entry off for every row, at most."""

_LEAST_SHARE = 1e-150
"""Entry of ``-L`` from which products of two are no subnormal numbers."""


@dataclass(frozen=True, eq=False)
class DirectFactor(Factor):
    """A matrix and its factors ``L D L^T``.

    `laplacian`: as of every `Factor`; `plain`: residuals of normwise answers, where many will be asked for.
    """

    factors: SupernodalFactors
    plain: Residual | None = None
    name = "direct"

    def _solve(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> NDArray[np.float64]:
        del guess
        matrix = self.plain or Residual.of(self.laplacian)
        x, error = refine_normwise(matrix, rhs, self.factors.solve, self.factors.solve(rhs), rtol)
        return self._judged(x, error, rtol, watch)

    def _solve_nonnegative(self, rhs: NDArray[np.float64] | Scaled, watch: Watch | None) -> tuple[Scaled, float]:
        exact = self.laplacian.size <= EXACT_ROWS
        sure = self._certainty() if exact else np.inf
        found = refine(self.laplacian, rhs, self._substitute, REFINED, exact=exact, sure=sure)
        if watch is not None:
            watch.done(found.error, found.bound)
        return found.solution, found.error

    def _certainty(self) -> float:
        """Share of itself by which substitution puts an entry off, at most; infinite where shares may underflow."""
        values = self.factors.values
        least = values.min(initial=1.0, where=values > 0.0)
        return _ROUNDINGS * self.laplacian.size if least > _LEAST_SHARE else np.inf

    def _substitute(self, m: NDArray[np.float64], e: NDArray[np.int64], accuracy: float) -> Numbers:
        """Both substitutions, in scaled numbers, as accurate as the factors are."""
        del accuracy
        return self.factors.substitute(m, e)


def factor_direct(laplacian: Laplacian, order: Symbolic | None = None, plain: Residual | None = None) -> DirectFactor:
    """Factor a matrix, in an order that has been found or in the one that suits it."""
    laplacian = laplacian.with_rows()
    return DirectFactor(laplacian, factor_supernodes(laplacian, order), plain)
