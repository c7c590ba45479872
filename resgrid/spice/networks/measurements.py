"""Single circuits of Circuitscape jobs and their solutions: currents from sources to grounds through a network."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.driven_pairs import currents_between_groups, through_nodes
from resgrid.circuit.linear import solve_linear
from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.regions import label_components

UNCONNECTED = -1.0
"""Value in Circuitscape's files in place of a resistance, in ohms, for pairs that are not connected or are left out."""


class Measurement(NamedTuple):
    """One circuit of a Circuitscape job, with sources and grounds.

    `netlist`: circuit without sources; for rasters its node 0 has no elements; `sources`: nodes into which currents are
    injected; `amps`: these currents in A; `ground`: nodes at 0 V (a source or ground of -1 is ignored); `node` (rows,
    columns): node of every cell, -1 for none; None in a network.
    """

    netlist: Netlist
    sources: tuple[int, ...]
    amps: tuple[float, ...]
    ground: tuple[int, ...]
    node: NDArray[np.int64] | None


class JobSolution(NamedTuple):
    """Solution of one circuit of a Circuitscape job.

    `resistance`: voltage divided by current, in ohms, of the first source that is connected to a ground, 0 for a source
    at 0 V; `voltage` (nodes,): in V; `node_current` (nodes,): the larger of the currents into and out of the node, in
    A; voltage and node current are 0 in components without a source; `resistor_current` (resistors,): in A, from first
    to second node.
    """

    resistance: float
    voltage: NDArray[np.float64]
    node_current: NDArray[np.float64]
    resistor_current: NDArray[np.float64]


def solve_measurement(measured: Measurement) -> JobSolution | None:
    """Return the solution of one circuit of a job; None if no source with a current is connected to a ground."""
    netlist = measured.netlist
    part = label_components(netlist.resistor_nodes, netlist.node_count)
    grounds = [node for node in measured.ground if node >= 0]
    grounded = {int(part[node]) for node in grounds}
    driven = [
        (node, amps)
        for node, amps in zip(measured.sources, measured.amps, strict=True)
        if node >= 0 and amps and int(part[node]) in grounded
    ]
    if not driven:
        return None
    if {node for node, _ in driven} <= set(grounds):  # points on one node: no current leaves the node
        zeros = np.zeros(netlist.node_count)
        return JobSolution(0.0, zeros, zeros, np.zeros(len(netlist.conductance)))
    if len(driven) == 1:
        return _from_one_source(netlist, *driven[0], grounds)
    place = np.arange(netlist.node_count)
    place[[GROUND, grounds[0]]] = grounds[0], GROUND
    driven_netlist = Netlist(
        netlist.node_count,
        place[netlist.resistor_nodes].astype(np.int32),
        netlist.conductance,
        current_nodes=np.array([[GROUND, place[node]] for node, _ in driven], dtype=np.int32),
        current_amps=np.array([amps for _, amps in driven]),
    )
    point = solve_linear(driven_netlist, accuracy="direction", method="auto", rtol=1e-10)
    voltage = np.nan_to_num(point.voltage[place])
    through = through_nodes(netlist.resistor_nodes, point.resistor_current, netlist.node_count)
    node, amps = driven[0]
    return JobSolution(float(voltage[node] / amps), voltage, through, point.resistor_current)


def _from_one_source(netlist: Netlist, source: int, amps: float, grounds: list[int]) -> JobSolution:
    """Return the solution of a circuit with one source and some nodes at 0 V.

    `netlist`: circuit without sources; `source`: node of the source; `amps`: current into this node, in A; `grounds`:
    nodes at 0 V.
    """
    group = np.arange(netlist.node_count)
    group[grounds] = grounds[0]
    _, group = np.unique(group, return_inverse=True)
    flow = currents_between_groups(netlist, group, int(group[source]), int(group[grounds[0]]), amps=abs(amps))
    sign = float(np.sign(amps))
    through = through_nodes(netlist.resistor_nodes, flow.resistor_current, netlist.node_count)
    return JobSolution(flow.resistance, sign * np.nan_to_num(flow.voltage), through, sign * flow.resistor_current)
