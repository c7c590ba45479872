"""What every method of solving makes of a nodal system: something to solve with, many times."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.scaled import Scaled
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch


class Factor(Protocol):
    """A nodal system made ready for many right-hand sides."""

    @property
    def system(self) -> NodalSystem:
        """The system."""
        ...

    @property
    def name(self) -> str:
        """The method."""
        ...

    def solve(
        self,
        rhs: NDArray[np.float64],
        *,
        rtol: float = 1e-10,
        guess: NDArray[np.float64] | None = None,
        watch: Watch | None = None,
    ) -> NDArray[np.float64]:
        """Solve to a normwise backward error ``rtol``: currents in amperes to voltages in volts, shape (n,).

        An iteration begins with the ``guess``, and then also ends where it estimates the error of every voltage to be
        at most ``rtol`` of the largest one; the direct method needs no guess.
        """
        ...

    def solve_nonnegative(
        self, rhs: NDArray[np.float64] | Scaled, *, watch: Watch | None = None
    ) -> tuple[Scaled, float]:
        """Solve for currents of one sign, entry by entry; returns voltages and their componentwise backward error."""
        ...
