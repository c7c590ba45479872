"""By how many decades a potential falls, foreseen from the graph alone.

The answer of a coarse level would tell as well, and better in the open: of the true decades it found 0.7 to 0.95 in
planes and volumes, but 0.2 to 0.7 where corridors are narrower than its blocks, and it costs the levels first, which
circuits that are then solved directly do not need.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel
from resgrid.solvers.laplacian import Connections, Laplacian, Rows

VOLUME = 4.2
"""Neighbours a node above which corridors have two dimensions across."""

WHOLE_STEPS = 0.7
"""Potentials fall over straight distances, ways on a grid are longer."""

_MOST_REST, _SHARE_OF_REST = 5_000, 50
"""Nodes behind slits that are left out: so many at most, and one in so many."""

_PARTS = 64.0
"""Parts of a factor of e in which steps are counted."""

_ROUNDS = 30
"""Rounds in which depths are found where rows are numbered as it happens, at most."""

_SEEN = -1
"""End of a list of nodes; whatever is less stands for the cost of a step to a node that has not been reached."""


def foresee_decades(laplacian: Laplacian, found: Connections) -> float:
    """Rough number of decades that a potential between two rails falls over the graph; 0 for other circuits.

    The lowest nodes are left out, if they are few: they are found directly (`resgrid.solvers.refine`).

    Along a corridor ``w`` cells wide it falls by ``exp(-pi sqrt(d) / w)`` a cell, in ``d = 1`` or 2 cross dimensions;
    behind walls of ``k`` times the resistance between cells by ``exp(-sqrt(2 d / (k w)))`` where that is less.  On 20
    spaces and maps the estimate was 0.9 to 1.7 times the true number, in volumes 2 times.
    """
    rails = laplacian.rails
    if rails is None or not found.entries:
        return 0.0
    cross = 2.0 if found.entries > VOLUME * laplacian.size else 1.0
    rounds = 1 if laplacian.grid is not None else _ROUNDS
    to_low, to_high = rails.to_low, rails.to_high
    wall = _wall(found.mean, to_high[to_high > 0])
    rest = min(_MOST_REST, laplacian.size // _SHARE_OF_REST)
    ends, rate = (to_low > 0, to_high > 0), np.pi * np.sqrt(cross)
    factors = decay(laplacian.as_rows(), ends, rate, wall / (2.0 * cross), rounds, rest)
    return float(WHOLE_STEPS * factors / np.log(10.0))


def decay(
    rows: Rows,
    ends: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    rate: float,
    wall: float,
    rounds: int,
    rest: int,
) -> float:
    """Factors of e by which a potential falls, about, but at the ``rest`` lowest nodes.

    ``ends``: the nodes that touch the low rail and the high rail.  Where the nearest contact with the high rail lies
    ``r`` steps away, the corridor counts as ``w = 2 r + 1`` wide, and the potential falls by ``((w / rate)**2 + w
    wall)**(-1/2)`` a step: as between plain rails where there is no ``wall``, by the square root of what leaks through
    it where that is large.
    """
    (low, high), n = ends, len(ends[0])
    after, head = np.full(n, n, dtype=np.int32), np.full(int(_PARTS * rate) + 2, -1, dtype=np.int32)
    costs = costs_by_depth(n, rate, wall)
    indptr, indices = rows.indptr.view(np.uint32), rows.indices.view(np.uint32)  # need no sign
    return fall(indptr, indices, low, high, costs, rounds, n - rest, after, head) / _PARTS


def costs_by_depth(deepest: int, rate: float, wall: float) -> NDArray[np.int32]:
    """What a step costs by depth, in parts of a factor of e, at least one; nothing where there is no depth."""
    costs = np.ones(deepest + 1, dtype=np.int32)
    width = 2.0 * np.arange(min(deepest, int(_PARTS * rate))) + 1.0
    costs[: len(width)] = np.maximum(1.0, _PARTS / np.sqrt((width / rate) ** 2 + width * wall))
    costs[deepest] = 0
    return costs


def _wall(mean: float, tied: NDArray[np.float64]) -> float:
    """Mean resistance before the high rail beyond that between nodes, and as a multiple of that.

    Shapes: `tied` (rows there,): conductances to the rail.
    """
    return max(mean / float(tied.mean()) - 1.0, 0.0) if tied.size else 0.0


@inner
def _find_depths(
    indptr: NDArray[np.uint32],
    indices: NDArray[np.uint32],
    high: NDArray[np.bool_],
    rounds: int,
    steps: NDArray[np.int32],
) -> None:
    """Steps from the nearest node at the high rail, by sweeps up and down; left alone where none comes.

    Where nodes are numbered as the cells of a grid, one round does: a shortest way runs up or down the rows.
    """
    n = len(high)
    for _ in range(rounds):
        moved = _shorten(indptr, indices, high, steps, range(n))
        if not moved:
            break
        _shorten(indptr, indices, high, steps, range(n - 1, -1, -1))


@inner
def _shorten(
    indptr: NDArray[np.uint32], indices: NDArray[np.uint32], high: NDArray[np.bool_], steps: NDArray[np.int32],
    nodes: range,
) -> bool:  # fmt: skip
    """Steps by way of the neighbours, node by node; whether any became fewer."""
    moved = False
    for node in nodes:
        least = 0 if high[node] else steps[node]
        for k in range(indptr[node], indptr[node + 1]):
            here = steps[indices[k]] + 1
            least = here if here < least else least
        moved |= least < steps[node]
        steps[node] = least
    return moved


@kernel
def fall(
    indptr: NDArray[np.uint32],
    indices: NDArray[np.uint32],
    low: NDArray[np.bool_],
    high: NDArray[np.bool_],
    costs: NDArray[np.int32],
    rounds: int,
    kept: int,
    after: NDArray[np.int32],
    head: NDArray[np.int32],
) -> int:
    """What the way costs on which a potential falls least, over the ``kept`` nearest nodes.

    ``costs`` (n + 1,): of a step to a node by its depth, as `_find_depths` finds it in some rounds; ``after`` (n,)
    comes as ``n``, and ``head`` (buckets,) as -1.  By buckets (Dial 1969): since a step costs what the node it leads to
    does, the first way found to a node is the best.
    """
    n = len(low)
    # Lists of nodes in the buckets: their heads, and the one after every node; until then, a node's depth or cost.
    _find_depths(indptr, indices, high, rounds, after)
    for node in range(n):
        after[node] = _SEEN - 1 - costs[after[node]]
    buckets, waiting, seen = len(head), 0, 0
    for node in range(n):
        if low[node]:
            after[node], head[0] = head[0], node
            waiting += 1
    now, bucket = 0, 0
    while waiting > 0 and seen < kept:
        node = head[bucket]
        if node == _SEEN:
            now += 1
            bucket = bucket + 1 if bucket + 1 < buckets else 0
            continue
        head[bucket] = after[node]
        waiting, seen = waiting - 1, seen + 1
        for k in range(indptr[node], indptr[node + 1]):
            other = indices[k]
            if after[other] < _SEEN:
                ahead = bucket + _SEEN - 1 - after[other]
                ahead -= buckets if ahead >= buckets else 0
                after[other], head[ahead] = head[ahead], other
                waiting += 1
    return now
