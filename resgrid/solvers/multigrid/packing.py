"""Coarse levels laid one behind the other for the compiled cycle.

A graph is renumbered by colour, so that neighbouring rows of a sweep do not wait for one another, and within a colour
by length in windows: the ends of its loops can then be foreseen, which is half of the time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel
from resgrid.solvers import ordering_kernels as ordering
from resgrid.solvers.multigrid.graph_sweeps import Graphs
from resgrid.solvers.multigrid.graphs import Graph, coarsen_down
from resgrid.solvers.multigrid.levels import Grids, Levels, Work
from resgrid.solvers.multigrid.red_black import Stencil

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]

_FAR, _LARGE = 0.5, 250_000
"""Share of neighbours numbered far apart above which a graph of so many nodes is renumbered before anything else."""

_WINDOW = 4096
_LARGEST_INVERSE = 2000

_LONG = 31
"""Longer rows count as one length."""

_COLOURS = 64
_ONE = np.uint64(1)


def pack_netlist(graph: Graph) -> tuple[Levels, NDArray[np.int32]]:
    """Coarsen a graph that is no grid, and lay out its levels; returns where every node stands, shape (n,)."""
    rows, order = (graph.indptr, graph.indices, graph.conductance, graph.leak), None
    if graph.size >= _LARGE and ordering.far_share(*rows[:2]) > _FAR:
        order = ordering.breadth_first(*rows[:2], 0)
        graph = Graph(*ordering.renumber(*rows, order))
    graphs, rank = pack_graphs(*coarsen_down(graph))
    if order is not None:
        rank = rank[inverse_of(order)]
    return pack_levels(pack_grids([], [], [], 2), graphs), rank


def pack_graphs(graphs: list[Graph], targets: list[NDArray[np.int32]]) -> tuple[Graphs, NDArray[np.int32]]:
    """Lay graphs, and what their nodes belong to, one behind the other; the last one is inverted.

    Returns where every node of the first one stands, shape (n,).
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
        inverse=np.empty(nodes, dtype=np.float32),
        aggregate=np.zeros(nodes, dtype=np.uint32),
        coarsest=inverse_matrix(graphs[-1]),
    )
    for level, graph in enumerate(graphs):
        rows = (graph.indptr, graph.indices, graph.conductance, graph.leak)
        lay_rows(rows, order[level], rank[level], first[level], entry[level], packed)
    for level, target in enumerate(targets):
        own = first[level + 1] + rank[level + 1][target[order[level]]]
        packed.aggregate[first[level] : first[level + 1]] = own
    return packed, rank[0]


def pack_grids(
    stencils: list[Stencil], targets: list[NDArray[np.int32]], weights: list[NDArray[np.float32]], dimensions: int
) -> Grids:
    """Lay grids, and what their black slots belong to and take from there, one behind the other."""

    def joined(parts: list[NDArray[Any]], kind: type) -> NDArray[Any]:
        return np.concatenate([np.empty(0, dtype=kind), *(part.ravel() for part in parts)]).astype(kind, copy=False)

    distance = np.array([stencil.distance for stencil in stencils], dtype=np.int64)
    return Grids(
        slots=np.cumsum([0, *(stencil.faces.shape[1] for stencil in stencils)]),
        first_off=np.cumsum([0, *(len(stencil.couplings) for stencil in stencils)]),
        margin=np.array([stencil.margin for stencil in stencils], dtype=np.int64),
        block=np.array([stencil.block for stencil in stencils], dtype=np.int64),
        distance=distance.reshape(len(stencils), 2 * dimensions),
        faces=joined([stencil.faces for stencil in stencils], np.float32),
        couplings=joined([stencil.couplings for stencil in stencils], np.float32),
        off_red=joined([stencil.off_red for stencil in stencils], np.int32),
        off_black=joined([stencil.off_black for stencil in stencils], np.int32),
        red_inverse=joined([stencil.red_inverse for stencil in stencils], np.float32),
        black_inverse=joined([stencil.black_inverse for stencil in stencils], np.float32),
        black_degree=joined([stencil.black_degree for stencil in stencils], np.float32),
        aggregate=joined(targets, np.int32),
        weight=joined(weights, np.float32),
    )


def pack_levels(grids: Grids, graphs: Graphs) -> Levels:
    """Both together, without work space."""
    return Levels(grids, graphs, Work(*[np.empty(0, dtype=np.float32)] * 7))


def with_work(levels: Levels) -> Levels:
    """The same levels with work space of its own, so that one hierarchy can serve several solves at a time."""
    slots, nodes = int(levels.grids.slots[-1]), int(levels.graphs.first[-1])
    b, x = np.zeros((2, 2 * slots + 1 + nodes), dtype=np.float32)
    f, z = np.zeros((2, slots), dtype=np.float32)
    c, v, w = np.zeros((3, slots + nodes), dtype=np.float32)
    return levels._replace(work=Work(b, x, f, z, c, v, w))


def inverse_matrix(graph: Graph) -> NDArray[np.float32]:
    """Inverse of the last level's matrix; empty where it did not shrink, as nodes without neighbours do not.

    Its diagonal is made 1, and then a little larger so that it has an inverse.
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
    """Where every element of a permutation stands."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order), dtype=order.dtype)
    return rank


@kernel
def order_by_colour(indptr: Indices, indices: Indices, window: int) -> Indices:
    """The nodes by colour; in windows of each colour by the length of their rows, then by how many come before.

    Colours are given greedily in the order of the nodes: each takes the first that its neighbours do not have.  From
    the 64th on neighbours may share one.
    """
    n = len(indptr) - 1
    colour, of_colour = _colours(indptr, indices)
    key, start = np.empty(n, np.int32), np.zeros((_LONG + 1) ** 2 + 1, np.int32)
    for i in range(n):
        earlier = 0
        for k in range(indptr[i], indptr[i + 1]):
            earlier += colour[indices[k]] < colour[i]
        key[i] = min(indptr[i + 1] - indptr[i], _LONG) * (_LONG + 1) + min(earlier, _LONG)
        start[key[i] + 1] += 1
    by_length = _sorted(np.arange(n).astype(np.int32), key, start)
    base = np.zeros(_COLOURS + 1, np.int64)
    for c in range(_COLOURS):
        base[c + 1] = base[c] + (of_colour[c] + window - 1) // window
    start, met = np.zeros(base[_COLOURS] + 1, np.int32), np.zeros(_COLOURS, np.int64)
    for i in range(n):
        key[i] = base[colour[i]] + met[colour[i]] // window
        met[colour[i]] += 1
        start[key[i] + 1] += 1
    return _sorted(by_length, key, start)


@kernel
def _colours(indptr: Indices, indices: Indices) -> tuple[Indices, NDArray[np.int64]]:
    """Greedy colours, and how many nodes have each."""
    n = len(indptr) - 1
    bit = np.zeros(n, np.uint64)
    colour, count = np.empty(n, np.int32), np.zeros(_COLOURS, np.int64)
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
        count[c] += 1
    return colour, count


@inner
def _sorted(nodes: Indices, key: Indices, start: Indices) -> Indices:
    """Nodes by key, those of one key in their order; ``start[k + 1]`` says how many there are of key ``k``."""
    for k in range(len(start) - 1):
        start[k + 1] += start[k]
    out = np.empty(len(nodes), np.int32)
    for slot in range(len(nodes)):
        i = nodes[slot]
        out[start[key[i]]] = i
        start[key[i]] += 1
    return out


@kernel
def lay_rows(
    rows: tuple[Indices, Indices, Floats, Floats], order: Indices, rank: Indices, first: int, entry: int, packed: Graphs
) -> None:
    """Write the rows of a level behind those before it: earlier neighbours first, the others from ``middle`` on."""
    indptr, indices, conductance, leak = rows
    begin = entry
    for slot in range(len(order)):
        i = order[slot]
        end = begin + indptr[i + 1] - indptr[i]
        packed.indptr[first + slot] = begin
        front, back, degree = begin, end - 1, leak[i]
        for k in range(indptr[i], indptr[i + 1]):
            neighbour = rank[indices[k]]
            degree += conductance[k]
            earlier = neighbour < slot
            at = front if earlier else back
            front += earlier
            back -= not earlier
            packed.indices[at] = first + neighbour
            packed.conductance[at] = conductance[k]
        packed.middle[first + slot] = front
        packed.inverse[first + slot] = 1.0 / degree if degree > 0.0 else 0.0
        begin = end
    packed.indptr[first + len(order)] = begin
