"""The state just after time 0: capacitors keep their charge, everything else follows."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.circuit.charges import Charges
from resgrid.circuit.dynamics import Dynamics
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.errors import InputError
from resgrid.netlist import CellMap, Netlist


def initial_state(
    dynamics: Dynamics, initial: OperatingPoint | ArrayLike | None, charges: Charges | None = None
) -> NDArray[np.float64]:
    """State at time 0+, when the sources of the netlist act at once.

    Finite currents move no charge in no time: at every node (or nodes joined by voltage sources) the charge on the
    capacitors is that of the initial voltages.  Nodes without capacitance take the voltage at which Kirchhoff's
    current law holds.

    Shapes: `initial` (nodes,); returns (n,).
    """
    netlist = dynamics.netlist
    before = np.zeros(netlist.node_count) if initial is None else _voltages(netlist, initial)
    charges = charges or Charges(dynamics)
    x = _without_loose(charges, dynamics.state(before))
    held, now = (volts[netlist.capacitor_nodes] for volts in (before, dynamics.voltage(x)))
    missing = netlist.capacitance * np.nan_to_num((held[:, 0] - held[:, 1]) - (now[:, 0] - now[:, 1]))
    first, second = netlist.capacitor_nodes.T
    charge = dynamics.injection(first, missing) - dynamics.injection(second, missing)
    return charges.followed(x + charges.voltages(charge))


def _without_loose(charges: Charges, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """The state, every loose part shifted so that its first row is at 0 V."""
    groups, charged = charges.basis.spread, charges.basis.charged
    first = np.where(charged, 0.0, x)
    return np.asarray(x - groups @ (groups.T @ first))


def real_numbers(values: ArrayLike, message: str) -> NDArray[np.float64]:
    """A new array of real numbers."""
    try:
        given: np.ndarray[Any, Any] = np.ma.asanyarray(values)
        real = given.dtype.kind in "biuf" or all(isinstance(value, Real) for value in given.flat)
        if not real or np.ma.is_masked(given):
            raise InputError(message)
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(message) from error


def _voltages(netlist: Netlist, initial: OperatingPoint | ArrayLike) -> NDArray[np.float64]:
    if isinstance(initial, OperatingPoint):
        old, new = initial.netlist.cell_map, netlist.cell_map
        if old is not None and new is not None:
            return np.nan_to_num(_carried_over(initial, old, netlist, new), nan=0.0)
        initial = np.nan_to_num(initial.voltage, nan=0.0)
    volts = real_numbers(initial, "initial must be an operating point or one number per node")
    if volts.shape != (netlist.node_count,):
        raise InputError(f"initial has shape {volts.shape}, but the netlist has {netlist.node_count} nodes")
    if not np.isfinite(volts).all():
        node = netlist.node_name(int(np.argmin(np.isfinite(volts))))
        raise InputError(f"the initial voltage of node {node} is not finite")
    return volts


def _carried_over(point: OperatingPoint, old: CellMap, netlist: Netlist, new: CellMap) -> NDArray[np.float64]:
    """Old voltages at the nodes of a new scene: cell by cell, and rail by rail."""
    if old.space.shape != new.space.shape:
        raise InputError(
            f"initial is of a grid of {old.space.shape} cells, but this netlist has {new.space.shape}; "
            "it must be the operating point of the same chip with another scene"
        )
    before = np.zeros(netlist.node_count)
    if netlist.node_count == point.netlist.node_count and old.wiring.rails == new.wiring.rails == "cells":
        before[:] = point.voltage
    had = (new.node >= 0) & (old.node >= 0)
    before[new.node[had]] = point.voltage[old.node[had]]
    pairs = [(new.obstacle_node, old.obstacle_node), *zip(new.goal_nodes, old.goal_nodes, strict=False)]
    for here, there in pairs:
        if here >= 0 and there >= 0:
            before[here] = point.voltage[there]
    return before
