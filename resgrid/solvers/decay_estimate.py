"""Estimate of the orders of magnitude by which a potential falls, from the conductances alone, without a solution.

The potential is here the voltage difference to the high rail (obstacles). It is largest at the low rail (goals), and
falls along a corridor with the distance from the goal.

The solution on a coarse multigrid level would be an alternative. It found 0.7 to 0.95 of the true orders of magnitude
in open planes and volumes, but 0.2 to 0.7 where corridors are narrower than its blocks. It also needs the levels, which
circuits that are then solved directly do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import kernel
from resgrid.solvers.laplacian import VOLUME, ConductanceStatistics, Laplacian, Rows
from resgrid.solvers.llvm_intrinsics import prefetch
from resgrid.solvers.scaled import Indices

STRAIGHTNESS = 0.7
"""Factor of the estimate: typical ratio of a straight distance to the distance along the grid axes.

Paths run along the grid axes, but the potential decays over the straight distance.
"""

_MOST_EXCLUDED, _EXCLUDED_OF = 5_000, 50
"""Limits on the number of nodes of lowest potential that are left out of the estimate; the smaller limit applies.

The first is a number of nodes, the second divides the number of all nodes.
"""

_PARTS = 64.0
"""Number of units of path cost per decay of the potential by a factor of e; path costs are rounded down to integers.

A path cost is the natural logarithm of the decay along a path, times this number.
"""

_SEEN = -1
"""Marks the end of a linked list of nodes; a smaller value ``v`` stands for an unreached node with step cost ``-2 -
v``.
"""


def estimate_decades(laplacian: Laplacian, statistics: ConductanceStatistics) -> float:
    """Return an estimate of the orders of magnitude by which a potential falls between two rails; 0 for other circuits.

    The potential is the voltage difference to the high rail, which falls with the distance from the low rail.
    `laplacian, statistics`: the matrix, and statistics of its conductances. The nodes of lowest potential are left out,
    at most 5,000 and one in 50, since `resgrid.solvers.refinement` solves for them directly.

    Along a corridor ``w`` cells wide the potential falls by ``exp(-pi sqrt(d) / w)`` per cell, in ``d = 1`` or 2
    dimensions across the corridor. With a contact resistance to the obstacles of ``k`` times the resistance between
    cells the factor is ``exp(-sqrt(2 d / (k w)))`` if that fall is slower. A leak of ``q`` times the conductance
    between cells adds ``q`` to the square of the rate. On 20 spaces and maps the estimate was 0.9 to 1.7 times the true
    number of orders of magnitude, in volumes twice the true number.
    """
    rails = laplacian.rails
    if rails is None or not statistics.entries:
        return 0.0
    cross = 2.0 if statistics.entries > VOLUME * laplacian.size else 1.0
    to_low, to_high = rails.to_low, rails.to_high
    at_obstacle = to_high > 1.5 * rails.leak
    tied = to_high[at_obstacle] - rails.leak
    # Contact resistance in excess of the resistance between nodes, relative to the latter.
    wall = max(statistics.mean / float(tied.mean()) - 1.0, 0.0) if tied.size else 0.0
    excluded = min(_MOST_EXCLUDED, laplacian.size // _EXCLUDED_OF)
    ends, rate = (to_low > 0, at_obstacle), np.pi * np.sqrt(cross)
    leak = rails.leak / statistics.mean
    factors = decay(laplacian.as_rows(), ends, rate, wall / (2.0 * cross), excluded, leak)
    return float(STRAIGHTNESS * factors / np.log(10.0))


def decay(
    rows: Rows,
    ends: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    rate: float,
    wall: float,
    excluded: int,
    leak: float = 0.0,
) -> float:
    """Return the approximate natural logarithm of the ratio by which a potential falls, without the lowest nodes.

    The potential is the voltage difference to the high rail, which falls with the distance from the low rail. The
    ratio, at least 1, is that of the largest potential, at the low rail, to the smallest one of a node that is not left
    out.

    `rows`: conductances between nodes; `ends`: masks (n,) of the nodes that touch the low rail and the high rail;
    `rate`: natural logarithm of the fall per cell, times the width of a corridor in cells; `wall`: contact resistance
    to obstacles in excess of the resistance between nodes, divided by the latter and by twice the number of dimensions
    across a corridor; `excluded`: number of lowest nodes that are left out; `leak`: conductance of the leak of every
    node to the high rail, relative to that between nodes.

    If the nearest contact with the high rail lies ``r`` steps away, the corridor is taken to be ``w = 2 r + 1`` cells
    wide. The potential then falls by ``((w / rate)**2 + w wall)**(-1/2)`` factors of e per step. The first term is the
    Dirichlet case; the second term is the leakage through contact resistances, if it is large.
    """
    (low, high), n = ends, len(ends[0])
    by_depth = costs_by_depth(n, rate, wall, leak)
    count = max(int(_PARTS * rate), int(by_depth.max())) + 2
    depth, buckets = np.full(n, _SEEN - 2, dtype=np.int32), np.full(count, _SEEN, dtype=np.int32)
    cheapest_paths(rows, high, depth, n, buckets[:2])
    costs = by_depth[np.where(depth < 0, n, depth)]
    buckets[:] = _SEEN
    return cheapest_paths(rows, low, _SEEN - 1 - costs, n - excluded, buckets) / _PARTS


def costs_by_depth(deepest: int, rate: float, wall: float, leak: float = 0.0) -> Indices:
    """Return the cost of a step to a node, by the number of steps from the node to the high rail, shape (deepest + 1,).

    The cost is the natural logarithm of the decay of the potential in the step, times 64 (`_PARTS`), rounded down, and
    at least 1. The last entry, for nodes without a path to obstacles, is the decay by the leak alone, 0 without a leak.
    `deepest`: upper bound of the number of steps; `rate`: natural logarithm of the fall per cell, times the width of a
    corridor in cells; `wall`: contact resistance to obstacles in excess of that between nodes, divided by the latter
    and by twice the number of dimensions across a corridor; `leak`: conductance of the leak of a node, relative to that
    between nodes. Along a chain with leaks the potential falls by ``2 asinh(sqrt(leak) / 2)`` factors of e per step.
    """
    least = _PARTS * 2.0 * np.arcsinh(0.5 * np.sqrt(leak))
    costs = np.full(deepest + 1, max(1.0, least), dtype=np.int32)
    width = 2.0 * np.arange(min(deepest, int(_PARTS * rate))) + 1.0
    falls = 1.0 / np.sqrt((width / rate) ** 2 + width * wall)
    if leak:
        falls = 2.0 * np.arcsinh(0.5 * np.sqrt(falls**2 + leak))
    costs[: len(width)] = np.maximum(1.0, _PARTS * falls)
    costs[deepest] = least
    return costs


@kernel
def cheapest_paths(rows: Rows, begin: NDArray[np.bool_], cost: Indices, wanted: int, head: Indices) -> int:
    """Return the largest cost of a cheapest path to any of the ``wanted`` nodes with the cheapest paths (Dial 1969).

    The cost of a step depends only on the node that the step leads to. The first path found to a node is therefore the
    cheapest.

    `rows`: neighbours of every node; `begin` (n,): mask of the nodes where paths begin, which count as nodes with a
    path of cost 0; `cost` (n,): cost of a step to each node, below the number of buckets. On entry it is encoded as
    ``-2 - cost``; on exit it is the cost of the path to each of the ``wanted`` nodes, unchanged at nodes without a
    path, and without meaning at other nodes. If fewer nodes have a path, all of them count as wanted. `head`
    (buckets,): first node of the linked list of every bucket of the priority queue, -1 on entry.
    """
    # Linked lists of the nodes in the buckets: `head`, and the successor of every node until it is visited.
    after, buckets, waiting, seen = cost, len(head), 0, 0
    for node in range(len(begin)):
        if begin[node]:
            after[node], head[0] = head[0], node
            waiting += 1
    now, bucket = 0, 0
    while waiting > 0 and seen < wanted:
        node = head[bucket]
        if node == _SEEN:
            now += 1
            bucket = bucket + 1 if bucket + 1 < buckets else 0
            continue
        head[bucket], after[node] = after[node], now
        waiting, seen = waiting - 1, seen + 1
        for k in range(rows.indptr[node], rows.indptr[node + 1]):
            other = np.uint32(rows.indices[k])
            if after[other] < _SEEN:
                ahead = bucket + _SEEN - 1 - after[other]
                ahead -= buckets if ahead >= buckets else 0
                after[other], head[ahead] = head[ahead], other
                prefetch(rows.indices, rows.indptr[other])
                waiting += 1
    return now
