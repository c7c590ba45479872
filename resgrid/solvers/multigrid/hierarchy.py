"""The hierarchy that preconditions the multigrid solver: red-black grids and graphs for grids, graphs for netlists."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.laplacian import EdgeList, Laplacian
from resgrid.solvers.multigrid.blocks import Coarsened, coarsen
from resgrid.solvers.multigrid.graphs import coarsen_down, pack_graphs, pack_netlist
from resgrid.solvers.multigrid.grid_level import Level, compensated, in_double, in_single, lay_out, to_graph
from resgrid.solvers.multigrid.levels import Finest, GridLevel, Levels, Way
from resgrid.solvers.multigrid.red_black import Stencil
from resgrid.solvers.team import ALONE, Team

_WHOLE = 32
"""Cells that the finest level may begin at multiples of: its blocks lie as they would from the first cell on."""

_SMALL = 250
_SHRINKAGE = 0.6
"""Share of nodes above which a grid has fallen apart, and a graph takes its place."""

_MOST_EXTRAS, _MOST_EXTRAS_KEPT = 0.1, 0.5
"""Share of nodes beside the lattice above which a graph serves better than a grid."""

UNSCALED = np.empty(0, dtype=np.float32)

FirstLevel = tuple[Stencil, Stencil, NDArray[np.float64]]
"""The finest level in double precision and in single, and the black diagonal that makes up for that, (slots,)."""


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


def build_hierarchy(laplacian: Laplacian, team: Team = ALONE) -> Hierarchy:
    """Coarsen a nodal system until it is small, and invert what is left."""
    found = lay_out_grid(laplacian, team)
    if found is not None:
        level, slot, unit, box = found
        made = _grid_levels(*coarsen_beside(level, team))
        if made is not None:
            finest, levels = made
            return Hierarchy(levels, slot, unit, unit * largest_degree(finest.true), finest, box)
    # A grid's rows are sorted by a thread beside this one for refinement: their order is not to depend on who is first.
    rows = laplacian.as_rows(ordered=laplacian.grid is not None)
    unit = float(rows.data.mean()) if rows.data.size else float(laplacian.ground.mean())
    graphs, slot = pack_netlist(rows, laplacian.ground, unit)
    inverse = graphs.inverse[: laplacian.size]
    largest = unit / float(inverse.min(initial=np.inf, where=inverse > 0.0))
    return Hierarchy(Levels((), graphs), slot, unit, largest)


def coarsen_beside(level: Level, team: Team, *, keep: bool = False) -> tuple[list[Level], list[Coarsened], FirstLevel]:
    """Coarsen a grid and lay its finest level out, side by side: of degrees coarsening asks only which are positive."""
    coarse, finest = team.together(
        [partial(coarsen_grid, level, keep=keep, team=team), partial(finest_stencils, level)]
    )
    return *coarse, finest


def coarsen_grid(level: Level, *, keep: bool = False, team: Team = ALONE) -> tuple[list[Level], list[Coarsened]]:
    """Coarsen a grid by blocks until it falls apart or is small."""
    levels: list[Level] = [level]
    steps: list[Coarsened] = []
    while True:
        made = coarsen(levels[-1], split=level.uneven, keep=keep, team=team)
        if made is None or made.level.size > _SHRINKAGE * levels[-1].size:
            break
        coarse = made.level
        levels.append(coarse)
        steps.append(made)
        extras = sum(len(cell) for cell in coarse.extra_cell)
        if coarse.size < _SMALL or extras > (_MOST_EXTRAS_KEPT if keep else _MOST_EXTRAS) * coarse.size:
            break
    return levels, steps


def _grid_levels(levels: list[Level], steps: list[Coarsened], first: FirstLevel) -> tuple[Finest, Levels] | None:
    """Lay grids out for the compiled passes, and coarsen the last one as a graph; None where it does not shrink."""
    level, targets = levels[0], [step.target for step in steps]
    graph, number = to_graph(levels[-1])
    graphs, shrinking = coarsen_down(graph)
    if not targets:
        if not shrinking:
            return None
        number[number >= 0] = shrinking[0][number[number >= 0]]
        targets = [np.arange(level.lattice.slots, 2 * level.lattice.slots, dtype=np.int32)]
        graphs, shrinking = graphs[1:], shrinking[1:]
    packed, rank = pack_graphs(graphs, shrinking)
    targets[-1] = counted(number, rank, targets[-1])
    grids = tuple(
        GridLevel(in_single(coarse), coarse.degree[1].copy(), Way(target, UNSCALED))
        for coarse, target in zip(levels[1:-1], targets[1:], strict=True)
    )
    return Finest(*first, Way(targets[0], UNSCALED)), Levels(grids, packed)


def finest_stencils(level: Level) -> FirstLevel:
    """The finest level; takes over its degrees."""
    stencil = in_single(level)
    degree = compensated(level, stencil)
    return in_double(level), stencil, degree


def counted(number: NDArray[np.int32], rank: NDArray[np.int32], slot: NDArray[np.integer]) -> NDArray[np.int32]:
    """Where a graph's nodes at some slots stand, counted from 1; 0 for none, as at slot 0."""
    node = number[slot]
    return np.where(node >= 0, rank[node] + 1, 0).astype(np.int32)


def largest_degree(true: Stencil) -> float:
    """Largest diagonal entry of the finest level."""
    red = float(true.red_inverse.min(initial=np.inf, where=true.red_inverse > 0))
    return max(float(true.black_degree.max()), 1.0 / red)


def lay_out_grid(
    laplacian: Laplacian, team: Team = ALONE
) -> tuple[Level, NDArray[np.int32], float, tuple[slice, ...]] | None:
    """Lay a system out by colour; the level, slots, unit and box, or None where it is no grid of two colours."""
    if laplacian.grid is None:
        return None
    node = laplacian.grid.vertex
    pairs, conductance, row = laplacian.listed or EdgeList(
        *laplacian.as_rows().pairs, np.arange(laplacian.size, dtype=np.int32)
    )
    if not conductance.size:
        return None
    unit = float(conductance.mean())
    box = _box_around_rows(row, node)
    laid_out = lay_out(pairs, conductance, row, np.ascontiguousarray(node[box]), laplacian.ground, unit, team)
    return None if laid_out is None else (*laid_out, unit, box)


def _box_around_rows(row: NDArray[np.int32], node: NDArray[np.int32]) -> tuple[slice, ...]:
    """The range of cells along every axis outside which no cell has a row, from whole blocks of several levels on."""
    box: tuple[slice, ...] = ()
    for axis in range(node.ndim):
        lines = np.moveaxis(node[box], axis, 0)
        first = _leading_without_rows(row, lines) // _WHOLE * _WHOLE
        box = (*box, slice(first, len(lines) - _leading_without_rows(row, lines[:first:-1])))
    return box


def _leading_without_rows(row: NDArray[np.int32], lines: NDArray[np.int32]) -> int:
    """How many lines from the first one on have no row in any cell; searched in steps that double and halve."""
    count, step = 0, 1
    while count < len(lines) and step:
        some = lines[count : count + step]
        if np.any(row[some[some >= 0]] >= 0):
            step //= 2
        else:
            count += len(some)
            step *= 2
    return count
