"""Ideal voltage sources: each source fixes the voltage difference of two nodes and so removes an unknown.

The sources are the edges of a graph.  A spanning forest of this graph gives every node a voltage offset from the root
of the node's tree; ground is the root of the tree that contains ground.  A source that closes a loop must agree with
the forest, and the currents in that loop are undetermined.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import CircuitError

_Amps = TypeVar("_Amps", int, float, Fraction)

LOOP_TOLERANCE = 1e-12
"""Largest voltage by which sources in a loop may contradict each other, relative to the largest source of the loop."""

_ROUNDED = 1e-24
"""Mismatch of a loop, relative to the voltages of its nodes, up to which it is computed again without rounding."""

_MOST_OF_FLOW = 0.6
"""Limit on the current of the subtree below a source, as a fraction of the total current of the tree of sources.

The current of the source is the sum over the subtree up to this limit, and beyond it the sum over the rest of the tree,
because the smaller sum has the smaller rounding error.
"""


@dataclass(frozen=True, eq=False)
class SourceForest:
    """Spanning forest of the voltage sources: sources are edges, and a tree joins nodes with known voltage differences.

    Tied nodes are ground and the nodes at sources.  `count`: number of nodes of the circuit; `order` (tied nodes,):
    node numbers, parents before children; `base` (tied nodes,): node number of the root of the tree, which is ground in
    the tree of ground; `height`, `rounding` (tied nodes,): voltage above the root as a double, and its rounding error,
    in volts; `parent`, `source` (tied nodes,): node number of the parent, and index of the source between node and
    parent; -1 for roots; `loop` (sources,): whether the source belongs to a loop of sources; `exact`: exact voltages
    above the root by node number, in volts.  A node whose only source leads to ground is left out of `exact`, since its
    `height` is exact.
    """

    count: int
    order: NDArray[np.int64]
    base: NDArray[np.int64]
    height: NDArray[np.float64]
    rounding: NDArray[np.float64]
    parent: NDArray[np.int64]
    source: NDArray[np.int64]
    loop: NDArray[np.bool_]
    exact: Mapping[int, float | Fraction]

    @property
    def ties(self) -> list[tuple[int, int, int, int]]:
        """Tuples (node, parent, index of source, root) of all nodes at sources but the roots, parents first."""
        tied = self.source >= 0
        parts = (self.order, self.parent, self.source, self.base)
        return list(zip(*(part[tied].tolist() for part in parts), strict=True))

    @property
    def largest_offset(self) -> float:
        """Largest magnitude of a node voltage above the root of the tree, in volts, over the trees without ground."""
        return float(np.abs(self.height[self.base != GROUND]).max(initial=0.0))

    @property
    def root(self) -> NDArray[np.int64]:
        """Root of the tree of every node, shape (nodes,); the node itself if no source is connected to it."""
        root = np.arange(self.count)
        root[self.order] = self.base
        return root

    @property
    def offsets(self) -> NDArray[np.float64]:
        """Voltage of every node above the root of its tree, and the rounding error, in volts, shape (2, nodes)."""
        offsets = np.zeros((2, self.count))
        offsets[:, self.order] = self.height, self.rounding
        return offsets


def tie_sources(netlist: Netlist) -> SourceForest:
    """Return the spanning forest of the voltage sources; raise CircuitError if sources of a loop contradict each other.

    In ``SourceForest.order``, nodes whose only source leads to ground come last.
    """
    nodes = netlist.source_nodes.max(axis=1)
    leaf = (netlist.source_nodes.min(axis=1) == GROUND) & (nodes != GROUND)
    leaf &= np.bincount(netlist.source_nodes.ravel(), minlength=netlist.node_count)[nodes] == 1
    others, ends, volts = np.flatnonzero(~leaf), netlist.source_nodes.tolist(), netlist.source_volts.tolist()
    ties, exact = _grow_trees(others.tolist(), ends, volts)
    if sum(source >= 0 for *_, source in ties) < len(others):  # there are loops: leave out the largest source of each
        kept = _smallest_forest(others[np.argsort(np.abs(netlist.source_volts[others]), kind="stable")].tolist(), ends)
        ties, exact = _grow_trees(sorted(kept), ends, volts)
    order, base, above, source = np.array(ties, dtype=np.int64).T
    try:
        height, closing = np.array([float(exact[node]) for node, *_ in ties]), ~leaf
    except OverflowError:
        raise CircuitError(
            "voltage sources in series exceed 1.8e308 V, the range of doubles; check their units"
        ) from None
    closing[source[source >= 0]] = False
    upright = np.where(netlist.source_nodes[:, 1] == GROUND, 1.0, -1.0)
    order, height = np.append(order, nodes[leaf]), np.append(height, (upright * netlist.source_volts)[leaf])
    base, above = (np.append(part, np.full(np.count_nonzero(leaf), GROUND)) for part in (base, above))
    source, rest = np.append(source, np.flatnonzero(leaf)), np.zeros(len(order))
    rounded = [number for number, (node, *_) in enumerate(ties) if isinstance(exact[node], Fraction)]
    rest[rounded] = [float(exact[ties[number][0]] - Fraction(height[number])) for number in rounded]
    forest = SourceForest(netlist.node_count, order, base, height, rest, above, source, closing, exact)
    if closing.any():
        _check_loops(netlist, forest)
        _mark_loops(netlist, forest)
    return forest


def _grow_trees(
    sources: Sequence[int], ends: Sequence[Sequence[int]], volts: Sequence[float]
) -> tuple[list[tuple[int, int, int, int]], dict[int, float | Fraction]]:
    """Return tuples (node, root, parent, source) of all nodes at sources, and their exact voltages above the roots.

    Parent and source of a root are -1.  The voltages, in volts, are in a dict by node number, as fractions or floats.
    `sources`: indices of the sources to use; `ends`: plus and minus node of every source; `volts`: voltage of every
    source.
    """
    sources_at: dict[int, list[int]] = {GROUND: []}
    for number in sources:
        for end in ends[number]:
            sources_at.setdefault(end, []).append(number)
    exact: dict[int, float | Fraction] = {}
    ties: list[tuple[int, int, int, int]] = []
    for first in sorted(sources_at):
        if first in exact:
            continue
        exact[first], tree = 0.0, [(first, first, -1, -1)]
        for node, *_ in tree:  # breadth-first search: the list grows
            for number in sources_at[node]:
                plus, minus = ends[number]
                other, step = (plus, volts[number]) if minus == node else (minus, -volts[number])
                if other not in exact:
                    exact[other] = Fraction(exact[node]) + Fraction(step) if exact[node] else step
                    tree.append((other, first, node, number))
        ties += tree
    return ties, exact


def _smallest_forest(sources: Sequence[int], ends: Sequence[Sequence[int]]) -> list[int]:
    """Return the indices of the sources in Kruskal's minimum spanning forest.

    `sources`: indices of the sources, sorted by voltage; `ends`: plus and minus node of every source.  If small sources
    contradict each other, a large source in the same loop does not hide the contradiction.
    """
    parent: dict[int, int] = {}

    def part_of(node: int) -> int:
        while (above := parent.setdefault(node, node)) != node:
            parent[node] = node = parent[above]
        return node

    kept = []
    for number in sources:
        plus, minus = (part_of(node) for node in ends[number])
        if plus != minus:
            parent[plus] = minus
            kept.append(number)
    return kept


def source_currents(
    netlist: Netlist, forest: SourceForest, outflow: NDArray[np.float64], through: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the current into the plus terminal of every voltage source, (sources,), in amperes, from KCL.

    `outflow` (nodes,): net current out of a node; `through` (nodes,): half the sum of the current magnitudes at a node.
    Removing a source cuts a tree of the forest in two.  KCL is summed over the side with the smaller currents, where
    the rounding error is smaller.
    """
    ties = forest.ties
    remaining, flow = ({node: float(values[node]) for node in forest.order.tolist()} for values in (outflow, through))
    for node, above, _, _ in reversed(ties):
        flow[above] += flow[node]
    inwards = [(above, node, source) for node, above, source, base in ties if flow[node] > _MOST_OF_FLOW * flow[base]]
    turned = {source for _, _, source in inwards}
    outwards = [(node, above, source) for node, above, source, _ in reversed(ties) if source not in turned]
    current = np.full(len(netlist.source_volts), np.nan)
    for source, amps in _cut_currents(netlist, outwards + inwards, remaining):
        current[source] = amps
    return without_loops(forest, current)


def sum_cuts(netlist: Netlist, forest: SourceForest, outflow: Sequence[_Amps]) -> list[_Amps]:
    """Return the current into the plus terminal of every voltage source, (sources,), by exact sums over subtrees.

    `outflow` (nodes,): net current out of every node, in any exact unit.  Sources outside the forest get 0.
    """
    towards_roots = [(node, above, source) for node, above, source, _ in reversed(forest.ties)]
    current = [0 * outflow[GROUND]] * len(netlist.source_volts)
    remaining = {node: outflow[node] for node in forest.order.tolist()}
    for source, amps in _cut_currents(netlist, towards_roots, remaining):
        current[source] = amps
    return current


def _cut_currents(
    netlist: Netlist, steps: list[tuple[int, int, int]], remaining: dict[int, _Amps]
) -> Iterator[tuple[int, _Amps]]:
    """Yield (source, current into the plus terminal): each step moves the remaining current of a node through a source.

    `steps`: tuples (node, node at the other end of the source, source index), in the order of processing; `remaining`:
    current out of every node, by node number, changed in place; all currents are in one exact unit.
    """
    for node, other, source in steps:
        yield source, -remaining[node] if netlist.source_nodes[source, 0] == node else remaining[node]
        remaining[other] += remaining[node]


def without_loops(forest: SourceForest, current: NDArray[np.float64]) -> NDArray[np.float64]:
    """Set the currents of sources in loops to NaN, in place, with a warning; return the array.

    `current` (sources,): current into the plus terminal of every voltage source, in amperes.
    """
    if forest.loop.any():
        current[forest.loop] = np.nan
        warnings.warn(
            f"{int(forest.loop.sum())} voltage sources form loops; their currents are undetermined (NaN)", stacklevel=2
        )
    return current


def contradictions(
    forest: SourceForest, forest_volts: NDArray[np.float64], ends: NDArray[np.int32], volts: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return by how many volts each source contradicts the forest, and whether by more than the tolerance; (sources,).

    `forest_volts` (sources of the forest,): voltages of the sources from which the forest was built; `ends` (sources,
    2), `volts` (sources,): plus and minus nodes, and voltages, of the sources to check.  The tolerance is
    `LOOP_TOLERANCE` times the largest source voltage of the loop.  Sources outside the loop may be larger by many
    orders of magnitude.
    """
    (plus, minus), (plus_rest, minus_rest) = (level[ends.T] for level in forest.offsets)
    mismatch = np.abs(plus - minus - volts + (plus_rest - minus_rest))
    heights, level = forest.offsets[0], np.maximum(np.abs(plus), np.abs(minus))
    for number in np.flatnonzero((mismatch > 0.0) & (mismatch <= _ROUNDED * level)).tolist():
        rise = [Fraction(forest.exact.get(node, heights[node])) for node in ends[number].tolist()]
        mismatch[number] = abs(float(rise[0] - rise[1] - Fraction(volts[number])))
    largest = max(np.abs(part).max(initial=0.0) for part in (forest_volts, volts))
    bad = mismatch > LOOP_TOLERANCE * np.abs(volts)
    doubtful = np.flatnonzero(bad & (mismatch <= LOOP_TOLERANCE * largest))
    if doubtful.size:
        above = {node: (parent, abs(float(forest_volts[source]))) for node, parent, source, _ in forest.ties}
        for number in doubtful.tolist():
            first, second = ends[number].tolist()
            bad[number] = mismatch[number] > LOOP_TOLERANCE * _largest_between(above, first, second)
    return mismatch, bad


def _largest_between(above: Mapping[int, tuple[int, float]], first: int, second: int) -> float:
    """Return the largest source voltage, in volts, on the path between two nodes of a tree.

    `above`: for every node but the root, its parent and the voltage of the source between both; `first`, `second`:
    numbers of the two nodes.
    """
    largest_to, largest = {first: 0.0}, 0.0
    while first in above:
        first, step = above[first]
        largest = max(largest, step)
        largest_to[first] = largest
    largest = 0.0
    while second not in largest_to:
        second, step = above[second]
        largest = max(largest, step)
    return max(largest, largest_to[second])


def _check_loops(netlist: Netlist, forest: SourceForest) -> None:
    mismatch, contradicts = contradictions(forest, netlist.source_volts, netlist.source_nodes, netlist.source_volts)
    bad = np.flatnonzero(forest.loop & contradicts)
    if bad.size:
        source = int(bad[0])
        names = netlist.names_of(netlist.source_nodes[source])
        raise CircuitError(
            f"voltage source {source} between nodes {names[0]} and {names[1]} contradicts the other sources by "
            f"{mismatch[source]:g} V: remove it, or insert a resistor into the loop"
        )


def _mark_loops(netlist: Netlist, forest: SourceForest) -> None:
    """Mark all sources that belong to loops in `forest.loop`, in place; sources that close loops are already marked.

    A source of the forest belongs to a loop if exactly one end of a closing source lies in the subtree below it.  Every
    closing source has a random bit pattern, and the exclusive or over a subtree cancels sources with both ends in it.
    """
    below, closing = np.zeros(forest.count, dtype=np.int64), netlist.source_nodes[forest.loop]
    bits = np.random.default_rng(0).integers(2**62, size=len(closing))
    for end in closing.T:
        np.bitwise_xor.at(below, end, bits)
    for node, above, source, _ in reversed(forest.ties):
        forest.loop[source] = below[node] != 0
        below[above] ^= below[node]
