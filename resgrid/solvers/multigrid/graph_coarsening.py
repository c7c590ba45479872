"""Coarsening of netlists and coarse grids, both as graphs, by aggregation along the strongest conductances.

Aggregates are grown node by node along the strongest conductances, so that an aggregate never joins both sides of a
barrier of obstacles. A graph is renumbered by colour, so that neighbouring rows of a sweep are independent. Within a
colour, rows are sorted by length in windows: the processor then predicts the ends of inner loops, which saves half of
the time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inner, interruptible, kernel
from resgrid.solvers import ordering_kernels as ordering
from resgrid.solvers.laplacian import Graph, Rows
from resgrid.solvers.multigrid.graph_sweeps import Graphs
from resgrid.solvers.scaled import Floats, Indices, Integers, Singles

_COARSEST = 250
"""Largest number of nodes of a graph that is not coarsened further."""

_MOST_LEVELS = 40
"""Maximum number of graphs of a hierarchy."""

_LEAST_SHRINKAGE = 0.98
"""Ratio of the number of aggregates to the number of nodes above which coarsening ends."""

_MEMBERS = 4
"""Maximum number of nodes of an aggregate, before nodes without a strong neighbour join it."""

_CLUSTERS_SHRINK = 0.7
"""Ratio of the number of aggregates to the number of nodes above which aggregates are grown again.

The second time, nodes also join along weak conductances.
"""

_WEAK = 0.2
"""Least sum of conductances between a node and an aggregate with which the node may join, as a fraction of another sum.

The other sum is over all conductances of the node, or over those of the aggregate's first node if that sum is smaller.
"""

_BESIDE_STRONGEST = 0.7
"""Least sum of conductances between a node and an aggregate with which the node may join even below the limit `_WEAK`.

The sum is given as a fraction of the strongest single conductance of the aggregate's first node.
"""

_FAR = 0.5
"""Fraction of neighbours with distant indices (`ordering_kernels.far_fraction`) above which a netlist is renumbered."""

_WINDOW = 4096
"""Number of nodes of a colour that are sorted together by their number of neighbours."""

_LARGEST_INVERSE = 2000
"""Largest number of nodes of the coarsest graph for which the inverse of its matrix is computed."""

_LONG = 31
"""Rows with at least this number of neighbours count as equally long when rows are sorted by length."""

_ONE = np.uint64(1)

_TAKEN, _NONE = np.float32(-1.0), np.float32(0.0)
"""Weights in `grow_aggregates` of a node in an aggregate, and of a node without conductances to the present aggregate.
"""


def coarsen_down(graph: Graph) -> tuple[list[Graph], list[NDArray[np.int32]]]:
    """Coarsen a graph until it has at most 250 nodes or does not shrink; return all graphs and their aggregates.

    The first returned list contains the given graph and all coarser ones. The second list contains, for every graph but
    the last, the node of the next graph, from 0, to which every node belongs, shape (n,).
    """
    graph = graph._replace(conductance=graph.conductance.astype(np.float32, copy=False))
    graphs, targets = [graph], list[Indices]()
    while graph.size > _COARSEST and len(graphs) < _MOST_LEVELS:
        aggregate, count = grow_aggregates(graph, _MEMBERS, True)
        if count > _CLUSTERS_SHRINK * graph.size:
            aggregate, count = grow_aggregates(graph, _MEMBERS, False)
        if count > _LEAST_SHRINKAGE * graph.size:
            break
        graph = Graph(*aggregate_graph(graph, aggregate, count))
        graphs.append(graph)
        targets.append(aggregate)
    return graphs, targets


@interruptible
@kernel
def grow_aggregates(graph: Graph, most: int, strict: bool) -> tuple[Indices, int]:
    """Partition the nodes of a graph into aggregates; return the aggregate of every node, shape (n,), and their number.

    `most`: maximum number of nodes of an aggregate, before single nodes join; `strict`: whether nodes join only with a
    strong sum of conductances (see below), and single nodes join only aggregates of fewer than 1.5 ``most`` nodes. If
    False, nodes join along any conductance, and only nodes without neighbours stay alone.

    An aggregate starts with the first node that has no aggregate. The aggregate repeatedly takes in the neighbour
    without an aggregate that has the greatest sum of conductances to the aggregate, divided by the square root of the
    sum of all conductances of the neighbour. A sum is strong if it is at least 0.2 times the sum of all conductances of
    the neighbour or of the first node, whichever is smaller, or at least 0.7 times the first node's strongest
    conductance. A first node without such a neighbour joins the aggregate at the other end of the node's strongest
    conductance.
    """
    (indptr, indices, conductance, leak), n = graph, len(graph.leak)
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
def _degrees(indptr: Indices, conductance: Singles, leak: Floats) -> tuple[Floats, Singles, Floats]:
    """Return three arrays (n,) over the nodes: sum of conductances, reciprocal square root of the sum, and maximum.

    `indptr` (n + 1,), `conductance` (entries,): compressed rows of the conductances between nodes; `leak` (n,):
    conductance to known voltages, included in the sum but not in the maximum. The reciprocal is 0 for a sum of 0.
    """
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
def _host(indptr: Indices, indices: Indices, conductance: Singles, aggregate: Indices, node: int) -> int:
    """Return the aggregate of the neighbour with the strongest conductance to ``node``; -1 if there is none.

    `indptr, indices, conductance`: compressed rows of the conductances; `aggregate` (n,): aggregate of every node, or
    -1 for none. The result is -1 for a node without neighbours, and if that neighbour has no aggregate.
    """
    best, host = 0.0, -1
    for k in range(indptr[node], indptr[node + 1]):
        if conductance[k] > best:
            best, host = conductance[k], aggregate[indices[k]]
    return host


@interruptible
@kernel
def aggregate_graph(graph: Graph, aggregate: Indices, count: int) -> tuple[Indices, Indices, Singles, Floats]:
    """Return the graph of the aggregates: sums of the conductances between aggregates, and of the leaks in each.

    `aggregate` (n,): aggregate of every node, from 0; `count`: number of aggregates. Returns the fields of `Graph`:
    begins of rows, columns, conductances and leaks (conductances to known voltages) of ``count`` rows, whose columns
    are not sorted.
    """
    (indptr, indices, conductance, leak), n = graph, len(graph.leak)
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
    new_indices = np.empty(len(indices) + 1, np.int32)
    new_conductance, total = np.empty(len(indices) + 1, conductance.dtype), np.zeros(count, conductance.dtype)
    size = 0
    for row in range(count):
        begin = size
        total[row] = 1.0
        for m in range(start[row], start[row + 1]):
            node = member[m]
            new_leak[row] += leak[node]
            for k in range(indptr[node], indptr[node + 1]):
                column = aggregate[indices[k]]
                new_indices[size] = column
                size += total[column] == 0.0
                total[column] += conductance[k]
        total[row] = 0.0
        for at in range(begin, size):
            new_conductance[at] = total[new_indices[at]]
            total[new_indices[at]] = 0.0
        new_indptr[row + 1] = size
    return new_indptr, new_indices[:size].copy(), new_conductance[:size].copy(), new_leak


def pack_netlist(rows: Rows, ground: Floats, unit: float) -> tuple[Graphs, NDArray[np.int32]]:
    """Coarsen a netlist, and return all levels as concatenated graphs, and the position of every row, shape (n,).

    The position is the index of the row among the nodes of the finest level, from 0. `rows`: conductances in siemens;
    `ground` (n,): conductances to known voltages, in siemens; `unit`: conductance in siemens by which all are divided.
    Rows are renumbered if the indices of most neighbours differ by more than a sixteenth of all rows. A graph that
    cannot be coarsened is stored twice, so that there are at least two levels.
    """
    conductance = np.divide(rows.data, unit, out=np.empty(len(rows.data), np.float32), casting="same_kind")
    graph, number = Graph(rows.indptr, rows.indices, conductance, ground / unit), None
    if ordering.far_fraction(rows.indptr, rows.indices) > _FAR:
        moved, number = ordering.renumber(*graph)
        graph = Graph(*moved)
    graphs, targets = coarsen_down(graph)
    if not targets:
        graphs, targets = [graph, graph], [np.arange(graph.size, dtype=np.int32)]
    packed, rank = pack_graphs(graphs, targets)
    return packed, rank if number is None else rank[number]


def pack_graphs(graphs: list[Graph], targets: list[NDArray[np.int32]]) -> tuple[Graphs, NDArray[np.int32]]:
    """Return a list of graphs as concatenated graphs, and the position of every node of the first graph, shape (n,).

    The position is the index of the node among the renumbered nodes of the first graph, from 0. `targets`: for every
    graph but the last, the node of the next graph, from 0, to which every node belongs. Nodes are renumbered by colour
    (`order_by_colour`); the matrix of the last graph is inverted.
    """
    first = np.cumsum([0, *(graph.size for graph in graphs)])
    entry = np.cumsum([0, *(len(graph.indices) for graph in graphs)])
    order = [order_by_colour(graph.indptr, graph.indices, _WINDOW) for graph in graphs[:-1]]
    order.append(np.arange(graphs[-1].size, dtype=np.int32))
    rank = [inverse_of(nodes) for nodes in order]
    nodes, entries = int(first[-1]), int(entry[-1])
    packed = Graphs(
        first=first,
        indptr=np.empty(nodes + 1, dtype=np.uint32),
        middle=np.empty(nodes, dtype=np.uint32),
        indices=np.empty(entries, dtype=np.uint32),
        conductance=np.empty(entries, dtype=np.float32),
        leak=np.empty(nodes, dtype=np.float32),
        degree=np.empty(nodes, dtype=np.float32),
        inverse=np.empty(nodes, dtype=np.float32),
        aggregate=np.zeros(nodes, dtype=np.uint32),
        coarsest=inverse_matrix(graphs[-1]),
    )
    for level, graph in enumerate(graphs):
        length = np.diff(graph.indptr)[order[level]]
        lay_rows(graph, rank[level], entry[level] + np.cumsum(length) - length, first[level], packed)
    packed.indptr[nodes] = entries
    for level, target in enumerate(targets):
        own = rank[level + 1][target[order[level]]]
        np.add(own, first[level + 1], out=packed.aggregate[first[level] : first[level + 1]], casting="unsafe")
    return packed, rank[0]


def inverse_matrix(graph: Graph) -> NDArray[np.float32]:
    """Return the inverse (n, n) of the matrix of a graph with n nodes; shape (0, 0) for more than 2000 nodes.

    The matrix is scaled to a diagonal of 1 before the inversion, and the diagonal is increased by 1e-7, so that the
    matrix is not singular. The returned inverse is that of the matrix without the scaling.
    """
    n = graph.size
    if n > _LARGEST_INVERSE:
        return np.empty((0, 0), dtype=np.float32)
    matrix, row = np.zeros((n, n)), np.repeat(np.arange(n), np.diff(graph.indptr))
    degree = np.bincount(row, graph.conductance, n) + graph.leak
    scale = np.divide(1.0, np.sqrt(degree), out=np.zeros(n), where=degree > 0.0)
    np.subtract.at(matrix, (row, graph.indices), graph.conductance * scale[row] * scale[graph.indices])
    matrix[np.diag_indices(n)] += 1.0 + 1e-7
    return np.asarray(scale[:, None] * np.linalg.inv(matrix) * scale, dtype=np.float32)


def inverse_of(order: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the inverse (n,) of the permutation `order` (n,): ``inverse[order[k]] = k``."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order), dtype=order.dtype)
    return rank


def order_by_colour(indptr: Indices, indices: Indices, window: int) -> Indices:
    """Return the nodes of a graph, shape (n,), ordered by colour, then by number of neighbours, in windows.

    Colours are assigned greedily in the order of the nodes: every node gets the first colour that no neighbour has.
    From the 64th colour on, neighbours may have equal colours. The nodes of a colour, in their original order, are
    divided into windows of ``window`` nodes. Each window is sorted by the number of neighbours, and for equal numbers
    by the number of neighbours with a lower colour.

    `indptr` (n + 1,), `indices` (entries,): compressed rows of the neighbours of every node.
    """
    colour, earlier = _colours(indptr, indices)
    key = np.minimum(np.diff(indptr), _LONG) * (_LONG + 1) + np.minimum(earlier, _LONG)
    # numpy sorts 16-bit integers in linear time.
    colour, key = colour.astype(np.uint16), key.astype(np.uint16)
    nodes, order = np.argsort(colour, kind="stable").astype(np.int32), list[Indices]()
    for of_colour in np.split(nodes, np.cumsum(np.bincount(colour))):
        windows = (of_colour[begin : begin + window] for begin in range(0, len(of_colour), window))
        order.extend(some[np.argsort(key[some], kind="stable")] for some in windows)
    return np.concatenate(order)


@interruptible
@kernel
def _colours(indptr: Indices, indices: Indices) -> tuple[Indices, Indices]:
    """Return the greedy colour of every node, and the number of its neighbours with a lower colour, shape (n,) each.

    `indptr` (n + 1,), `indices` (entries,): compressed rows of the neighbours of every node.
    """
    n = len(indptr) - 1
    bit, colour, earlier = np.zeros(n, np.uint64), np.empty(n, np.int32), np.zeros(n, np.int32)
    for i in range(n):
        taken = np.uint64(0)
        for k in range(indptr[i], indptr[i + 1]):
            taken |= bit[indices[k]]
        bit[i] = ~taken & (taken + _ONE)
        c, rest = 0, bit[i] >> _ONE
        while rest:
            rest >>= _ONE
            c += 1
        colour[i] = c
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            earlier[i] += colour[indices[k]] < colour[i]
    return colour, earlier


@kernel
def lay_rows(graph: Graph, rank: Indices, begin: Integers, first: int, packed: Graphs) -> None:
    """Write the rows of one level to ``packed``: earlier neighbours first, the later ones from ``middle`` on.

    `graph`: the level; `rank` (n,): new number of every node within the level, from 0; `begin` (n,): begin of the row
    of every new number, counted over the entries of all levels; `first`: number of nodes of all finer levels. An
    earlier neighbour has a smaller new number. Rows are read in order and written at random, since reads at random
    would stall longer than writes.
    """
    indptr, indices, conductance, leak = graph
    for i in range(len(rank)):
        slot, length = rank[i], indptr[i + 1] - indptr[i]
        at = first + slot
        front, back, degree = begin[slot], begin[slot] + length - 1, leak[i]
        packed.indptr[at] = front
        for k in range(indptr[i], indptr[i + 1]):
            neighbour = rank[indices[k]]
            degree += conductance[k]
            earlier = neighbour < slot
            place = front if earlier else back
            front += earlier
            back -= not earlier
            packed.indices[place] = first + neighbour
            packed.conductance[place] = conductance[k]
        packed.middle[at] = front
        packed.leak[at] = leak[i]
        packed.degree[at] = degree
        packed.inverse[at] = 1.0 / degree if degree > 0.0 else 0.0
