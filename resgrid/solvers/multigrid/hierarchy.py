"""The hierarchy of levels that preconditions conjugate gradients, and the equations that conjugate gradients solve.

`build_hierarchy` computes the levels; `GridProblem` and `GraphProblem` hold the equations, the solution and the
vectors, compute residuals and apply the preconditioner.

The levels of a grid are red-black grids, and graphs from the coarsest grid on; the levels of a netlist are graphs.

A grid is preconditioned on one thread or several, with bitwise equal results: the finest grids are divided into slabs
(`resgrid.solvers.multigrid.sweeps`). Levels below are too small for the cost of synchronization.
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
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

_WHOLE = 32
"""The range of cells that the finest level covers begins, along every axis, at a multiple of this number of cells.

The blocks of coarse levels then do not depend on the width of a border without unknowns.
"""

_SMALL = 250
"""Number of nodes of a grid below which coarsening continues with a graph."""

_SHRINKAGE = 0.6
"""Ratio of the nodes of a coarse grid to those of the finer one above which coarsening continues with a graph."""

_MOST_EXTRAS = 0.1
"""Fraction of extra nodes among the nodes of a grid above which coarsening continues with a graph.

Extra nodes are the connected components of a disconnected block of cells except its first one.
"""


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The multigrid preconditioner of a matrix with ``n`` rows.

    `levels`: the coarse levels; for a netlist, also the finest one; `slot` (n,): position of every row on the finest
    level: in a netlist, its index in vectors (n,); in a grid, a red cell's index in an array (slots,) over the red
    cells, or the number of slots plus a black cell's index in an array over the black cells; `unit`: conductance in
    siemens by which the conductances of all levels are divided; `largest_degree`: largest diagonal entry of the matrix,
    in siemens; `grid`: finest level of a red-black grid, None for a netlist; `box`: range of cells along every axis
    that the finest grid covers, empty for a netlist.
    """

    levels: Levels
    slot: NDArray[np.int32]
    unit: float
    largest_degree: float
    grid: Finest | None = None
    box: tuple[slice, ...] = ()


def build_hierarchy(laplacian: Laplacian, threads: ThreadTeam = SINGLE_THREAD) -> Hierarchy:
    """Return the multigrid hierarchy of a matrix; `threads`: share the work of coarsening a grid.

    The matrix is coarsened to about 250 nodes, or until it does not shrink further; the coarsest matrix is inverted if
    it has at most 2000 nodes.
    """
    laid_out = lay_out_grid(laplacian)
    if laid_out is not None:
        level, slot, unit, box = laid_out
        coarse, stencils = threads.together([partial(coarsen_grid, level), partial(finest_stencils, level)])
        stored = _grid_levels(coarse[0], coarse[1], stencils)
        if stored is not None:
            finest, levels = stored
            return Hierarchy(levels, slot, unit, unit * largest_degree(finest.true), finest, box)
    rows = laplacian.as_rows()
    unit = float(rows.data.mean()) if rows.data.size else float(laplacian.ground.mean())
    graphs, slot = pack_netlist(rows, laplacian.ground, unit)
    inverse = graphs.inverse[: laplacian.size]
    largest = unit / float(inverse.min(initial=np.inf, where=inverse > 0.0))
    return Hierarchy(Levels((), graphs), slot, unit, largest)


def coarsen_grid(level: Level) -> tuple[list[Level], list[NDArray[np.int32]]]:
    """Return the levels of a grid, finest first, and the coarse nodes of the black nodes of each level but the last.

    The second list contains one array (slots,) per level: for every black node, by its index in arrays over the black
    nodes of this level, the position of the block on the next level that contains the node. A position is a red block's
    index in an array (coarse slots,), or the number of coarse slots plus a black block's index; 0 at an unused slot. A
    disconnected block of cells is several nodes, one per connected component; all but the first are extra nodes, and
    follow the first nodes of all blocks in arrays. Coarsening by blocks ends with a grid that has fewer than 250 nodes,
    or more than a tenth of extra nodes. It also ends before a grid that has more than 0.6 times as many nodes as the
    finer one, or in which nodes of one colour would be joined.
    """
    levels, targets = [level], list[NDArray[np.int32]]()
    while True:
        coarser = coarsen(levels[-1], split=level.uneven)
        if coarser is None or coarser[0].size > _SHRINKAGE * levels[-1].size:
            break
        coarse, target = coarser
        levels.append(coarse)
        targets.append(target[1].copy())
        extras = sum(len(cell) for cell in coarse.extra_cell)
        if coarse.size < _SMALL or extras > _MOST_EXTRAS * coarse.size:
            break
    return levels, targets


def _grid_levels(
    levels: list[Level], targets: list[NDArray[np.int32]], stencils: tuple[Stencil, Stencil]
) -> tuple[Finest, Levels] | None:
    """Return the finest grid, and the coarse grids with the graphs of coarser levels; None if the grid does not shrink.

    The coarsest grid of `levels` is stored as a graph, and coarsened further as a graph. If the finest grid is the only
    one, its first coarse level is already a graph. Nodes of this first graph are counted from 1 in the results.

    `levels`: grids, finest first; `targets`: for every grid but the last, the position on the next grid of the block of
    every black node, shape (slots,), 0 for none: a red block's index in an array (coarse slots,), or the number of
    coarse slots plus a black block's index (index 0 is unused in both, so that 0 is no block); `stencils`: conductances
    of the finest grid in double and in single precision.
    """
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
    targets[-1] = np.where(node >= 0, rank[node] + 1, 0).astype(np.int32)  # slot 0 belongs to no node
    grids = tuple(
        GridLevel(in_single(stencil_of(coarse)), target)
        for coarse, target in zip(levels[1:-1], targets[1:], strict=True)
    )
    return Finest(*stencils, targets[0]), Levels(grids, packed)


def finest_stencils(level: Level) -> tuple[Stencil, Stencil]:
    """Return the conductances of the finest level in double precision and in single precision.

    The first has no reciprocal black diagonal. The black diagonal of the second compensates the rounding of
    conductances (`grid_level.compensated`).
    """
    double = stencil_of(level)
    single = in_single(double)
    return double._replace(black_inverse=np.empty(0)), single._replace(black_degree=compensated(level, single))


def largest_degree(true: Stencil) -> float:
    """Return the largest diagonal entry of the matrix of the finest grid, divided by ``hierarchy.unit``.

    `true`: the finest grid in double precision.
    """
    red = float(true.red_inverse.min(initial=np.inf, where=true.red_inverse > 0))
    return max(float(true.black_degree.max()), 1.0 / red)


def lay_out_grid(laplacian: Laplacian) -> tuple[Level, NDArray[np.int32], float, tuple[slice, ...]] | None:
    """Return a grid as a `Level`, the position of every row (n,), the unit in siemens, and a box of cells.

    The position of a red cell is its index in an array (slots,) over the red cells of the level; that of a black cell
    is the number of slots plus its index in an array (slots,) over the black cells. The unit is the conductance by
    which all conductances are divided. The box is a range of cells along every axis, which the level covers; outside
    the box no cell has a row. The begin of each range is a multiple of 32 cells, so that the coarse levels have whole
    blocks. Returns None if the matrix is not a grid whose cells can be coloured red and black.
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
    """The equations of a grid's black cells, divided by ``hierarchy.unit``, and their multigrid preconditioner.

    Red cells are eliminated: the matrix is the Schur complement ``S = D - G^T R G``, with the black diagonal ``D``,
    conductances ``G`` from black to red cells, and reciprocal red diagonal ``R``. The levels are divided into slabs for
    the threads.

    A slot is the index of a cell in the arrays of its colour, from 0 for both colours. `finest`: the finest level;
    `currents` (2, slots): currents into red cells (row 0) and black cells (row 1), in amperes divided by
    ``hierarchy.unit`` in siemens; `x` (2, slots): the solution in volts, which is updated; `vectors`: vectors of
    conjugate gradients; `relaxes`: whether a relaxation of all cells can reduce the final residual; `table`: one record
    per grid, for the compiled cycle (`levels.GRID`); `state`: integers that the threads share; `work`: work arrays of
    the graphs below the grids.
    """

    relaxes = True

    def __init__(
        self, finest: Finest, levels: Levels, currents: Floats, x: Floats, threads: ThreadTeam = SINGLE_THREAD
    ) -> None:
        self.threads, self._graphs, self.work = threads, levels.graphs, work_space(levels.graphs)
        self.vectors = krylov.vectors_over(finest.stencil.black_inverse)
        self.state = np.zeros(llvm_intrinsics.PLACES, dtype=np.int64)
        grids = (GridLevel(finest.stencil, finest.aggregate), *levels.grids)
        slots = [len(of.aggregate) for of in grids]
        cuts = [slabs_of(of.stencil, threads.size) for of in grids[:-1]]
        cuts.append(slabs_of(grids[-1].stencil, 1))  # nodes of a graph may have parts in several slabs
        self._parts = cuts[0]
        sums, coefficients = np.empty((blocks_of(finest.stencil), 3)), np.empty(2)
        self._arrays: dict[tuple[int, str], NDArray[np.generic]] = {}
        self.table = np.zeros(len(grids), dtype=GRID)
        rhs = [np.zeros((2, count), dtype=np.float32) for count in slots[1:]]
        solutions = [np.zeros((2, count), dtype=np.float32) for count in slots[1:]]
        below = [*zip(rhs, solutions, strict=True), (self.work.b[: 1 + self._graphs.first[1]], self.work.x)]
        self._buffers = np.zeros((max(len(cut) for cut in cuts), max(of.stencil.block for of in grids)))
        for number, (of, cut, (rhs_below, solution)) in enumerate(zip(grids, cuts, below, strict=True)):
            slabs = [(*slab[:-1], buffer.ctypes.data) for slab, buffer in zip(cut, self._buffers, strict=False)]
            self.table["parts"][number], self.table["below_slots"][number] = len(cut), rhs_below.size
            self._set_addresses(
                number,
                sums=sums,
                coefficients=coefficients,
                slabs=np.array(slabs),
                below_rhs=rhs_below,
                below_x=solution,
            )
            if number:
                self._describe(number, of)
                (red_rhs, black_rhs), (red, before) = rhs[number - 1], solutions[number - 1]
                r, s, z, w, c = np.zeros((5, slots[number]), dtype=np.float32)
                self._set_addresses(number, red_rhs=red_rhs, black_rhs=black_rhs, red=red, before=before)
                self._set_addresses(number, r=r, s=s, z=z, w=w, c=c, red_double=np.zeros(slots[number]))
        self.set_finest(finest, currents, x)

    def set_finest(self, finest: Finest, currents: Floats, x: Floats) -> None:
        """Replace the finest level by another one of the same cells.

        `finest`: the new level; `currents, x` (2, slots): right-hand side in amperes divided by ``hierarchy.unit``, and
        solution in volts; red cells in row 0, black cells in row 1.
        """
        self.finest, self.currents, self.x = finest, currents, x
        self.vectors = v = self.vectors._replace(inverse=finest.stencil.black_inverse)
        self._describe(0, GridLevel(finest.stencil, finest.aggregate))
        # The red cells of the solution follow its black ones whenever there is a residual.
        self._set_addresses(0, before=v.before, r=v.r, s=v.s, w=v.w, red_double=x[0])

    def _describe(self, number: int, of: GridLevel) -> None:
        """Write the numbers and array addresses of the grid ``of`` to the table of grids.

        `number`: index of the record in the table, 0 for the finest grid.
        """
        stencil, row = of.stencil, self.table[number]
        sides, slots = stencil.faces.shape
        counts = {
            "slots": slots, "sides": sides, "margin": stencil.margin, "block": stencil.block,
            "blocks": blocks_of(stencil), "joined": len(stencil.couplings),
        }  # fmt: skip
        for name, count in counts.items():
            row[name] = count
        names = ("faces", "distance", "off_red", "off_black", "couplings", "red_inverse", "black_inverse")
        self._set_addresses(number, **{name: getattr(stencil, name) for name in names})
        self._set_addresses(number, degree=stencil.black_degree, aggregate=of.aggregate)

    def _set_addresses(self, number: int, **arrays: NDArray[np.generic]) -> None:
        """Write addresses of arrays to the table of grids, and keep the arrays alive.

        `number`: index of the record in the table, 0 for the finest grid; `arrays`: arrays by the names of the fields
        of the record (`levels.GRID`) that receive their addresses.
        """
        row = self.table[number]
        for name, array in arrays.items():
            assert array.flags.c_contiguous
            row[name] = array.ctypes.data
            self._arrays[number, name] = array

    def residual(self, r: Floats) -> float:
        """Relax the red cells, write the residual ``b - A x`` at black cells to ``r`` (slots,), and return its norm.

        The residual is in amperes divided by ``hierarchy.unit`` in siemens.
        """
        return krylov.black_residual(self.finest.true, self.currents, self.x, r, self._parts, self.threads)

    def precondition(self, z: Singles, stop: float = ENOUGH) -> tuple[float, float, float]:
        """Precondition the residual ``vectors.r`` into ``z`` (slots,); set ``vectors.w = S z``; return three sums.

        The sums are ``z.r``, ``z.w`` and ``z.s`` with ``s = vectors.s``. `stop`: ratio of the residual norms after and
        before the first step of a K-cycle on the first coarse level below which the second step is skipped.
        """
        self.set_output(z)
        if len(self._parts) == 1:
            return self._precondition(stop)
        products = list[float]()
        llvm_intrinsics.begin_jobs(self.state)

        def part(number: int) -> None:  # holds a reference to the arrays of the table, even if a thread is interrupted
            if number:
                help_sweep(self.table, self.state)
            else:
                products.extend(self._precondition(stop))

        self.threads.run_parts(part, self.threads.size)
        rest, product, gamma = products
        return rest, product, gamma

    def set_output(self, z: Singles) -> None:
        """Set the array ``z`` (slots,) that receives the preconditioned residual of the finest level's black cells.

        Its unused entries at both ends are set to 0.
        """
        self._output, self.table["z"][0] = z, z.ctypes.data
        margin = self.finest.stencil.margin
        z[:margin], z[len(z) - margin :] = 0.0, 0.0

    def _precondition(self, stop: float) -> tuple[float, float, float]:
        """Run the compiled cycle, led by this thread; return ``z.r``, ``z.w`` and ``z.s`` of the finest vectors.

        ``z`` is the correction, ``w`` the product of the matrix with ``z``, and ``s`` that with the last search
        direction. `stop`: ratio of the residual norms after and before the first step of a K-cycle on the first coarse
        level below which the second step is skipped.
        """
        return precondition_grid(self.table, self.state, self._graphs, self.work, stop)


class GraphProblem:
    """The equations of a netlist's rows, divided by ``hierarchy.unit``, in the order of the finest level.

    `laplacian, hierarchy`: the matrix and its multigrid levels; `b` (n,): right-hand side in amperes, in the order of
    rows; `threads`: share the work on the vectors; `x` (1, n): the solution in volts, in the order of the finest level,
    0 at the start, updated; `vectors`: vectors of conjugate gradients, in that order; `relaxes`: False, since no
    relaxation follows the last iteration.
    """

    relaxes = False

    def __init__(self, laplacian: Laplacian, hierarchy: Hierarchy, b: Floats, threads: ThreadTeam) -> None:
        self.x, self.threads, self._graphs = np.zeros((1, len(b))), threads, hierarchy.levels.graphs
        self.vectors = krylov.vectors_over(self._graphs.inverse[: len(b)])
        self._matrix, self._b = laplacian.graph, b
        self._slot, self._unit, self._work = hierarchy.slot, hierarchy.unit, work_space(self._graphs)

    def residual(self, r: Floats) -> float:
        """Write the residual ``b - A x``, in amperes divided by ``hierarchy.unit``, to ``r`` (n,); return its norm.

        ``r`` is in the order of the finest level.
        """
        if self.x.any():
            row_residual(self._matrix, self._slot, self._b, self.x[0, self._slot], r)
            r *= 1.0 / self._unit
        else:
            r[self._slot] = self._b / self._unit
        return krylov.norm(r)

    def precondition(self, z: Singles) -> tuple[float, float, float]:
        """Precondition the residual ``r`` into ``z`` (n,); set ``w = A z``; return ``z.r``, ``z.w`` and ``z.s``.

        The vectors ``r``, ``w`` and ``s`` are those of ``self.vectors``: residual, product, and product of the matrix
        with the last search direction.
        """
        return precondition_graph(self._graphs, self._work, self.vectors.r, self.vectors.s, z, self.vectors.w)


MultigridProblem = GridProblem | GraphProblem
"""Equations that conjugate gradients solve, with their multigrid preconditioner."""
