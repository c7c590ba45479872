"""Where the power of a circuit comes from and where it becomes heat, and how far nodes lie from their supply."""

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
    """Tellegen's theorem, element by element.

    Attributes
    ----------
    source_power : ndarray of float64, shape (sources,)
        Power that every voltage source delivers, in watts; NaN in a loop of sources of more than 0 V.
    current_source_power : ndarray of float64, shape (current sources,)
        Power that every current source delivers, in watts; NaN where it feeds a floating part.
    resistor_power : ndarray of float64, shape (resistors,)
        Power that every resistor dissipates, in watts.
    nonlinear_power : ndarray of float64, shape (nonlinear resistors,)
        Power that every nonlinear resistor dissipates, in watts.
    """

    source_power: NDArray[np.float64]
    current_source_power: NDArray[np.float64]
    resistor_power: NDArray[np.float64]
    nonlinear_power: NDArray[np.float64]

    @property
    def delivered(self) -> float:
        """Net power of all sources, in watts; NaN if one is undetermined."""
        return float(self.source_power.sum() + self.current_source_power.sum())

    @property
    def dissipated(self) -> float:
        """Power of all resistors, in watts."""
        return float(self.resistor_power.sum() + self.nonlinear_power.sum())

    @property
    def imbalance(self) -> float:
        """What is left over, relative to all power that flows; NaN if it is undetermined."""
        flowing = np.abs(self.source_power).sum() + np.abs(self.current_source_power).sum() + self.dissipated
        return float(abs(self.delivered - self.dissipated) / flowing) if flowing else 0.0


def power_balance(op: OperatingPoint) -> PowerBalance:
    """Weigh the power that sources deliver against what resistors dissipate.

    Parameters
    ----------
    op : OperatingPoint

    Returns
    -------
    PowerBalance

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> balance = rg.spice.power_balance(rg.solve(divider))
    >>> round(balance.delivered, 9), round(balance.dissipated, 9)
    (0.002, 0.002)
    """
    netlist = op.netlist
    volts = netlist.source_volts
    taken, fed = netlist.current_nodes.T
    by_current = netlist.current_amps * (op.voltage[fed] - op.voltage[taken])
    by_current[netlist.current_amps == 0] = 0.0
    with np.errstate(under="ignore"):
        dissipated = op.resistor_current**2 / netlist.conductance
        saturated = op.nonlinear_amps * nonlinear_drops(op)
    return PowerBalance(np.where(volts == 0, 0.0, -volts * op.source_current), by_current, dissipated, saturated)


@frozen
@dataclass(frozen=True, eq=False)
class IrDrop:
    """The drop of every node from its supply.

    A net is what resistors and sources of 0 V join, ground left out.  Its supply is, of the voltages at which sources
    hold its nodes, the one farthest from ground; ground itself where no source holds any.

    Attributes
    ----------
    supply : ndarray of float64, shape (nodes,)
        In volts.
    drop : ndarray of float64, shape (nodes,)
        ``supply - voltage``, in volts; negative where a node lies above its supply (a bouncing ground); NaN where a
        node floats.
    """

    supply: NDArray[np.float64]
    drop: NDArray[np.float64]

    def worst(self, count: int) -> NDArray[np.int64]:
        """The nodes that lie farthest from their supply, the worst first; those that float left out."""
        size = np.abs(self.drop)
        size[~np.isfinite(size)] = -1.0
        size[GROUND] = -1.0
        count = min(count, int((size >= 0).sum()))
        chosen = np.argpartition(-size, count - 1)[:count] if count else np.empty(0, dtype=np.int64)
        return np.asarray(chosen[np.lexsort((chosen, -size[chosen]))], dtype=np.int64)


def ir_drop(op: OperatingPoint) -> IrDrop:
    """Find every node's supply, and how far it is from it.

    Parameters
    ----------
    op : OperatingPoint

    Returns
    -------
    IrDrop

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
