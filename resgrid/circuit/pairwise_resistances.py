"""Effective resistances of all pairs of nodes of a dense network, by elimination without subtractions.

A relative error of at most ``e`` in every conductance changes an effective resistance by at most ``e``, because
effective resistances are monotone in conductances (Rayleigh 1871) and have degree -1.  The elimination of a node from
the reduced network (`resgrid.circuit.resistance_kernels`) only rounds the remaining conductances, and these errors add
up to at most a few roundings per eliminated node.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_ROUNDINGS = 8.0 * float(np.finfo(np.float64).eps)
"""Bound on the relative error that rounding adds to a conductance when a node is eliminated."""

_LEAF = 16
"""Largest number of nodes of a network whose resistances are computed by a separate elimination for every pair."""


def resistances_between(conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the effective resistance between every two nodes of a dense network, in ohms, (k, k).

    The resistance between nodes that are not connected is infinite. `conductance` (k, k): symmetric conductances in
    siemens. Nodes are eliminated without subtractions. Divide and conquer (the nodes of one half are eliminated once
    for all pairs of the other half) takes about ``3 k**3`` operations.
    """
    count = len(conductance)
    resistance = np.zeros((count, count))
    largest = float(conductance.max(initial=0.0))
    if count < 2 or not largest:
        resistance[~np.eye(count, dtype=np.bool_)] = np.inf
        return resistance
    unit = 2.0 ** np.floor(np.log2(largest))
    _within(conductance / unit, np.arange(count), resistance)
    with np.errstate(over="ignore"):
        return np.asarray(resistance / unit)


def _within(network: NDArray[np.float64], nodes: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Compute the effective resistances between all nodes of a network, and write them to `out`.

    `network` (k, k): conductances; `nodes` (k,): index in `out` of every node; `out` (n, n): resistances, in units of 1
    / conductance.
    """
    from resgrid.circuit.resistance_kernels import without_nodes

    count = len(nodes)
    if count <= _LEAF:
        _write_small(network, 0, nodes, out)
        return
    half, order = count // 2, np.arange(count)
    _within(without_nodes(network, order, half), nodes[:half], out)
    _within(without_nodes(network, np.roll(order, -half), count - half), nodes[half:], out)
    _across(network, half, nodes, out)


def _across(network: NDArray[np.float64], half: int, nodes: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Compute the effective resistances between the first `half` nodes of a network and its other nodes.

    `network` (k, k): conductances; `nodes` (k,): index in `out` of every node; `out` (n, n): array to which the
    resistances are written. The larger set of nodes is halved, and each half is eliminated in turn.
    """
    from resgrid.circuit.resistance_kernels import without_nodes

    count = len(nodes)
    if count <= _LEAF:
        _write_small(network, half, nodes, out)
        return
    order, splits_first = np.arange(count), 2 * half > count
    begin, end = (0, half) if splits_first else (half, count)
    middle = (begin + end) // 2
    for left_out in (slice(middle, end), slice(begin, middle)):
        kept = np.delete(order, left_out)
        reduced = without_nodes(network, np.concatenate([kept, order[left_out]]), len(kept))
        _across(reduced, half - (left_out.stop - left_out.start) * splits_first, nodes[kept], out)


def _write_small(network: NDArray[np.float64], half: int, nodes: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Compute the effective resistances in a network of at most `_LEAF` nodes, and write them to `out`.

    `network` (k, k): conductances; `half`: number k1 for the resistances between the first k1 nodes and the others;
    0 for all pairs; `nodes` (k,): index in `out` of every node; `out` (n, n): resistances.
    """
    from resgrid.circuit.resistance_kernels import small_network_resistances

    found = np.zeros_like(network)
    small_network_resistances(network, half, np.empty_like(network), found)
    if not half:
        out[np.ix_(nodes, nodes)] = found
        return
    out[np.ix_(nodes[:half], nodes[half:])] = found[:half, half:]
    out[np.ix_(nodes[half:], nodes[:half])] = found[half:, :half]


def elimination_error(count: int) -> float:
    """Return the bound on the relative rounding error of resistances by elimination in a network of `count` nodes."""
    return _ROUNDINGS * count
