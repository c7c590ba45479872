"""What every method of solving makes of a nodal system: something to solve with, many times."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.nodal.scaled import Scaled
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch
from resgrid.space import Cell

if TYPE_CHECKING:
    from resgrid.nodal.multigrid.hierarchy import Hierarchy
    from resgrid.nodal.update.change import Change


@dataclass(frozen=True, eq=False)
class Factor(ABC):
    """A nodal system made ready for many right-hand sides.

    Attributes
    ----------
    system : NodalSystem
        The system.
    change : Change or None
        What updates have changed since the netlist was compiled; its ``reason`` says why not all could be kept.
    """

    system: NodalSystem
    change: Change | None = field(default=None, kw_only=True)

    @property
    @abstractmethod
    def name(self) -> str:
        """The method."""

    @abstractmethod
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

    @abstractmethod
    def solve_nonnegative(
        self, rhs: NDArray[np.float64] | Scaled, *, watch: Watch | None = None
    ) -> tuple[Scaled, float]:
        """Solve for currents of one sign, entry by entry; returns voltages and their componentwise backward error."""

    def update(self, cells: ArrayLike, to: int = Cell.OBSTACLE) -> Factor:
        """Factor the circuit again after free cells have become obstacles, or goals.

        Rows keep their numbers; those of changed cells are pinned at their rail.  Multigrid patches its first level
        and keeps the coarse ones, where few cells change and the circuit stays in one piece; otherwise, and by the
        other methods, everything is made anew, and ``change.reason`` says why.  The new right-hand side is
        ``system.feed + system.injected`` of the new factor, whose netlist is still the one before.

        Parameters
        ----------
        cells : array_like of int, shape (k, ndim)
            Cell indices.
        to : Cell
            ``Cell.OBSTACLE`` or ``Cell.GOAL``.

        Returns
        -------
        Factor
            Of the same rows; its ``change`` says what was done.

        Raises
        ------
        InputError
            If a cell is not free, or the netlist does not come from a space with merged rails.
        CircuitError
            If nothing is driven any more.
        """
        from resgrid.nodal.update.change import change_cells

        system, change = change_cells(self.system, self._board(), self.change, cells, to)
        if system is self.system:
            return replace(self, change=change)
        return self._updated(system, change)

    def _board(self) -> Hierarchy | None:
        """Levels in which the surroundings of cells are looked up, if the first is a board."""
        return None

    @abstractmethod
    def _updated(self, system: NodalSystem, change: Change) -> Factor:
        """The factor of the system changed."""


def factor_anew(make: Callable[[NodalSystem], Factor], system: NodalSystem, change: Change, reason: str) -> Factor:
    """Make a factor of a system that an update has changed, for a reason, unless the change itself is one."""
    factors = make(replace(system, derived=system.coupling, separated=None))
    return replace(factors, change=replace(change, reason=change.reason or reason))
