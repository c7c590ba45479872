"""The hierarchy that preconditions the multigrid solver, and the equations as it preconditions them.

Red-black grids and graphs for grids, graphs for netlists.

A grid is preconditioned on one thread or several, with the same digits, whatever their number: the finest grids are cut
into slabs (`resgrid.solvers.multigrid.sweeps`); levels below are too small to be worth a wait.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers import llvm_intrinsics
from resgrid.solvers.csr_kernels import row_residual
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.multigrid import krylov
from resgrid.solvers.multigrid.cycle import ENOUGH, help_sweep, precondition_graph, precondition_grid
from resgrid.solvers.multigrid.graph_coarsening import coarsen_down, pack_graphs, pack_netlist
from resgrid.solvers.multigrid.graph_sweeps import work_space
from resgrid.solvers.multigrid.grid_coarsening import coarsen
from resgrid.solvers.multigrid.grid_level import Level, compensated, in_single, lay_out, stencil_of, to_graph
from resgrid.solvers.multigrid.levels import (
    GRID,
    Finest,
    GridLevel,
    Levels,
    blocks_of,
    slabs_of,
)
from resgrid.solvers.multigrid.red_black import Stencil
from resgrid.solvers.scaled import Floats, Singles
from resgrid.solvers.threads import ALONE, ThreadTeam

_WHOLE = 32
"""Cells that the finest level may begin at multiples of: its blocks lie as they would from the first cell on."""

_SMALL = 250
_SHRINKAGE = 0.6
"""Share of nodes above which a grid has fallen apart, and a graph takes its place."""

_MOST_EXTRAS = 0.1
"""Share of nodes beside the lattice above which a graph serves better than a grid."""


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """What preconditions the conjugate gradients.

    `levels`: the coarse levels; of a netlist, the finest one too; `slot` (n,): where every row stands among the
    vectors: of a grid, red cells first; `unit`: conductance that counts as 1 on all levels, in siemens;
    `largest_degree`: largest diagonal entry of the matrix, in siemens; `grid`: the finest level of a grid of two
    colours; `box`: the range of cells along every axis that it covers.
    """

    levels: Levels
    slot: NDArray[np.int32]
    unit: float
    largest_degree: float
    grid: Finest | None = None
    box: tuple[slice, ...] = ()


def build_hierarchy(laplacian: Laplacian, team: ThreadTeam = ALONE) -> Hierarchy:
    """Coarsen a nodal system until it is small, and invert what is left."""
    found = lay_out_grid(laplacian)
    if found is not None:
        level, slot, unit, box = found
        coarse, first = team.together([partial(coarsen_grid, level), partial(finest_stencils, level)])
        made = _grid_levels(coarse[0], coarse[1], first)
        if made is not None:
            finest, levels = made
            return Hierarchy(levels, slot, unit, unit * largest_degree(finest.true), finest, box)
    rows = laplacian.as_rows()
    unit = float(rows.data.mean()) if rows.data.size else float(laplacian.ground.mean())
    graphs, slot = pack_netlist(rows, laplacian.ground, unit)
    inverse = graphs.inverse[: laplacian.size]
    largest = unit / float(inverse.min(initial=np.inf, where=inverse > 0.0))
    return Hierarchy(Levels((), graphs), slot, unit, largest)


def coarsen_grid(level: Level) -> tuple[list[Level], list[NDArray[np.int32]]]:
    """Coarsen a grid by blocks until it falls apart or is small; the levels, and where black slots lead, (slots,)."""
    levels, targets = [level], list[NDArray[np.int32]]()
    while True:
        made = coarsen(levels[-1], split=level.uneven)
        if made is None or made[0].size > _SHRINKAGE * levels[-1].size:
            break
        coarse, target = made
        levels.append(coarse)
        targets.append(target[1].copy())
        extras = sum(len(cell) for cell in coarse.extra_cell)
        if coarse.size < _SMALL or extras > _MOST_EXTRAS * coarse.size:
            break
    return levels, targets


def _grid_levels(
    levels: list[Level], targets: list[NDArray[np.int32]], first: tuple[Stencil, Stencil]
) -> tuple[Finest, Levels] | None:
    """Lay grids out for the compiled passes, and coarsen the last one as a graph; None where it does not shrink."""
    level = levels[0]
    graph, number = to_graph(levels[-1])
    graphs, shrinking = coarsen_down(graph)
    if not targets:
        if not shrinking:
            return None
        number[number >= 0] = shrinking[0][number[number >= 0]]
        targets = [np.arange(level.lattice.slots, 2 * level.lattice.slots, dtype=np.int32)]
        graphs, shrinking = graphs[1:], shrinking[1:]
    packed, rank = pack_graphs(graphs, shrinking)
    node = number[targets[-1]]
    targets[-1] = np.where(node >= 0, rank[node] + 1, 0).astype(np.int32)  # none at slot 0
    grids = tuple(
        GridLevel(in_single(stencil_of(coarse)), target)
        for coarse, target in zip(levels[1:-1], targets[1:], strict=True)
    )
    return Finest(*first, targets[0]), Levels(grids, packed)


def finest_stencils(level: Level) -> tuple[Stencil, Stencil]:
    """The finest level in double precision and in single, whose black diagonal makes up for that."""
    double = stencil_of(level)
    single = in_single(double)
    return double._replace(black_inverse=np.empty(0)), single._replace(black_degree=compensated(level, single))


def largest_degree(true: Stencil) -> float:
    """Largest diagonal entry of the finest level."""
    red = float(true.red_inverse.min(initial=np.inf, where=true.red_inverse > 0))
    return max(float(true.black_degree.max()), 1.0 / red)


def lay_out_grid(laplacian: Laplacian) -> tuple[Level, NDArray[np.int32], float, tuple[slice, ...]] | None:
    """Lay a system out by colour; the level, slots, unit and box, or None where it is no grid of two colours.

    Outside the box no cell has a row; it begins with whole blocks of several levels.
    """
    if laplacian.grid is None:
        return None
    pairs, conductance, row = laplacian.listed or laplacian.as_rows().listed
    cells = laplacian.grid.of_rows(row).vertex
    used = cells >= 0
    if not conductance.size or not used.any():
        return None
    unit, box = float(conductance.mean()), list[slice]()
    for axis in range(cells.ndim):
        lines = np.flatnonzero(used.any(axis=tuple(other for other in range(cells.ndim) if other != axis)))
        box.append(slice(int(lines[0]) // _WHOLE * _WHOLE, int(lines[-1]) + 1))
    laid_out = lay_out(pairs, conductance, row, cells[*box], laplacian.ground, unit)
    return None if laid_out is None else (*laid_out, unit, tuple(box))


class GridProblem:
    """The equations of a grid's black cells, ``S = D - G^T R G``, the red ones eliminated, in the hierarchy's units.

    Its levels are cut into slabs for the threads of a team.

    `finest`: of the levels; `currents` (2, slots): into both colours; `x` (2, slots): the solution, which is improved;
    `vectors`: of the iteration; `relaxes`: whether what they lack can be made up for by relaxing all cells.
    """

    relaxes = True

    def __init__(self, finest: Finest, levels: Levels, currents: Floats, x: Floats, team: ThreadTeam = ALONE) -> None:
        self.team, self._graphs, self.work = team, levels.graphs, work_space(levels.graphs)
        self.vectors = krylov.vectors_over(finest.stencil.black_inverse)
        self.state = np.zeros(llvm_intrinsics.PLACES, dtype=np.int64)
        grids = (GridLevel(finest.stencil, finest.aggregate), *levels.grids)
        slots = [len(of.aggregate) for of in grids]
        cuts = [slabs_of(of.stencil, team.size) for of in grids[:-1]]
        cuts.append(slabs_of(grids[-1].stencil, 1))  # nodes of a graph may have parts in several slabs
        self._parts = cuts[0]
        sums, shares = np.empty((blocks_of(finest.stencil), 3)), np.empty(2)
        self._kept: dict[tuple[int, str], NDArray[np.generic]] = {}
        self.table = np.zeros(len(grids), dtype=GRID)
        fed = [np.zeros((2, count), dtype=np.float32) for count in slots[1:]]
        answers = [np.zeros((2, count), dtype=np.float32) for count in slots[1:]]
        below = [*zip(fed, answers, strict=True), (self.work.b[: 1 + self._graphs.first[1]], self.work.x)]
        self._rooms = np.zeros((max(len(cut) for cut in cuts), max(of.stencil.block for of in grids)))
        for number, (of, cut, (into, answer)) in enumerate(zip(grids, cuts, below, strict=True)):
            slabs = [(*slab[:-1], room.ctypes.data) for slab, room in zip(cut, self._rooms, strict=False)]
            self.table["parts"][number], self.table["below_slots"][number] = len(cut), into.size
            self._note(number, sums=sums, shares=shares, slabs=np.array(slabs), below_fed=into, below=answer)
            if number:
                self._fill(number, of)
                (red_fed, black_fed), (red, before) = fed[number - 1], answers[number - 1]
                r, s, z, w, c = np.zeros((5, slots[number]), dtype=np.float32)
                self._note(number, red_fed=red_fed, black_fed=black_fed, red=red, before=before)
                self._note(number, r=r, s=s, z=z, w=w, c=c, led=np.zeros(slots[number]))
        self.begin(finest, currents, x)

    def begin(self, finest: Finest, currents: Floats, x: Floats) -> None:
        """Take up another finest level of the same cells, and what belongs to it."""
        self.finest, self.currents, self.x = finest, currents, x
        self.vectors = v = self.vectors._replace(inverse=finest.stencil.black_inverse)
        self._fill(0, GridLevel(finest.stencil, finest.aggregate))
        # The red cells of the solution follow its black ones whenever there is a residual.
        self._note(0, before=v.before, r=v.r, s=v.s, w=v.w, led=x[0])

    def _fill(self, number: int, of: GridLevel) -> None:
        """Describe a grid by its row of the table."""
        stencil, row = of.stencil, self.table[number]
        sides, slots = stencil.faces.shape
        counts = {
            "slots": slots, "sides": sides, "margin": stencil.margin, "block": stencil.block,
            "blocks": blocks_of(stencil), "joined": len(stencil.couplings),
        }  # fmt: skip
        for name, count in counts.items():
            row[name] = count
        names = ("faces", "distance", "off_red", "off_black", "couplings", "red_inverse", "black_inverse")
        self._note(number, **{name: getattr(stencil, name) for name in names})
        self._note(number, degree=stencil.black_degree, aggregate=of.aggregate)

    def _note(self, number: int, **arrays: NDArray[np.generic]) -> None:
        """Write addresses of arrays, and keep these."""
        row = self.table[number]
        for name, array in arrays.items():
            assert array.flags.c_contiguous
            row[name] = array.ctypes.data
            self._kept[number, name] = array

    def residual(self, r: Floats) -> float:
        """``r = b - A x`` (slots,), and its norm; relaxes the red cells."""
        return krylov.black_residual(self.finest.true, self.currents, self.x, r, self._parts, self.team)

    def precondition(self, z: Singles, stop: float = ENOUGH) -> tuple[float, float, float]:
        """Precondition ``r`` into ``z``, and multiply into ``w``; returns ``z.r, z.w, z.s``; `run_cycle` says more."""
        self.write_into(z)
        if len(self._parts) == 1:
            return self._lead(stop)
        made = list[float]()
        llvm_intrinsics.begin_jobs(self.state)

        def part(number: int) -> None:  # keeps what the table points to, whoever is interrupted
            if number:
                help_sweep(self.table, self.state)
            else:
                made.extend(self._lead(stop))

        self.team.share(part, self.team.size)
        rest, product, gamma = made
        return rest, product, gamma

    def write_into(self, z: Singles) -> None:
        """Let the finest level have its answer there."""
        self._answer, self.table["z"][0] = z, z.ctypes.data
        margin = self.finest.stencil.margin
        z[:margin], z[len(z) - margin :] = 0.0, 0.0

    def _lead(self, stop: float) -> tuple[float, float, float]:
        return precondition_grid(self.table, self.state, self._graphs, self.work, stop)


class GraphProblem:
    """As `GridProblem`, of a netlist's rows: `x` (1, n), in the order of the finest level.  Shapes: `b` (n,)."""

    relaxes = False

    def __init__(self, laplacian: Laplacian, hierarchy: Hierarchy, b: Floats, team: ThreadTeam) -> None:
        self.x, self.team, self._graphs = np.zeros((1, len(b))), team, hierarchy.levels.graphs
        self.vectors = krylov.vectors_over(self._graphs.inverse[: len(b)])
        self._matrix, self._b = laplacian.graph, b
        self._slot, self._unit, self._work = hierarchy.slot, hierarchy.unit, work_space(self._graphs)

    def residual(self, r: Floats) -> float:
        """As of `GridProblem`."""
        if self.x.any():
            row_residual(self._matrix, self._slot, self._b, self.x[0, self._slot], r)
            r *= 1.0 / self._unit
        else:
            r[self._slot] = self._b / self._unit
        return krylov.norm(r)

    def precondition(self, z: Singles) -> tuple[float, float, float]:
        """As of `GridProblem`."""
        return precondition_graph(self._graphs, self._work, self.vectors.r, self.vectors.s, z, self.vectors.w)


Problem = GridProblem | GraphProblem
