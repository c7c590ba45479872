"""The hierarchy of ever coarser graphs that preconditions the multigrid solver.

Aggregates never join across a wall: on grids they are the connected parts of blocks of two cells a side; on other
netlists pairs of pairs along the strongest conductances (Notay 2010).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.nodal.multigrid import aggregation
from resgrid.nodal.multigrid.checkerboard import lay_out
from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.system import NodalSystem

_COARSEST = 250
_LEAST_GAIN = 0.9
_MOST_LEVELS = 40
_MOST_CONTRAST = 5.0


@dataclass(frozen=True, eq=False)
class _Graph:
    """One level: conductances by rows, leaks to the rails, and where its nodes lie on a grid (None for netlists)."""

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    conductance: NDArray[np.float64]
    leak: NDArray[np.float64]
    coordinate: NDArray[np.int32] | None

    @property
    def size(self) -> int:
        return len(self.leak)


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
    coordinate = None if cell is None or not _even(coupling.data) else _coordinates(system, cell)
    finest = _Graph(coupling.indptr, coupling.indices, coupling.data / unit, system.excess / unit, coordinate)
    graphs, aggregates = _coarsen_down(finest)
    laid_out = None
    if cell is not None and aggregates:
        shape = system.netlist.layout.space.shape  # type: ignore[union-attr]
        laid_out = lay_out(coupling, system.excess, cell, shape, aggregates[0], unit)
    if laid_out is None:
        return Hierarchy(_stacked(graphs, aggregates), None, np.empty(0, dtype=np.int64), 0, unit)
    return Hierarchy(_stacked(graphs[1:], aggregates[1:]), *laid_out, _reach(coupling), unit)


def _reach(coupling: sparse.csr_array) -> int:
    """How many rows behind its own a row has neighbours."""
    last = coupling.indptr[1:] - 1
    rows = np.flatnonzero(np.diff(coupling.indptr) > 0)
    return int(np.max(coupling.indices[last[rows]] - rows, initial=0))


def _coarsen_down(graph: _Graph) -> tuple[list[_Graph], list[NDArray[np.int32]]]:
    graphs, aggregates = [graph], []
    while graph.size > _COARSEST and len(graphs) < _MOST_LEVELS:
        aggregate, coarse = _coarsened(graph)
        if coarse.size > _LEAST_GAIN * graph.size and graph.coordinate is not None:
            graph = graphs[-1] = _Graph(graph.indptr, graph.indices, graph.conductance, graph.leak, None)
            continue
        if coarse.size > 0.98 * graph.size:
            break
        graphs.append(coarse)
        aggregates.append(aggregate)
        graph = coarse
    return graphs, aggregates


def _even(conductance: NDArray[np.float64]) -> bool:
    """Whether conductances are so much alike that blocks of cells make good aggregates."""
    return bool(conductance.size and conductance.max() <= _MOST_CONTRAST * conductance.min())


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
    return np.ascontiguousarray(np.stack(np.unravel_index(cell, layout.space.shape), axis=1), dtype=np.int32)


def _coarsened(graph: _Graph) -> tuple[NDArray[np.int32], _Graph]:
    if graph.coordinate is None:
        return _paired_twice(graph)
    aggregate, count = aggregation.aggregate_blocks(graph.indptr, graph.indices, graph.coordinate)
    indptr, indices, conductance, leak = aggregation.coarsen(
        graph.indptr, graph.indices, graph.conductance, graph.leak, aggregate, count
    )
    coordinate, width, members, mean = aggregation.block_shape(
        graph.indptr, graph.conductance, aggregate, graph.coordinate, count
    )
    aggregation.lengthen(indptr, indices, conductance, leak, coordinate, width, members, mean)
    return aggregate, _Graph(indptr, indices, conductance, leak, coordinate)


def _paired_twice(graph: _Graph) -> tuple[NDArray[np.int32], _Graph]:
    whole = np.arange(graph.size, dtype=np.int32)
    for _ in range(2):
        aggregate, count = aggregation.aggregate_pairs(graph.indptr, graph.indices, graph.conductance)
        coarse = aggregation.coarsen(graph.indptr, graph.indices, graph.conductance, graph.leak, aggregate, count)
        graph = _Graph(*coarse, None)
        whole = aggregate[whole]
    return whole, graph


def _stacked(graphs: list[_Graph], aggregates: list[NDArray[np.int32]]) -> Stack:
    sizes = [graph.size for graph in graphs]
    first = np.cumsum([0, *sizes])
    entries = np.cumsum([0, *(len(graph.indices) for graph in graphs)])
    degree = np.concatenate([_degree(graph) for graph in graphs])
    work = [np.zeros(first[-1], dtype=np.float32) for _ in range(6)]
    with np.errstate(divide="ignore"):
        inverse = np.where(degree > 0, 1.0 / degree, 0.0)
    starts = [graph.indptr[:-1] + entry for graph, entry in zip(graphs, entries, strict=False)]
    neighbours = [graph.indices + begin for graph, begin in zip(graphs, first, strict=False)]
    parents = [aggregate + begin for aggregate, begin in zip(aggregates, first[1:], strict=False)]
    return Stack(
        first.astype(np.int64),
        np.array([_red_end(graph, begin) for graph, begin in zip(graphs, first, strict=False)]),
        np.concatenate([*starts, entries[-1:]]).astype(np.uint32),
        np.concatenate(neighbours).astype(np.uint32),
        np.concatenate([graph.conductance for graph in graphs]).astype(np.float32),
        inverse.astype(np.float32),
        degree.astype(np.float32),
        np.concatenate([*parents, np.zeros(sizes[-1], dtype=np.int32)]).astype(np.uint32),
        _inverse(graphs[-1]),
        *work,
    )


def _red_end(graph: _Graph, begin: int) -> int:
    """Behind the last of the first nodes, where these and the others have no neighbours among themselves; else -1."""
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    red = int(np.min(graph.indices[row < graph.indices], initial=graph.size))
    return int(begin) + red if not np.any((row < red) == (graph.indices < red)) else -1


def _degree(graph: _Graph) -> NDArray[np.float64]:
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    return np.asarray(np.bincount(row, graph.conductance, graph.size) + graph.leak, dtype=np.float64)


def _inverse(graph: _Graph) -> NDArray[np.float32]:
    matrix = np.diag(_degree(graph) * (1.0 + 1e-7))
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    matrix[row, graph.indices] -= graph.conductance
    return np.linalg.inv(matrix).astype(np.float32)
