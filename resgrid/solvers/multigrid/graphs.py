"""From one graph of conductances to the next: aggregates are grown node by node along the strongest ones.

So they never join across a wall.  Loops over neighbours avoid branches that cannot be foreseen; they would take most of
the time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Singles = NDArray[np.float32]

_COARSEST = 250
_MOST_LEVELS = 40
_LEAST_SHRINKAGE = 0.98
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


def coarsen_down(graph: Graph) -> tuple[list[Graph], list[NDArray[np.int32]]]:
    """Coarsen a graph until it is small, or does not shrink any more.

    Returns all graphs, and the node of the next one that every node belongs to, shape (n,) each.
    """
    graphs: list[Graph] = [graph]
    targets: list[NDArray[np.int32]] = []
    while graph.size > _COARSEST and len(graphs) < _MOST_LEVELS:
        rows = (graph.indptr, graph.indices, graph.conductance, graph.leak)
        aggregate, count = grow_aggregates(*rows, _MEMBERS, True)
        if count > _CLUSTERS_SHRINK * graph.size:
            aggregate, count = grow_aggregates(*rows, _MEMBERS, False)
        if count > _LEAST_SHRINKAGE * graph.size:
            break
        graph = Graph(*sum_up(*rows, aggregate, count))
        graphs.append(graph)
        targets.append(aggregate)
    return graphs, targets


@kernel
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


@kernel
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
    slot, inner = np.full(count, -1, np.int32), len(indices)
    size = 0
    for row in range(count):
        begin = size
        slot[row] = inner
        for m in range(start[row], start[row + 1]):
            node = member[m]
            new_leak[row] += leak[node]
            for k in range(indptr[node], indptr[node + 1]):
                column = aggregate[indices[k]]
                known = slot[column] >= begin
                at = slot[column] if known else size
                slot[column] = at
                new_indices[at] = column
                new_conductance[at] = conductance[k] + (new_conductance[at] if known else 0.0)
                size += not known
        slot[row] = -1
        new_indptr[row + 1] = size
    return new_indptr, new_indices[:size].copy(), new_conductance[:size].copy(), new_leak
