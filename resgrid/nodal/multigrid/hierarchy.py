"""The hierarchy of ever coarser graphs that preconditions the multigrid solver.

Aggregates never join across a wall: on grids they are the connected parts of blocks of two cells a side; on other
netlists pairs of pairs along the strongest conductances (Notay 2010).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid import aggregation
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


def build_hierarchy(system: NodalSystem) -> Stack:
    """Coarsen a nodal system until it is small, and invert what is left.

    Parameters
    ----------
    system : NodalSystem

    Returns
    -------
    Stack
    """
    coupling = system.coupling
    coupling.sort_indices()
    graph = _Graph(coupling.indptr, coupling.indices, coupling.data, system.excess, _coordinates(system))
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
    return _stacked(graphs, aggregates)


def _coordinates(system: NodalSystem) -> NDArray[np.int32] | None:
    """Cell indices of every row, where each row is the node of one cell and conductances are much alike."""
    layout = system.netlist.layout
    g = system.coupling.data
    if layout is None or not g.size or g.max() > _MOST_CONTRAST * g.min():
        return None
    cell_of = system.netlist.cell_of_node()
    nodes = np.flatnonzero(system.unknown >= 0)
    if len(nodes) != system.size or np.any(cell_of[nodes] < 0):
        return None
    coordinate = np.empty((system.size, layout.space.ndim), dtype=np.int32)
    coordinate[system.unknown[nodes]] = np.stack(np.unravel_index(cell_of[nodes], layout.space.shape), axis=1)
    return coordinate


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
    entries = np.cumsum([0, *(len(graph.indices) for graph in graphs)])
    degree = np.concatenate([_degree(graph) for graph in graphs])
    nodes = sum(sizes)
    work = [np.zeros(nodes, dtype=np.float32) for _ in range(6)]
    with np.errstate(divide="ignore"):
        inverse = np.where(degree > 0, 1.0 / degree, 0.0)
    return Stack(
        np.cumsum([0, *sizes]).astype(np.int64),
        np.concatenate(
            [graph.indptr[:-1] + entry for graph, entry in zip(graphs, entries, strict=False)] + [entries[-1:]]
        ),
        np.concatenate([graph.indices for graph in graphs]),
        np.concatenate([graph.conductance for graph in graphs]).astype(np.float32),
        inverse.astype(np.float32),
        degree.astype(np.float32),
        np.concatenate([*aggregates, np.zeros(sizes[-1], dtype=np.int32)]),
        _inverse(graphs[-1]),
        *work,
    )


def _degree(graph: _Graph) -> NDArray[np.float64]:
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    return np.asarray(np.bincount(row, graph.conductance, graph.size) + graph.leak, dtype=np.float64)


def _inverse(graph: _Graph) -> NDArray[np.float32]:
    matrix = np.diag(_degree(graph) * (1.0 + 1e-7))
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    matrix[row, graph.indices] -= graph.conductance
    return np.linalg.inv(matrix).astype(np.float32)
