"""Conjugate gradients preconditioned by multigrid.

From the top: `factor_multigrid` coarsens the circuit into a hierarchy of graphs (`hierarchy`).  `MultigridFactor.solve`
runs flexible conjugate gradients (Notay 2000) in double precision; every step is preconditioned by one cycle in single
precision (`kernels.cycle`): Gauss-Seidel forth on the way down, back on the way up, K-cycles on the coarse levels.
Where the recursive residual has drifted from the true one, the iteration starts again from the true one.
`MultigridFactor.solve_nonnegative` wraps it in refinement (`resgrid.nodal.refine`), each pass of which gains nine
digits of the largest entry: a potential that falls by 45 decades takes five passes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.refine import Numbers, refine
from resgrid.nodal.scaled import Scaled, power
from resgrid.nodal.system import NodalSystem

REFINED = 1e-20
"""Componentwise backward error at which refinement stops."""

_PASS = 1e-9
_MOST_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class MultigridFactor:
    """A nodal system and the hierarchy that preconditions it.

    Attributes
    ----------
    system : NodalSystem
    stack : Stack
        All levels of the hierarchy.
    """

    system: NodalSystem
    stack: Stack
    name = "multigrid"

    def solve(self, rhs: NDArray[np.float64], *, rtol: float = 1e-10) -> NDArray[np.float64]:
        """Solve to a normwise backward error; the residual norm is brought to ``rtol |b|`` where rounding allows.

        Parameters
        ----------
        rhs : ndarray of float64, shape (n,)
            Currents in amperes.
        rtol : float
            Bound on ``|b - A x| / (|A| |x| + |b|)``.

        Returns
        -------
        ndarray of float64, shape (n,)
            Voltages in volts.

        Raises
        ------
        AccuracyError
            If the iteration stagnates above the bound; it carries the best answer.
        """
        x, residual = self._iterate(rhs, rtol)
        degree = 2.0 * float(self.stack.diagonal[: self.system.size].max(initial=0.0))
        error = residual / (degree * float(np.linalg.norm(x)) + float(np.linalg.norm(rhs)) or 1.0)
        if not error <= rtol:
            raise AccuracyError(
                f"multigrid stagnates at a backward error of {error:.1e}, above rtol = {rtol:.1e}; "
                "use method = 'direct', or a larger rtol",
                x,
            )
        return x

    def solve_nonnegative(self, rhs: NDArray[np.float64] | Scaled) -> tuple[Scaled, float]:
        """Solve for a right-hand side without negative entries, entry by entry.

        Parameters
        ----------
        rhs : ndarray of float64 or Scaled, shape (n,)
            Currents in amperes, none negative.

        Returns
        -------
        solution : Scaled, shape (n,)
            Voltages in volts.
        error : float
            Its componentwise backward error.
        """
        return refine(self.system, rhs, self._approximate, REFINED)

    def _approximate(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """Nine digits of ``A^-1`` times scaled numbers, relative to the largest."""
        present = m != 0
        if not present.any():
            return np.zeros_like(m), np.zeros_like(e)
        top = int(e[present].max())
        plain = m * power(np.maximum(e - top, -8))
        largest = float(np.abs(plain).max())
        x, _ = self._iterate(plain / largest, _PASS)
        return x * largest, np.full_like(e, top)

    def _iterate(self, b: NDArray[np.float64], rtol: float) -> tuple[NDArray[np.float64], float]:
        """Flexible conjugate gradients with restarts; returns the answer and the norm of its true residual."""
        from resgrid.nodal.multigrid import kernels

        coupling, excess = self.system.coupling, self.system.excess
        matrix = (coupling.indptr, coupling.indices, coupling.data, excess)
        n = len(b)
        x, r, z = np.zeros(n), b.copy(), np.empty(n, dtype=np.float32)
        size, left = float(np.linalg.norm(b)), _MOST_ITERATIONS
        goal = rtol * size
        while size > goal and left > 0:
            p, s, w = np.zeros(n), np.zeros(n), np.empty(n)
            trial, recursive, energy = x.copy(), size, 0.0
            while recursive > 0.7 * goal and left > 0:
                kernels.apply(self.stack, r, recursive, z)
                zr, zw, zs = kernels.multiply(*matrix, z, r, s, w)
                beta = -zs / energy if energy > 0.0 else 0.0
                energy = zw + beta * zs
                if not energy > 0.0:
                    break
                recursive = float(np.sqrt(kernels.advance(z, w, p, s, trial, r, beta, zr / energy)))
                left -= 1
            true = kernels.subtract_product(*matrix, b, trial, r)
            if not true < 0.5 * size:
                break
            x, size = trial, true
        return x, size


def factor_multigrid(system: NodalSystem) -> MultigridFactor:
    """Build the hierarchy of a nodal system."""
    from resgrid.nodal.multigrid.hierarchy import build_hierarchy

    return MultigridFactor(system, build_hierarchy(system))
