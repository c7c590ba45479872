"""The voltage sources of a compiled netlist, as a row of symbols below the drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from resgrid.netlist import CellMap, Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.plot.style import GOAL, OBSTACLE, SMALL
from resgrid.plot.symbols import INK, draw_ground, draw_supply, engineering
from resgrid.space import Cell

SUPPLY_GAP = 0.5
"""Between the drawing and the first row, in cells."""

SUPPLY_HEIGHT = 1.5
"""Height of a row, in cells."""

_WIDTH = 2.4


@dataclass(frozen=True)
class Supply:
    """Voltage sources that are drawn as one symbol.

    `name`: the rail, or what kind of cells they tie; `amps`: total current into the plus terminals.
    """

    name: str
    colour: str
    volts: float
    amps: float | None
    count: int


def supplies_of(netlist: Netlist, cell_map: CellMap, op: OperatingPoint | None) -> list[Supply]:
    """Group the voltage sources of a netlist: one for each rail, and for each kind of cell with a source of its own."""
    groups: dict[tuple[str, str, float], list[int]] = {}
    for number, (plus, volts) in enumerate(zip(netlist.source_nodes[:, 0], netlist.source_volts, strict=True)):
        name, colour = _rail_of(int(plus), netlist, cell_map)
        groups.setdefault((name, colour, float(volts)), []).append(number)
    return [
        Supply(name, colour, volts, None if op is None else float(op.source_current[numbers].sum()), len(numbers))
        for (name, colour, volts), numbers in groups.items()
    ]


def _rail_of(node: int, netlist: Netlist, cell_map: CellMap) -> tuple[str, str]:
    if node == cell_map.obstacle_node:
        return "obstacle", OBSTACLE
    if node in cell_map.goal_nodes:
        return netlist.node_name(node), GOAL
    cell = int(netlist.cell_of_node()[node])
    code = cell_map.space.cell.ravel()[cell] if cell >= 0 else Cell.FREE
    if code == Cell.OBSTACLE:
        return "obstacle cells", OBSTACLE
    if code == Cell.GOAL:
        return "goal cells", GOAL
    return netlist.node_name(node), INK


def supply_rows(supplies: list[Supply], across: int) -> list[list[Supply]]:
    """Break supplies into rows that fit below a grid so many cells wide."""
    room = int((max(across, 4) + 1) / _WIDTH)
    return [supplies[first : first + room] for first in range(0, len(supplies), room)]


def draw_supplies(axes: Axes, rows: list[list[Supply]], top: float) -> None:
    """Draw rows of supplies from ``top`` downwards."""
    for rank, row in enumerate(rows):
        for place, supply in enumerate(row):
            _draw_one(axes, supply, 0.3 + _WIDTH * place, top - SUPPLY_HEIGHT * rank)


def _draw_one(axes: Axes, supply: Supply, x: float, y: float) -> None:
    axes.plot([x - 0.28, x + 0.28], [y, y], color=supply.colour, linewidth=3.0, solid_capstyle="butt", zorder=2)
    draw_supply(axes, (x, y), (x, y - 1.0))
    draw_ground(axes, (x, y - 1.0))
    lines = [supply.name if supply.count == 1 else f"{supply.count} {supply.name}", engineering(supply.volts, "V")]
    if supply.count > 1:
        lines[1] += " each"
    if supply.amps is not None and np.isfinite(supply.amps):
        verb = "takes" if supply.amps > 0 else "gives"
        lines.append(f"{verb} {engineering(abs(supply.amps), 'A')}")
    axes.text(x + 0.34, y - 0.5, "\n".join(lines), va="center", ha="left", fontsize=SMALL, linespacing=1.25)
