"""Warm starts: solve the circuit of a changed space, starting from the solution for the space before the change.

The equations change only near the changed cells.  They are assembled in windows (boxes of cells) around the changes, by
the rules of the compiler (`resgrid.core.compiler`), without a netlist or the equations of the whole grid.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.validation import checked
from resgrid.circuit.equations import Equations, assemble, sum_by_row
from resgrid.circuit.linear import factor_circuit, solve_linear
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.postprocess import read_normwise
from resgrid.core.cell import Cell
from resgrid.core.compiler import CellRole, compile_space, contacts_of_box
from resgrid.core.drive_checks import require_drive
from resgrid.core.lattice import require_square
from resgrid.core.netlist import Netlist
from resgrid.core.regions import cells_at_faces, label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, wiring_of
from resgrid.errors import AccuracyError, InputError
from resgrid.solvers.factors import check_rtol
from resgrid.solvers.hierarchy_reuse import WarmGrid
from resgrid.solvers.laplacian import EdgeList, Grid, Laplacian
from resgrid.solvers.progress import Progress, ProgressMonitor

_SMALL = 100_000
"""Smallest number of cells of a space for which windows are solved before the iteration over the whole grid.

A window is a box of cells around changed cells.  In smaller spaces its solution would save few iterations.
"""

_MORE_ITERATIONS, _MOST_ITERATIONS = 4, 3
"""Limits on the iterations of a warm solve, compared with the number of iterations of the first solve.

The first solve is the one that sets up the multigrid hierarchy.  If a warm solve takes over `_MORE_ITERATIONS` more
iterations, the next solve sets up a new hierarchy.  If it takes over `_MOST_ITERATIONS` times as many iterations, its
result is rejected, since the error estimate is unreliable.
"""

_WINDOW = 12_000
"""Approximate number of cells in the window around a small change; the equations of the window are solved first."""

_MOST = 4
"""Inverse of the largest fraction of the cells of a space that windows, or changed cells, may cover in a warm start."""

_RIM, _NEAR = 3, 2
"""Widths in cells around a change.

`_RIM`: margin of a window in which equations are incomplete; `_NEAR`: distance from a changed cell up to which
equations change.
"""


@dataclass(frozen=True, eq=False)
class WarmPoint:
    """Solution of a warm start: the voltages of the cells of a space.

    Returned by `resgrid.circuit.WarmStart.solve`.

    Attributes
    ----------
    space : ConfigurationSpace
        The space of the circuit.
    wiring : Wiring
        Boundary conditions and drive of the circuit.
    voltage : ndarray of float64, shape of the space
        Voltage above ground of every cell with an unknown voltage, in volts; NaN for other cells.
    fresh : bool
        Whether the solve used no earlier solution and no earlier multigrid hierarchy.
    iterations : int
        Number of iterations of the iterative method.
    backward_error : float
        Normwise backward error.
    netlist : Netlist
        Netlist of the space, compiled at every access.

    Examples
    --------
    >>> warm = rg.circuit.WarmStart(boundary="neumann")
    >>> point = warm.solve(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> point.voltage[6, :4].round(6)
    array([0.178125,      nan, 0.332966, 0.529663])
    >>> point.fresh, point.backward_error < 1e-10
    (True, True)
    >>> op = point.operating_point()
    >>> round(float(op.voltage.max()), 6)
    1.14067
    """

    space: ConfigurationSpace
    wiring: Wiring
    voltage: NDArray[np.float64]
    fresh: bool
    iterations: int
    backward_error: float

    @property
    def netlist(self) -> Netlist:
        """Netlist of the space, compiled at every access."""
        return compile_space(self.space, self.wiring)

    def operating_point(self, accuracy: str = "normwise") -> OperatingPoint:
        """Return the operating point of the whole circuit.

        Parameters
        ----------
        accuracy : {"normwise", "direction"}
            ``"normwise"`` computes the operating point from `voltage`; ``"direction"`` solves the circuit again, for a
            direction-safe result.

        Returns
        -------
        OperatingPoint
            Operating point with branch currents, power and KCL residual.
        """
        netlist = self.netlist
        if accuracy != "normwise":
            return solve_linear(netlist, accuracy=accuracy, method="auto", rtol=1e-10)
        system = assemble(netlist)
        row = np.append(system.unknown, -1)[netlist.cells.node]
        x = np.empty(system.size)
        x[row[row >= 0]] = self.voltage[row >= 0] - system.reference
        progress = {"iterations": self.iterations, "backward_error": self.backward_error}
        return read_normwise(system, x, method="multigrid", seconds={}, **progress)


@checked
class WarmStart:
    """Solver for the circuits of a changing space, which reuses the last solution and its multigrid hierarchy.

    After a change of few cells (obstacles, goals or conductivities), the equations of the finest level are overwritten
    around these cells, and the coarser levels are kept.  The iteration starts from the last voltages, updated in
    windows around the changes.  After a change of many cells (over a quarter of the space, counted with their
    windows if the space is large), or if the old hierarchy converges slowly, the solve starts without earlier results
    (`WarmPoint.fresh`).  Cells that become connected or disconnected count as changed.

    Parameters
    ----------
    wiring : Wiring, optional
        Boundary conditions and drive; by default obstacles are at 1 V and goals at 0 V.
    rtol : float
        Largest normwise backward error of all solutions.
    **options
        Fields of `Wiring`, instead of `wiring` or as changes to it.

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
        self.wiring, self.rtol = wiring_of(wiring, options), rtol
        require_square(self.wiring.lattice, "a warm start")
        require_drive(self.wiring, "a warm start")
        if self.wiring.rails != "merged":
            raise InputError("a warm start needs rails = 'merged': with rails = 'cells', use resgrid.solve")
        self._last: _WarmCircuit | None = None

    def solve(self, space: ConfigurationSpace, *, progress: Progress | None = None) -> WarmPoint:
        """Solve the circuit of a space, starting from the last solution if few cells have changed.

        Parameters
        ----------
        space : ConfigurationSpace
            The space; a warm start requires the axes of the last space.
        progress : callable, optional
            Called after every iteration with the number of iterations, the relative residual, and the estimated
            remaining seconds (None without progress).

        Returns
        -------
        WarmPoint
            Voltages of the cells, in volts, and details of the solve.

        Raises
        ------
        InputError
            If `space` is not a space, has no goal, or does not fit the wiring.
        CircuitError
            If nothing drives the circuit.
        BudgetError
            If the equations do not fit in memory.
        AccuracyError
            If the backward error exceeds `rtol`.
        """
        if not isinstance(space, ConfigurationSpace):
            raise InputError(f"space = {space!r} must be a ConfigurationSpace (rg.build_space(scene))")
        wiring, watch = self.wiring.on(space), ProgressMonitor(progress)
        last, self._last = self._last, None
        with suppress(AccuracyError):
            if last is not None and last.change(space, wiring):
                point = self._solved(last, wiring, watch, fresh=False)
                if point.iterations <= _MOST_ITERATIONS * last.first_iterations:
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
        self._last = circuit if watch.iterations <= circuit.first_iterations + _MORE_ITERATIONS else None
        is_driven = wiring.drive == "uniform"
        voltage = circuit.grid.values
        voltage *= wiring.supply / (wiring.resistance * np.count_nonzero(circuit.row) if is_driven else 1.0)
        voltage += wiring.goal_voltage
        voltage[~circuit.row] = np.nan
        return WarmPoint(circuit.space, wiring, voltage, fresh, watch.iterations, watch.error)


@dataclass(eq=False)
class _WarmCircuit:
    """Circuit of a space with rails at 0 V and 1 V, or with 1 A into every row, and its multigrid hierarchy.

    `space`: the space; `row` (shape of the space): whether a cell has an unknown voltage (a row); `grid`: equations,
    last solution and hierarchy; `first_iterations`: number of iterations of the solve that set up the
    hierarchy.
    """

    space: ConfigurationSpace
    row: NDArray[np.bool_]
    grid: WarmGrid
    first_iterations: int = 0

    @classmethod
    def of(cls, system: Equations, space: ConfigurationSpace, wiring: Wiring) -> _WarmCircuit | None:
        """Return the circuit of a space with a new hierarchy, or None if a warm start is impossible.

        It is impossible if the grid cannot be coloured red and black, or if the number of rows is 0 or differs from the
        number of cells with an unknown voltage. `system`: equations of the circuit with rails at 0 V and 1 V; `space`:
        the space; `wiring`: boundary conditions and drive.
        """
        row, is_driven = _rows_of(space, wiring), wiring.drive == "uniform"
        if not system.size == np.count_nonzero(row) > 0:
            return None
        grid = WarmGrid.of(system.laplacian, np.ones(system.size) if is_driven else system.drive, flat=is_driven)
        return None if grid is None else cls(space, row, grid)

    def change(self, space: ConfigurationSpace, wiring: Wiring) -> bool:
        """Update the equations for a changed space, in place; return False if the change is too large for a warm start.

        `space`: the changed space; `wiring`: boundary conditions and drive.  After False the object is unusable.
        """
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
    """Return which cells have an unknown voltage (a row), in the shape of the space.

    With a uniform drive or a leak these are the cells connected to a goal, else the cells of components that touch both
    rails.
    """
    if wiring.drive == "uniform" or wiring.leak:
        return space.goal_connected
    kind, inside = contacts_of_box(space, wiring, connected=False).kind, (slice(1, -1),) * space.ndim
    component = np.pad(label_regions(kind[inside] == CellRole.NODE, space.periodic), 1)
    steps = [sign * stride // component.itemsize for stride in component.strides for sign in (-1, 1)]
    touches_both = np.arange(int(component.max()) + 1) > 0
    for rail in (CellRole.LOW, CellRole.HIGH):
        rail_cells, touches = np.flatnonzero(kind == rail), np.zeros_like(touches_both)
        for step in steps:
            touches[component.take(rail_cells + step, mode="clip")] = True
            if touches[touches_both].all():
                break
        touches_both &= touches
    return np.asarray(touches_both[component[inside]])


def _boxes_around(changed: NDArray[np.bool_]) -> list[tuple[slice, ...]] | None:
    """Return disjoint, non-adjacent boxes of cells around the changed cells; None if they cover too much of the grid.

    Too much is over a quarter of the cells (for the boxes: and over 12,000 cells).  `changed`: mask of the changed
    cells.  A box has one slice per axis.  The sides of a box lie on a coarse mesh with an even number of cells per
    step, so that a box has the red-black colouring of the grid.
    """
    from scipy import ndimage

    if np.count_nonzero(changed) > changed.size / _MOST:
        return None
    ndim, shape = changed.ndim, np.array(changed.shape)
    side = 2 * (_RIM if changed.size < _SMALL else max(round(_WINDOW ** (1 / ndim) / 7), _RIM))
    tiles = np.zeros(-(-shape // side), dtype=np.bool_)
    tiles[tuple(index // side for index in np.unravel_index(np.flatnonzero(changed), changed.shape))] = True
    around = np.ones((3,) * ndim, dtype=np.bool_)
    labels = label_regions(ndimage.binary_dilation(tiles, around), periodic=False, corners=True)
    boxes = [
        tuple(slice(ends.start * side, min(ends.stop * side, n)) for ends, n in zip(box, changed.shape, strict=True))
        for box in ndimage.find_objects(labels)
    ]
    volume = sum(np.prod([ends.stop - ends.start for ends in box]) for box in boxes)
    return boxes if volume <= max(changed.size / _MOST, _WINDOW) else None


def _inside(space: ConfigurationSpace, box: tuple[slice, ...], margin: int) -> tuple[slice, ...]:
    """Return the part of a box that keeps a margin from its sides, as one slice per axis, relative to the box.

    `box`: slices of the cells; `margin`: width of the margin, in cells.  A side at the edge of the grid has no margin,
    unless the axis is periodic.
    """
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
    """Return the matrix and the right-hand side (rows of the box,), in amperes, of a box of cells.

    `box`: slices of the cells; `row` (shape of the box): whether a cell has a row (an unknown voltage).  The high rail
    is at 1 V and the low rail at 0 V, or 1 A is injected into every row.
    """
    contacts = contacts_of_box(space, wiring, [(ends.start, ends.stop) for ends in box], connected=False)
    size, vertex = int(np.count_nonzero(row)), np.full(row.shape, -1, dtype=np.int32)
    vertex[row] = np.arange(size, dtype=np.int32)
    # Numbers of nodes: the rows, then the high rail and the low rail.
    node = np.array([-1, size, size + 1, -1], dtype=np.int32)[contacts.kind]
    np.copyto(node[(slice(1, -1),) * row.ndim], vertex, where=row)
    pairs, conductance = [], []
    for axis, siemens in enumerate(contacts.conductance):
        ends = np.sort(np.stack(cells_at_faces(node, axis), axis=-1))
        kept = (ends[..., 0] >= 0) & (ends[..., 0] < size) & (siemens > 0.0)
        pairs.append(ends[kept])
        conductance.append(siemens[kept])
    row_of = np.append(vertex[row], np.full(2, -1, dtype=np.int32))
    listed = EdgeList(np.concatenate(pairs), np.concatenate(conductance), row_of)
    first, second = listed.ends.T
    at_rail, at_high = second >= size, second == size
    ground = sum_by_row(first[at_rail], listed.conductance[at_rail], size) + contacts.leak
    drive = sum_by_row(first[at_high], listed.conductance[at_high], size) + contacts.leak
    drive += wiring.drive == "uniform"
    grid = Grid(vertex, (False,) * vertex.ndim)
    return Laplacian(ground, listed, grid=grid, dimensions=grid.dimensions), drive
