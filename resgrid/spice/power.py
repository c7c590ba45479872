"""Power balance and IR drop (voltage lost between supply and node) of an operating point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.circuit.nonlinear import nonlinear_drops
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.netlist import GROUND
from resgrid.core.regions import label_components


@frozen
@dataclass(frozen=True, eq=False)
class PowerBalance:
    """Power of every element (Tellegen's theorem: delivered and dissipated power are equal).

    Returned by `resgrid.spice.power_balance`.

    Attributes
    ----------
    source_power : ndarray of float64, shape (sources,)
        Power that every voltage source delivers, in watts; 0 for a source of 0 V; NaN if its current is undetermined
        (in a loop of voltage sources).
    current_source_power : ndarray of float64, shape (current sources,)
        Power that every current source delivers, in watts; 0 for a source of 0 A, otherwise NaN if the source is
        connected to a floating node (a node without a conducting path to ground).
    resistor_power : ndarray of float64, shape (resistors,)
        Power that every resistor dissipates, in watts.
    nonlinear_power : ndarray of float64, shape (nonlinear resistors,)
        Power that every nonlinear resistor dissipates, in watts.
    delivered : float
        Net power that all sources deliver, in watts; NaN if the power of a source is undetermined.
    dissipated : float
        Power of all resistors and nonlinear resistors, in watts.
    imbalance : float
        Magnitude of delivered minus dissipated power, relative to the sum of the magnitudes of all powers; NaN if a
        power is undetermined, 0 if all powers are 0.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 3e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> balance = rg.spice.power_balance(rg.solve(divider))
    >>> balance.source_power.round(6), balance.resistor_power.round(6)
    (array([0.003]), array([0.00225, 0.00075]))
    >>> balance.imbalance < 1e-12
    True
    """

    source_power: NDArray[np.float64]
    current_source_power: NDArray[np.float64]
    resistor_power: NDArray[np.float64]
    nonlinear_power: NDArray[np.float64]

    @property
    def delivered(self) -> float:
        """Net power that all sources deliver, in watts; NaN if the power of a source is undetermined."""
        return float(self.source_power.sum() + self.current_source_power.sum())

    @property
    def dissipated(self) -> float:
        """Power of all resistors and nonlinear resistors, in watts."""
        return float(self.resistor_power.sum() + self.nonlinear_power.sum())

    @property
    def imbalance(self) -> float:
        """Magnitude of delivered minus dissipated power, relative to the sum of the magnitudes of all powers.

        NaN if the power of a source is undetermined; 0 if all powers are 0.
        """
        total = np.abs(self.source_power).sum() + np.abs(self.current_source_power).sum() + self.dissipated
        return float(abs(self.delivered - self.dissipated) / total) if total else 0.0


def power_balance(op: OperatingPoint) -> PowerBalance:
    """Compute the power that sources deliver and that resistors dissipate.

    Parameters
    ----------
    op : OperatingPoint
        The operating point of the circuit.

    Returns
    -------
    PowerBalance
        Power of every element, totals, and their imbalance.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> balance = rg.spice.power_balance(rg.solve(divider))
    >>> round(balance.delivered, 9), round(balance.dissipated, 9)
    (0.002, 0.002)
    """
    netlist = op.netlist
    volts = netlist.source_volts
    start, end = netlist.current_nodes.T
    by_current = netlist.current_amps * (op.voltage[end] - op.voltage[start])
    by_current[netlist.current_amps == 0] = 0.0
    with np.errstate(under="ignore"):
        dissipated = op.resistor_current**2 / netlist.conductance
        saturated = op.nonlinear_amps * nonlinear_drops(op)
    return PowerBalance(np.where(volts == 0, 0.0, -volts * op.source_current), by_current, dissipated, saturated)


@frozen
@dataclass(frozen=True, eq=False)
class IrDrop:
    """Voltage drop of every node from its supply.

    Returned by `resgrid.spice.ir_drop`.  A net is a set of nodes that resistors, nonlinear resistors and sources of 0 V
    connect, where paths through ground do not count.  The supply of a net is the voltage, of those of its nodes that
    voltage sources tie to ground, that is farthest from 0 V; without such a node the supply is 0 V.

    Attributes
    ----------
    supply : ndarray of float64, shape (nodes,)
        Supply of the net that each node belongs to, in volts.
    drop : ndarray of float64, shape (nodes,)
        ``supply - voltage``, in volts; negative for a node above its supply (ground bounce), NaN for a floating node.

    Examples
    --------
    >>> grid = rg.Netlist(4, [[1, 2], [2, 3], [3, 0]], [1.0, 1.0, 0.1], source_nodes=[[1, 0]], source_volts=[1.8])
    >>> drops = rg.spice.ir_drop(rg.solve(grid))
    >>> worst = drops.worst(count=2)
    >>> worst, drops.drop[worst].round(6), drops.supply[worst]
    (array([3, 2]), array([0.3 , 0.15]), array([1.8, 1.8]))
    """

    supply: NDArray[np.float64]
    drop: NDArray[np.float64]

    def worst(self, count: int) -> NDArray[np.int64]:
        """Return the nodes with the largest drops in magnitude, the largest first, without ground and floating nodes.

        Parameters
        ----------
        count : int
            Maximum number of nodes.

        Returns
        -------
        ndarray of int64, shape (at most count,)
            Node numbers.
        """
        size = np.abs(self.drop)
        size[~np.isfinite(size)] = -1.0
        size[GROUND] = -1.0
        count = min(count, int((size >= 0).sum()))
        chosen = np.argpartition(-size, count - 1)[:count] if count else np.empty(0, dtype=np.int64)
        return np.asarray(chosen[np.lexsort((chosen, -size[chosen]))], dtype=np.int64)


def ir_drop(op: OperatingPoint) -> IrDrop:
    """Compute the supply of every node, and the voltage drop of the node from its supply.

    Parameters
    ----------
    op : OperatingPoint
        The operating point of the circuit.

    Returns
    -------
    IrDrop
        For every node: voltage of its supply, and supply minus node voltage, both in volts.

    Examples
    --------
    >>> supply = rg.Netlist(4, [[1, 2], [2, 3], [3, 0]], [1.0, 1.0, 0.1], source_nodes=[[1, 0]], source_volts=[1.8])
    >>> rg.spice.ir_drop(rg.solve(supply)).drop.round(3)
    array([0.  , 0.  , 0.15, 0.3 ])
    """
    netlist = op.netlist
    shorts = netlist.source_nodes[netlist.source_volts == 0]
    joined = np.concatenate([netlist.resistor_nodes, shorts, netlist.nonlinear_nodes])
    net = label_components(joined[(joined != GROUND).all(axis=1)], netlist.node_count)
    held = label_components(netlist.source_nodes, netlist.node_count)
    rails = np.flatnonzero(held == held[GROUND])
    rails = rails[rails != GROUND]
    rails = rails[np.argsort(np.abs(op.voltage[rails]), kind="stable")]
    supply = np.zeros(int(net.max()) + 1)
    supply[net[rails]] = op.voltage[rails]  # the last one assigned is the farthest from ground
    return IrDrop(supply[net], supply[net] - op.voltage)
