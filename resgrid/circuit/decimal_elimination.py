"""Resistances and reduced networks of circuits of up to 2,000 nodes, whatever the range of their conductances.

All nodes but the terminals are eliminated by star-mesh transforms, ``g_ij += g_iv g_vj / sum_k g_vk``: sums, products
and quotients of positive numbers, which lose no digits (Grassmann, Taksar & Heyman 1985).  Doubles overflow or
underflow if the conductances span hundreds of orders of magnitude.  Here numbers are decimals with 40 digits and
unbounded exponents, and every result is rounded to a double once.
"""

from __future__ import annotations

import decimal
import heapq
from collections.abc import Iterable, Iterator, Sequence
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import Netlist

MOST_NODES, _MOST_TERMINALS = 2000, 200
"""Largest numbers of nodes and of terminals for this arithmetic; a mesh of 2,000 nodes takes up to ten seconds."""

ROUNDING = 2.0**-52
"""Bound on the relative error of a result in the normal range of doubles: one rounding, and 40-digit decimals."""

ARITHMETIC = decimal.Context(prec=40, Emin=decimal.MIN_EMIN, Emax=decimal.MAX_EMAX)
"""Decimal arithmetic with 40 digits, in which no product and no quotient of doubles overflows or underflows."""

Network = dict[int, dict[int, Decimal]]
"""Conductances in siemens between every node and its neighbours, by node."""

Pair = tuple[int, int]


def fits_decimals(netlist: Netlist, terminals: int) -> bool:
    """Return whether a circuit with this number of terminals is small enough for decimal arithmetic."""
    return netlist.node_count <= MOST_NODES and terminals <= _MOST_TERMINALS


def reduce_in_decimals(netlist: Netlist, group: NDArray[np.int64], terminals: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the conductances between terminals after the elimination of all other nodes, in siemens, (k, k).

    `group` (nodes,): number of the group of joined nodes of every node; `terminals` (k,): different groups.
    """
    found = np.zeros((len(terminals), len(terminals)))
    number_of = {node: number for number, node in enumerate(terminals.tolist())}
    with decimal.localcontext(ARITHMETIC):
        network = _without(network_of(netlist, group), number_of)
        for node, number in number_of.items():
            for other, siemens in network.get(node, {}).items():
                found[number, number_of[other]] = float(siemens)
    return found


def resistances_in_decimals(
    netlist: Netlist, group: NDArray[np.int64], pairs: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the effective resistances of pairs of groups in ohms, (p,): 0 for equal, infinite for unconnected groups.

    `group` (nodes,): number of the group of joined nodes of every node; `pairs` (p, 2): both groups of every pair.
    """
    wanted: list[Pair] = [(min(pair), max(pair)) for pair in pairs.tolist()]
    found: dict[Pair, Decimal] = {}
    with decimal.localcontext(ARITHMETIC):
        _write_resistances(network_of(netlist, group), sorted({pair for pair in wanted if pair[0] != pair[1]}), found)
    return np.array([float(found[pair]) if pair[0] != pair[1] else 0.0 for pair in wanted])


def _write_resistances(network: Network, pairs: Sequence[Pair], found: dict[Pair, Decimal]) -> None:
    """Compute the resistances of pairs of nodes in ohms, and write them to `found`.

    The nodes of no pair are eliminated.  Then the pairs are halved by their first or second nodes, so that nodes are
    eliminated once for many pairs.  `network`: conductances; `pairs`: different pairs of nodes.
    """
    if not pairs:
        return
    reduced = _without(network, {node for pair in pairs for node in pair})
    if len(pairs) == 1:
        ((first, second),) = pairs
        siemens = reduced.get(first, {}).get(second)
        found[first, second] = 1 / siemens if siemens else Decimal("Infinity")
        return
    sets = [sorted({pair[end] for pair in pairs}) for end in (0, 1)]
    end = int(len(sets[1]) > len(sets[0]))
    middle = sets[end][len(sets[end]) // 2]
    _write_resistances(reduced, [pair for pair in pairs if pair[end] < middle], found)
    _write_resistances(reduced, [pair for pair in pairs if pair[end] >= middle], found)


def network_of(netlist: Netlist, group: NDArray[np.integer[Any]]) -> Network:
    """Return the conductances between groups of joined nodes; `group` (nodes,): group of every node."""
    network: Network = {}
    ends = group[netlist.resistor_nodes].tolist()
    for (a, b), siemens in zip(ends, map(Decimal, netlist.conductance.tolist()), strict=True):
        if a != b:
            _add(network, a, b, siemens)
    return network


def _add(network: Network, a: int, b: int, siemens: Decimal) -> None:
    """Add a conductance in siemens between two nodes of a network, in place."""
    for node, other in ((a, b), (b, a)):
        star = network.setdefault(node, {})
        star[other] = star.get(other, Decimal(0)) + siemens


def _without(network: Network, kept: Iterable[int]) -> Network:
    """Return a network after the elimination of all nodes but `kept`; the given network is not changed."""
    reduced = {node: star.copy() for node, star in network.items()}
    for _ in eliminations(reduced, kept):
        pass
    return reduced


def eliminations(network: Network, kept: Iterable[int]) -> Iterator[tuple[int, dict[int, Decimal]]]:
    """Eliminate all nodes of a network but `kept` by star-mesh transforms, in place, always one with fewest neighbours.

    Yield every eliminated node, with the conductances that joined the node to its neighbours, in siemens.
    """
    stays = set(kept)
    queue = [(len(star), node) for node, star in network.items() if node not in stays]
    heapq.heapify(queue)
    while queue:
        degree, node = heapq.heappop(queue)
        if node not in network or len(network[node]) != degree:
            continue
        star = network.pop(node)
        _join_neighbours(network, node, star)
        for other in star:
            if other not in stays:
                heapq.heappush(queue, (len(network[other]), other))
        yield node, star


def _join_neighbours(network: Network, node: int, star: dict[int, Decimal]) -> None:
    """Join the neighbours of a removed node in its place; `star`: conductances between the node and its neighbours."""
    total, neighbours = sum(star.values()), list(star.items())
    for place, (a, siemens) in enumerate(neighbours):
        del network[a][node]
        part = siemens / total
        for b, other in neighbours[:place]:
            _add(network, a, b, part * other)
