"""In which cells a field of a normwise answer is direction-safe: found out afterwards, cell by cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import Ammeters, OperatingPoint
from resgrid.circuit.readout import DIRECTION_RESIDUAL, injected_currents
from resgrid.circuit.slabs import ROUNDING, obeys_kcl
from resgrid.grids import before_and_behind, sides_of_cells, with_margin
from resgrid.space import Cell, ConfigurationSpace

Faces = list[NDArray[np.float64]]
"""Per axis an array of the space's shape, one longer along that axis."""


def safe_cells(op: OperatingPoint) -> NDArray[np.bool_] | None:
    """Cells in which KCL holds to 1e-6 of their own current, rounding included, and out of which current flows.

    None where the solver has seen to that in all of them.
    """
    if not isinstance(op.ammeters, Ammeters):
        return None
    netlist, cells = op.netlist, op.netlist.cells
    from_node, to_node = netlist.resistor_nodes.T
    amps = np.nan_to_num(op.resistor_current)
    height = np.abs(np.nan_to_num(op.voltage - cells.wiring.goal_voltage))
    rounding = ROUNDING * netlist.conductance * (height[from_node] + height[to_node])

    def per_node(nodes: NDArray[np.int32], values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.bincount(nodes, values, netlist.node_count), dtype=np.float64)

    injected = injected_currents(netlist)
    net = injected + per_node(to_node, amps) - per_node(from_node, amps)
    through = 0.5 * (np.abs(injected) + per_node(to_node, np.abs(amps)) + per_node(from_node, np.abs(amps)))
    off = per_node(to_node, rounding) + per_node(from_node, rounding)
    off += np.where(_held(op), 0.0, np.abs(net))
    amps = amps * np.sign(cells.wiring.supply)
    leaving = per_node(from_node, np.maximum(amps, 0.0)) + per_node(to_node, np.maximum(-amps, 0.0))
    safe = (leaving > 0.0) & (off <= DIRECTION_RESIDUAL * through)
    return np.asarray((cells.space.cell == Cell.FREE) & (cells.node >= 0) & safe[cells.node], dtype=np.bool_)


def safe_cells_of(space: ConfigurationSpace, currents: Faces, magnitudes: Faces, injected: float) -> NDArray[np.bool_]:
    """The same of currents that fall with the potential through all faces, in amperes, positive in the axis' direction.

    ``magnitudes``: conductances times voltages on both sides; ``injected``: current fed into every cell.
    """
    enters = np.zeros(space.shape, dtype=np.bool_)
    solid = with_margin(space.cell == Cell.OBSTACLE, space.periodic, beyond=True)
    for axis, amps in enumerate(currents):
        below, above = sides_of_cells(amps, axis)
        before, behind = before_and_behind(solid, axis)
        enters |= sides_of_cells(before, axis)[0] & (below < 0)
        enters |= sides_of_cells(behind, axis)[1] & (above > 0)
    obeys = obeys_kcl(currents, magnitudes, injected)
    return np.asarray((space.cell == Cell.FREE) & ~enters & obeys, dtype=np.bool_)


def _held(op: OperatingPoint) -> NDArray[np.bool_]:
    """Nodes that voltage sources tie, shape (nodes,)."""
    held = np.zeros(op.netlist.node_count, dtype=np.bool_)
    held[op.netlist.source_nodes] = True
    held[0] = True
    return held
