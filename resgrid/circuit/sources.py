"""Ideal voltage sources: every one removes an unknown by tying two nodes at a fixed difference.

The sources form a graph.  A spanning forest of it gives every node an offset from the root of its tree (ground is the
root of its own); a source that closes a loop must agree with the forest, and leaves the currents of that loop unknown.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from fractions import Fraction
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import CircuitError
from resgrid.netlist import GROUND, Netlist

LOOP_TOLERANCE = 1e-12
"""Share of the largest voltage up to which the sources of a loop agree."""

_MOST_OF_FLOW = 0.6
"""Share of what flows in a tree of sources from which its lower part is the louder one."""


@dataclass(frozen=True, eq=False)
class SourceForest:
    """How voltage sources tie nodes together.

    `count`: number of nodes of the circuit; `order` (tied nodes,): the nodes that sources tie, and ground; parents
    before children; `base` (tied nodes,): node that the voltage of each is counted from: ground, or its tree's first
    node; `height` (tied nodes,): its voltage above that node, in volts; `above, source` (tied nodes,): its parent,
    and the source that ties it there; -1 for roots; `loop` (sources,): sources that belong to a loop of sources.
    """

    count: int
    order: NDArray[np.int64]
    base: NDArray[np.int64]
    height: NDArray[np.float64]
    above: NDArray[np.int64]
    source: NDArray[np.int64]
    loop: NDArray[np.bool_]

    @property
    def lift(self) -> float:
        """The most by which a floating source holds a node above its tree's first one, in volts."""
        return float(np.abs(self.height[self.base != GROUND]).max(initial=0.0))

    @property
    def root(self) -> NDArray[np.int64]:
        """Node that every node's voltage is counted from, shape (nodes,): itself, where no source ties it."""
        root = np.arange(self.count)
        root[self.order] = self.base
        return root

    @property
    def offset(self) -> NDArray[np.float64]:
        """Voltage of every node above its root, in volts, shape (nodes,)."""
        offset = np.zeros(self.count)
        offset[self.order] = self.height
        return offset


def tie_sources(netlist: Netlist) -> SourceForest:
    """Build the spanning forest of the voltage sources."""
    tied = np.unique(np.append(netlist.source_nodes, GROUND))
    ends, volts = np.searchsorted(tied, netlist.source_nodes), netlist.source_volts
    order, parent = _walk(ends, len(tied))
    source = _tree_sources(ends, parent)
    base, height = np.arange(len(tied)), np.zeros(len(tied))
    exact: list[float | Fraction] = [0.0] * len(tied)  # sums of volts that cancel do so to the last digit
    for node in order[parent[order] >= 0].tolist():
        up, tie = int(parent[node]), int(source[node])
        base[node] = base[up]
        step = float(volts[tie] if ends[tie, 0] == node else -volts[tie])
        exact[node] = Fraction(exact[up]) + Fraction(step) if exact[up] else step
        height[node] = float(exact[node])
    closing = np.ones(len(volts), dtype=np.bool_)
    closing[source[source >= 0]] = False
    _check_loops(netlist, height[ends[:, 0]] - height[ends[:, 1]] - volts, closing)
    return SourceForest(
        count=netlist.node_count,
        order=tied[order],
        base=tied[base[order]],
        height=height[order],
        above=np.where(parent >= 0, tied[parent], -1)[order],
        source=source[order],
        loop=_loops(ends, closing, order, parent, source),
    )


def source_currents(
    netlist: Netlist, forest: SourceForest, outflow: NDArray[np.float64], through: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Current into the plus terminal of every voltage source, from KCL on the forest.

    That of a floating source is summed on the side of it where less flows, and less is lost to rounding: from the
    leaves of its tree and from its root towards the node around which most flows.
    Shapes: `outflow, through` (nodes,), the net current and half the sum of all magnitudes; returns (sources,).
    """
    current = np.full(len(netlist.source_volts), np.nan)
    ties = list(zip(*(part.tolist() for part in (forest.order, forest.above, forest.source)), strict=True))
    remaining, flow = ({node: float(values[node]) for node, *_ in ties} for values in (outflow, through))
    for node, above, source in reversed(ties):
        if source >= 0:
            flow[above] += flow[node]
    floating = forest.base != GROUND
    heavy = [
        tie
        for tie, base in zip(compress(ties, floating), forest.base[floating].tolist(), strict=True)
        if flow[tie[0]] > _MOST_OF_FLOW * flow[base] and tie[2] >= 0
    ]
    inwards = set(heavy)
    for node, above, source in [tie for tie in reversed(ties) if tie not in inwards]:
        if source >= 0:
            current[source] = remaining[node] * (-1.0 if netlist.source_nodes[source, 0] == node else 1.0)
            remaining[above] += remaining[node]
    for node, above, source in heavy:
        current[source] = remaining[above] * (-1.0 if netlist.source_nodes[source, 0] == above else 1.0)
        remaining[node] += remaining[above]
    if forest.loop.any():
        current[forest.loop] = np.nan
        warnings.warn(
            f"{int(forest.loop.sum())} voltage sources form loops; their currents are undetermined (NaN)", stacklevel=2
        )
    return current


def _walk(ends: NDArray[np.int64], size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Tied nodes, parents before children, and the parent of each; ground, which is node 0, is the first root."""
    if not ends.min(axis=1).any():  # every source stands on ground
        return np.arange(size), np.append(-1, np.zeros(size - 1, dtype=np.int64))
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    graph = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(size, size))
    _, tree = connected_components(graph, directed=False)
    _, roots = np.unique(tree, return_index=True)
    # A virtual node above all roots turns the forest into one tree, walked at once.
    rows = np.append(ends[:, 0], np.full(len(roots), size))
    columns = np.append(ends[:, 1], roots)
    whole = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size + 1, size + 1)).tocsr()
    order, above = breadth_first_order(whole, size, directed=False)
    parent = above[:size].astype(np.int64)
    return order[1:].astype(np.int64), np.where(parent == size, -1, parent)


def _tree_sources(ends: NDArray[np.int64], parent: NDArray[np.int64]) -> NDArray[np.int64]:
    """For every node with a parent, the first source that joins the two; -1 for the others."""
    found = np.full(len(parent), -1, dtype=np.int64)
    number = np.arange(len(ends))[::-1]
    for child, up in ((0, 1), (1, 0)):
        nodes = ends[number, child]
        fits = parent[nodes] == ends[number, up]
        found[nodes[fits]] = number[fits]
    return found


def _check_loops(netlist: Netlist, left_over: NDArray[np.float64], closing: NDArray[np.bool_]) -> None:
    scale = np.max(np.abs(netlist.source_volts), initial=0.0)
    bad = np.flatnonzero(closing & (np.abs(left_over) > LOOP_TOLERANCE * scale))
    if bad.size:
        source = int(bad[0])
        names = netlist.names_of(netlist.source_nodes[source])
        raise CircuitError(
            f"voltage source {source} between nodes {names[0]} and {names[1]} contradicts the other sources by "
            f"{abs(left_over[source]):g} V: remove it, or put a resistor into the loop"
        )


def _loops(
    ends: NDArray[np.int64], closing: NDArray[np.bool_], order: NDArray[np.int64], parent: NDArray[np.int64],
    source: NDArray[np.int64],
) -> NDArray[np.bool_]:  # fmt: skip
    """Sources that close loops, and those of the forest that have one end alone of some of them below: random bits."""
    loop, below = closing.copy(), np.zeros(len(parent), dtype=np.int64)
    bits = np.random.default_rng(0).integers(2**62, size=np.count_nonzero(closing))
    for end in ends[closing].T:
        np.bitwise_xor.at(below, end, bits)
    for node in order[parent[order] >= 0][::-1].tolist() if closing.any() else ():
        loop[source[node]] = below[node] != 0
        below[parent[node]] ^= below[node]
    return loop
