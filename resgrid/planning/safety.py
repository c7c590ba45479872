"""In which cells a field of a normwise answer is direction-safe: found out afterwards, cell by cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import Ammeters, OperatingPoint
from resgrid.circuit.readout import DIRECTION_RESIDUAL, injected_currents
from resgrid.grids import before_and_behind, with_margin
from resgrid.space import Cell, ConfigurationSpace

Faces = list[NDArray[np.float64]]
"""Per axis an array of the space's shape, one longer along that axis."""

_ROUNDING = 8 * np.finfo(np.float64).eps
"""What a sum of currents may be off by, relative to conductances times values."""


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
    rounding = _ROUNDING * netlist.conductance * (height[from_node] + height[to_node])

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
    net, total, rounding = (np.full(space.shape, start) for start in (injected, abs(injected), 0.0))
    enters = np.zeros(space.shape, dtype=np.bool_)
    leaves = enters.copy()
    solid = with_margin(space.cell == Cell.OBSTACLE, space.periodic, beyond=True)
    for axis, (amps, magnitude) in enumerate(zip(currents, magnitudes, strict=True)):
        below, above = _sides(amps, axis)
        net += below - above
        total += np.abs(below) + np.abs(above)
        rounding += sum(_sides(magnitude, axis))
        leaves |= (below < 0) | (above > 0)
        before, behind = (_sides(part, axis)[side] for side, part in enumerate(before_and_behind(solid, axis)))
        enters |= (before & (below < 0)) | (behind & (above > 0))
    off = np.abs(net) + _ROUNDING * rounding
    safe = (space.cell == Cell.FREE) & leaves & ~enters & (off <= DIRECTION_RESIDUAL * 0.5 * total)
    return np.asarray(safe, dtype=np.bool_)


def _sides(faces: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Of an array of faces what belongs to the lower and to the upper face of every cell."""
    along = np.moveaxis(faces, axis, 0)
    return np.moveaxis(along[:-1], 0, axis), np.moveaxis(along[1:], 0, axis)


def _held(op: OperatingPoint) -> NDArray[np.bool_]:
    """Nodes that voltage sources tie, shape (nodes,)."""
    held = np.zeros(op.netlist.node_count, dtype=np.bool_)
    held[op.netlist.source_nodes] = True
    held[0] = True
    return held
