"""The hierarchy of ever coarser graphs that preconditions the multigrid solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid import aggregation
from resgrid.nodal.multigrid.checkerboard import lay_out
from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.multigrid.levels import Graph, Step, coarsen_down
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
    graphs, steps = coarsen_down(finest)
    laid_out = None
    if cell is not None and steps:
        shape = system.netlist.layout.space.shape  # type: ignore[union-attr]
        laid_out = lay_out(coupling, system.excess, cell, shape, steps[0].target, unit)
    if laid_out is None:
        return Hierarchy(stack_levels(graphs, steps), None, np.empty(0, dtype=np.int64), 0, unit)
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


def stack_levels(graphs: list[Graph], steps: list[Step]) -> Stack:
    """Lay graphs, and the steps between them, one behind the other; the last one is inverted."""
    sizes = [graph.size for graph in graphs]
    first = np.cumsum([0, *sizes])
    entries = np.cumsum([0, *(len(graph.indices) for graph in graphs)])
    degree = np.concatenate([_degree(graph) for graph in graphs])
    work = [np.zeros(first[-1], dtype=np.float32) for _ in range(6)]
    with np.errstate(divide="ignore"):
        inverse = np.where(degree > 0, 1.0 / degree, 0.0)
    starts = [graph.indptr[:-1] + entry for graph, entry in zip(graphs, entries, strict=False)]
    neighbours = [graph.indices + begin for graph, begin in zip(graphs, first, strict=False)]
    targets = [np.where(step.target < 0, 0, step.target + begin) for step, begin in zip(steps, first[1:], strict=False)]
    rows = [np.where(step.rows < 0, -1, step.rows + begin) for step, begin in zip(steps, first, strict=False)]
    return Stack(
        first.astype(np.int64),
        np.array([_red_end(graph, begin) for graph, begin in zip(graphs, first, strict=False)]),
        np.concatenate([*starts, entries[-1:]]).astype(np.uint32),
        np.concatenate(neighbours).astype(np.uint32),
        np.concatenate([graph.conductance for graph in graphs]).astype(np.float32),
        inverse.astype(np.float32),
        degree.astype(np.float32),
        np.concatenate([*targets, np.zeros(sizes[-1], dtype=np.int32)]).astype(np.uint32),
        np.cumsum([0, *(len(step.rows) for step in steps), 0]),
        np.concatenate([np.empty((0, 3), dtype=np.int64), *rows]),
        np.concatenate([np.empty((0, 3)), *(step.weights for step in steps)]).astype(np.float32),
        _inverse(graphs[-1]),
        *work,
    )


def _red_end(graph: Graph, begin: int) -> int:
    """Behind the last of the first nodes, where these and the others have no neighbours among themselves; else -1."""
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    red = int(np.min(graph.indices[row < graph.indices], initial=graph.size))
    return int(begin) + red if not np.any((row < red) == (graph.indices < red)) else -1


def _degree(graph: Graph) -> NDArray[np.float64]:
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    return np.asarray(np.bincount(row, graph.conductance, graph.size) + graph.leak, dtype=np.float64)


def _inverse(graph: Graph) -> NDArray[np.float32]:
    matrix = np.diag(_degree(graph) * (1.0 + 1e-7))
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    matrix[row, graph.indices] -= graph.conductance
    return np.linalg.inv(matrix).astype(np.float32)
