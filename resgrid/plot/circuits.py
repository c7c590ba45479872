"""Pictures of small circuits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import CellMap, Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.plot.figures import new_figure
from resgrid.plot.graphs import plot_graph
from resgrid.plot.schematic import HALF, MARGIN, Box, Schematic, schematic_of
from resgrid.plot.style import GOAL, OBSTACLE, SMALL, add_swatch, height_map, refresh_legend
from resgrid.plot.supplies import SUPPLY_GAP, SUPPLY_HEIGHT, draw_supplies, supplies_of, supply_rows
from resgrid.plot.symbols import INK, engineering, zigzag
from resgrid.plot.voltages import voltage_texts

MOST_CELLS_A_SIDE = 10
_INCHES = 0.8
_HALO = [withStroke(linewidth=1.8, foreground="white")]
_DRIVE = "#8E2A84"


def plot_circuit(netlist: Netlist, op: OperatingPoint | None = None, ax: Axes | None = None) -> Axes:
    """Draw a small netlist as a circuit: nodes where their cells are, with names and voltages, resistors, supplies.

    Parameters
    ----------
    netlist : Netlist
        Compiled from a space of one or two axes with at most 10 cells a side; without a map of cells, at most 40 nodes.
    op : OperatingPoint, optional
        Its voltages are written beside the nodes, its source currents beside the supplies.
    ax : matplotlib.axes.Axes, optional
        Made when None, large enough to be read.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the circuit is too large to be read or has nonlinear resistors, or the operating point belongs to another
        netlist.
    """
    if netlist.nonlinear_nodes.size:
        raise InputError("a circuit with nonlinear resistors is not drawn; use plot_potential and plot_currents")
    if op is not None and not op.is_of(netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    cell_map = netlist.cell_map
    if cell_map is None or len(cell_map.resistor_face) != len(netlist.resistor_nodes):
        return plot_graph(netlist, op, ax)
    _require_small(cell_map)
    plan = schematic_of(cell_map)
    supplies = supplies_of(netlist, cell_map, op)
    rows = supply_rows(supplies, plan.across)
    axes = _new_axes(plan, len(rows)) if ax is None else ax
    _draw_rails(plan, cell_map, netlist, axes)
    _draw_resistors(plan, cell_map, netlist, axes)
    _draw_nodes(plan, netlist, op, axes)
    _draw_drive(netlist, cell_map, axes)
    draw_supplies(axes, rows, -MARGIN - SUPPLY_GAP)
    _finish(plan, len(rows), axes)
    return axes


def _require_small(cell_map: CellMap) -> None:
    shape = cell_map.space.shape
    if len(shape) > 2:
        raise InputError(
            f"a circuit is drawn for one or two axes, this space has {len(shape)}; use plot_slices for its field"
        )
    if max(shape) > MOST_CELLS_A_SIDE:
        size = " x ".join(str(n) for n in shape)
        raise InputError(
            f"a circuit of {size} cells cannot be read; at most {MOST_CELLS_A_SIDE} a side are drawn.  "
            "Use plot_potential and plot_currents, or sample the scene more coarsely"
        )


def _new_axes(plan: Schematic, rows: int) -> Axes:
    left, right, bottom, top = _limits(plan, rows)
    return new_figure(_INCHES * (right - left), _INCHES * (top - bottom) + 0.5).add_subplot()


def _draw_rails(plan: Schematic, cell_map: CellMap, netlist: Netlist, axes: Axes) -> None:
    for side in plan.frame:
        axes.plot(*side.T, color=OBSTACLE, linewidth=3.0, solid_capstyle="projecting", zorder=1)
    for boxes, colour in ((plan.obstacles, OBSTACLE), (plan.goals, GOAL)):
        for left, bottom, width, height in boxes:
            axes.add_patch(Rectangle((left, bottom), width, height, facecolor=colour, linewidth=0, zorder=2.5))
    for left, bottom, width, height in plan.open_cells:
        axes.add_patch(
            Rectangle(
                (left, bottom), width, height, facecolor="#eeeeee", edgecolor="#999999", hatch="////", linewidth=0.5
            )
        )
    if plan.obstacles or plan.frame:
        add_swatch(axes, "obstacle rail", OBSTACLE)
    add_swatch(axes, "goal rail", GOAL)
    if plan.open_cells:
        add_swatch(axes, "no node (open)", "#dddddd")
    _name_boxes(plan.goals, cell_map, netlist, axes)
    if cell_map.wiring.rails == "cells":
        _name_boxes(plan.obstacles, cell_map, netlist, axes, "white")


def _name_boxes(boxes: Sequence[Box], cell_map: CellMap, netlist: Netlist, axes: Axes, colour: str = "black") -> None:
    """Write each rail's name into its first square."""
    node = cell_map.node.reshape(cell_map.node.shape[0], -1)
    named: set[int] = set()
    for left, bottom, width, height in boxes:
        if (width, height) != (2 * HALF, 2 * HALF):
            continue
        number = int(node[int(left), int(bottom)])
        if number not in named:
            named.add(number)
            axes.text(
                left + HALF, bottom + HALF, netlist.node_name(number), ha="center", va="center", fontsize=SMALL,
                color=colour, zorder=6,
            )  # fmt: skip


def _draw_resistors(plan: Schematic, cell_map: CellMap, netlist: Netlist, axes: Axes) -> None:
    lines = LineCollection(list(zigzag(plan.start, plan.end)), colors=INK, linewidths=0.9, zorder=2, gid="resistors")
    axes.add_collection(lines, autolim=False)
    axes.add_line(Line2D([], [], color=INK, linewidth=0.9, label=resistor_note(netlist)))
    _draw_seams(plan, cell_map, netlist, axes)


def resistor_note(netlist: Netlist) -> str:
    """What the resistors measure: their values if there are few, otherwise the range."""
    drawn = np.ones(len(netlist.conductance), dtype=np.bool_)
    if netlist.cell_map is not None:
        drawn = netlist.cells.resistor_face >= 0
    hidden = int(np.count_nonzero(~drawn))
    rest = f"; not drawn: {hidden} of switches, rails, loads" if hidden else ""
    resistance = 1.0 / netlist.conductance[drawn]
    ohms = Counter(engineering(float(value), "Ω") for value in resistance)
    if len(ohms) > 3:
        return f"resistor, {engineering(resistance.min(), 'Ω')} to {engineering(resistance.max(), 'Ω')}{rest}"
    values = (f"{count} of {value}" if len(ohms) > 1 else value for value, count in ohms.most_common())
    return f"resistor, {', '.join(values)}{rest}"


def _draw_seams(plan: Schematic, cell_map: CellMap, netlist: Netlist, axes: Axes) -> None:
    """A resistor across a seam ends in a terminal; so does a wire from its other node, and each names the other."""
    names = netlist.names_of(netlist.resistor_nodes.ravel())
    for number in np.flatnonzero(plan.seam).tolist():
        first, second = names[2 * number : 2 * number + 2]
        before, after = (first, second) if cell_map.resistor_upward[number] else (second, first)
        terminal = plan.start[number]
        axis = int(np.argmax(np.abs(plan.end[number] - terminal)))
        wire = np.repeat(terminal[None], 2, axis=0)
        wire[:, axis] = (-MARGIN, 0.5)
        axes.plot(*wire.T, color=INK, linewidth=0.9, zorder=2)
        for place, name, outward in ((wire[0], before, -1), (terminal, after, 1)):
            axes.plot(*place, marker="o", markersize=3, markerfacecolor="white", markeredgecolor=INK, zorder=3)
            shift = np.zeros(2)
            shift[axis] = 0.08 * outward
            x, y = (place + shift).tolist()
            text = axes.text(x, y, f"to {name}", fontsize=SMALL, ha="center", va="center")
            if axis == 0:
                text.set_horizontalalignment("left" if outward > 0 else "right")
            else:
                text.set_verticalalignment("bottom" if outward > 0 else "top")


def _draw_nodes(plan: Schematic, netlist: Netlist, op: OperatingPoint | None, axes: Axes) -> None:
    if not len(plan.dot_node):
        return
    colours: str | NDArray[np.float64] = INK
    if op is not None and op.potential is not None:
        colours = height_map()(np.nan_to_num(op.potential[plan.dot_node]))
    axes.scatter(plan.dot[:, 0], plan.dot[:, 1], s=20, c=colours, edgecolor=INK, linewidth=0.7, zorder=4)
    texts, unit = voltage_texts(op, plan.dot_node)
    for (x, y), name, text in zip(plan.dot, netlist.names_of(plan.dot_node), texts, strict=True):
        axes.text(
            x + 0.1, y - 0.11, name, ha="left", va="top", fontsize=SMALL, color="#666666", path_effects=_HALO, zorder=6
        )
        axes.text(
            x + 0.1, y + 0.11, text, ha="left", va="bottom", fontsize=SMALL, path_effects=_HALO, zorder=6, gid="volts"
        )
    label = f"node: name, and voltage above it in {unit}" if op is not None else "node"
    axes.scatter([], [], s=20, c="#41b6c4" if op is not None else INK, edgecolor=INK, linewidth=0.7, label=label)


def _draw_drive(netlist: Netlist, cell_map: CellMap, axes: Axes) -> None:
    if not len(netlist.current_nodes):
        return
    cells = netlist.cell_of_node()
    up = cell_map.node.size // cell_map.node.shape[0]
    for node in netlist.current_nodes[:, 1].tolist():
        x, y = (index + 0.5 for index in divmod(int(cells[node]), up))
        axes.annotate(
            "", (x - 0.05, y - 0.05), (x - 0.32, y - 0.32), zorder=3,
            arrowprops={"arrowstyle": "-|>", "color": _DRIVE, "linewidth": 1.0, "mutation_scale": 6, "shrinkB": 1.5},
        )  # fmt: skip
    amps = engineering(float(netlist.current_amps.max()), "A")
    axes.add_line(
        Line2D([], [], linestyle="", marker=r"$\nearrow$", markersize=8, color=_DRIVE, label=f"current source, {amps}")
    )


def _limits(plan: Schematic, rows: int) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of the drawing."""
    around = MARGIN + 0.2 + (0.75 if plan.seam.any() else 0.0)
    left, right = -around, max(plan.across + around, 5.6 - around)
    return left, right, -MARGIN - SUPPLY_GAP - SUPPLY_HEIGHT * rows, plan.up + MARGIN + 0.2


def _finish(plan: Schematic, rows: int, axes: Axes) -> None:
    left, right, bottom, top = _limits(plan, rows)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()
    refresh_legend(axes, columns=3 if plan.across >= 6 else 2, gap=0.6)
