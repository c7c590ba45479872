"""Many chips of one circuit: what the nominal one was prepared with serves all others.

A chip of a grid has its own finest level, and the nominal coarse ones; of other circuits, the nominal order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.jit import kernel
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.multigrid.conjugate_gradients import ROUNDING, GridProblem, Stop, converge, iterate
from resgrid.solvers.multigrid.grid_level import compensate
from resgrid.solvers.multigrid.hierarchy import Hierarchy, build_hierarchy
from resgrid.solvers.multigrid.krylov import gather_rows, norm, scatter_rows
from resgrid.solvers.multigrid.levels import Finest
from resgrid.solvers.multigrid.red_black import Floats, Indices, Integers, Stencil
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
    """An order of elimination for a circuit, whatever its conductances."""

    order: Symbolic
    name = "direct"

    def solve(
        self, chips: Iterable[Chip], rtol: float, solution: NDArray[np.float64], reached: NDArray[np.bool_]
    ) -> None:
        """As `GridBatch.solve`; ``rtol`` bounds the error of voltages, relative to the largest."""
        for number, chip in enumerate(chips):
            matrix = self.order.matrix._replace(edges=chip.entries, ground=chip.ground)
            try:
                factors = factor_in_order(self.order.of(matrix))
            except AccuracyError:
                continue
            solution[number] = factors.solve(chip.drive)
            # Entries of a solution for currents of one sign are right to some roundings.
            summed = factors.solve(np.abs(chip.drive)) if chip.drive.min() < 0.0 else solution[number]
            rounding = _ROUNDINGS * np.abs(summed).max()
            reached[number] = rounding <= max(rtol, _FORBIDDEN) * np.abs(solution[number]).max()
