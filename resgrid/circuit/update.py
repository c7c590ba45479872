"""Circuits of a space that changes, each solved from the one before.

What a change of cells does to the equations is found in a window around it, by the compiler's rules
(`resgrid.compiler`), so that neither a netlist nor its equations are made before somebody asks for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations, assemble
from resgrid.circuit.linear import factor_circuit, solve_linear
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.readout import read_normwise
from resgrid.circuit.window import boxes_around, rows_after, window_of
from resgrid.compiler import compile_space
from resgrid.errors import AccuracyError, InputError
from resgrid.netlist import Netlist
from resgrid.solvers.factors.factor import check_rtol
from resgrid.solvers.monitor import Progress, Watch
from resgrid.solvers.warm import WarmGrid
from resgrid.space import Cell, ConfigurationSpace
from resgrid.wiring import Wiring, wiring_of

_SMALL = 100_000
"""Cells below which iterations cost less than what windows spare of them."""

_WORN = 2
"""Iterations of a warm start beyond those of the first solution after which levels are made anew."""


@dataclass(frozen=True, eq=False)
class WarmPoint:
    """What a warm start found for a space: its voltages cell by cell.

    Attributes
    ----------
    space : ConfigurationSpace
        The space that was solved.
    wiring : Wiring
        How it is wired.
    voltage : ndarray of float64, shape of the space
        Voltage of every cell that is solved for, in volts; NaN elsewhere.
    fresh : bool
        Whether levels were made anew and nothing was carried over.
    iterations : int
        Steps of the iterative method.
    backward_error : float
        Normwise.
    """

    space: ConfigurationSpace
    wiring: Wiring
    voltage: NDArray[np.float64]
    fresh: bool
    iterations: int
    backward_error: float

    @property
    def netlist(self) -> Netlist:
        """The circuit, compiled whenever it is asked for."""
        return compile_space(self.space, self.wiring)

    def operating_point(self, accuracy: str = "normwise") -> OperatingPoint:
        """Read the operating point of the whole circuit.

        Parameters
        ----------
        accuracy : {"normwise", "direction"}
            ``"direction"`` solves the circuit once more, entry by entry, as `resgrid.solve` does.

        Returns
        -------
        OperatingPoint
        """
        netlist = self.netlist
        if accuracy != "normwise":
            return solve_linear(netlist, accuracy=accuracy, method="auto", rtol=1e-10)
        system = assemble(netlist)
        x = np.empty(system.size)
        node = netlist.cells.node
        row = np.where(node >= 0, system.unknown[node], -1)
        x[row[row >= 0]] = self.voltage[row >= 0] - system.reference
        told = {"iterations": self.iterations, "backward_error": self.backward_error}
        return read_normwise(system, x, method="multigrid", seconds={}, **told)


class WarmStart:
    """Solves circuits of a space that changes, each from the one before: its levels, its voltages.

    Where few cells have changed (obstacles set or freed, goals added, moved or taken away, conductivities), the finest
    level's equations are written over around them, the coarser levels are kept, and the iteration begins with the
    voltages there were, solved anew around the change.  Where many have, or parts of the circuit are joined or cut
    off, or the old levels do not serve, it starts afresh (`WarmPoint.fresh` tells).

    Parameters
    ----------
    wiring : Wiring, optional
        As for `resgrid.compile_space`.
    rtol : float
        Normwise backward error of all solutions.
    **options
        Fields of `Wiring`, instead of one or changes to it.

    Examples
    --------
    >>> cell = np.zeros((40, 40), dtype=np.uint8)
    >>> cell[20, 20] = rg.Cell.GOAL
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 1.0, 40), rg.Axis("y", 0.0, 1.0, 40)], cell)
    >>> warm = rg.WarmStart(boundary="neumann")
    >>> first = warm.solve(space)
    >>> cell[22, 18:23] = rg.Cell.OBSTACLE
    >>> warm.solve(space.with_cells(cell)).fresh
    False
    """

    def __init__(self, wiring: Wiring | None = None, *, rtol: float = 1e-8, **options: Any) -> None:
        check_rtol(rtol)
        if not (wiring is None or isinstance(wiring, Wiring)):
            raise InputError(f"wiring = {wiring!r} must be a Wiring (rg.Wiring(...)), or None")
        self.wiring, self.rtol = wiring_of(wiring, options), rtol
        if self.wiring.rails != "merged":
            raise InputError("a warm start needs rails = 'merged': with rails = 'cells', use resgrid.solve")
        self._state: _State | None = None

    def solve(self, space: ConfigurationSpace, *, progress: Progress | None = None) -> WarmPoint:
        """Solve the circuit of a space, from the last one on where few cells are others.

        Parameters
        ----------
        space : ConfigurationSpace
        progress : callable, optional
            As for `resgrid.solve`.

        Returns
        -------
        WarmPoint

        Raises
        ------
        InputError, CircuitError, BudgetError
            As `resgrid.compile_space` and `resgrid.solve`.
        AccuracyError
            If the backward error is not reached.
        """
        if not isinstance(space, ConfigurationSpace):
            raise InputError(f"space = {space!r} must be a ConfigurationSpace (rg.sample(scene))")
        watch, state, self._state = Watch(progress), self._state, None
        wiring = self.wiring.on(space)
        fresh = state is None or not state.takes(space)
        if fresh:
            system = assemble(compile_space(space, replace(wiring, supply=1.0, goal_voltage=0.0)))
            state = _State.of(system, space, wiring)
            if state is None:
                voltage = _solved_plainly(system, wiring, self.rtol, watch)
                return WarmPoint(space, wiring, voltage, True, watch.iterations, watch.error)
        assert state is not None
        try:
            voltage = state.solve(self.rtol, watch)
        except AccuracyError:
            if fresh:
                raise
            return self.solve(space, progress=progress)
        self._state = None if state.worn else state
        return WarmPoint(space, wiring, voltage, fresh, watch.iterations, watch.error)


def _solved_plainly(system: Equations, wiring: Wiring, rtol: float, watch: Watch) -> NDArray[np.float64]:
    """Voltages of all cells with rows, from nothing; NaN elsewhere."""
    x = factor_circuit(system).solve(system.drive, rtol=rtol, watch=watch) if system.size else np.zeros(0)
    node = system.netlist.cells.node
    row = np.where((node >= 0), system.unknown[node], -1)
    return np.where(row >= 0, wiring.goal_voltage + wiring.supply * np.append(x, np.nan)[row], np.nan)


class _State:
    """A circuit with its rails at 0 and 1 V, and the space it was compiled from.

    `row`: cells with rows, of the space's shape; `drive`: current into every row, in amperes, where it is the same.
    """

    def __init__(
        self, space: ConfigurationSpace, wiring: Wiring, row: NDArray[np.bool_], drive: float, grid: WarmGrid
    ) -> None:
        self.space, self.wiring, self.worn = space, wiring, False
        self._row, self._drive, self._grid = row, drive, grid
        self._first_rows = self._rows = int(np.count_nonzero(row))
        self._most = 0

    @classmethod
    def of(cls, system: Equations, space: ConfigurationSpace, wiring: Wiring) -> _State | None:
        """Lay the levels of a space's equations out; None where these are no grid of two colours."""
        node = system.netlist.cells.node
        row = (node >= 0) & (space.cell == Cell.FREE)
        row[row] = system.unknown[node[row]] >= 0
        flat = wiring.drive == "uniform"
        grid = WarmGrid.of(system.laplacian, system.drive, flat) if system.size == np.count_nonzero(row) > 0 else None
        return None if grid is None else cls(space, wiring, row, float(system.drive[0]) if flat else 0.0, grid)

    def takes(self, space: ConfigurationSpace) -> bool:
        """Take over what has changed since; False, of no use any more, where that is no gain or asks for a search."""
        old, self.space = self.space, space
        if space.axes != old.axes or (space.conductivity is None) != (old.conductivity is None):
            return False
        changed = space.cell != old.cell
        if space.conductivity is not None and space.conductivity is not old.conductivity:
            changed |= space.conductivity != old.conductivity
        if not changed.any():
            return True
        boxes = boxes_around(space, np.argwhere(changed))
        if boxes is None or not all(self._grid.covers(box) for box, _ in boxes):
            return False
        goals = np.count_nonzero(space.cell == Cell.GOAL)
        windows = []
        for box, near in boxes:
            before = self._row[box]
            after = rows_after(old, space, self.wiring, box, before)
            if after is None:
                return False
            window = window_of(space, self.wiring, box, near, after, self._drive)
            if window is None:
                return False
            self._rows += int(np.count_nonzero(after) - np.count_nonzero(before))
            self._row[box] = after
            windows.append(window)
        for window in windows:
            alone = len(windows) == 1 and np.count_nonzero(space.cell[window.box] == Cell.GOAL) == goals
            self._grid.change(window, solve=self._row.size >= _SMALL, follow=alone)
        return True

    def solve(self, rtol: float, watch: Watch) -> NDArray[np.float64]:
        """Voltages of all cells with rows; NaN elsewhere."""
        self._grid.solve(rtol, watch)
        self._most = self._most or watch.iterations + _WORN
        self.worn = watch.iterations > self._most
        wiring = self.wiring
        voltage = self._grid.values(self.space.shape)
        voltage *= wiring.supply * (self._first_rows / self._rows if wiring.drive == "uniform" else 1.0)
        if wiring.goal_voltage:
            voltage += wiring.goal_voltage
        voltage[~self._row] = np.nan
        return voltage
