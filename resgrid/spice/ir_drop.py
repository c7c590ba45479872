"""How far every node of a network lies from the supply of its own net: the IR drop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.frozen import frozen
from resgrid.netlist import GROUND, Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.subject import connected_parts_of


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


def ir_drop(point: OperatingPoint) -> IrDrop:
    """Find every node's supply, and how far it is from it.

    Parameters
    ----------
    point : OperatingPoint

    Returns
    -------
    IrDrop
    """
    netlist = point.netlist
    net = _nets(netlist)
    held = connected_parts_of(netlist.source_nodes, netlist.node_count)
    rails = np.flatnonzero(held == held[GROUND])
    rails = rails[rails != GROUND]
    rails = rails[np.argsort(np.abs(point.voltage[rails]), kind="stable")]
    supply = np.zeros(int(net.max()) + 1)
    supply[net[rails]] = point.voltage[rails]  # the last one assigned is the farthest from ground
    return IrDrop(supply[net], supply[net] - point.voltage)


def _nets(netlist: Netlist) -> NDArray[np.int64]:
    shorts = netlist.source_nodes[netlist.source_volts == 0]
    joined = np.concatenate([netlist.resistor_nodes, shorts, netlist.nonlinear_nodes])
    return connected_parts_of(joined[(joined != GROUND).all(axis=1)], netlist.node_count)
