"""Which current no nonlinear resistor can carry: the cut that current sources would overload.

A nonlinear resistor carries less than its ``I0``, so a circuit has an operating point if and only if the currents fed
in could flow to the rails with every one of them below capacity: a maximum flow (Ford & Fulkerson 1956).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.equations import Equations
from resgrid.errors import CircuitError
from resgrid.netlist import Netlist

_UNITS = 2**28
"""What the largest demand is in the whole numbers that the flow is computed in."""

_SLACK = 1 + 2.0**-20
"""How much more is fed in than there is, so that of two equal cuts the one through resistors is found."""

_MARGIN = 1e-12
"""Share of what a cut carries, below which doubles do not tell what is left of it."""


def refuse_saturated_cut(netlist: Netlist, system: Equations) -> None:
    """Refuse a circuit whose current sources exceed what a cut through nonlinear resistors can carry."""
    injected = system.injected
    demand = max(float(injected[injected > 0].sum()), float(-injected[injected < 0].sum()))
    if demand == 0:
        return
    for inside in _tightest(netlist, system, injected, demand):
        across, capacity = _leading_out(netlist, system, inside)
        fed = abs(float(injected[inside].sum()))
        if across.size and fed >= capacity * (1 - _MARGIN):
            raise CircuitError(_message(netlist, system, inside, across, fed, capacity))


def _message(
    netlist: Netlist,
    system: Equations,
    inside: NDArray[np.bool_],
    across: NDArray[np.int64],
    fed: float,
    capacity: float,
) -> str:
    nodes = np.flatnonzero((system.unknown >= 0) & inside[np.maximum(system.unknown, 0)])
    names = netlist.names_of(netlist.nonlinear_nodes[across[0]])
    what = "is no operating point" if fed >= capacity else "may be no operating point, so close are the resistors to I0"
    return (
        f"there {what}: the current sources drive {fed:.6g} A through the {len(across)} nonlinear "
        f"resistors around {len(nodes)} nodes (such as {netlist.node_name(int(nodes[0]))}), but these (such as the one "
        f"between {names[0]} and {names[1]}) carry less than {capacity:.6g} A, the sum of their I0; "
        "feed less current, or raise I0"
    )


def _tightest(
    netlist: Netlist, system: Equations, injected: NDArray[np.float64], demand: float
) -> Iterator[NDArray[np.bool_]]:
    """Rows cut off from the rails by a minimum cut, shape (n,): the cut nearest what is fed in, then the farthest."""
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    rail, source, sink = system.size, system.size + 1, system.size + 2
    capacity = _flow_graph(netlist, system, injected, demand)
    left = sparse.csr_array(capacity - maximum_flow(capacity, source, sink).flow)
    left.eliminate_zeros()
    for graph, terminal in ((left, source), (left.T.tocsr(), sink)):
        side = np.zeros(system.size + 3, dtype=np.bool_)
        side[breadth_first_order(graph, terminal, return_predecessors=False)] = True
        yield np.asarray(side[: system.size] != side[rail])


def _flow_graph(netlist: Netlist, system: Equations, injected: NDArray[np.float64], demand: float) -> Any:
    """Capacities between rows, the rails (as one), the source of what is fed in and the sink of what is taken out."""
    size = system.size
    rail, source, sink = size, size + 1, size + 2
    scale = _UNITS / demand
    outer = scale * _SLACK
    rows = np.where(system.unknown < 0, rail, system.unknown)
    limit = np.append(np.full(len(netlist.conductance), 2.0 * _UNITS), netlist.nonlinear_current * scale)
    a, b = rows[np.concatenate([netlist.resistor_nodes, netlist.nonlinear_nodes])].T
    fed, taken = np.flatnonzero(injected > 0), np.flatnonzero(injected < 0)
    surplus = float(injected.sum())
    tails = np.concatenate([a, b, np.full(len(fed), source), taken, [rail if surplus > 0 else source]])
    heads = np.concatenate([b, a, fed, np.full(len(taken), sink), [sink if surplus > 0 else rail]])
    amounts = np.concatenate([limit, limit, injected[fed] * outer, -injected[taken] * outer, [abs(surplus) * outer]])
    kept = tails != heads
    graph = sparse.coo_array((amounts[kept], (tails[kept], heads[kept])), shape=(size + 3,) * 2).tocsr()
    graph.data = np.minimum(graph.data, 2.0 * _UNITS).astype(np.int32)
    return graph


def _leading_out(netlist: Netlist, system: Equations, inside: NDArray[np.bool_]) -> tuple[NDArray[np.int64], float]:
    """Nonlinear resistors across the border of some rows, and the sum of their I0; none if a resistor crosses it."""
    within = (system.unknown >= 0) & inside[np.maximum(system.unknown, 0)]
    linear = within[netlist.resistor_nodes]
    if np.any(linear[:, 0] != linear[:, 1]):
        return np.empty(0, dtype=np.int64), np.inf
    ends = within[netlist.nonlinear_nodes]
    across = np.flatnonzero(ends[:, 0] != ends[:, 1])
    return across, float(netlist.nonlinear_current[across].sum())
