"""Equations of random walks: conductances to the goals, and the walks in cells without a node.

In circuits with open obstacles, free cells without a path to a goal have no node, because no current would flow there.
With a leak, a walk that starts in such a cell is still killed after a finite mean time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.linear import CircuitFactor
from resgrid.circuit.solve import factorize
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.compiler import contacts_of_box
from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.regions import cells_at_faces, with_margin

_RAIL = GROUND + 1


def factor_cut_off(cells: CellMap) -> tuple[CircuitFactor, NDArray[np.int32]] | None:
    """Return the factored equations of the free cells without a node, and the matrix rows of these cells.

    The rows have the shape of the space, and are -1 in other cells.  The result is None without a leak, or if every
    free cell has a node.  `cells`: map of the circuit's nodes to cells, with space and wiring.
    """
    space, wiring = cells.space, cells.wiring
    mask = (space.cell == Cell.FREE) & (cells.node < 0)
    if not wiring.leak or not mask.any():
        return None
    node = np.full(space.shape, -1, dtype=np.int32)
    own = np.arange(_RAIL + 1, _RAIL + 1 + np.count_nonzero(mask), dtype=np.int32)
    node[mask] = own
    pairs, siemens = _resistors_between(node, cells)
    leaks = np.stack([own, np.full_like(own, _RAIL)], axis=1)
    netlist = Netlist(
        _RAIL + 1 + own.size,
        np.concatenate([pairs, leaks]),
        np.concatenate([siemens, np.full(own.size, wiring.leak_conductance(space.spacing))]),
        source_nodes=np.array([[_RAIL, GROUND]]),
        source_volts=np.ones(1),
        # A current into every node: otherwise the cells, without currents, would be left out of the factorization.
        current_nodes=np.stack([np.full_like(own, GROUND), own], axis=1),
        current_amps=np.full(own.size, 1.0 / wiring.resistance),
    )
    factors = factorize(netlist)
    return factors, np.where(mask, factors.system.unknown[node], -1)


def to_goal_conductance(
    netlist: Netlist, node_goal: NDArray[np.int64], unknown: NDArray[np.int32], size: int
) -> sparse.csr_array:
    """Return the conductances (goals, rows) between goal regions and matrix rows, in siemens.

    `node_goal` (nodes,): index of the goal region of every node, -1 for nodes that are not goals; `unknown` (nodes,):
    matrix row of every node, negative for nodes with a known voltage; `size`: number of matrix rows.
    """
    entries: list[NDArray[np.float64]] = []
    for here, there in ((0, 1), (1, 0)):
        row = unknown[netlist.resistor_nodes[:, here]]
        goal = node_goal[netlist.resistor_nodes[:, there]]
        touches = (row >= 0) & (goal >= 0)
        entries.append(np.stack([netlist.conductance[touches], goal[touches], row[touches]]))
    conductance, goal, row = np.concatenate(entries, axis=1)
    shape = (int(node_goal.max()) + 1, size)
    return sparse.coo_array((conductance, (goal.astype(np.int64), row.astype(np.int64))), shape=shape).tocsr()


def _resistors_between(node: NDArray[np.int32], cells: CellMap) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return nodes (m, 2) and conductances (m,), in siemens, of the resistors between neighbouring cells.

    `node` (shape of the space): node of every cell, -1 for cells without a resistor.
    """
    space = cells.space
    contacts = contacts_of_box(space, cells.wiring, connected=False)
    wide = with_margin(node, space.periodic, beyond=-1)
    pairs, siemens = [], []
    for axis, conductance in enumerate(contacts.conductance):
        lower, upper = cells_at_faces(wide, axis)
        joined = contacts.joined[axis] & (lower >= 0) & (upper >= 0)
        if space.periodic[axis]:  # the last face repeats the first
            np.moveaxis(joined, axis, 0)[-1] = False
        pairs.append(np.stack([lower[joined], upper[joined]], axis=1))
        siemens.append(conductance[joined])
    return np.concatenate(pairs), np.concatenate(siemens)
