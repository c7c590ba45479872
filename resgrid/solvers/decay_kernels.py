"""Compiled loops that foresee how far a potential falls: depths of corridors, and the way on which it falls least."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inlined, inner, kernel

_PARTS = 64.0
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
def _depths(places: Places, rounds: int) -> Indices:
    """Steps from the nearest node at the high rail, by sweeps up and down; the number of places where none comes.

    Where nodes are numbered as the cells of a grid, one round does: a shortest way runs up or down the rows.  Of a
    cell's neighbours each sweep asks those that it has passed.
    """
    n, half = len(places.there), len(places.offsets) // 2
    steps = np.full(n, n, np.int32)
    for _ in range(rounds):
        moved = False
        for i in range(n):
            if places.there[i]:
                least = 0 if places.high[i] else steps[i]
                for k in range(half if half > 0 else _neighbours(places, i)):
                    least = min(least, steps[_neighbour(places, i, k)] + 1)
                moved |= least < steps[i]
                steps[i] = least
        if not moved:
            break
        for i in range(n - 1, -1, -1):
            if places.there[i]:
                least = steps[i]
                for k in range(half, _neighbours(places, i)):
                    least = min(least, steps[_neighbour(places, i, k)] + 1)
                steps[i] = least
    return steps


@inner
def _costs(deepest: int, rate: float, wall: float) -> Indices:
    """What a step costs by depth, in parts of a factor of e; nothing where there is no depth."""
    costs = np.ones(deepest + 1, np.int32)
    costs[deepest] = 0
    for r in range(deepest):
        width = 2.0 * r + 1.0
        costs[r] = max(1, int(_PARTS / math.sqrt((width / rate) ** 2 + width * wall)))
        if costs[r] == 1:
            break
    return costs


@kernel
def decay(places: Places, rate: float, wall: float, rounds: int, first: int, rest: int) -> tuple[float, float, float]:
    """Factors of e by which a potential falls, about: over the ``first`` nodes, but at the ``rest`` lowest, in all.

    Where the nearest contact with the high rail lies ``r`` steps away, as `_depths` finds it in some rounds, the
    corridor counts as ``w = 2 r + 1`` wide, and the potential falls by ``((w / rate)**2 + w wall)**(-1/2)`` a step: as
    between plain rails where there is no ``wall``, by the square root of what leaks through it where that is large.
    The way on which the potential falls least counts (shortest paths by buckets, Dial 1969); since a step's fall is
    that of the node it leads to, the first way found to a node is the best.
    """
    n = len(places.there)
    # Lists of nodes in the buckets: their heads, and the one after every node; until then, a node's cost.
    after, costs = _depths(places, rounds), _costs(n, rate, wall)
    for node in range(n):
        after[node] = _SEEN - 1 - costs[after[node]] if places.there[node] else _SEEN
    head = np.full(int(_PARTS * rate) + 2, _SEEN, np.int32)
    buckets, waiting, seen, kept = len(head), 0, 0, np.count_nonzero(places.there) - rest
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
    return near / _PARTS, most / _PARTS, deepest / _PARTS
