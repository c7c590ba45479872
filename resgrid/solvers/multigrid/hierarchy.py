"""The hierarchy that preconditions the multigrid solver: boards and graphs for grids, graphs for other netlists."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.solvers.laplacian import EdgeList, Grid, Laplacian
from resgrid.solvers.multigrid.aggregation import coordinates
from resgrid.solvers.multigrid.boards import Level, lay_out
from resgrid.solvers.multigrid.grid_levels import GridLevels, coarsen_grid
from resgrid.solvers.multigrid.kernels import Stack
from resgrid.solvers.multigrid.levels import Graph, coarsen_down
from resgrid.solvers.multigrid.stack import stack_graph, stack_levels

_WHOLE = 32
"""Cells that boards may begin at multiples of: their blocks lie as they would from the first cell on."""


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """What preconditions the conjugate gradients.

    `stack`: the levels that are graphs: all of them, or those below the boards; `grid`: the boards, where the circuit
    is a grid of two colours; `unit`: conductance that counts as 1 on all levels, in siemens; `box`: the range of
    cells along every axis that the boards cover.
    """

    stack: Stack
    grid: GridLevels | None
    unit: float
    box: tuple[slice, ...] = ()

    def largest_degree(self, laplacian: Laplacian) -> float:
        """Largest diagonal entry of a system's matrix, in siemens."""
        if self.grid is not None:
            return self.grid.largest_degree * self.unit
        return float(laplacian.diagonal.max(initial=0.0))


def build_hierarchy(laplacian: Laplacian) -> Hierarchy:
    """Coarsen a nodal system until it is small, and invert what is left."""
    found = lay_out_grid(laplacian)
    if found is not None:
        level, place, unit, box = found
        made = coarsen_grid(level, place)
        if made is not None:
            return Hierarchy(made[1], made[0], unit, box)
    where = _coordinates(laplacian)
    rows = laplacian.rows if where is None else laplacian.edges
    unit = float(rows.data.mean()) if rows.nnz else float(laplacian.ground.mean())
    finest = Graph(rows.indptr, rows.indices, rows.data / unit, laplacian.ground / unit, where)
    stack = stack_graph(finest) if where is None else stack_levels(*coarsen_down(finest), free=True)
    return Hierarchy(stack, None, unit)


def lay_out_grid(laplacian: Laplacian) -> tuple[Level, NDArray[np.int32], float, tuple[slice, ...]] | None:
    """Lay a system out by colour; the level, places, unit and box, or None where it is no grid of two colours."""
    if laplacian.grid is None:
        return None
    (pairs, conductance, row), node = _edges(laplacian, laplacian.grid)
    if not conductance.size:
        return None
    unit = float(conductance.mean())
    box = _box_around_rows(row, node)
    laid_out = lay_out(pairs, conductance, row, np.ascontiguousarray(node[box]), laplacian.ground, unit)
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


def _edges(laplacian: Laplacian, grid: Grid) -> tuple[EdgeList, NDArray[np.int32]]:
    """The edges as a list, and the vertex of every cell."""
    if laplacian.listed is not None:
        return laplacian.listed, grid.vertex
    upper = sparse.triu(laplacian.edges, format="coo")
    pairs = np.stack([upper.row, upper.col], axis=1).astype(np.int32)
    return EdgeList(pairs, upper.data, np.arange(laplacian.size, dtype=np.int32)), grid.vertex


def _coordinates(laplacian: Laplacian) -> NDArray[np.int32] | None:
    """Where every row lies on the grid, where each is one cell."""
    if laplacian.grid is None:
        return None
    vertex = laplacian.grid.vertex
    row = (vertex if laplacian.listed is None else laplacian.grid.of_rows(laplacian.listed.row).vertex).ravel()
    cells = np.flatnonzero(row >= 0)
    cell = np.full(laplacian.size, -1, dtype=np.int64)
    cell[row[cells]] = cells
    if len(cells) != laplacian.size or np.any(cell < 0):
        return None
    return coordinates(cell, np.array(vertex.shape))
