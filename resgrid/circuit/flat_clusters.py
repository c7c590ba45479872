"""Kirchhoff's current law for flat clusters: connected nodes whose values differ by less than can be known.

Which way currents run inside a cluster, nobody can say; what flows into it and out of it is known, and must balance.
So a dead end that carries nothing is right, and stiffly joined nodes between two rails are so only at the right height.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.node_values import NodeValues
from resgrid.netlist import Netlist
from resgrid.solvers.extended import logarithm

_KNOWN, _GRAINS = np.log(1e-12), np.log(1e6)
"""Difference of two values, relative to the larger one, and in grains, from which a current is known; logarithms."""


def cluster_residual(
    netlist: Netlist,
    unknown: NDArray[np.int32],
    tied: NDArray[np.int64],
    values: NodeValues,
    amps: NDArray[np.float64],
    exponent: NDArray[np.int64],
    injected: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Violation of KCL by the cluster of every node, relative to the current through the cluster.

    Shapes: `unknown` (nodes,), `tied` (k, 2): nodes that floating voltage sources join, `amps, exponent` (resistors,),
    `injected` (nodes,); returns (nodes,).
    """
    ends, size = netlist.resistor_nodes, logarithm(np.abs(amps), exponent)
    known = size > np.log(netlist.conductance) + _least_log_volts(values, ends)
    cluster = _clusters(len(unknown), np.concatenate([ends[~known], tied]))
    one, other = cluster[ends[known]].T
    fed = np.flatnonzero(injected)
    # Into the second ends of resistors, out of the first ones, and into what sources feed.
    into = np.concatenate([other, one, cluster[fed]])
    sign = np.concatenate([np.sign(amps[known]), -np.sign(amps[known]), np.sign(injected[fed])])
    log = np.concatenate([size[known], size[known], np.log(np.abs(injected[fed]))])
    crosses = np.concatenate([one != other, one != other, np.ones(len(fed), dtype=np.bool_)])
    net, through = _summed(into[crosses], sign[crosses], log[crosses], int(cluster.max()) + 1)
    free = np.ones(len(net), dtype=np.bool_)
    free[cluster[unknown < 0]] = False
    residual = np.divide(np.abs(net), through, out=np.zeros(len(net)), where=free & (through > 0.0))
    return np.asarray(residual[cluster])


def _least_log_volts(values: NodeValues, ends: NDArray[np.int32]) -> NDArray[np.float64]:
    """Logarithm of the difference from which a current is known, in volts.

    It is judged by the larger value of both ends, or by the unit between two rails.
    """
    log = logarithm(np.abs(values.value.hi), values.value.exponent)
    a, b = ends.T
    larger = np.where(values.down[a] == values.down[b], np.maximum(log[a], log[b]), 0.0)
    grain = np.log(values.grain) if values.grain > 0.0 else -np.inf
    return np.asarray(np.maximum(_KNOWN + larger, _GRAINS + grain) + np.log(abs(values.volts)))


def _clusters(count: int, alike: NDArray[np.int64]) -> NDArray[np.int32]:
    """The cluster of every node, shape (count,), of pairs of nodes that are alike."""
    graph = sparse.coo_array((np.ones(len(alike), dtype=np.bool_), tuple(alike.T)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def _summed(
    into: NDArray[np.int32], sign: NDArray[np.float64], log: NDArray[np.float64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Net current into every cluster, and half the sum of all magnitudes, in units of the largest current there."""
    top = np.full(count, -np.inf)
    np.maximum.at(top, into, log)
    share = np.exp(log - top[into])
    # Counts of nothing come as whole numbers, whatever their weights.
    net, total = (np.asarray(np.bincount(into, weight, count), dtype=np.float64) for weight in (sign * share, share))
    return net, 0.5 * total
