"""From one level of the hierarchy to the next: a graph of conductances and how it shrinks.

Aggregates never join across a wall: on grids they are the connected parts of blocks of two cells a side; on other
netlists they are grown node by node along the strongest conductances.  Where a level has come down to corridors one
node wide, its nodes of at most two neighbours are eliminated instead, which is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.solvers.multigrid import aggregation, clusters
from resgrid.solvers.star_mesh import eliminate_rows

_COARSEST = 250
_MOST_LEVELS = 40
_LEAST_SHRINKAGE = 0.98
_BLOCKS_SHRINK = 0.6
"""Share of nodes above which blocks have fallen apart at weak conductances; others are grown in their place."""

_WEAK = 0.1
_CORRIDORS = 0.3
"""Share of nodes with at most two neighbours from which elimination takes the place of aggregation."""

_MEMBERS = 4
"""Nodes of an aggregate that is grown."""

_CLUSTERS_SHRINK = 0.7
"""Share of nodes above which aggregates are grown along weak conductances, too."""


@dataclass(frozen=True, eq=False)
class Graph:
    """One level: conductances by rows, leaks to the rails, and where its nodes lie on a grid (None for netlists)."""

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    conductance: NDArray[np.float64]
    leak: NDArray[np.float64]
    coordinate: NDArray[np.int32] | None

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.leak)


@dataclass(frozen=True, eq=False)
class Step:
    """The way from a level to the next.

    `target` (n,): node of the next level that a node belongs to; without meaning where it is eliminated; `rows`
    (eliminated, 3): the eliminated nodes in their order, and their neighbours (-1 for none); empty where nodes are
    aggregated; `weights` (eliminated, 3): shares of the neighbours, and the reciprocal of the diagonal.
    """

    target: NDArray[np.int32]
    rows: NDArray[np.int32]
    weights: NDArray[np.float64]


def coarsen_down(graph: Graph) -> tuple[list[Graph], list[Step]]:
    """Coarsen a graph until it is small, or does not shrink any more."""
    graphs: list[Graph] = [graph]
    steps: list[Step] = []
    while graph.size > _COARSEST and len(graphs) < _MOST_LEVELS:
        step, coarse = _next(graph, first=not steps)
        if coarse.size > _LEAST_SHRINKAGE * graph.size:
            break
        graphs.append(coarse)
        steps.append(step)
        graph = coarse
    return graphs, steps


def _next(graph: Graph, *, first: bool) -> tuple[Step, Graph]:
    if not first and np.count_nonzero(np.diff(graph.indptr) <= 2) > _CORRIDORS * graph.size:
        return _eliminated(graph)
    if graph.coordinate is not None:
        step, coarse = _blocks(graph, graph.coordinate)
        if coarse.size <= _BLOCKS_SHRINK * graph.size:
            return step, coarse
    return _clusters(graph)


def _aggregation(aggregate: NDArray[np.int32]) -> Step:
    return Step(aggregate, np.empty((0, 3), dtype=np.int32), np.empty((0, 3)))


def _eliminated(graph: Graph) -> tuple[Step, Graph]:
    """Eliminate the nodes of at most two neighbours (`resgrid.solvers.star_mesh`)."""
    coupling = sparse.csr_array((graph.conductance, graph.indices, graph.indptr), shape=(graph.size, graph.size))
    shrunk = eliminate_rows(coupling, graph.leak)
    core = shrunk.edges
    coordinate = None if graph.coordinate is None else graph.coordinate[shrunk.kept]
    coarse = Graph(core.indptr, core.indices, core.data, shrunk.ground, coordinate)
    return Step(shrunk.number, shrunk.log.rows, shrunk.log.weights[:, ::2]), coarse


def _blocks(graph: Graph, coordinate: NDArray[np.int32]) -> tuple[Step, Graph]:
    """Blocks of two cells along every axis but those that conduct badly, split where conductances are weak."""
    rows = (graph.indptr, graph.indices, graph.conductance)
    mean = aggregation.mean_along(*rows, coordinate)
    shift = (mean > _WEAK * mean.max()).astype(np.int64)
    g = graph.conductance
    weak = _WEAK if g.min() < _WEAK * g.max() else 0.0
    aggregate, count = aggregation.aggregate_blocks(*rows, coordinate, shift, weak)
    coarse = aggregation.coarsen(*rows, graph.leak, aggregate, count)
    shape = aggregation.block_shape(*rows, aggregate, coordinate, shift, count)
    aggregation.lengthen(*coarse, *shape)
    return _aggregation(aggregate), Graph(*coarse, shape[0])


def _clusters(graph: Graph) -> tuple[Step, Graph]:
    """Aggregates grown along the strongest conductances, and along all of them where those are too few."""
    rows = (graph.indptr, graph.indices, graph.conductance, graph.leak)
    aggregate, count = clusters.grow_aggregates(*rows, _MEMBERS, True)
    if count > _CLUSTERS_SHRINK * graph.size:
        aggregate, count = clusters.grow_aggregates(*rows, _MEMBERS, False)
    return _aggregation(aggregate), Graph(*clusters.sum_up(*rows, aggregate, count), None)
