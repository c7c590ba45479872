"""Ideal voltage sources: every one removes an unknown by tying two nodes at a fixed difference.

The sources form a graph.  A spanning forest of it gives every node an offset from the root of its tree (ground is the
root of its own); a source that closes a loop must agree with the forest, and leaves the currents of that loop unknown.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import CircuitError
from resgrid.netlist import GROUND, Netlist

_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class SourceForest:
    """How voltage sources tie nodes together.

    Attributes
    ----------
    root : ndarray of int64, shape (nodes,)
        Node that every node's voltage is counted from: ground, a tree's first node, or the node itself.
    offset : ndarray of float64, shape (nodes,)
        Voltage above the root, in volts.
    order : ndarray of int64
        Nodes of the trees, parents before children.
    parent_source : ndarray of int64, shape (nodes,)
        Source that ties a node to its parent, -1 for roots.
    parent : ndarray of int64, shape (nodes,)
        Parent node, -1 for roots.
    loop : ndarray of bool, shape (sources,)
        Sources that belong to a loop of sources.
    """

    root: NDArray[np.int64]
    offset: NDArray[np.float64]
    order: NDArray[np.int64]
    parent_source: NDArray[np.int64]
    parent: NDArray[np.int64]
    loop: NDArray[np.bool_]


def tie_sources(netlist: Netlist) -> SourceForest:
    """Build the spanning forest of the voltage sources.

    Raises
    ------
    CircuitError
        If a loop of sources contradicts itself; the message names its last source and the voltage left over.
    """
    count = netlist.node_count
    ends, volts = netlist.source_nodes, netlist.source_volts
    order, parent = _walk(ends, count)
    parent_source = _tree_sources(ends, parent, count)
    root = np.arange(count)
    offset = np.zeros(count)
    for node in order[parent[order] >= 0].tolist():
        source, up = int(parent_source[node]), int(parent[node])
        root[node] = root[up]
        sign = 1.0 if ends[source, 0] == node else -1.0
        offset[node] = offset[up] + sign * volts[source]
    closing = np.ones(len(volts), dtype=np.bool_)
    closing[parent_source[parent_source >= 0]] = False
    _check_loops(netlist, offset, closing)
    loop = _loops(ends, closing, parent, parent_source)
    return SourceForest(root, offset, order, parent_source, parent, loop)


def source_currents(netlist: Netlist, forest: SourceForest, outflow: NDArray[np.float64]) -> NDArray[np.float64]:
    """Current into the plus terminal of every voltage source, from KCL on the forest.

    Parameters
    ----------
    netlist : Netlist
    forest : SourceForest
    outflow : ndarray of float64, shape (nodes,)
        Current that leaves every node through resistors and current sources, in amperes.

    Returns
    -------
    ndarray of float64, shape (sources,)
        In amperes; NaN for sources in a loop, with a warning.
    """
    current = np.full(len(netlist.source_volts), np.nan)
    remaining = outflow.copy()
    for node in forest.order[::-1].tolist():
        source = int(forest.parent_source[node])
        if source < 0:
            continue
        from_source = remaining[node]
        current[source] = -from_source if netlist.source_nodes[source, 0] == node else from_source
        remaining[forest.parent[node]] += from_source
    if forest.loop.any():
        current[forest.loop] = np.nan
        warnings.warn(
            f"{int(forest.loop.sum())} voltage sources form loops; their currents are undetermined (NaN)", stacklevel=2
        )
    return current


def _walk(ends: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Nodes tied by sources, parents before children, and the parent of each; ground is the first root."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    parent = np.full(count, -1, dtype=np.int64)
    tied = np.unique(np.append(ends, GROUND))
    local = np.searchsorted(tied, ends)
    size = len(tied)
    graph = coo_array((np.ones(len(ends)), (local[:, 0], local[:, 1])), shape=(size, size))
    _, tree = connected_components(graph, directed=False)
    _, roots = np.unique(tree, return_index=True)
    # A virtual node above all roots turns the forest into one tree, walked at once.
    rows = np.append(local[:, 0], np.full(len(roots), size))
    columns = np.append(local[:, 1], roots)
    whole = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size + 1, size + 1)).tocsr()
    order, above = breadth_first_order(whole, size, directed=False)
    order = order[1:]
    child = order[above[order] != size]
    parent[tied[child]] = tied[above[child]]
    return tied[order], parent


def _tree_sources(ends: NDArray[np.int64], parent: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """For every node with a parent, the first source that joins the two."""
    found = np.full(count, -1, dtype=np.int64)
    number = np.arange(len(ends))[::-1]
    for child, up in ((0, 1), (1, 0)):
        nodes = ends[number, child]
        fits = parent[nodes] == ends[number, up]
        found[nodes[fits]] = number[fits]
    return found


def _check_loops(netlist: Netlist, offset: NDArray[np.float64], closing: NDArray[np.bool_]) -> None:
    plus, minus = netlist.source_nodes[closing].T
    left_over = offset[plus] - offset[minus] - netlist.source_volts[closing]
    scale = np.max(np.abs(netlist.source_volts), initial=0.0)
    bad = np.flatnonzero(np.abs(left_over) > _TOLERANCE * scale)
    if bad.size:
        source = int(np.flatnonzero(closing)[bad[0]])
        names = netlist.names_of(netlist.source_nodes[source])
        raise CircuitError(
            f"voltage source {source} between nodes {names[0]} and {names[1]} contradicts the other sources by "
            f"{abs(left_over[bad[0]]):g} V: remove it, or put a resistor into the loop"
        )


def _loops(
    ends: NDArray[np.int64], closing: NDArray[np.bool_], parent: NDArray[np.int64], parent_source: NDArray[np.int64]
) -> NDArray[np.bool_]:
    loop = closing.copy()
    for a, b in ends[closing].tolist():
        way_a, way_b = _to_root(a, parent), _to_root(b, parent)
        while way_a and way_b and way_a[-1] == way_b[-1]:
            way_a.pop()
            way_b.pop()
        loop[parent_source[way_a + way_b]] = True
    return loop


def _to_root(node: int, parent: NDArray[np.int64]) -> list[int]:
    way = [node]
    while parent[way[-1]] >= 0:
        way.append(int(parent[way[-1]]))
    return way
