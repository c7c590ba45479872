"""A circuit whose equations are made ready for many right-hand sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.circuit.equations import Equations
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.extended import Scaled
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.monitor import Watch


@dataclass(frozen=True, eq=False)
class CircuitFactor:
    """A circuit's equations and the factors of their matrix.

    `system`: which node has which row, and what drives the rows; `factors`: of ``system.laplacian``.
    """

    system: Equations
    factors: Factor

    @property
    def name(self) -> str:
        """The method."""
        return self.factors.name

    def solve(
        self, rhs: ArrayLike, *, rtol: float = 1e-10, guess: ArrayLike | None = None, watch: Watch | None = None
    ) -> NDArray[np.float64]:
        """Solve to a normwise backward error.  Shapes: `rhs` (n,), `guess` (n,); returns (n,)."""
        return self.factors.solve(rhs, rtol=rtol, guess=guess, watch=watch)

    def solve_nonnegative(self, rhs: ArrayLike | Scaled, *, watch: Watch | None = None) -> tuple[Scaled, float]:
        """Solve for a right-hand side without negative entries, entry by entry.  Shapes: `rhs` (n,)."""
        return self.factors.solve_nonnegative(rhs, watch=watch)


def factor_circuit(system: Equations, method: str = "auto") -> CircuitFactor:
    """Factor the matrix of a circuit's equations."""
    return CircuitFactor(system, factor_laplacian(system.laplacian, method))
