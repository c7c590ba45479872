"""In which cells a field of a normwise answer is direction-safe: found out afterwards, cell by cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import injected_currents
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.postprocess import DIRECTION_RESIDUAL
from resgrid.core.regions import cells_at_faces, sides_of_cells
from resgrid.core.space import Cell
from resgrid.core.wiring import Wiring

ROUNDING = 8 * np.finfo(np.float64).eps
"""What a sum of currents may be off by, relative to conductances times values."""

Faces = Sequence[NDArray[np.float64]]


def safe_cells(op: OperatingPoint) -> NDArray[np.bool_] | None:
    """Cells in which KCL holds to 1e-6 of their own current, rounding included, and out of which current flows.

    None where the solver has seen to that in all of them.  No current flows into an obstacle.
    """
    if op.has_stored_currents and op.kcl_residual <= DIRECTION_RESIDUAL:
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


def face_currents(conductance: Faces, value: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Currents through the faces of a box, per axis, in the axis' direction and down the values; 0 beside a NaN.

    Shapes: `conductance` of all faces, `value` of the cells with a margin around them.
    """
    sides = (cells_at_faces(value, axis) for axis in range(value.ndim))
    return [np.nan_to_num(g * (before - behind)) for g, (before, behind) in zip(conductance, sides, strict=True)]


def obeys_kcl(
    conductance: Faces,
    value: NDArray[np.float64],
    currents: Faces,
    injected: float,
    *,
    held: NDArray[np.bool_] | bool = False,
) -> NDArray[np.bool_]:
    """Cells in which KCL holds to 1e-6 of their own current, rounding included, and out of which current flows.

    Shapes: as of `face_currents`; `injected` into every cell; `held` by sources, whatever they give.
    """
    shape = sides_of_cells(currents[0], 0)[0].shape
    net, total, rounding = (np.full(shape, start) for start in (injected, abs(injected), 0.0))
    leaves, size = np.zeros(shape, dtype=np.bool_), np.abs(np.nan_to_num(value))
    for axis, (g, amps) in enumerate(zip(conductance, currents, strict=True)):
        below, above = sides_of_cells(amps, axis)
        net += below - above
        total += np.abs(below) + np.abs(above)
        rounding += sum(sides_of_cells(g * sum(cells_at_faces(size, axis)), axis))
        leaves |= (below < 0) | (above > 0)
    off = np.where(held, 0.0, np.abs(net)) + ROUNDING * rounding
    return np.asarray(leaves & (off <= DIRECTION_RESIDUAL * 0.5 * total))


def between_rails(height: NDArray[np.float64], wiring: Wiring) -> NDArray[np.bool_]:
    """Whether heights above the goal rail, in volts, are none that would drive current into an obstacle."""
    return np.ones(height.shape, dtype=np.bool_) if wiring.is_driven else np.asarray(height <= abs(wiring.supply))


def _held(op: OperatingPoint) -> NDArray[np.bool_]:
    """Nodes that voltage sources tie, shape (nodes,)."""
    held = np.zeros(op.netlist.node_count, dtype=np.bool_)
    held[op.netlist.source_nodes] = True
    held[0] = True
    return held
