"""Kernels for the pairwise resistances of a dense network: elimination of nodes without subtractions."""

from __future__ import annotations

import numpy as np

from resgrid._internal.jit import inlined, kernel
from resgrid.solvers.scaled import Floats, Integers


@inlined
def _eliminate_last(network: Floats, node: int) -> None:
    """Eliminate a node by the star-mesh transform, in place: ``g_ij += g_iv g_vj / sum_j g_vj``.

    `network` (k, k): conductances, of which only the entries below the diagonal are used; `node`: index of the
    eliminated node v; nodes with larger indices must be eliminated already. The sum is compensated (Kahan 1965), so
    that the relative error of every conductance is a few rounding errors, whatever the number of nodes.
    """
    total, lost = 0.0, 0.0
    for j in range(node):
        term = network[node, j] - lost
        larger = total + term
        lost = (larger - total) - term
        total = larger
    if total > 0.0:
        for i in range(1, node):
            fraction = network[node, i] / total
            if fraction > 0.0:
                for j in range(i):
                    network[i, j] += fraction * network[node, j]


@kernel
def without_nodes(network: Floats, order: Integers, kept: int) -> Floats:
    """Return the symmetric conductances (kept, kept) of a network after the elimination of some of its nodes.

    `network` (k, k): symmetric conductances; `order` (m,): indices of different nodes. The first `kept` of them stay,
    in this order, and the others are eliminated from the last to the first.
    """
    count = len(order)
    work = np.empty((count, count))
    for i in range(count):
        for j in range(i):
            work[i, j] = network[order[i], order[j]]
    for node in range(count - 1, kept - 1, -1):
        _eliminate_last(work, node)
    reduced = np.zeros((kept, kept))
    for i in range(kept):
        for j in range(i):
            reduced[i, j] = reduced[j, i] = work[i, j]
    return reduced


@kernel
def small_network_resistances(network: Floats, first: int, work: Floats, resistance: Floats) -> None:
    """Compute the effective resistances between the first nodes of a small network and its other nodes.

    `network` (k, k): symmetric conductances; `first`: number of first nodes, 0 for the resistances of all pairs; `work`
    (k, k): scratch array; `resistance` (k, k): receives the resistances, in the inverse of the unit of `network`,
    infinite without a connection; its other entries do not change.
    """
    count = len(network)
    for a in range(first if first > 0 else count - 1):
        for b in range(first if first > 0 else a + 1, count):
            place = 2
            for i in range(count):
                if i not in (a, b):
                    row = place
                    place += 1
                else:
                    row = 0 if i == a else 1
                column = 2
                for j in range(count):
                    if j not in (a, b):
                        work[row, column] = network[i, j]
                        column += 1
                    else:
                        work[row, 0 if j == a else 1] = network[i, j]
            for node in range(count - 1, 1, -1):
                _eliminate_last(work, node)
            between = work[1, 0]
            resistance[a, b] = resistance[b, a] = 1.0 / between if between > 0.0 else float("inf")
