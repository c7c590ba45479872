"""The direct method: sparse factors, substitution in scaled numbers, refinement in double-double.

Narrow circuits are factored along their corridors, in positive numbers alone (`resgrid.solvers.narrow`).  All others
are SuperLU's: with diagonal pivots it gives ``A = L D L^T`` up to rounding.  Its own substitution underflows where a
potential falls below 1e-308, and its pivots, formed by subtraction, cost up to eight digits on a large grid.  So both
substitutions are done again in scaled numbers, and the answer is refined with residuals in which differences come
first, until the violations of KCL, summed, prove every entry right, or in small circuits until KCL holds to the
rounding of the voltages (`resgrid.solvers.refine`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.extended import Scaled, power
from resgrid.solvers.factors.factor import Factor, refine_normwise
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.narrow.panels import NarrowFactors, factor_narrow, narrow_order
from resgrid.solvers.refine import Numbers, refine
from resgrid.solvers.superlu import SparseFactors

REFINED = 1e-28
"""Componentwise backward error that is enough where no current flows: the noise of double-double arithmetic."""

EXACT_ROWS = 20_000
"""Rows up to which it is reached everywhere: their answers are the nearest doubles, on every machine the same."""


@dataclass(frozen=True, eq=False)
class DirectFactor(Factor):
    """A matrix and its factors ``L D L^T``.

    `laplacian`: as of every `Factor`.
    """

    factors: NarrowFactors | SparseFactors
    name = "direct"

    def _solve(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> NDArray[np.float64]:
        del guess
        x, error = refine_normwise(self.laplacian, rhs, self._plain, self._plain(rhs), rtol)
        return self._judged(x, error, rtol, watch)

    def _solve_nonnegative(self, rhs: NDArray[np.float64] | Scaled, watch: Watch | None) -> tuple[Scaled, float]:
        exact = self.laplacian.size <= EXACT_ROWS
        found = refine(self.laplacian, rhs, self._substitute, REFINED, exact=exact)
        if watch is not None:
            watch.done(found.error, found.bound)
        return found.solution, found.error

    def _plain(self, rhs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Both substitutions, from doubles to doubles."""
        if isinstance(self.factors, SparseFactors):
            return self.factors.doubles(rhs)
        m, e = self.factors.substitute(rhs, np.zeros(len(rhs), dtype=np.int64))
        return m * power(e)

    def _substitute(self, m: NDArray[np.float64], e: NDArray[np.int64], accuracy: float) -> Numbers:
        """Both substitutions, in scaled numbers, as accurate as the factors are."""
        del accuracy
        return self.factors.substitute(m, e if e.size else np.zeros(len(m), dtype=np.int64))


def factor_direct(laplacian: Laplacian) -> DirectFactor:
    """Factor a nodal laplacian."""
    narrow = narrow_order(laplacian)
    if narrow is not None:
        return DirectFactor(laplacian, factor_narrow(narrow))
    return DirectFactor(laplacian, SparseFactors.of(laplacian.matrix))
