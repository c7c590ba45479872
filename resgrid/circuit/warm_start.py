"""Circuits of a space that changes, each solved from the one before.

What a change of cells does to the equations is found in windows around it, by the compiler's rules
(`resgrid.core.compiler`), so that neither a netlist nor its equations are made before somebody asks for them.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations, assemble, sum_by_row
from resgrid.circuit.linear import factor_circuit, solve_linear
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.postprocess import read_normwise
from resgrid.core.compiler import CellRole, compile_space, contacts_of_box
from resgrid.core.netlist import Netlist
from resgrid.core.regions import before_and_behind, label_regions
from resgrid.core.space import Cell, ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, wiring_of
from resgrid.errors import AccuracyError, InputError
from resgrid.solvers.factors import check_rtol
from resgrid.solvers.hierarchy_reuse import WarmGrid
from resgrid.solvers.laplacian import EdgeList, Grid, Laplacian
from resgrid.solvers.progress import Progress, ProgressMonitor

_SMALL = 100_000
"""Cells below which iterations cost less than what windows spare of them."""

_WORN, _STALE = 4, 3
"""Iterations beyond those of the first solution after which levels are made anew for the next one, and how many times
as many tell that old levels do not serve: what their steps say of the error is not to be trusted either."""

_WINDOW = 12_000
"""Cells of a window around a small change that is solved anew, about."""

_MOST = 4
"""Share of the space beyond which windows are no gain."""

_RIM, _NEAR = 3, 2
"""Cells beside a window's cut sides whose equations are not whole, and how far from a change equations change."""


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
        row = np.append(system.unknown, -1)[netlist.cells.node]
        x = np.empty(system.size)
        x[row[row >= 0]] = self.voltage[row >= 0] - system.reference
        told = {"iterations": self.iterations, "backward_error": self.backward_error}
        return read_normwise(system, x, method="multigrid", seconds={}, **told)


class WarmStart:
    """Solves circuits of a space that changes, each from the one before: its levels, its voltages.

    Where few cells have changed (obstacles set or freed, goals added, moved or taken away, conductivities), the finest
    level's equations are written over around them, the coarser levels are kept, and the iteration begins with the
    voltages there were, solved anew around the change.  Where many have, cells of parts that are joined or cut off
    among them, or the old levels do not serve, it starts afresh (`WarmPoint.fresh` tells).

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
    >>> warm = rg.circuit.WarmStart(boundary="neumann")
    >>> first = warm.solve(space)
    >>> cell[22, 18:23] = rg.Cell.OBSTACLE
    >>> warm.solve(space.with_cells(cell)).fresh
    False
    """

    def __init__(self, wiring: Wiring | None = None, *, rtol: float = 1e-8, **options: Unpack[WiringOptions]) -> None:
        check_rtol(rtol)
        if not (wiring is None or isinstance(wiring, Wiring)):
            raise InputError(f"wiring = {wiring!r} must be a Wiring (rg.Wiring(...)), or None")
        self.wiring, self.rtol = wiring_of(wiring, options), rtol
        if self.wiring.rails != "merged":
            raise InputError("a warm start needs rails = 'merged': with rails = 'cells', use resgrid.solve")
        self._last: _WarmCircuit | None = None

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
            raise InputError(f"space = {space!r} must be a ConfigurationSpace (rg.build_space(scene))")
        wiring, watch = self.wiring.on(space), ProgressMonitor(progress)
        last, self._last = self._last, None
        with suppress(AccuracyError):
            if last is not None and last.change(space, wiring):
                point = self._solved(last, wiring, watch, fresh=False)
                if point.iterations <= _STALE * last.first_iterations:
                    return point
        system = assemble(compile_space(space, replace(wiring, supply=1.0, goal_voltage=0.0)))
        watch, circuit = ProgressMonitor(progress), _WarmCircuit.of(system, space, wiring)
        if circuit is not None:
            return self._solved(circuit, wiring, watch, fresh=True)
        x = np.zeros(0)
        if system.size:
            x = factor_circuit(system).factors.solve(system.drive, rtol=self.rtol, watch=watch)
        height = np.append(x, np.nan)[np.append(system.unknown, -1)[system.netlist.cells.node]]
        voltage = wiring.goal_voltage + wiring.supply * height
        return WarmPoint(space, wiring, voltage, True, watch.iterations, watch.error)

    def _solved(self, circuit: _WarmCircuit, wiring: Wiring, watch: ProgressMonitor, *, fresh: bool) -> WarmPoint:
        circuit.grid.solve(self.rtol, watch)
        if fresh:
            circuit.first_iterations = watch.iterations
        self._last = circuit if watch.iterations <= circuit.first_iterations + _WORN else None
        fed = wiring.drive == "uniform"
        voltage = circuit.grid.values
        voltage *= wiring.supply / (wiring.resistance * np.count_nonzero(circuit.row) if fed else 1.0)
        voltage += wiring.goal_voltage
        voltage[~circuit.row] = np.nan
        return WarmPoint(circuit.space, wiring, voltage, fresh, watch.iterations, watch.error)


@dataclass(eq=False)
class _WarmCircuit:
    """A circuit with its rails at 0 and 1 V, or 1 A into every row, and the space it was compiled from.

    `row`: cells with rows, of the space's shape; `first_iterations`: steps that its first solution took.
    """

    space: ConfigurationSpace
    row: NDArray[np.bool_]
    grid: WarmGrid
    first_iterations: int = 0

    @classmethod
    def of(cls, system: Equations, space: ConfigurationSpace, wiring: Wiring) -> _WarmCircuit | None:
        """Lay the levels of a space's equations out; None where these are no grid of two colours."""
        row, fed = _rows_of(space, wiring), wiring.drive == "uniform"
        if not system.size == np.count_nonzero(row) > 0:
            return None
        grid = WarmGrid.of(system.laplacian, np.ones(system.size) if fed else system.drive, flat=fed)
        return None if grid is None else cls(space, row, grid)

    def change(self, space: ConfigurationSpace, wiring: Wiring) -> bool:
        """Take over what has changed since; False, of no use any more, where that is no gain."""
        old, self.space = self.space, space
        if space.axes != old.axes or (space.conductivity is None) != (old.conductivity is None):
            return False
        row = _rows_of(space, wiring)
        changed = (space.cell != old.cell) | (row != self.row)
        if space.conductivity is not None and space.conductivity is not old.conductivity:
            changed |= space.conductivity != old.conductivity
        self.row = row
        boxes = _boxes_around(changed)
        if boxes is None or not row.any() or not all(self.grid.slot[box].all() for box in boxes):
            return False
        if any(changed[box].sum() > changed[box][_inside(space, box, _RIM + _NEAR)].sum() for box in boxes):
            return False
        goals = np.count_nonzero(space.cell == Cell.GOAL)
        for box in boxes:
            around_goals = space.cell[box][_inside(space, box, _RIM + 1)] == Cell.GOAL
            alone = len(boxes) == 1 and np.count_nonzero(around_goals) == goals
            window = _window_of(space, wiring, box, row[box])
            self.grid.change(box, _inside(space, box, _RIM), *window, solve=row.size >= _SMALL, follow=alone)
        return True


def _rows_of(space: ConfigurationSpace, wiring: Wiring) -> NDArray[np.bool_]:
    """Which cells have rows, of the space's shape: parts that meet both rails, or the goal where all cells are fed."""
    if wiring.drive == "uniform":
        return space.goal_connected
    kind, inside = contacts_of_box(space, wiring, connected=False).kind, (slice(1, -1),) * space.ndim
    part = np.pad(label_regions(kind[inside] == CellRole.NODE, space.periodic), 1)
    steps = [sign * stride // part.itemsize for stride in part.strides for sign in (-1, 1)]
    meets_both = np.arange(int(part.max()) + 1) > 0
    for rail in (CellRole.LOW, CellRole.HIGH):
        beside, met = np.flatnonzero(kind == rail), np.zeros_like(meets_both)
        for step in steps:
            met[part.take(beside + step, mode="clip")] = True
            if met[meets_both].all():
                break
        meets_both &= met
    return np.asarray(meets_both[part[inside]])


def _boxes_around(changed: NDArray[np.bool_]) -> list[tuple[slice, ...]] | None:
    """Boxes of whole tiles around changed cells, none of whose tiles meet; None if these are no gain.

    Tiles have an even number of cells along every axis: colours in a box are those of the whole grid.
    """
    from scipy import ndimage

    if np.count_nonzero(changed) > changed.size / _MOST:
        return None
    ndim, shape = changed.ndim, np.array(changed.shape)
    side = 2 * (_RIM if changed.size < _SMALL else max(round(_WINDOW ** (1 / ndim) / 7), _RIM))
    tiles = np.zeros(-(-shape // side), dtype=np.bool_)
    tiles[tuple(index // side for index in np.unravel_index(np.flatnonzero(changed), changed.shape))] = True
    around = np.ones((3,) * ndim, dtype=np.bool_)
    labels, _ = ndimage.label(ndimage.binary_dilation(tiles, around), around)
    boxes = [
        tuple(slice(ends.start * side, min(ends.stop * side, n)) for ends, n in zip(box, changed.shape, strict=True))
        for box in ndimage.find_objects(labels)
    ]
    volume = sum(np.prod([ends.stop - ends.start for ends in box]) for box in boxes)
    return boxes if volume <= max(changed.size / _MOST, _WINDOW) else None


def _inside(space: ConfigurationSpace, box: tuple[slice, ...], margin: int) -> tuple[slice, ...]:
    """The cells of a box that are so far from where the grid goes on beyond it."""
    return tuple(
        slice(
            margin if ends.start > 0 or axis.periodic else 0,
            ends.stop - ends.start - (margin if ends.stop < axis.cells or axis.periodic else 0),
        )
        for ends, axis in zip(box, space.axes, strict=True)
    )


def _window_of(
    space: ConfigurationSpace, wiring: Wiring, box: tuple[slice, ...], row: NDArray[np.bool_]
) -> tuple[Laplacian, NDArray[np.float64]]:
    """The equations of a box, with the high rail at 1 V and the low one at 0 V, or with 1 A into every row.

    Shapes: `row`, of the box: which of its cells have rows.
    """
    contacts = contacts_of_box(space, wiring, [(ends.start, ends.stop) for ends in box], connected=False)
    size, vertex = int(np.count_nonzero(row)), np.full(row.shape, -1, dtype=np.int32)
    vertex[row] = np.arange(size, dtype=np.int32)
    # Rows are followed by the high rail and the low one.
    node = np.array([-1, size, size + 1, -1], dtype=np.int32)[contacts.kind]
    np.copyto(node[(slice(1, -1),) * row.ndim], vertex, where=row)
    pairs, conductance = [], []
    for axis, siemens in enumerate(contacts.conductance):
        ends = np.sort(np.stack(before_and_behind(node, axis), axis=-1))
        kept = (ends[..., 0] >= 0) & (ends[..., 0] < size) & (siemens > 0.0)
        pairs.append(ends[kept])
        conductance.append(siemens[kept])
    row_of = np.append(vertex[row], np.full(2, -1, dtype=np.int32))
    listed = EdgeList(np.concatenate(pairs), np.concatenate(conductance), row_of)
    here, beside = listed.ends.T
    tied, fed = beside >= size, beside == size
    ground = sum_by_row(here[tied], listed.conductance[tied], size)
    drive = sum_by_row(here[fed], listed.conductance[fed], size) + (wiring.drive == "uniform")
    grid = Grid(vertex, (False,) * vertex.ndim)
    return Laplacian(ground, listed, grid=grid, dimensions=grid.dimensions), drive
