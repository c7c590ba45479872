"""Compiled loops that foresee how far a potential falls: depths of corridors, and the way on which it falls least."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inlined, inner, kernel

_SEEN = -1
"""End of a list of nodes; whatever is less stands for the cost of a step to a node that has not been reached."""

Indices = NDArray[np.int32]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Places(NamedTuple):
    """Nodes and their neighbours: of a graph in compressed rows, or of a grid's cells with a margin around them.

    `there, low, high` (places,): whether there is a node at a place, and whether it touches the low rail, the high
    rail; `indptr, indices`: neighbours of a graph's nodes, empty for a grid; `offsets`: from a cell to its
    neighbours, those before it first; empty for a graph.
    """

    there: Flags
    low: Flags
    high: Flags
    indptr: Indices
    indices: Indices
    offsets: Integers


@inlined
def _neighbours(places: Places, node: int) -> int:
    return len(places.offsets) if len(places.offsets) > 0 else int(places.indptr[node + 1] - places.indptr[node])


@inlined
def _neighbour(places: Places, node: int, k: int) -> int:
    return int(node + places.offsets[k]) if len(places.offsets) > 0 else int(places.indices[places.indptr[node] + k])


@inner
def _find_depths(places: Places, rounds: int, steps: Indices) -> None:
    """Steps from the nearest node at the high rail, by sweeps up and down; left alone where none comes.

    Where nodes are numbered as the cells of a grid, one round does: a shortest way runs up or down the rows.  Of a
    cell's neighbours each sweep asks those that it has passed.
    """
    n, half = len(places.there), len(places.offsets) // 2
    for _ in range(rounds):
        moved = False
        for i in range(n):
            if places.there[i]:
                least = 0 if places.high[i] else steps[i]
                for k in range(half if half > 0 else _neighbours(places, i)):
                    here = steps[_neighbour(places, i, k)] + 1
                    least = here if here < least else least
                moved |= least < steps[i]
                steps[i] = least
        if not moved:
            break
        for i in range(n - 1, -1, -1):
            if places.there[i]:
                least = steps[i]
                for k in range(half, _neighbours(places, i)):
                    here = steps[_neighbour(places, i, k)] + 1
                    least = here if here < least else least
                steps[i] = least


@kernel
def fall(
    places: Places, costs: Indices, rounds: int, first: int, kept: int, after: Indices, head: Indices
) -> tuple[int, int, int]:
    """What the way costs on which a potential falls least: over the ``first`` nodes, the ``kept`` ones, and all.

    ``costs`` (n + 1,): of a step to a node by its depth, as `_find_depths` finds it in some rounds; ``after`` (n,)
    comes as ``n``, and ``head`` (buckets,) as -1.  By buckets (Dial 1969): since a step costs what the node it leads to
    does, the first way found to a node is the best.
    """
    n = len(places.there)
    # Lists of nodes in the buckets: their heads, and the one after every node; until then, a node's depth or cost.
    _find_depths(places, rounds, after)
    for node in range(n):
        after[node] = _SEEN - 1 - costs[after[node]] if places.there[node] else _SEEN
    buckets, waiting, seen = len(head), 0, 0
    for node in range(n):
        if places.low[node]:
            after[node], head[0] = head[0], node
            waiting += 1
    now, near, most, deepest, bucket = 0, 0, 0, 0, 0
    while waiting > 0:
        node = head[bucket]
        if node == _SEEN:
            now += 1
            bucket = bucket + 1 if bucket + 1 < buckets else 0
            continue
        head[bucket], deepest = after[node], now
        waiting, seen = waiting - 1, seen + 1
        near = now if seen <= first else near
        most = now if seen <= kept else most
        for k in range(_neighbours(places, node)):
            other = _neighbour(places, node, k)
            if after[other] < _SEEN:
                ahead = bucket + _SEEN - 1 - after[other]
                ahead -= buckets if ahead >= buckets else 0
                after[other], head[ahead] = head[ahead], other
                waiting += 1
    return near, most, deepest
