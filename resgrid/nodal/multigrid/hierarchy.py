"""The hierarchy of ever coarser graphs that preconditions the multigrid solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid import aggregation
from resgrid.nodal.multigrid.checkerboard import lay_out
from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.multigrid.levels import Graph, coarsen_down
from resgrid.nodal.multigrid.stack import stack_graph, stack_levels
from resgrid.nodal.system import NodalSystem


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """What preconditions the conjugate gradients.

    Attributes
    ----------
    stack : Stack
        The levels as graphs; with a board they begin with the first coarse one.
    board : Board or None
        The first level by colour, where the circuit is a grid of two colours.
    place : ndarray of int64, shape (n,)
        Where every unknown lies on the board: its black place, or -1 less its red place; empty without a board.
    reach : int
        How many rows behind its own a row of the system has neighbours.
    unit : float
        Conductance that counts as 1 on all levels, in siemens.
    """

    stack: Stack
    board: Board | None
    place: NDArray[np.int64]
    reach: int
    unit: float


def build_hierarchy(system: NodalSystem) -> Hierarchy:
    """Coarsen a nodal system until it is small, and invert what is left.

    Parameters
    ----------
    system : NodalSystem

    Returns
    -------
    Hierarchy
    """
    coupling = system.coupling
    unit = float(coupling.data.mean()) if coupling.nnz else float(system.excess.mean())
    cell = _cells(system)
    coordinate = None if cell is None else _coordinates(system, cell)
    finest = Graph(coupling.indptr, coupling.indices, coupling.data / unit, system.excess / unit, coordinate)
    if cell is None:
        return Hierarchy(stack_graph(finest), None, np.empty(0, dtype=np.int64), 0, unit)
    graphs, steps = coarsen_down(finest)
    laid_out = None
    if steps:
        shape = system.netlist.layout.space.shape  # type: ignore[union-attr]
        laid_out = lay_out(coupling, system.excess, cell, shape, steps[0].target, unit)
    if laid_out is None:
        return Hierarchy(stack_levels(graphs, steps, free=True), None, np.empty(0, dtype=np.int64), 0, unit)
    return Hierarchy(
        stack_levels(graphs[1:], steps[1:]), *laid_out, aggregation.reach(coupling.indptr, coupling.indices), unit
    )


def _cells(system: NodalSystem) -> NDArray[np.int64] | None:
    """Flat cell index of every row, where each row is the node of one cell."""
    if system.netlist.layout is None:
        return None
    cell_of = system.netlist.cell_of_node()
    nodes = np.flatnonzero(system.unknown >= 0)
    if len(nodes) != system.size or np.any(cell_of[nodes] < 0):
        return None
    cell = np.empty(system.size, dtype=np.int64)
    cell[system.unknown[nodes]] = cell_of[nodes]
    return cell


def _coordinates(system: NodalSystem, cell: NDArray[np.int64]) -> NDArray[np.int32]:
    layout = system.netlist.layout
    assert layout is not None
    return aggregation.coordinates(cell, np.array(layout.space.shape))
