"""By how many decades a potential falls, foreseen from the graph alone.

The answer of a coarse level would tell as well, and better in the open: of the true decades it found 0.7 to 0.95 in
planes and volumes, but 0.2 to 0.7 where corridors are narrower than its blocks, and it costs the levels first, which
circuits that are then solved directly do not need.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import kernel
from resgrid.solvers.laplacian import VOLUME, Connections, Laplacian, Rows
from resgrid.solvers.llvm_intrinsics import prefetch
from resgrid.solvers.scaled import Indices

WHOLE_STEPS = 0.7
"""Potentials fall over straight distances, ways on a grid are longer."""

_MOST_REST, _SHARE_OF_REST = 5_000, 50
"""Nodes behind slits that are left out: so many at most, and one in so many."""

_PARTS = 64.0
"""Parts of a factor of e in which steps are counted."""

_SEEN = -1
"""End of a list of nodes; whatever is less stands for the cost of a step to a node that has not been reached."""


def foresee_decades(laplacian: Laplacian, found: Connections) -> float:
    """Rough number of decades that a potential between two rails falls over the graph; 0 for other circuits.

    The lowest nodes are left out, if they are few: they are found directly (`resgrid.solvers.refinement`).

    Along a corridor ``w`` cells wide it falls by ``exp(-pi sqrt(d) / w)`` a cell, in ``d = 1`` or 2 cross dimensions;
    behind walls of ``k`` times the resistance between cells by ``exp(-sqrt(2 d / (k w)))`` where that is less.  On 20
    spaces and maps the estimate was 0.9 to 1.7 times the true number, in volumes 2 times.
    """
    rails = laplacian.rails
    if rails is None or not found.entries:
        return 0.0
    cross = 2.0 if found.entries > VOLUME * laplacian.size else 1.0
    to_low, to_high = rails.to_low, rails.to_high
    tied = to_high[to_high > 0]
    wall = max(found.mean / float(tied.mean()) - 1.0, 0.0) if tied.size else 0.0  # beyond what is between nodes
    rest = min(_MOST_REST, laplacian.size // _SHARE_OF_REST)
    ends, rate = (to_low > 0, to_high > 0), np.pi * np.sqrt(cross)
    factors = decay(laplacian.as_rows(), ends, rate, wall / (2.0 * cross), rest)
    return float(WHOLE_STEPS * factors / np.log(10.0))


def decay(rows: Rows, ends: tuple[NDArray[np.bool_], NDArray[np.bool_]], rate: float, wall: float, rest: int) -> float:
    """Factors of e by which a potential falls, about, but at the ``rest`` lowest nodes.

    ``ends``: the nodes that touch the low rail and the high rail.  Where the nearest contact with the high rail lies
    ``r`` steps away, the corridor counts as ``w = 2 r + 1`` wide, and the potential falls by ``((w / rate)**2 + w
    wall)**(-1/2)`` a step: as between plain rails where there is no ``wall``, by the square root of what leaks through
    it where that is large.
    """
    (low, high), n = ends, len(ends[0])
    depth, buckets = np.full(n, _SEEN - 2, dtype=np.int32), np.full(int(_PARTS * rate) + 2, _SEEN, dtype=np.int32)
    walk(rows, high, depth, n, buckets[:2])
    costs = costs_by_depth(n, rate, wall)[np.where(depth < 0, n, depth)]
    buckets[:] = _SEEN
    return walk(rows, low, _SEEN - 1 - costs, n - rest, buckets) / _PARTS


def costs_by_depth(deepest: int, rate: float, wall: float) -> Indices:
    """What a step costs by depth, in parts of a factor of e, at least one; nothing where there is no depth."""
    costs = np.ones(deepest + 1, dtype=np.int32)
    width = 2.0 * np.arange(min(deepest, int(_PARTS * rate))) + 1.0
    costs[: len(width)] = np.maximum(1.0, _PARTS / np.sqrt((width / rate) ** 2 + width * wall))
    costs[deepest] = 0
    return costs


@kernel
def walk(rows: Rows, begin: NDArray[np.bool_], cost: Indices, kept: int, head: Indices) -> int:
    """What the cheapest ways to the ``kept`` nearest nodes cost, at most.

    By buckets (Dial 1969): since a step costs what the node it leads to does, the first way found to a node is the
    best.

    Shapes: `begin` (n,): where ways begin; `cost` (n,): of a step to a node, less than there are buckets, comes as
    ``_SEEN - 1 - cost``, and becomes the cost of the way to it, if there is one; `head` (buckets,): comes as -1.
    """
    # Lists of nodes in the buckets: their heads, and the one after every node, until it is passed.
    after, buckets, waiting, seen = cost, len(head), 0, 0
    for node in range(len(begin)):
        if begin[node]:
            after[node], head[0] = head[0], node
            waiting += 1
    now, bucket = 0, 0
    while waiting > 0 and seen < kept:
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
