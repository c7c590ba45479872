"""Many chips of any circuit: conjugate gradients, preconditioned by the factors of the nominal one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.nodal.batch.boards import check_residual
from resgrid.nodal.batch.pattern import Pattern

_MOST_ITERATIONS = 200
_ROUNDING = 2.0**-52


@dataclass(frozen=True, eq=False)
class FactoredBatch:
    """A circuit made ready for other conductances.

    Attributes
    ----------
    pattern : Pattern
    start : ndarray of float64, shape (n,)
        Where the iteration begins, in volts.
    """

    pattern: Pattern
    start: NDArray[np.float64]
    name = "direct"

    def solve(self, conductance: NDArray[np.float64], rtol: float) -> NDArray[np.float64]:
        """Voltages of the rows for every chip; as `resgrid.nodal.batch.boards.BoardBatch.solve`."""
        factors = self._factors
        coupling = self.pattern.system.coupling
        solution = np.empty((len(conductance), self.pattern.system.size))
        for x, chip in zip(solution, conductance, strict=True):
            entries, excess, b = self.pattern.rows(chip)
            other = sparse.csr_array((entries, coupling.indices, coupling.indptr), shape=coupling.shape)
            x[:] = self.start
            _iterate(other, other.sum(axis=1) + excess, b, factors, rtol, x)
        return solution

    @cached_property
    def _factors(self) -> Any:
        return _factors(self.pattern)

    def __getstate__(self) -> dict[str, Any]:
        """Without factors, which no process can hand to another."""
        return {"pattern": self.pattern, "start": self.start}


def factored_batch(pattern: Pattern) -> FactoredBatch:
    """Factor the nominal circuit."""
    return FactoredBatch(pattern, np.asarray(_factors(pattern).solve(pattern.system.drive)))


def _factors(pattern: Pattern) -> Any:
    from resgrid.nodal.superlu import symmetric_factors

    return symmetric_factors(pattern.system.matrix)


def _iterate(
    coupling: sparse.csr_array,
    degree: NDArray[np.float64],
    b: NDArray[np.float64],
    factors: Any,
    rtol: float,
    x: NDArray[np.float64],
) -> None:
    """Conjugate gradients in place, started anew from the true residual once the recursive one is small."""
    largest, size = float(degree.max(initial=0.0)), float(np.linalg.norm(b))
    left, last = _MOST_ITERATIONS, np.inf
    while True:
        r = b - (degree * x - coupling @ x)
        norm = float(np.linalg.norm(r))
        goal = max(rtol * size, _ROUNDING * largest * float(np.linalg.norm(x)))
        if not (norm > goal and norm < 0.5 * last and left > 0):
            check_residual(norm, largest, x, b, rtol)
            return
        last = norm
        p, rz = np.zeros_like(r), np.inf
        while np.linalg.norm(r) > 0.8 * goal and left > 0:
            z = factors.solve(r)
            before, rz = rz, float(r @ z)
            p = z + (rz / before) * p
            q = degree * p - coupling @ p
            step = rz / float(p @ q)
            x += step * p
            r -= step * q
            left -= 1
