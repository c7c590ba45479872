"""Reuse of a multigrid hierarchy or elimination order for Monte Carlo samples and for local changes.

Monte Carlo samples: a sample of a grid has its own finest level and shares the coarse levels of the nominal chip.
Samples of other circuits share the nominal elimination order.

Warm start: the equations of a grid change in a window, a box of cells. The old levels precondition, and the old
voltages are the initial guess. The finest level is overwritten where its equations have changed; coarser levels stay.
In the window the new equations are solved at once, with the voltages around the window held fixed. The voltages outside
are corrected by a multiple of one vector ``v``. With ``A v = 0`` outside and in the window (``v`` is the drop from the
high rail with two rails, or 1 with a single rail), ``x + alpha v`` is optimal in the energy norm for ``alpha = v.(b - A
x) / v.A v``. Both products come from the conductances across the window's border alone.
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
from resgrid.solvers.multigrid.conjugate_gradients import ROUNDING, StoppingRule, converge, iterate
from resgrid.solvers.multigrid.grid_level import lay_out
from resgrid.solvers.multigrid.hierarchy import GridProblem, Hierarchy, build_hierarchy, finest_stencils
from resgrid.solvers.multigrid.krylov import norm
from resgrid.solvers.multigrid.levels import Finest
from resgrid.solvers.multigrid.red_black import RedBlackLayout
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.scaled import Floats, Indices
from resgrid.solvers.supernodal import factor_supernodes
from resgrid.solvers.symbolic import Symbolic

_FEW = 300
"""Approximate number of resistors from which the unit of a chip's equations is estimated.

The equations are divided by the nominal unit times the median ratio of these conductances to the nominal ones.
"""

_LEFT = 16 * ROUNDING
"""Limit on the residual norm of a chip's solution, as a fraction of the norm ``|x|`` times a diagonal entry.

The entry is the largest diagonal entry of the nominal chip's matrix.

The limit is the size of rounding errors; a solution below it is accepted even if the residual exceeds the tolerance.
"""

_ROUNDINGS = 1e-13
"""Bound on the relative error of every entry of a solution by subtraction-free factors, for currents of one sign.

The error is due to rounding. For currents of both signs the bound is relative to the solution for their magnitudes.
"""

_FORBIDDEN = 1e-9
"""Smallest tolerance of `solve_in_order`, relative to the largest magnitude of a voltage of the chip.

A smaller tolerance is replaced by this value. A solution is accepted if the bound on its rounding error is at most the
tolerance times that magnitude.
"""

_EVEN = 1e4
"""Largest ratio of diagonal entries of the matrix for which a warm start may stop at an estimate of the error.

The ratio is that of the largest to the smallest sum of the conductances at a black cell of the grid.

The estimate uses the step lengths of the iteration. With a larger ratio the error at weak conductances may be hidden,
and only the residual ends the iteration.
"""

_WINDOW_RTOL = 1e-10
"""Residual norm at which the solution in a changed window ends, relative to the norm of the right-hand side.

It is small because the correction outside the window is computed from small differences at the window's border.
"""

Box = tuple[slice, ...]
"""A box of cells of a grid: one slice per axis."""

Chips = Iterable[tuple[Laplacian, Floats]]
"""Pairs of a matrix and its currents (n,) in amperes, one per chip; all matrices have the nominal chip's connections.
"""

ChipSolver = Callable[[Chips, float], Iterator[Floats | None]]
"""Function of chips and a relative tolerance: yields the solution (n,) of every chip in volts, None where it is
inaccurate.

The tolerance limits either the residual norm, relative to the norm of the currents (`solver_by_levels`), or the error
of a voltage, relative to the largest one (`solve_in_order`).
"""


def solve_by_levels(
    nominal: Laplacian, hierarchy: Hierarchy, start: Floats, chips: Chips, rtol: float
) -> Iterator[Floats | None]:
    """Yield the solution (n,) of every chip in volts, None where the iteration stagnates above rounding error.

    A chip differs from the nominal chip in the values of its resistors. Its finest level is computed, its coarse levels
    are those of the nominal chip. `nominal, hierarchy`: matrix of the nominal chip, and its levels; `start` (n,):
    solution of the nominal chip in volts, the initial guess; `chips`: for every chip a pair of its matrix and its
    currents (n,) in amperes; `rtol`: residual norm relative to the norm of the currents at which an iteration ends. In
    the latter norm, a row whose diagonal exceeds the largest nominal one has a smaller weight.
    """
    grid, listed, ordinary = nominal.grid, nominal.listed, hierarchy.largest_degree / hierarchy.unit
    assert hierarchy.grid is not None and grid is not None and listed is not None
    few, cells = slice(None, None, max(1, len(listed.conductance) // _FEW)), grid.of_rows(listed.row).vertex
    problem: GridProblem | None = None
    for chip, drive in chips:
        assert chip.listed is not None
        # In this unit the median conductance equals that of the nominal chip in its own unit.
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
            problem.set_finest(finest, currents, x)
        # A row is weighted by the ratio of the nominal diagonal to its own, if that is larger.
        wanted = rtol * norm((currents * (ordinary / np.maximum(level.degree, ordinary))).ravel())
        residual = converge(problem, StoppingRule(wanted, ROUNDING * float(level.degree.max()), unit), None)
        solution = x.ravel()[slot]
        yield solution if residual <= max(wanted, _LEFT * ordinary * norm(solution)) else None


def solver_by_levels(laplacian: Laplacian, drive: Floats) -> ChipSolver | None:
    """Return a function of chips and a tolerance that yields solutions, with the coarse levels of the nominal grid.

    The result is None unless the grid's cells can be coloured red and black. The function takes pairs of a matrix and
    its currents (n,), one per chip, and a residual norm relative to that of the currents. It yields the solution (n,)
    of every chip in volts, None where it is inaccurate.

    `laplacian`: matrix of the nominal chip; `drive` (n,): its currents in amperes.
    """
    hierarchy = build_hierarchy(laplacian)
    if hierarchy.grid is None:
        return None
    return partial(solve_by_levels, laplacian, hierarchy, iterate(laplacian, hierarchy, drive, 1e-12)[0])


def solve_in_order(order: Symbolic, chips: Chips, rtol: float) -> Iterator[Floats | None]:
    """Yield the solution (n,) of every chip in volts, by elimination in a common order; None where it is not accurate.

    `order`: elimination order and structure of the factors; `chips`: for every chip a pair of its matrix and its
    currents (n,) in amperes; `rtol`: largest error of a voltage, relative to the chip's largest magnitude of a voltage;
    a value below 1e-9 counts as 1e-9.
    """
    for chip, drive in chips:
        try:
            factors = factor_supernodes(chip, order)
        except AccuracyError:
            yield None
            continue
        solution = factors.solve(drive)
        # Entries of a solution for currents of one sign are accurate to some rounding errors.
        summed = factors.solve(np.abs(drive)) if drive.min() < 0.0 else solution
        right = _ROUNDINGS * np.abs(summed).max() <= max(rtol, _FORBIDDEN) * np.abs(solution).max()
        yield solution if right else None


@dataclass(frozen=True, eq=False)
class WarmGrid:
    """The equations ``A x = b`` of a grid that change, and their latest solution.

    Two rails are at 0 V (goals) and 1 V; a single rail is at 0 V. The position of a cell is its index in a flattened
    array (2, slots), whose row 0 holds red and row 1 black cells, each with padding.

    `hierarchy`: multigrid levels of a grid of two colours, all of whose rows are cells; `finest`: finest level of the
    hierarchy, into which changes are written; `lattice`: memory layout of the finest level; `slot`, of the grid's
    shape: position of every cell, 0 for none; `flat`: whether there is a single rail, so that the solution outside a
    changed window is corrected by a constant; with two rails it is corrected by a multiple of ``1 - x``; `b, x` (2,
    slots): right-hand side in amperes divided by ``hierarchy.unit`` (siemens), and solution in volts.
    """

    hierarchy: Hierarchy
    finest: Finest
    lattice: RedBlackLayout
    slot: Indices
    flat: bool
    b: Floats
    x: Floats

    @classmethod
    def of(cls, laplacian: Laplacian, drive: Floats, flat: bool) -> WarmGrid | None:
        """Return the equations of a grid, with 0 as the latest solution.

        The result is None unless the grid's cells can be coloured red and black and the coarse multigrid levels are
        formed from blocks of cells. `laplacian`: the matrix; `drive` (n,): currents in amperes; `flat`: whether there
        is a single rail.
        """
        hierarchy, grid = build_hierarchy(laplacian), laplacian.grid
        if hierarchy.grid is None or grid is None:
            return None
        lattice = RedBlackLayout(tuple(ends.stop - ends.start for ends in hierarchy.box))
        slot, (b, x) = np.zeros(grid.vertex.shape, dtype=np.int32), np.zeros((2, 2, lattice.slots))
        slot[hierarchy.box] = lattice.cells
        b.ravel()[hierarchy.slot] = drive / hierarchy.unit
        return cls(hierarchy, hierarchy.grid, lattice, slot, flat, b, x)

    def solve(self, rtol: float, watch: ProgressMonitor) -> None:
        """Iterate from the latest solution ``x`` to a normwise backward error, and store the new solution in ``x``.

        Parameters
        ----------
        rtol : float
            Largest normwise backward error.
        watch : ProgressMonitor
            Records iterations and the accuracy, and can cancel the solve.

        Raises
        ------
        AccuracyError
            If the iteration stagnates.
        """
        begun, allowed = bool(self.x.any()), rtol * norm(self.b.ravel())
        hierarchy, largest = self.hierarchy, self.hierarchy.largest_degree / self.hierarchy.unit
        degree = self.finest.true.black_degree
        even = float(degree.max()) <= _EVEN * float(degree.min(where=degree > 0.0, initial=np.inf))
        stop = StoppingRule(
            allowed, ROUNDING * largest, hierarchy.unit, self.x if begun else None, rtol if even else 0.0
        )
        size = converge(GridProblem(self.finest, hierarchy.levels, self.b, self.x), stop, watch)
        scale = 2.0 * largest * norm(self.x.ravel()) + norm(self.b.ravel())
        error = size / (scale or 1.0)
        if not error <= rtol:
            raise AccuracyError(
                f"the warm start stagnates at a backward error of {error:.1e}, above rtol = {rtol:.1e}; use a larger "
                "rtol, or solve without a warm start"
            )
        watch.done(error)

    @property
    def values(self) -> Floats:
        """The latest solution in volts, of the grid's shape; arbitrary in cells without an equation."""
        return self.x.ravel()[self.slot]

    def change(self, box: Box, core: Box, laplacian: Laplacian, drive: Floats, *, solve: bool, follow: bool) -> None:
        """Replace the equations of a box of cells, and update the solution there.

        `box`: slices of the cells in the grid; `core`: slices, relative to the box, of the cells without neighbours
        outside the box; only their equations are replaced. `laplacian`: matrix on the grid of the box, its rows in C
        order; `drive` (n,): current into every row of this matrix, in amperes; `solve`: whether to solve the new
        equations in the core, with the voltages around it held fixed (otherwise only new cells, whose value is still 0,
        are updated, by one Jacobi step); `follow`: whether to correct the solution outside the core, too, by a multiple
        of one vector; ignored unless `solve`.
        """
        assert laplacian.grid is not None
        vertex, x = laplacian.grid.vertex, self.x.ravel()
        self._write(self.slot[box][core].ravel(), core, laplacian, drive)
        x[self.slot[box][vertex < 0]] = 0.0
        slot = self.slot[box][vertex >= 0]
        before = x[slot]
        if not solve:
            new = before == 0.0
            inflow, degree = (drive + laplacian.edges @ before)[new], laplacian.diagonal[new]
            x[slot[new]] = np.divide(inflow, degree, out=np.zeros_like(inflow), where=degree > 0.0)
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
        """Overwrite the equations of the finest level in the inner cells of a window.

        `there` (cells,): positions of these cells in flattened arrays (2, slots) of the finest level, whose row 0 holds
        red and row 1 black cells; `core`: slices of these cells, relative to the window; `laplacian, drive`: matrix on
        the grid of the window, and currents (n,) in amperes.
        """
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
        """Assign every new black cell to the aggregate (coarse node) of a black cell that is two steps away.

        The two steps lead through a red cell. Of all such paths to a cell with an aggregate, the one is taken whose
        weaker conductance is largest; without such a path the new cell stays without an aggregate. A cell is new if it
        has an equation and no aggregate yet. `slot` (m,): indices of some black cells in arrays over the black cells of
        the finest level, from 0; `present` (m,): whether each has an equation; cells without an equation get the number
        0, which stands for no aggregate.
        """
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
