"""Kirchhoff's current law for plateaus: connected nodes whose values differ by less than can be told.

Which way currents run inside a plateau, nobody can say; what flows into it and out of it is known, and must balance.
So a dead end that carries nothing is right, and stiffly joined nodes between two rails are so only at the right height.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.equations import Equations
from resgrid.circuit.node_values import NodeValues
from resgrid.netlist import GROUND
from resgrid.solvers.extended import logarithm

_TOLD, _GRAINS = np.log(1e-12), np.log(1e6)
"""Difference of two values, relative to the larger one, and in grains, from which a current is known; logarithms."""


def plateau_residual(
    system: Equations,
    values: NodeValues,
    amps: NDArray[np.float64],
    exponent: NDArray[np.int64],
    injected: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Violation of KCL by the plateau of every node, relative to the current through the plateau.

    Floating voltage sources join the nodes that they tie.

    Shapes: `amps, exponent` (resistors,), `injected` (nodes,); returns (nodes,).
    """
    ends, size = system.netlist.resistor_nodes, logarithm(np.abs(amps), exponent)
    told = size > np.log(system.netlist.conductance) + _least_log_volts(values, ends)
    plateau = _plateaus(system, ends[~told])
    one, other = plateau[ends[told]].T
    fed = np.flatnonzero(injected)
    # Into the second ends of resistors, out of the first ones, and into what sources feed.
    into = np.concatenate([other, one, plateau[fed]])
    sign = np.concatenate([np.sign(amps[told]), -np.sign(amps[told]), np.sign(injected[fed])])
    log = np.concatenate([size[told], size[told], np.log(np.abs(injected[fed]))])
    crosses = np.concatenate([one != other, one != other, np.ones(len(fed), dtype=np.bool_)])
    net, through = _summed(into[crosses], sign[crosses], log[crosses], int(plateau.max()) + 1)
    free = np.ones(len(net), dtype=np.bool_)
    free[plateau[system.unknown < 0]] = False
    residual = np.divide(np.abs(net), through, out=np.zeros(len(net)), where=free & (through > 0.0))
    return np.asarray(residual[plateau])


def _least_log_volts(values: NodeValues, ends: NDArray[np.int32]) -> NDArray[np.float64]:
    """Logarithm of the difference from which a current is known, in volts.

    It is judged by the larger value of both ends, or by the unit between two rails.
    """
    log = logarithm(np.abs(values.value.hi), values.value.exponent)
    a, b = ends.T
    larger = np.where(values.down[a] == values.down[b], np.maximum(log[a], log[b]), 0.0)
    grain = np.log(values.grain) if values.grain > 0.0 else -np.inf
    return np.asarray(np.maximum(_TOLD + larger, _GRAINS + grain) + np.log(abs(values.volts)))


def _plateaus(system: Equations, alike: NDArray[np.int32]) -> NDArray[np.int32]:
    """The plateau of every node."""
    forest, count = system.forest, len(system.unknown)
    lifted = forest.base != GROUND
    row = np.concatenate([alike[:, 0], forest.order[lifted]])
    column = np.concatenate([alike[:, 1], forest.base[lifted]])
    graph = sparse.coo_array((np.ones(len(row), dtype=np.bool_), (row, column)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def _summed(
    into: NDArray[np.int32], sign: NDArray[np.float64], log: NDArray[np.float64], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Net current into every plateau, and half the sum of all magnitudes, in units of the largest current there."""
    top = np.full(count, -np.inf)
    np.maximum.at(top, into, log)
    share = np.exp(log - top[into])
    # Counts of nothing come as whole numbers, whatever their weights.
    net, total = (np.asarray(np.bincount(into, weight, count), dtype=np.float64) for weight in (sign * share, share))
    return net, 0.5 * total
