"""What every method of solving makes of a nodal system: something to solve with, many times."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.scaled import Scaled
from resgrid.nodal.system import NodalSystem


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

    def solve(self, rhs: NDArray[np.float64], *, rtol: float = 1e-10) -> NDArray[np.float64]:
        """Solve to a normwise backward error ``rtol``: currents in amperes to voltages in volts, shape (n,)."""
        ...

    def solve_nonnegative(self, rhs: NDArray[np.float64] | Scaled) -> tuple[Scaled, float]:
        """Solve for currents of one sign, entry by entry; returns voltages and their componentwise backward error."""
        ...
