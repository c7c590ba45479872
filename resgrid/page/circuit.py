"""The circuit of a small drawing, element by element, as the page draws it."""

from __future__ import annotations

from typing import Any

import numpy as np

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.grids import crossed_faces

MOST_CELLS_A_SIDE = 10
"""As `rg.draw` draws circuits symbol by symbol."""


def describe_circuit(op: OperatingPoint) -> dict[str, Any] | None:
    """Resistors, supplies and currents fed; None of a grid that is too large for symbols.

    `resistors`: lists of axis, i, j (across whose lower face of cell (i, j)), ohms, and volts and amperes from the
    lower side to the upper one; `supplies`: every rail's name, volts and amperes that it gives; `fed`: amperes that
    every driven node is fed.
    """
    netlist, cells = op.netlist, op.netlist.cells
    shape = cells.space.shape
    if max(shape) > MOST_CELLS_A_SIDE:
        return None
    ohms = 1.0 / netlist.conductance
    amperes = np.where(cells.resistor_upward, 1.0, -1.0) * op.resistor_current
    across, index = crossed_faces(cells.resistor_face, shape)
    columns = [column[across >= 0] for column in (across, *index.T, ohms, ohms * amperes, amperes)]
    resistors = [list(row) for row in zip(*(column.tolist() for column in columns), strict=True)]
    supplies = [
        {"rail": _rail(op, int(plus)), "volts": volts, "amperes": -amps}
        for plus, volts, amps in zip(
            netlist.source_nodes[:, 0], netlist.source_volts.tolist(), op.source_current.tolist(), strict=True
        )
    ]
    fed = float(netlist.current_amps.max()) if len(netlist.current_amps) else None
    return {"resistors": resistors, "supplies": supplies, "fed": fed}


def _rail(op: OperatingPoint, node: int) -> str:
    cells = op.netlist.cells
    if node == cells.obstacle_node:
        return "obstacles"
    return f"goal {cells.goal_nodes.index(node)}" if node in cells.goal_nodes else "start"
