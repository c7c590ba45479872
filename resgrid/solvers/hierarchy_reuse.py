"""What was made ready for one circuit serves others: many chips of it, and the same one with changed cells.

Many chips: one of a grid has its own finest level, and the nominal coarse ones; of other circuits, the nominal order.

Warm start: the equations of a grid change in a window, old levels precondition, old voltages begin.  The finest level
is written over where its equations have changed; coarser levels stay.  In the window the new equations are solved at
once, with the voltages around it held.  What lies outside follows along one mode ``v``: with ``A v = 0`` outside and in
the window (the drop from the high rail; or 1, above the only rail), ``x + alpha v`` is best, in the energy norm, for
``alpha = v.(b - A x) / v.A v``, and both products come from the window's rim alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.solvers.factors import factor_multigrid
from resgrid.solvers.laplacian import Grid, Laplacian
from resgrid.solvers.multigrid.conjugate_gradients import ROUNDING, Stop, converge, iterate
from resgrid.solvers.multigrid.grid_level import lay_out
from resgrid.solvers.multigrid.hierarchy import GridProblem, Hierarchy, build_hierarchy, finest_stencils
from resgrid.solvers.multigrid.krylov import norm
from resgrid.solvers.multigrid.levels import Finest
from resgrid.solvers.multigrid.red_black import Lattice
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.scaled import Floats, Indices
from resgrid.solvers.supernodal import factor_supernodes
from resgrid.solvers.symbolic import Symbolic

_FEW = 300
"""Resistors that tell in which unit a chip is solved."""

_LEFT = 16 * ROUNDING
"""Share of ``|A| |x|`` up to which a residual may be what rounding leaves."""

_ROUNDINGS = 1e-13
"""What factors in positive numbers make of roundings."""

_FORBIDDEN = 1e-9
"""Error that is let pass where rounding forbids a smaller one."""

_EVEN = 1e4
"""Range of conductances within which steps tell the error that is left: beyond, strong ones hide that of weak ones."""

_WINDOW_RTOL = 1e-10
"""Residual of a window: the mode outside is found from small differences at its rim."""

Box = tuple[slice, ...]
"""Some cells of a grid, axis by axis."""

Chips = Iterable[tuple[Laplacian, Floats]]
"""Matrices of chips whose nodes are joined as the nominal one's, and what drives their rows."""

Solver = Callable[[Chips, float], Iterator[Floats | None]]
"""Solutions (n,) for chips, one by one, to a tolerance; None for one that is none."""


def solve_by_levels(
    nominal: Laplacian, hierarchy: Hierarchy, start: Floats, chips: Chips, rtol: float
) -> Iterator[Floats | None]:
    """As `Solver`; a chip has its own finest level and the coarse ones of the nominal chip.  Shapes: `start` (n,)."""
    grid, listed, ordinary = nominal.grid, nominal.listed, hierarchy.largest_degree / hierarchy.unit
    assert hierarchy.grid is not None and grid is not None and listed is not None
    few, cells = slice(None, None, max(1, len(listed.conductance) // _FEW)), grid.of_rows(listed.row).vertex
    problem: GridProblem | None = None
    for chip, drive in chips:
        assert chip.listed is not None
        # Most of its conductances are as large in this unit as the nominal ones are in theirs.
        unit = hierarchy.unit * float(np.median(chip.listed.conductance[few] / listed.conductance[few]))
        laid_out = lay_out(*chip.listed, cells[hierarchy.box], chip.ground, unit)
        assert laid_out is not None
        level, slot = laid_out
        x, currents = np.zeros((2, *level.degree.shape))
        x.ravel()[slot], currents.ravel()[slot] = start, drive / unit
        finest = Finest(*finest_stencils(level), hierarchy.grid.aggregate)
        if problem is None:
            problem = GridProblem(finest, hierarchy.levels, currents, x)
        else:
            problem.begin(finest, currents, x)
        # A row whose own diagonal exceeds an ordinary one counts for so much less.
        wanted = rtol * norm((currents * (ordinary / np.maximum(level.degree, ordinary))).ravel())
        residual = converge(problem, Stop(wanted, ROUNDING * float(level.degree.max()), unit), None)
        solution = x.ravel()[slot]
        yield solution if residual <= max(wanted, _LEFT * ordinary * norm(solution)) else None


def solver_by_levels(laplacian: Laplacian, drive: Floats) -> Solver | None:
    """Lay a grid out by colour; None where it has no two colours.  Shapes: `drive` (n,)."""
    hierarchy = build_hierarchy(laplacian)
    if hierarchy.grid is None:
        return None
    return partial(solve_by_levels, laplacian, hierarchy, iterate(laplacian, hierarchy, drive, 1e-12)[0])


def solve_in_order(order: Symbolic, chips: Chips, rtol: float) -> Iterator[Floats | None]:
    """As `Solver`, by elimination; ``rtol`` bounds the error of voltages, relative to the largest."""
    for chip, drive in chips:
        try:
            factors = factor_supernodes(chip, order)
        except AccuracyError:
            yield None
            continue
        solution = factors.solve(drive)
        # Entries of a solution for currents of one sign are right to some roundings.
        summed = factors.solve(np.abs(drive)) if drive.min() < 0.0 else solution
        right = _ROUNDINGS * np.abs(summed).max() <= max(rtol, _FORBIDDEN) * np.abs(solution).max()
        yield solution if right else None


@dataclass(frozen=True, eq=False)
class WarmGrid:
    """The equations ``A x = b`` of a grid that change, and their latest solution.

    `hierarchy`: of a grid of two colours, all of whose rows are cells; `finest`: its finest level, into which changes
    are written; `lattice`: of that level; `slot`, of the grid's shape: slot of every cell, 0 for none; `flat`: whether
    constants are the mode outside of windows, for there is a single rail; otherwise it is ``1 - x``; `b, x` (2,
    slots): in units of the hierarchy, and in volts.
    """

    hierarchy: Hierarchy
    finest: Finest
    lattice: Lattice
    slot: Indices
    flat: bool
    b: Floats
    x: Floats

    @classmethod
    def of(cls, laplacian: Laplacian, drive: Floats, flat: bool) -> WarmGrid | None:
        """Levels of a grid, at rest; None where it is no grid of two colours that coarsens by blocks."""
        hierarchy, grid = build_hierarchy(laplacian), laplacian.grid
        if hierarchy.grid is None or grid is None:
            return None
        lattice = Lattice(tuple(ends.stop - ends.start for ends in hierarchy.box))
        slot, (b, x) = np.zeros(grid.vertex.shape, dtype=np.int32), np.zeros((2, 2, lattice.slots))
        slot[hierarchy.box] = lattice.cells
        b.ravel()[hierarchy.slot] = drive / hierarchy.unit
        return cls(hierarchy, hierarchy.grid, lattice, slot, flat, b, x)

    def solve(self, rtol: float, watch: ProgressMonitor) -> None:
        """Iterate from the latest solution on.

        Raises
        ------
        AccuracyError
            If the iteration stagnates.
        """
        begun, allowed = bool(self.x.any()), rtol * norm(self.b.ravel())
        hierarchy, largest = self.hierarchy, self.hierarchy.largest_degree / self.hierarchy.unit
        degree = self.finest.true.black_degree
        even = float(degree.max()) <= _EVEN * float(degree.min(where=degree > 0.0, initial=np.inf))
        stop = Stop(allowed, ROUNDING * largest, hierarchy.unit, self.x if begun else None, rtol if even else 0.0)
        size = converge(GridProblem(self.finest, hierarchy.levels, self.b, self.x), stop, watch)
        scale = 2.0 * largest * norm(self.x.ravel()) + norm(self.b.ravel())
        error = size / (scale or 1.0)
        if not error <= rtol:
            raise AccuracyError(f"a warm start stagnates at a backward error of {error:.1e}, above rtol = {rtol:.1e}")
        watch.done(error)

    @property
    def values(self) -> Floats:
        """The latest solution in every cell of the grid, of its shape; undefined where a cell has no row."""
        return self.x.ravel()[self.slot]

    def change(self, box: Box, core: Box, laplacian: Laplacian, drive: Floats, *, solve: bool, follow: bool) -> None:
        """Take over the equations of a box of cells; solve them, and let the outside follow.

        `core`: those cells of the box whose equations are whole; `laplacian` (n, n): on the grid of the box, its rows
        in C order; `drive` (n,): current into every row, in amperes.
        """
        assert laplacian.grid is not None
        vertex, x = laplacian.grid.vertex, self.x.ravel()
        self._write(self.slot[box][core].ravel(), core, laplacian, drive)
        x[self.slot[box][vertex < 0]] = 0.0
        slot = self.slot[box][vertex >= 0]
        before = x[slot]
        if not solve:
            new = before == 0.0
            fed, degree = (drive + laplacian.edges @ before)[new], laplacian.diagonal[new]
            x[slot[new]] = np.divide(fed, degree, out=np.zeros_like(fed), where=degree > 0.0)
            return
        inner = np.full_like(vertex, -1)
        inner[core] = vertex[core]
        own = inner[vertex >= 0] >= 0
        if not own.any():
            return
        inner[inner >= 0] = np.arange(np.count_nonzero(own), dtype=np.int32)
        factor = factor_multigrid(replace(laplacian.within(own), grid=Grid(inner, (False,) * inner.ndim)))
        from_rim = laplacian.edges[own][:, ~own]
        after = factor.solve(drive[own] + from_rim @ before[~own], rtol=_WINDOW_RTOL)
        if follow and from_rim.nnz:
            mode = np.ones_like(before) if self.flat else 1.0 - before
            at_rim = from_rim @ mode[~own]
            followed = factor.solve(at_rim, rtol=_WINDOW_RTOL)
            energy = float(at_rim @ (mode[own] - followed))
            alpha = float(at_rim @ (after - before[own])) / energy if energy > 0.0 else 0.0
            after += alpha * followed
            np.add(x, alpha if self.flat else alpha * (1.0 - x), out=x, where=x != 0.0)
        x[slot[own]] = after

    def _write(self, there: Indices, core: Box, laplacian: Laplacian, drive: Floats) -> None:
        """Write the equations of a window's core, whose cells stand at some slots (cells,), over those of the level."""
        assert laplacian.listed is not None and laplacian.grid is not None
        finest, vertex, unit = self.finest, laplacian.grid.vertex, self.hierarchy.unit
        cells = laplacian.grid.of_rows(laplacian.listed.row).vertex
        laid_out = lay_out(*laplacian.listed, cells, laplacian.ground, unit)
        assert laid_out is not None
        small = laid_out[0].lattice
        fresh, here = finest_stencils(laid_out[0]), small.cells[core].ravel()
        self.b.ravel()[there] = np.append(drive, 0.0)[vertex[core]].ravel() / unit
        red = there < self.lattice.slots
        to_red, of_red, to, of = there[red], here[red], there[~red] - self.lattice.slots, here[~red] - small.slots
        for old, new in zip(finest[:2], fresh, strict=True):
            old.faces[:, to_red], old.red_inverse[to_red] = new.faces[:, of_red], new.red_inverse[of_red]
            old.black_degree[to] = new.black_degree[of]
        finest.stencil.black_inverse[to] = fresh[1].black_inverse[of]
        self._aggregate(to, fresh[1].black_inverse[of] > 0.0)

    def _aggregate(self, slot: Indices, present: NDArray[np.bool_]) -> None:
        """Black slots that are new join the aggregate of a black one behind the strongest red neighbour."""
        target, faces, distance = self.finest.aggregate, self.finest.true.faces, self.lattice.distance
        target[slot[~present]] = 0
        for k in slot[present & (target[slot] == 0)].tolist():
            red = k - distance
            strength = np.minimum(faces[np.arange(len(red)), red][:, np.newaxis], faces[:, red].T)
            onwards = np.where(strength > 0.0, red[:, np.newaxis] + distance, k)
            strength[target[onwards] == 0] = 0.0
            best = np.unravel_index(int(np.argmax(strength)), strength.shape)
            if strength[best] > 0.0:
                target[k] = target[onwards[best]]
