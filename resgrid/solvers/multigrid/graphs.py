"""From one graph of conductances to the next: aggregates are grown, and corridors shrink by exact elimination.

Aggregates are grown node by node along the strongest conductances, so that they never join across a wall.  Where a
level has come down to corridors one node wide, its nodes of at most two neighbours are eliminated instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from resgrid.jit import inner
from resgrid.solvers.star_mesh import eliminate_rows

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Singles = NDArray[np.float32]

_COARSEST = 250
_MOST_LEVELS = 40
_LEAST_SHRINKAGE = 0.98
_CORRIDORS = 0.3
"""Share of nodes with at most two neighbours from which elimination takes the place of aggregation."""

_MEMBERS = 4
"""Nodes of an aggregate that is grown."""

_CLUSTERS_SHRINK = 0.7
"""Share of nodes above which aggregates are grown along weak conductances, too."""

_WEAK = 0.2
"""Share of its conductances (or of the first node's) by which a node must hang on an aggregate to join it."""

_BESIDE_STRONGEST = 0.7
"""It may join, too, if it hangs on it by so much of the first node's strongest conductance."""

_TAKEN, _NONE = np.float32(-1.0), np.float32(0.0)


@dataclass(frozen=True, eq=False)
class Graph:
    """One level: conductances by rows, in any order, and leaks to the rails."""

    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    conductance: NDArray[np.float64]
    leak: NDArray[np.float64]

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
    return _clusters(graph)


def _eliminated(graph: Graph) -> tuple[Step, Graph]:
    """Eliminate the nodes of at most two neighbours (`resgrid.solvers.star_mesh`)."""
    coupling = sparse.csr_array((graph.conductance, graph.indices, graph.indptr), shape=(graph.size, graph.size))
    shrunk = eliminate_rows(coupling, graph.leak)
    core = shrunk.edges
    coarse = Graph(core.indptr, core.indices, core.data, shrunk.ground)
    return Step(shrunk.number, shrunk.log.rows, shrunk.log.weights[:, ::2]), coarse


def _clusters(graph: Graph) -> tuple[Step, Graph]:
    """Aggregates grown along the strongest conductances, and along all of them where those are too few."""
    rows = (graph.indptr, graph.indices, graph.conductance, graph.leak)
    aggregate, count = grow_aggregates(*rows, _MEMBERS, True)
    if count > _CLUSTERS_SHRINK * graph.size:
        aggregate, count = grow_aggregates(*rows, _MEMBERS, False)
    return Step(aggregate, np.empty((0, 3), dtype=np.int32), np.empty((0, 3))), Graph(*sum_up(*rows, aggregate, count))


@njit(cache=True)
def grow_aggregates(
    indptr: Indices, indices: Indices, conductance: Floats, leak: Floats, most: int, strict: bool
) -> tuple[Indices, int]:
    """Aggregates of up to ``most`` nodes, grown one by one.

    From the first node that is still alone an aggregate takes in, again and again, the neighbour that hangs on it most:
    by the greatest sum of conductances, over the root of all that the neighbour has.  A node that finds no free
    neighbour joins the aggregate at the other end of its strongest conductance.  Unless ``strict``, weak conductances
    count, too, and an aggregate is never full, so that only nodes without neighbours stay alone.
    """
    n = len(indptr) - 1
    degree, scale, strongest = _degrees(indptr, conductance, leak)
    aggregate = np.full(n, -1, np.int32)
    members = np.zeros(n, np.int32)
    weight = np.zeros(n, np.float32)
    candidate = np.empty(n + 1, np.int32)
    count = 0
    for first in range(n):
        if aggregate[first] >= 0:
            continue
        aggregate[first] = count
        weight[first] = _TAKEN
        size, new, found = 1, first, 0
        while True:
            for k in range(indptr[new], indptr[new + 1]):
                j = indices[k]
                held = weight[j]
                candidate[found] = j
                found += held == 0.0
                weight[j] = held + np.float32(conductance[k]) if held >= 0.0 else held
            if size == most:
                break
            best, joins = _NONE, -1
            for c in range(found):
                j = candidate[c]
                hold = weight[j] * scale[j]
                joins = j if hold > best else joins
                best = hold if hold > best else best
            if joins < 0:
                break
            needed = min(_WEAK * min(degree[first], degree[joins]), _BESIDE_STRONGEST * strongest[first])
            if strict and weight[joins] < needed:
                break
            aggregate[joins] = count
            weight[joins] = _TAKEN
            new = joins
            size += 1
        for c in range(found):
            weight[candidate[c]] = min(weight[candidate[c]], _NONE)
        if size == 1:
            host = _host(indptr, indices, conductance, aggregate, first)
            if host >= 0 and (members[host] < most + most // 2 or not strict):
                aggregate[first] = host
                members[host] += 1
                continue
        members[count] = size
        count += 1
    return aggregate, count


@inner
def _degrees(indptr: Indices, conductance: Floats, leak: Floats) -> tuple[Floats, Singles, Floats]:
    """All conductances of a node summed, one over the root of that, and the strongest one."""
    n = len(leak)
    degree, scale, strongest = np.empty(n), np.empty(n, np.float32), np.empty(n)
    for i in range(n):
        total, most = leak[i], 0.0
        for k in range(indptr[i], indptr[i + 1]):
            total += conductance[k]
            most = max(most, conductance[k])
        degree[i], strongest[i] = total, most
        scale[i] = 1.0 / np.sqrt(total) if total > 0.0 else 0.0
    return degree, scale, strongest


@inner
def _host(indptr: Indices, indices: Indices, conductance: Floats, aggregate: Indices, node: int) -> int:
    """The aggregate at the other end of a node's strongest conductance; -1 where it has none."""
    best, host = 0.0, -1
    for k in range(indptr[node], indptr[node + 1]):
        if conductance[k] > best:
            best, host = conductance[k], aggregate[indices[k]]
    return host


@njit(cache=True)
def sum_up(
    indptr: Indices, indices: Indices, conductance: Floats, leak: Floats, aggregate: Indices, count: int
) -> tuple[Indices, Indices, Floats, Floats]:
    """Sum conductances between aggregates, and leaks within them; rows come out unsorted."""
    n = len(leak)
    start = np.zeros(count + 1, np.int32)
    for node in range(n):
        start[aggregate[node] + 1] += 1
    for row in range(count):
        start[row + 1] += start[row]
    member, fill = np.empty(n, np.int32), start[:-1].copy()
    for node in range(n):
        member[fill[aggregate[node]]] = node
        fill[aggregate[node]] += 1
    new_indptr, new_leak = np.zeros(count + 1, np.int32), np.zeros(count)
    new_indices, new_conductance = np.empty(len(indices) + 1, np.int32), np.empty(len(indices) + 1)
    place, inner = np.full(count, -1, np.int32), len(indices)
    size = 0
    for row in range(count):
        begin = size
        place[row] = inner
        for m in range(start[row], start[row + 1]):
            node = member[m]
            new_leak[row] += leak[node]
            for k in range(indptr[node], indptr[node + 1]):
                column = aggregate[indices[k]]
                known = place[column] >= begin
                at = place[column] if known else size
                place[column] = at
                new_indices[at] = column
                new_conductance[at] = conductance[k] + (new_conductance[at] if known else 0.0)
                size += not known
        place[row] = -1
        new_indptr[row + 1] = size
    return new_indptr, new_indices[:size].copy(), new_conductance[:size].copy(), new_leak
