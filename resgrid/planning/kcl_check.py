"""Direction-safe cells of a solution: Kirchhoff's current law (KCL) holds to 1e-6, and current flows out.

A cell is direction-safe if its KCL residual, including rounding errors, is at most 1e-6 of the current through the
cell, and if current flows out of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import injected_currents
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.postprocess import DIRECTION_RESIDUAL
from resgrid.core.cell import Cell
from resgrid.core.regions import cells_at_faces, sides_of_cells
from resgrid.core.wiring import Wiring

ROUNDING = 8 * np.finfo(np.float64).eps
"""Bound on the rounding error of a node's sum of currents, as a fraction of a sum over its resistors.

A resistor contributes its conductance times the sum of the absolute voltages of its two nodes.
"""

Faces = Sequence[NDArray[np.float64]]
"""One array per axis: a value for every face across that axis."""


def safe_cells(op: OperatingPoint) -> NDArray[np.bool_] | None:
    """Return the mask of direction-safe free cells, shape of the space; None if the solver guarantees that all are.

    `op`: operating point of a compiled space.  A cell whose voltage lies beyond that of the obstacle rail is not safe,
    because current would flow from the cell into obstacles.
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
        """Return sums (node_count,) of values of elements per node; `nodes` (elements,): node of every element."""
        return np.asarray(np.bincount(nodes, values, netlist.node_count), dtype=np.float64)

    injected = injected_currents(netlist)
    net = injected + per_node(to_node, amps) - per_node(from_node, amps)
    through = 0.5 * (np.abs(injected) + per_node(to_node, np.abs(amps)) + per_node(from_node, np.abs(amps)))
    residual = per_node(to_node, rounding) + per_node(from_node, rounding)
    residual += np.where(_source_nodes(op), 0.0, np.abs(net))
    amps = amps * np.sign(cells.wiring.supply)
    leaving = per_node(from_node, np.maximum(amps, 0.0)) + per_node(to_node, np.maximum(-amps, 0.0))
    safe = (leaving > 0.0) & (residual <= DIRECTION_RESIDUAL * through) & between_rails(height, cells.wiring)
    return np.asarray((cells.space.cell == Cell.FREE) & (cells.node >= 0) & safe[cells.node], dtype=np.bool_)


def face_currents(conductance: Faces, value: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return currents through all faces of a box of cells, one array per axis, positive along the axis.

    The current is the conductance times the decrease of `value` across the face, and 0 next to a NaN.
    `conductance`: conductances of the faces, one array per axis; `value`: voltages of the cells of the box and of a
    margin of one cell on each side.
    """
    sides = (cells_at_faces(value, axis) for axis in range(value.ndim))
    return [np.nan_to_num(g * (before - behind)) for g, (before, behind) in zip(conductance, sides, strict=True)]


def leak_currents(
    leak: float, wiring: Wiring, volts: NDArray[np.float64]
) -> tuple[NDArray[np.float64] | float, NDArray[np.float64] | float]:
    """Return the currents of leaks into the cells, and the scale of their rounding errors, both in amperes.

    A leak is a resistor from a cell to the obstacle rail.  The scale is the conductance times the sum of the absolute
    voltages, relative to ground, of the cell and of the obstacle rail.  Both results have the shape of `volts`, or are
    0 without a leak.  With a positive supply, currents are positive from the obstacle rail into the cell, with a
    negative supply in the opposite direction.
    `leak`: conductance of the leak of one cell, in siemens; `wiring`: gives the rail voltages; `volts`: voltage of
    every cell, in volts, NaN without a node.
    """
    if not leak:
        return 0.0, 0.0
    currents = leak * np.nan_to_num(wiring.high - volts) * np.sign(wiring.supply)
    return currents, leak * np.nan_to_num(abs(wiring.high) + np.abs(volts))


def obeys_kcl(
    conductance: Faces,
    value: NDArray[np.float64],
    currents: Faces,
    injected: float | NDArray[np.float64],
    *,
    held: NDArray[np.bool_] | bool = False,
    uncertain: float | NDArray[np.float64] = 0.0,
) -> NDArray[np.bool_]:
    """Return the mask of cells of a box that obey KCL to 1e-6 of their through-current and have an outgoing current.

    The through-current is half the sum of the magnitudes of the currents of a cell.  Units are consistent, such as V,
    S and A.  `conductance`, `currents`: conductances and currents of the faces, one array per axis, currents positive
    along the axis; `value`: voltages of the cells and of a margin of one cell on each side; `injected`: current of
    sources and leaks into the cells, one number or one per cell; `held`: mask of cells tied to voltage sources, whose
    net current need not be 0, shape of the box; `uncertain`: scale of the rounding errors of leak currents: the leak's
    conductance times the sum of the absolute voltages of the cell and of the obstacle rail.
    """
    shape = sides_of_cells(currents[0], 0)[0].shape
    net, total, rounding = (np.full(shape, start) for start in (injected, np.abs(injected), uncertain))
    leaves, size = np.zeros(shape, dtype=np.bool_), np.abs(np.nan_to_num(value))
    for axis, (g, amps) in enumerate(zip(conductance, currents, strict=True)):
        below, above = sides_of_cells(amps, axis)
        net += below - above
        total += np.abs(below) + np.abs(above)
        rounding += sum(sides_of_cells(g * sum(cells_at_faces(size, axis)), axis))
        leaves |= (below < 0) | (above > 0)
    residual = np.where(held, 0.0, np.abs(net)) + ROUNDING * rounding
    return np.asarray(leaves & (residual <= DIRECTION_RESIDUAL * 0.5 * total))


def between_rails(height: NDArray[np.float64], wiring: Wiring) -> NDArray[np.bool_]:
    """Return the mask of cells whose height is at most the supply; True everywhere if the wiring has a drive.

    A cell above the obstacle rail would drive current into an obstacle.  `height`: voltage of each cell above the goal
    rail, in volts, with the sign of the supply removed.
    """
    return np.ones(height.shape, dtype=np.bool_) if wiring.is_driven else np.asarray(height <= abs(wiring.supply))


def _source_nodes(op: OperatingPoint) -> NDArray[np.bool_]:
    """Return the mask of nodes that a voltage source fixes, and of ground, shape (nodes,)."""
    held = np.zeros(op.netlist.node_count, dtype=np.bool_)
    held[op.netlist.source_nodes] = True
    held[0] = True
    return held
