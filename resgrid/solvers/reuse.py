"""What was made ready for one circuit serves others: many chips of it, and the same one with changed cells.

Many chips: one of a grid has its own finest level, and the nominal coarse ones; of other circuits, the nominal order.

Warm start: the equations of a grid change in a window, old levels precondition, old voltages begin.  The finest level
is written over where its equations have changed; coarser levels stay.  In the window the new equations are solved at
once, with the voltages around it held.  What lies outside follows along one mode ``v``: with ``A v = 0`` outside and in
the window (the drop from the high rail; or 1, above the only rail), ``x + alpha v`` is best, in the energy norm, for
``alpha = v.(b - A x) / v.A v``, and both products come from the window's rim alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.jit import kernel
from resgrid.solvers.factor import factor_multigrid
from resgrid.solvers.laplacian import Conductances, Grid, Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.multigrid.conjugate_gradients import ROUNDING, GridProblem, Stop, converge, iterate
from resgrid.solvers.multigrid.grid_level import compensate, lay_out
from resgrid.solvers.multigrid.hierarchy import Hierarchy, build_hierarchy, finest_stencils
from resgrid.solvers.multigrid.krylov import gather_rows, norm, scatter_rows
from resgrid.solvers.multigrid.levels import Finest
from resgrid.solvers.multigrid.red_black import Floats, Indices, Integers, Lattice, Stencil
from resgrid.solvers.supernodal import factor_in_order
from resgrid.solvers.symbolic import Symbolic

_DEPTH = 12
"""Steps that are kept before they are gone: a whole burst."""

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


class Chip(NamedTuple):
    """Equations of a chip whose nodes are joined as the nominal one's are.

    `entries` (entries,): of the edges, row by row, in siemens; `ground` (n,): in siemens; `drive` (n,): in amperes;
    `mostly`: by how much most of its conductances exceed the nominal ones, as a power of two.
    """

    entries: NDArray[np.float64]
    ground: NDArray[np.float64]
    drive: NDArray[np.float64]
    mostly: float


@dataclass(frozen=True, eq=False)
class GridBatch:
    """A grid made ready for other conductances.

    `hierarchy`: of the nominal chip; `face` (entries,): where the entries of red rows belong, as `_refill` takes it;
    `start` (n,): where the iteration begins, in volts.
    """

    laplacian: Laplacian
    hierarchy: Hierarchy
    face: NDArray[np.int64]
    start: NDArray[np.float64]
    name = "multigrid"

    def solve(
        self, chips: Iterable[Chip], rtol: float, solution: NDArray[np.float64], reached: NDArray[np.bool_]
    ) -> None:
        """Solve for some chips, and tell which were.  Shapes: `solution` (chips, n), `reached` (chips,)."""
        hierarchy, edges = self.hierarchy, self.laplacian.edges
        ordinary, slot = hierarchy.largest_degree / hierarchy.unit, hierarchy.slot
        problem = _own(hierarchy)
        diagonal, leak, x = np.empty(len(slot)), np.zeros_like(problem.currents), np.empty_like(problem.currents)
        for number, chip in enumerate(chips):
            unit = hierarchy.unit * chip.mostly
            first, (_, stencil, compensated, _) = problem.finest[:2], problem.finest
            _refill(edges.indptr, chip.entries, chip.ground, self.face, slot, unit, first, leak.ravel(), diagonal)
            compensate(stencil, leak, compensated, np.zeros(leak.shape[1]))
            # A row whose own diagonal exceeds an ordinary one counts for so much less.
            wanted = rtol * norm(chip.drive * np.minimum(1.0, ordinary / diagonal)) / unit
            x[:] = 0.0
            scatter_rows(slot, self.start, 1.0, x.ravel())
            scatter_rows(slot, chip.drive, 1.0 / unit, problem.currents.ravel())
            stop = Stop(wanted, ROUNDING * float(diagonal.max()), unit)
            residual = converge(problem, x, stop, None)
            solution[number] = gather_rows(slot, x.ravel())
            reached[number] = residual <= max(wanted, _LEFT * ordinary * norm(solution[number]))


def grid_batch(laplacian: Laplacian, drive: NDArray[np.float64]) -> GridBatch | None:
    """Lay a grid out by colour; None where it has no two colours.  Shapes: `drive` (n,)."""
    hierarchy = build_hierarchy(laplacian)
    if hierarchy.grid is None:
        return None
    start, _ = iterate(laplacian, hierarchy, drive, 1e-12)
    return GridBatch(laplacian, hierarchy, _faces(laplacian, hierarchy.slot, hierarchy.grid.true), start)


def _faces(laplacian: Laplacian, slot: NDArray[np.int32], true: Stencil) -> NDArray[np.int64]:
    edges, slot, slots = laplacian.edges, slot.astype(np.int64), len(true.black_degree)
    row = np.repeat(np.arange(len(slot)), np.diff(edges.indptr))
    of_entry = np.zeros(len(row), dtype=np.int64)
    entry = np.flatnonzero(slot[row] < slots)
    here, there = slot[row[entry]], slot[edges.indices[entry]] - slots
    away = there - here
    face = np.full(len(entry), -1)
    for q, distance in enumerate(true.distance.tolist()):
        face[away == distance] = q
    couplings = np.flatnonzero(face < 0)
    face[couplings[np.lexsort((there[couplings], here[couplings]))]] = -1 - np.arange(len(couplings))
    of_entry[entry] = face
    return of_entry


def _own(hierarchy: Hierarchy) -> GridProblem:
    """A finest level and work space that nobody else writes to, without currents."""
    assert hierarchy.grid is not None
    true, stencil, degree, way = hierarchy.grid
    finest = Finest(_copied(true), _copied(stencil), degree.copy(), way)
    return GridProblem(finest, hierarchy.levels, np.zeros((2, len(degree))), _DEPTH)


def _copied(stencil: Stencil) -> Stencil:
    arrays = ("faces", "couplings", "red_inverse", "black_inverse", "black_degree")
    return stencil._replace(**{name: getattr(stencil, name).copy() for name in arrays})


@kernel
def _refill(
    indptr: Indices, conductance: Floats, ground: Floats, face: Integers, slot: Indices, unit: float,
    first: tuple[Stencil, Stencil], leak: Floats, diagonal: Floats,
) -> None:  # fmt: skip
    """Write the conductances of a chip onto its finest level, and its ``diagonal`` (n,), all in units.

    ``face`` says where an entry of a red row belongs: its face, or -1 less its coupling; ``leak`` (2 slots,)
    receives what leads to the rails.
    """
    true, stencil = first
    scale, slots = 1.0 / unit, len(true.black_degree)
    for i in range(len(slot)):
        here, degree = slot[i], ground[i] * scale
        leak[here] = degree
        for k in range(indptr[i], indptr[i + 1]):
            g = conductance[k] * scale
            degree += g
            if here < slots:
                if face[k] >= 0:
                    true.faces[face[k], here] = g
                    stencil.faces[face[k], here] = g
                else:
                    true.couplings[-1 - face[k]] = g
                    stencil.couplings[-1 - face[k]] = g
        diagonal[i] = degree
        if here < slots:
            true.red_inverse[here] = 1.0 / degree
            stencil.red_inverse[here] = 1.0 / degree
        else:
            true.black_degree[here - slots] = degree
            stencil.black_inverse[here - slots] = 1.0 / degree


@dataclass(frozen=True, eq=False)
class FactoredBatch:
    """An order of elimination for a circuit like this one, whatever its conductances."""

    matrix: Conductances
    order: Symbolic
    name = "direct"

    def solve(
        self, chips: Iterable[Chip], rtol: float, solution: NDArray[np.float64], reached: NDArray[np.bool_]
    ) -> None:
        """As `GridBatch.solve`; ``rtol`` bounds the error of voltages, relative to the largest."""
        for number, chip in enumerate(chips):
            matrix = self.matrix._replace(edges=chip.entries, ground=chip.ground)
            try:
                factors = factor_in_order(matrix, self.order)
            except AccuracyError:
                continue
            solution[number] = factors.solve(chip.drive)
            # Entries of a solution for currents of one sign are right to some roundings.
            summed = factors.solve(np.abs(chip.drive)) if chip.drive.min() < 0.0 else solution[number]
            rounding = _ROUNDINGS * np.abs(summed).max()
            reached[number] = rounding <= max(rtol, _FORBIDDEN) * np.abs(solution[number]).max()


class Window(NamedTuple):
    """The equations of a box of cells: right, but for rows on its rim.

    `laplacian` (n, n): on the grid of the box; `drive` (n,): current into every row, in amperes; `core`: those cells
    of the box whose equations are whole: what has changed lies among them.
    """

    box: tuple[slice, ...]
    laplacian: Laplacian
    drive: NDArray[np.float64]
    core: tuple[slice, ...]

    @property
    def vertex(self) -> NDArray[np.int32]:
        """Row of every cell of the box, -1 for none."""
        assert self.laplacian.grid is not None
        return self.laplacian.grid.vertex


class WarmGrid:
    """The equations ``A x = b`` of a grid that change, and their latest solution.

    Parameters
    ----------
    hierarchy : Hierarchy
        Of a grid of two colours, all of whose rows are cells; what changes is written into it.
    finest : Finest
        Its finest level.
    drive : ndarray of float64, shape (n,)
        Right-hand side, in amperes.
    flat : bool
        Whether constants are the mode outside of windows: there is a single rail.  Otherwise it is ``1 - x``.
    """

    def __init__(self, hierarchy: Hierarchy, finest: Finest, drive: NDArray[np.float64], flat: bool) -> None:
        lattice = Lattice(tuple(ends.stop - ends.start for ends in hierarchy.box))
        self._hierarchy, self._finest, self._lattice, self._flat = hierarchy, finest, lattice, flat
        self._first = np.array([ends.start for ends in hierarchy.box], dtype=np.int64)
        self._b, self._x = np.zeros((2, 2, lattice.slots))
        index = np.ix_(*(np.arange(n) for n in lattice.shape))
        self._slots = lattice.slot(lattice.number(index)).ravel().astype(np.int32)
        scatter_rows(hierarchy.slot, drive, 1.0 / hierarchy.unit, self._b.ravel())

    @classmethod
    def of(cls, laplacian: Laplacian, drive: NDArray[np.float64], flat: bool) -> WarmGrid | None:
        """Levels of a grid, at rest; None where it is no grid of two colours that coarsens by blocks."""
        hierarchy = build_hierarchy(laplacian)
        return None if hierarchy.grid is None else cls(hierarchy, hierarchy.grid, drive, flat)

    def covers(self, box: tuple[slice, ...]) -> bool:
        """Whether the levels have a slot for every cell of a box."""
        last = self._first + self._lattice.shape
        return all(
            a <= ends.start and ends.stop <= b
            for ends, a, b in zip(box, self._first.tolist(), last.tolist(), strict=True)
        )

    def solve(self, rtol: float, watch: Watch) -> None:
        """Iterate from the latest solution on.

        Raises
        ------
        AccuracyError
            If the iteration stagnates.
        """
        begun, allowed = bool(self._x.any()), rtol * norm(self._b.ravel())
        hierarchy, largest = self._hierarchy, self._hierarchy.largest_degree / self._hierarchy.unit
        degree = self._finest.true.black_degree
        even = float(degree.max()) <= _EVEN * float(degree.min(where=degree > 0.0, initial=np.inf))
        stop = Stop(allowed, ROUNDING * largest, hierarchy.unit, self._x if begun else None, rtol if even else 0.0)
        problem = GridProblem(self._finest, hierarchy.levels, self._b)
        size = converge(problem, self._x, stop, watch)
        scale = 2.0 * largest * norm(self._x.ravel()) + norm(self._b.ravel())
        error = size / (scale or 1.0)
        if not error <= rtol:
            raise AccuracyError(f"a warm start stagnates at a backward error of {error:.1e}, above rtol = {rtol:.1e}")
        watch.done(error)

    def values(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """The latest solution in every cell of the grid, of its shape; undefined where a cell has no row."""
        there: NDArray[np.float64] = gather_rows(self._slots, self._x.ravel()).reshape(self._lattice.shape)
        if shape == self._lattice.shape:
            return there
        values = np.zeros(shape)
        values[self._hierarchy.box] = there
        return values

    def change(self, window: Window, *, solve: bool = True, follow: bool = False) -> None:
        """Take over the equations of a window; solve them, and let the outside follow."""
        vertex, x = window.vertex, self._x.ravel()
        slot = self._lattice.slot(self._number(window.box))
        self._write(window)
        x[slot[vertex < 0]] = 0.0
        slot = slot[vertex >= 0]
        before = x[slot]
        if not solve:
            laplacian, new = window.laplacian, before == 0.0
            fed, degree = (window.drive + laplacian.edges @ before)[new], laplacian.diagonal[new]
            x[slot[new]] = np.divide(fed, degree, out=np.zeros_like(fed), where=degree > 0.0)
            return
        core = np.full_like(vertex, -1)
        core[window.core] = vertex[window.core]
        own = np.zeros(len(before), dtype=np.bool_)
        own[core[core >= 0]] = True
        if not own.any():
            return
        core[core >= 0] = np.arange(np.count_nonzero(own), dtype=np.int32)
        inner = replace(window.laplacian.within(own), grid=Grid(core, (False,) * core.ndim))
        factor = factor_multigrid(inner)
        from_rim = window.laplacian.edges[own][:, ~own]
        after = factor.solve(window.drive[own] + from_rim @ before[~own], rtol=_WINDOW_RTOL)
        if follow and from_rim.nnz:
            mode = np.ones_like(before) if self._flat else 1.0 - before
            followed = factor.solve(from_rim @ mode[~own], rtol=_WINDOW_RTOL)
            at_rim = from_rim @ mode[~own]
            energy = float(at_rim @ (mode[own] - followed))
            alpha = float(at_rim @ (after - before[own])) / energy if energy > 0.0 else 0.0
            after += alpha * followed
            np.add(x, alpha if self._flat else alpha * (1.0 - x), out=x, where=x != 0.0)
        x[slot[own]] = after

    def _number(self, box: tuple[slice, ...]) -> NDArray[np.int64]:
        """Numbers of the cells of a box, of its shape."""
        first = self._first.tolist()
        return self._lattice.number(
            np.ix_(*(np.arange(ends.start - a, ends.stop - a) for ends, a in zip(box, first, strict=True)))
        )

    def _write(self, window: Window) -> None:
        """Write the equations of a window's core over those of the finest level."""
        true, finest, margin, unit = self._finest.true, self._finest, self._lattice.margin, self._hierarchy.unit
        listed, drive = window.laplacian.listed, np.append(window.drive, 0.0)[window.vertex[window.core]].ravel()
        assert listed is not None
        found = lay_out(*listed, window.vertex, window.laplacian.ground, unit)
        assert found is not None
        small = found[0].lattice
        new = finest_stencils(found[0])
        here = small.number(np.ix_(*map(np.arange, small.shape)))[window.core].ravel()
        there = self._number(window.box)[window.core].ravel()
        for colour in range(2):
            mine = (here & 1) == colour
            source, target = small.margin + (here[mine] >> 1), margin + (there[mine] >> 1)
            self._b[colour, target] = drive[mine] / unit
            if colour == 0:
                for old, fresh in zip((true, finest.stencil), new[:2], strict=True):
                    old.faces[:, target] = fresh.faces[:, source]
                    old.red_inverse[target] = fresh.red_inverse[source]
            else:
                true.black_degree[target] = new[0].black_degree[source]
                finest.stencil.black_inverse[target] = new[1].black_inverse[source]
                finest.degree[target] = new[2][source]
                self._aggregate(target, new[1].black_inverse[source] > 0.0)

    def _aggregate(self, slot: NDArray[np.int64], present: NDArray[np.bool_]) -> None:
        """Black slots that are new join the aggregate of a black one behind the strongest red neighbour."""
        target, faces, distance = self._finest.way.aggregate, self._finest.true.faces, self._lattice.distance
        target[slot[~present]] = 0
        for k in slot[present & (target[slot] == 0)].tolist():
            red = k - distance
            strength = np.minimum(faces[np.arange(len(red)), red][:, np.newaxis], faces[:, red].T)
            onwards = np.where(strength > 0.0, red[:, np.newaxis] + distance, k)
            strength[target[onwards] == 0] = 0.0
            best = np.unravel_index(int(np.argmax(strength)), strength.shape)
            if strength[best] > 0.0:
                target[k] = target[onwards[best]]
