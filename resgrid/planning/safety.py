"""In which cells a field of a normwise answer is direction-safe: found out afterwards, cell by cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint, Readings
from resgrid.circuit.readout import DIRECTION_RESIDUAL, injected_currents
from resgrid.circuit.slabs import ROUNDING
from resgrid.space import Cell
from resgrid.wiring import Wiring


def safe_cells(op: OperatingPoint) -> NDArray[np.bool_] | None:
    """Cells in which KCL holds to 1e-6 of their own current, rounding included, and out of which current flows.

    None where the solver has seen to that in all of them.  No current flows into an obstacle.
    """
    if isinstance(op.ammeters, Readings):
        return None
    netlist, cells = op.netlist, op.netlist.cells
    from_node, to_node = netlist.resistor_nodes.T
    amps = np.nan_to_num(op.resistor_current)
    height = np.nan_to_num(op.voltage - cells.wiring.goal_voltage) * np.sign(cells.wiring.supply)
    size = np.abs(height)
    rounding = ROUNDING * netlist.conductance * (size[from_node] + size[to_node])

    def per_node(nodes: NDArray[np.int32], values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.bincount(nodes, values, netlist.node_count), dtype=np.float64)

    injected = injected_currents(netlist)
    net = injected + per_node(to_node, amps) - per_node(from_node, amps)
    through = 0.5 * (np.abs(injected) + per_node(to_node, np.abs(amps)) + per_node(from_node, np.abs(amps)))
    off = per_node(to_node, rounding) + per_node(from_node, rounding)
    off += np.where(_held(op), 0.0, np.abs(net))
    amps = amps * np.sign(cells.wiring.supply)
    leaving = per_node(from_node, np.maximum(amps, 0.0)) + per_node(to_node, np.maximum(-amps, 0.0))
    safe = (leaving > 0.0) & (off <= DIRECTION_RESIDUAL * through) & between_rails(height, cells.wiring)
    return np.asarray((cells.space.cell == Cell.FREE) & (cells.node >= 0) & safe[cells.node], dtype=np.bool_)


def between_rails(height: NDArray[np.float64], wiring: Wiring) -> NDArray[np.bool_]:
    """Whether heights above the goal rail, in volts, are none that would drive current into an obstacle."""
    return np.ones(height.shape, dtype=np.bool_) if wiring.is_driven else np.asarray(height <= abs(wiring.supply))


def _held(op: OperatingPoint) -> NDArray[np.bool_]:
    """Nodes that voltage sources tie, shape (nodes,)."""
    held = np.zeros(op.netlist.node_count, dtype=np.bool_)
    held[op.netlist.source_nodes] = True
    held[0] = True
    return held
