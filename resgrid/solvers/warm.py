"""Warm start: the equations of a grid change in a window, old levels precondition, old voltages begin.

The finest level is written over where its equations have changed; coarser levels stay.  In the window the new equations
are solved at once, with the voltages around it held.  What lies outside follows along one mode ``v``: with ``A v = 0``
outside and in the window (the drop from the high rail; or 1, above the only rail), ``x + alpha v`` is best, in the
energy norm, for ``alpha = v.(b - A x) / v.A v``, and both products come from the window's rim alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.grids import slab
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.factors.multigrid import factor_multigrid
from resgrid.solvers.laplacian import EdgeList, Grid, Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.multigrid.conjugate_gradients import ROUNDING, GridProblem, Stop, converge
from resgrid.solvers.multigrid.grid_level import lay_out
from resgrid.solvers.multigrid.hierarchy import Hierarchy, build_hierarchy, finest_stencils
from resgrid.solvers.multigrid.krylov import gather_rows, norm, scatter_rows
from resgrid.solvers.multigrid.levels import Finest
from resgrid.solvers.multigrid.red_black import Lattice

_WINDOW_RTOL = 1e-10
"""Residual of a window: the mode outside is found from small differences at its rim."""


@dataclass(frozen=True, eq=False)
class Window:
    """The equations of a box of cells, with a rim of cells around those that are solved for.

    `low`: first cell of the box; `row`: which cells have a row, of the box's shape; `edges`: conductances from every
    cell to the next one along each axis, 0 unless both have rows, one shorter along the axis; `ground, drive`: ground
    conductance and current into every cell, of the box's shape, right within `core`; `core`: the cells to solve for;
    `changed`: those whose equations have changed, within the core.
    """

    low: tuple[int, ...]
    row: NDArray[np.bool_]
    edges: tuple[NDArray[np.float64], ...]
    ground: NDArray[np.float64]
    drive: NDArray[np.float64]
    core: tuple[slice, ...]
    changed: tuple[slice, ...]

    @property
    def box(self) -> tuple[slice, ...]:
        """Where the box lies in the grid."""
        return tuple(slice(first, first + n) for first, n in zip(self.low, self.row.shape, strict=True))

    def relaxed(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """One relaxation of every row, of the box's shape: ``(b + G x) / degree``."""
        degree = self.ground + _into(self.edges, np.ones(self.row.shape), self.row)
        total = self.drive + _into(self.edges, values, self.row)
        return np.divide(total, degree, out=np.zeros_like(total), where=self.row & (degree > 0.0))


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
        stop = Stop(allowed, ROUNDING * largest, hierarchy.unit, self._x if begun else None, rtol)
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
        self._write(window)
        cells = [np.arange(ends.start, ends.stop) for ends in window.box]
        number = self._lattice.number(np.ix_(*(c - a for c, a in zip(cells, self._first.tolist(), strict=True))))
        slot, x = self._lattice.slot(number), self._x.ravel()
        before = np.where(window.row, x[slot], 0.0)
        x[slot[~window.row]] = 0.0
        if not solve:
            new = window.row & (before == 0.0)
            x[slot[new]] = window.relaxed(before)[new]
            return
        inner = _Inner.of(window)
        after = before.copy()
        after[inner.mask] = inner.solve(window.drive[inner.mask] + inner.from_rim(before))
        if follow and inner.rim.any():
            mode = np.ones_like(before) if self._flat else 1.0 - before
            followed = inner.solve(inner.from_rim(mode))
            moved = mode.copy()
            moved[inner.mask] -= followed
            missing, energy = inner.at_rim(after - before, mode), inner.at_rim(moved, mode)
            alpha = missing / energy if energy > 0.0 else 0.0
            after[inner.mask] += alpha * followed
            np.add(x, alpha if self._flat else alpha * (1.0 - x), out=x, where=x != 0.0)
        x[slot[inner.mask]] = after[inner.mask]

    def _write(self, window: Window) -> None:
        """Write the equations of the changed cells over those of the finest level."""
        true, finest, lattice, unit = self._finest.true, self._finest, self._lattice, self._hierarchy.unit
        vertex, pairs, conductance = _edge_list(window.row, window.edges)
        row = np.arange(np.count_nonzero(window.row), dtype=np.int32)
        found = lay_out(pairs, conductance, row, vertex, window.ground[window.row], unit)
        assert found is not None
        small = found[0].lattice
        new = finest_stencils(found[0])
        cells = np.ix_(*(np.arange(ends.start, ends.stop) for ends in window.changed))
        here = small.number(cells).ravel()
        shift = [int(a) for a in np.array(window.low) - self._first]
        there = lattice.number([c + a for c, a in zip(cells, shift, strict=True)]).ravel()
        for colour in range(2):
            mine = (here & 1) == colour
            source, target = small.margin + (here[mine] >> 1), lattice.margin + (there[mine] >> 1)
            self._b[colour, target] = window.drive[window.changed].ravel()[mine] / unit
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


@dataclass(frozen=True, eq=False)
class _Inner:
    """The rows of a window's core, with those around it held.

    `mask`: cells to solve for; `rim`: cells around them with rows; `factor`: of the former; None if there are none.
    """

    window: Window
    mask: NDArray[np.bool_]
    rim: NDArray[np.bool_]
    factor: Factor | None

    @classmethod
    def of(cls, window: Window) -> _Inner:
        core = np.zeros_like(window.row)
        core[window.core] = True
        mask = window.row & core
        vertex, pairs, conductance = _edge_list(mask, window.edges)
        rim = window.row & ~core
        ground = window.ground + _into(window.edges, rim.astype(np.float64), rim)
        row = np.arange(np.count_nonzero(mask), dtype=np.int32)
        grid = Grid(vertex, (False,) * vertex.ndim)
        listed = EdgeList(pairs, conductance, row)
        laplacian = Laplacian(ground[mask], listed=listed, grid=grid, dimensions=grid.dimensions)
        return cls(window, mask, rim, factor_multigrid(laplacian) if laplacian.size else None)

    def solve(self, currents: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voltages for currents into the rows."""
        return currents if self.factor is None else self.factor.solve(currents, rtol=_WINDOW_RTOL)

    def from_rim(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """What values of the rim drive into the rows."""
        return _into(self.window.edges, values, self.rim)[self.mask]

    def at_rim(self, inside: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
        """What values inside drive into the rim, weighted and summed."""
        return float(np.sum((weight * _into(self.window.edges, inside, self.mask))[self.rim]))


def neighbours(array: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Views of all cells that have a next one along an axis, and of those next ones."""
    n = array.shape[axis]
    return slab(array, axis, 0, n - 1), slab(array, axis, 1, n)


def _into(
    edges: tuple[NDArray[np.float64], ...], values: NDArray[np.float64], source: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """``sum_j g_ij x_j`` over the neighbours that are sources, of the box's shape."""
    values = np.where(source, values, 0.0)
    total = np.zeros_like(values)
    for axis, edge in enumerate(edges):
        below, above = neighbours(total, axis)
        lower, upper = neighbours(values, axis)
        below += edge * upper
        above += edge * lower
    return total


def _edge_list(
    rows: NDArray[np.bool_], edges: tuple[NDArray[np.float64], ...]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Rows numbered in C order, and the edges between them.  Returns `vertex`, of the box, `pairs`, `conductance`."""
    vertex = np.full(rows.shape, -1, dtype=np.int32)
    vertex[rows] = np.arange(np.count_nonzero(rows), dtype=np.int32)
    pairs, conductance = zip(*_along_axes(vertex, edges), strict=True)
    return vertex, np.ascontiguousarray(np.concatenate(pairs)), np.concatenate(conductance)


def _along_axes(
    vertex: NDArray[np.int32], edges: tuple[NDArray[np.float64], ...]
) -> Iterator[tuple[NDArray[np.int32], NDArray[np.float64]]]:
    for axis, edge in enumerate(edges):
        lower, upper = neighbours(vertex, axis)
        kept = (lower >= 0) & (upper >= 0) & (edge > 0.0)
        yield np.stack([lower[kept], upper[kept]], axis=1), edge[kept]
