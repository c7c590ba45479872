"""What every method of solving makes of a nodal system: something to solve with, many times."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.nodal.scaled import Scaled
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch
from resgrid.space import Cell

if TYPE_CHECKING:
    from resgrid.nodal.update.change import Change


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

    @property
    def change(self) -> Change | None:
        """What updates have changed since the netlist was compiled; its ``reason`` says why not all could be kept."""
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

    def update(self, cells: ArrayLike, to: int = Cell.OBSTACLE) -> Factor:
        """Factor the circuit again after free cells have become obstacles, or goals.

        Rows keep their numbers; those of changed cells are pinned at their rail.  Multigrid patches its first level
        and keeps the coarse ones, where few cells change and the circuit stays in one piece; otherwise, and by the
        other methods, everything is made anew, and ``change.reason`` says why.  The new right-hand side is
        ``system.feed + system.injected`` of the new factor, whose netlist is still the one before.
        """
        ...
