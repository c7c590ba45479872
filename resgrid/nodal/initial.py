"""The state just after time 0: capacitors keep their charge, everything else follows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from resgrid.errors import InputError
from resgrid.netlist import Layout, Netlist
from resgrid.nodal.dynamics import Dynamics, charge_basis
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.superlu import symmetric_factors


def initial_state(dynamics: Dynamics, initial: OperatingPoint | ArrayLike | None) -> NDArray[np.float64]:
    """State at time 0+, when the sources of the netlist act at once.

    Finite currents move no charge in no time: at every node (or nodes joined by voltage sources) the charge on the
    capacitors is that of the initial voltages.  Nodes without capacitance take the voltage at which Kirchhoff's
    current law holds.

    Parameters
    ----------
    dynamics : Dynamics
    initial : OperatingPoint or array_like of float, shape (nodes,), or None
        As in `resgrid.transient`.

    Returns
    -------
    ndarray of float64, shape (n,)
        In volts.

    Raises
    ------
    InputError
        If the voltages do not fit the netlist.
    """
    netlist = dynamics.netlist
    before = np.zeros(netlist.node_count) if initial is None else _voltages(netlist, initial)
    held = before[netlist.capacitor_nodes]
    rails = dynamics.fixed[netlist.capacitor_nodes]
    change = netlist.capacitance * np.nan_to_num((held[:, 0] - held[:, 1]) - (rails[:, 0] - rails[:, 1]))
    first, second = netlist.capacitor_nodes.T
    return _consistent(dynamics, dynamics.injection(first, change) - dynamics.injection(second, change))


def _voltages(netlist: Netlist, initial: OperatingPoint | ArrayLike) -> NDArray[np.float64]:
    if isinstance(initial, OperatingPoint):
        old, new = initial.netlist.layout, netlist.layout
        if old is not None and new is not None:
            return np.nan_to_num(_carried_over(initial, old, netlist, new), nan=0.0)
        initial = np.nan_to_num(initial.voltage, nan=0.0)
    try:
        volts = np.asarray(initial, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("initial must be an operating point or one number per node") from error
    if volts.shape != (netlist.node_count,):
        raise InputError(f"initial has shape {volts.shape}, but the netlist has {netlist.node_count} nodes")
    if not np.isfinite(volts).all():
        node = netlist.node_name(int(np.argmin(np.isfinite(volts))))
        raise InputError(f"the initial voltage of node {node} is not finite")
    return volts


def _carried_over(point: OperatingPoint, old: Layout, netlist: Netlist, new: Layout) -> NDArray[np.float64]:
    """Old voltages at the nodes of a new scene: cell by cell, and rail by rail."""
    if old.space.shape != new.space.shape:
        raise InputError(
            f"initial is of a grid of {old.space.shape} cells, but this netlist has {new.space.shape}; "
            "it must be the operating point of the same chip with another scene"
        )
    before = np.zeros(netlist.node_count)
    if netlist.node_count == point.netlist.node_count and old.rails == new.rails == "cells":
        before[:] = point.voltage
    had = (new.node >= 0) & (old.node >= 0)
    before[new.node[had]] = point.voltage[old.node[had]]
    pairs = [(new.obstacle_node, old.obstacle_node), *zip(new.goal_nodes, old.goal_nodes, strict=False)]
    for here, there in pairs:
        if here >= 0 and there >= 0:
            before[here] = point.voltage[there]
    return before


def _consistent(dynamics: Dynamics, charge: NDArray[np.float64]) -> NDArray[np.float64]:
    """State with the given charge in every row that has capacitance, and KCL in all others.

    Capacitors that join rows to each other but to no rail leave one voltage open for every such part; Kirchhoff's law
    for the part as a whole decides it.
    """
    basis = charge_basis(dynamics)
    charged, spread = basis.charged, basis.spread
    C, G = dynamics.capacitance, dynamics.conductance.matrix
    x = np.zeros(dynamics.size)
    if C.coupling.nnz == 0:
        x[charged] = charge[charged] / C.diagonal[charged]
    elif charged.any():
        x[charged] = _solve(C.matrix[charged][:, charged], charge[charged])
    if spread.shape[1]:
        x += spread @ _solve(spread.T @ G @ spread, spread.T @ (dynamics.drive - G @ x))
    return x


def _solve(matrix: sparse.csr_array, rhs: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(symmetric_factors(matrix).solve(rhs), dtype=np.float64)
