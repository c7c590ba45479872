"""Currents that obey Kirchhoff's current law at every node, where differences of its voltages do not tell them.

Stiff ties to a rail, flat dead ends, balanced loops: what flows there is some 1e-16 of what the voltages are, or less.
The state is the fall across every resistor; it is corrected by differences (`resgrid.solvers.differences`) until all
currents balance at every node, each node by its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.equations import Equations
from resgrid.errors import BudgetError
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.differences import differences
from resgrid.solvers.factor import DirectFactor

_MOST_TIES = 2e7
"""Rows times rails that are kept apart."""

_CERTAIN = 1e-9
"""Share of the current through a node by which the last correction may have changed a current there."""

_FAINT = 1e-30
"""Share of the largest current below which one that cancellation hides counts as none."""

_MOST_STEPS = 30


class Falls(NamedTuple):
    """Falls across resistors and the voltages that they make.

    `falls` (resistors,): voltage of the first end above the second one's; `volts` (rails,): voltages of the rails;
    `above` (n, rails): heights of the rows above each, in volts; `doubt`: the most by which the last correction has
    changed a current, relative to what flows through either end.
    """

    falls: NDArray[np.float64]
    volts: NDArray[np.float64]
    above: NDArray[np.float64]
    doubt: float


def balance(system: Equations) -> Falls | None:
    """Falls that balance at every row; None where there are too many rails, or too little memory for the factors."""
    forest, netlist = system.forest, system.netlist
    lift = np.where(system.unknown >= 0, forest.offset, 0.0)
    rows, known = system.unknown[netlist.resistor_nodes], system.known_voltages()[netlist.resistor_nodes]
    held = rows < 0
    contact = held[:, 0] != held[:, 1]
    volts, rail = np.unique(known[contact][held[contact]], return_inverse=True)
    if not 0 < system.size * len(volts) <= _MOST_TIES:
        return None
    rail_of = np.zeros(len(rows), dtype=np.int32)
    rail_of[contact] = rail
    ties = np.zeros((system.size, len(volts)))
    np.add.at(ties, (rows[contact][~held[contact]], rail), netlist.conductance[contact])
    try:
        factors = factor_laplacian(system.laplacian, "direct", reduce=False)
    except BudgetError:
        return None
    assert isinstance(factors, DirectFactor)
    by = differences(factors.factors, ties)
    apart = np.where(
        held.all(axis=1), np.nan_to_num(known[:, 0] - known[:, 1]), -np.diff(lift[netlist.resistor_nodes])[:, 0]
    )
    none, faint = np.zeros_like(apart), np.zeros(len(apart), dtype=np.bool_)
    places, worst = by.places(rows), np.inf
    residual, _ = _residual(system, rows, (apart, none))
    gaps = by.solve(residual, volts)
    falls = by.falls(gaps, places, rail_of, apart)
    residual, _ = _residual(system, rows, falls)
    for _ in range(_MOST_STEPS):
        more = by.solve(residual, np.zeros_like(volts))
        by.correct(gaps, more, volts)
        falls = by.falls(gaps, places, rail_of, apart)
        residual, through = _residual(system, rows, falls)
        least = np.append(through, np.inf)[rows].min(axis=1)
        amps = netlist.conductance * np.abs(falls[0])
        moved = netlist.conductance * np.abs(by.falls(more, places, rail_of, none)[0])
        share = np.divide(moved, least, out=none.copy(), where=(amps > 0.0) & (least > 0.0))
        faint = (share > _CERTAIN) & (amps <= _FAINT * amps.max())
        before, worst = worst, float(share.max(where=~faint, initial=0.0))
        if worst <= _CERTAIN or not worst < before:
            break
    if faint.any():
        falls[0][_around(netlist.resistor_nodes, netlist.node_count, amps <= _FAINT * amps.max(), faint)] = 0.0
    return Falls(falls[0], volts, by.heights(gaps), worst)


def _around(
    ends: NDArray[np.int32], nodes: int, small: NDArray[np.bool_], faint: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """The small currents (resistors,) that others join to a faint one: none of these is known if that is not."""
    pairs = ends[small]
    joined = sparse.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(nodes, nodes))
    part = connected_components(joined, directed=False)[1][ends[:, 0]]
    return np.asarray(small & np.isin(part, part[faint]))


def _residual(
    system: Equations, rows: NDArray[np.int32], falls: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What flows into every row beyond what flows out, and half of all that flows there; in amperes, (n,)."""
    from resgrid.circuit.kernels import add_flows

    netlist, amps = system.netlist, system.netlist.current_amps
    net, net_low, total = np.zeros((3, system.size))
    add_flows(rows, netlist.conductance, *falls, net, net_low, total)
    add_flows(system.unknown[netlist.current_nodes], np.ones_like(amps), amps, np.zeros_like(amps), net, net_low, total)
    return net, 0.5 * total
