"""Circuit diagrams of netlists compiled from small grids, with nodes at the cell centres; symbols of elements."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from resgrid._internal.colours import GOAL
from resgrid.chip.power import rail_names
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.netlist import Netlist
from resgrid.core.regions import crossed_faces
from resgrid.plot.figures import new_figure
from resgrid.plot.style import OBSTACLE, SMALL, add_swatch, height_map, refresh_legend
from resgrid.plot.workspace import fill
from resgrid.scene.quantities import format_quantity, prefix_of

INK = "#202020"
HALO = [withStroke(linewidth=1.8, foreground="white")]
SYMBOLS = {
    "resistor": "Resistor",
    "voltage source": "SourceV",
    "current source": "SourceI",
    "capacitor": "Capacitor",
}
"""Name of the schemdraw symbol of each kind of element."""

MOST_CELLS_A_SIDE = 10
"""Largest number of cells along an axis in a circuit diagram."""

HALF = 0.3
"""Half the side of the square that is drawn in a cell on a rail (obstacle or goal), in cell widths."""

_GAP = 0.5 - HALF
"""Distance between the border of a cell on a rail and the square in this cell, in cell widths."""
_BAND = 0.5
"""Width of the band around the grid for a rail at the edge, in cell widths, including the gaps inside the band."""

_BODY = 0.36
"""Length of an element's symbol without its leads, in cell widths."""

_INCHES = 0.8
"""Side of a cell in a new figure, in inches."""
_DRIVE = "#8E2A84"
_SUPPLY_GAP, _SUPPLY_HEIGHT, _SUPPLY_WIDTH = 0.5, 1.5, 2.4
"""Distance between the grid and the first row of supplies; height and width that one supply takes; in cell widths."""


@contextmanager
def symbols_on(axes: Axes) -> Iterator[Any]:
    """Yield a schemdraw drawing for symbols; when the context ends, draw the symbols on the axes."""
    import schemdraw

    drawing = schemdraw.Drawing(canvas=axes, show=False)
    drawing.config(fontsize=SMALL, lw=0.9, color=INK)
    yield drawing
    drawing.draw(show=False)


def add_symbol(drawing: Any, kind: str, start: ArrayLike, end: ArrayLike) -> None:
    """Add the symbol of an element to a schemdraw drawing.

    `kind`: key of `SYMBOLS`; `start`, `end` (2,): ends of the element with its leads, in coordinates of the axes.  A
    source has its plus at `start`; the current of a current source flows from `start` to `end`.
    """
    import schemdraw.elements

    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    if kind == "voltage source":  # schemdraw puts the plus at the end
        first, last = last, first
    body = min(_BODY, 0.6 * float(np.linalg.norm(last - first)))
    drawing.add(getattr(schemdraw.elements, SYMBOLS[kind])().scale(body).endpoints(tuple(first), tuple(last)))


def add_ground(drawing: Any, at: ArrayLike, along: ArrayLike = (0.0, -1.0)) -> None:
    """Add a ground symbol to a schemdraw drawing.

    `at` (2,): position of the symbol's terminal, in coordinates of the axes; `along` (2,): direction from the terminal
    to the symbol, by default downwards.
    """
    import schemdraw.elements

    x, y = np.asarray(along, dtype=np.float64)
    symbol = schemdraw.elements.Ground().scale(_BODY).theta(90.0 + float(np.degrees(np.arctan2(y, x))))
    drawing.add(symbol.at(tuple(np.asarray(at, dtype=np.float64))))


def draw_compiled(netlist: Netlist, op: OperatingPoint | None, ax: Axes | None) -> Axes:
    """Draw the circuit of a space with one or two axes: nodes at cell centres, resistors, rails and supplies.

    `op`: operating point with the voltages and currents to write, None to omit them; `ax`: axes to draw on, None for a
    new figure.  Returns the axes.
    """
    columns, rows = in_plane(netlist.cells.node).shape
    number, start, end, seam = resistor_ends(netlist.cells)
    supplies = _supplies(netlist)
    per_row = int((max(columns, 4) + 1) / _SUPPLY_WIDTH)
    around, below = HALF + 0.2 + 0.75 * seam.any(), HALF + _SUPPLY_GAP
    right, top = max(columns + around, 5.6 - around), rows + HALF + 0.2
    bottom = -below - _SUPPLY_HEIGHT * -(-len(supplies) // per_row)
    size = _INCHES * (right + around), _INCHES * (top - bottom) + 0.5
    axes = new_figure(*size).add_subplot() if ax is None else ax
    _draw_rails(netlist, axes)
    with symbols_on(axes) as drawing:
        for ends in zip(start, end, strict=True):
            add_symbol(drawing, "resistor", *ends)
        for rank, (rail, numbers) in enumerate(supplies.items()):
            row, column = divmod(rank, per_row)
            amps = None if op is None else float(op.source_current[numbers].sum())
            at = 0.3 + _SUPPLY_WIDTH * column, -below - _SUPPLY_HEIGHT * row
            _draw_supply(drawing, axes, rail, len(numbers), amps, at)
    axes.add_line(Line2D([], [], color=INK, linewidth=0.9, label=resistor_note(netlist)))
    for resistor in np.flatnonzero(seam).tolist():
        _draw_seam(netlist, int(number[resistor]), start[resistor], end[resistor], axes)
    _draw_nodes(netlist, op, axes)
    _draw_drive(netlist, axes)
    _draw_leaks(netlist, axes)
    axes.set(xlim=(-around, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()
    refresh_legend(axes, columns=3 if columns >= 6 else 2, gap=0.6)
    return axes


def _draw_rails(netlist: Netlist, axes: Axes) -> None:
    """Draw the areas of the obstacle rail and the goal rails, hatched cells without a node, and names of rail nodes."""
    cells = netlist.cells
    hatched: dict[str, Any] = {"edgecolor": "#999999", "hatch": "////", "linewidth": 0.5, "zorder": 1}
    filled: dict[str, Any] = {"linewidth": 0, "zorder": 2.5}
    kinds = (("obstacle rail", OBSTACLE, filled), ("goal rail", GOAL, filled), ("no node (open)", "#eeeeee", hatched))
    for area, (label, colour, style) in zip(rail_areas(cells), kinds, strict=True):
        if not area.is_empty:
            fill(area, axes, facecolor=colour, **style)
            add_swatch(axes, label, colour)
    named = [(Cell.GOAL, "black")] + [(Cell.OBSTACLE, "white")] * (cells.wiring.rails == "cells")
    for code, colour in named:  # each rail's name is written in its first square
        places = np.argwhere((cells.space.cell == code) & (cells.node >= 0))
        nodes, first = np.unique(cells.node[tuple(places.T)], return_index=True)
        for name, place in zip(netlist.names_of(nodes), places[first] + 0.5, strict=True):
            x, y = (*place, 0.5)[:2]
            axes.text(x, y, name, ha="center", va="center", fontsize=SMALL, color=colour, zorder=6)


def resistor_note(netlist: Netlist) -> str:
    """Return the legend entry of the resistors: their values in ohms, or the range of more than three values.

    If the diagram omits resistors of switches, rails or loads, the entry states their number.
    """
    drawn = netlist.cells.resistor_face >= 0
    hidden = int(np.count_nonzero(netlist.cells.resistor_face == -1))
    rest = f"; not drawn: {hidden} of switches, rails, loads" if hidden else ""
    resistance = 1.0 / netlist.conductance[drawn]
    ohms = Counter(format_quantity(float(value), "Ω", 3) for value in resistance)
    if len(ohms) > 3:
        lowest, highest = (format_quantity(value, "Ω", 3) for value in (resistance.min(), resistance.max()))
        return f"resistor, {lowest} to {highest}{rest}"
    values = (f"{count} of {value}" if len(ohms) > 1 else value for value, count in ohms.most_common())
    return f"resistor, {', '.join(values)}{rest}"


def _draw_seam(
    netlist: Netlist, number: int, terminal: NDArray[np.float64], end: NDArray[np.float64], axes: Axes
) -> None:
    """Draw the two open ends of a resistor across a periodic seam, each labelled with the node that it leads to.

    The resistor is drawn at the upper end of the axis, and a wire at the lower end.  `number`: index of the resistor;
    `terminal` (2,), `end` (2,): open end of the resistor and end in the grid, both in cell widths.
    """
    names = netlist.names_of(netlist.resistor_nodes[number])
    before, after = names if netlist.cells.resistor_upward[number] else names[::-1]
    axis = int(np.argmax(np.abs(end - terminal)))
    wire = np.repeat(terminal[None], 2, axis=0)
    wire[:, axis] = (-HALF, 0.5)
    axes.plot(*wire.T, color=INK, linewidth=0.9, zorder=2)
    for place, name, outward in ((wire[0], before, -1), (terminal, after, 1)):
        axes.plot(*place, marker="o", markersize=3, markerfacecolor="white", markeredgecolor=INK, zorder=3)
        x, y = place + 0.08 * outward * np.eye(2)[axis]
        ha = ("left", "right")[outward < 0] if axis == 0 else "center"
        va = ("bottom", "top")[outward < 0] if axis == 1 else "center"
        axes.text(x, y, f"to {name}", fontsize=SMALL, ha=ha, va=va)


def _draw_nodes(netlist: Netlist, op: OperatingPoint | None, axes: Axes) -> None:
    """Draw the nodes of free cells with their names and voltages, coloured by their potential.

    `op`: operating point with the voltages, None to omit them.
    """
    cells = netlist.cells
    free = (in_plane(cells.space.cell) == Cell.FREE) & (in_plane(cells.node) >= 0)
    nodes, places = in_plane(cells.node)[free], np.argwhere(free) + 0.5
    if not len(nodes):
        return
    colours: str | NDArray[np.float64] = INK
    if op is not None and op.potential is not None:
        colours = height_map()(np.nan_to_num(op.potential[nodes]))
    axes.scatter(places[:, 0], places[:, 1], s=20, c=colours, edgecolor=INK, linewidth=0.7, zorder=4)
    texts, unit = voltage_texts(op, nodes)
    style: dict[str, Any] = {"ha": "left", "fontsize": SMALL, "path_effects": HALO, "zorder": 6}
    for (x, y), name, text in zip(places, netlist.names_of(nodes), texts, strict=True):
        axes.text(x + 0.12, y - 0.11, name, va="top", color="#666666", **style)
        axes.text(x + 0.12, y + 0.11, text, va="bottom", gid="volts", **style)
    label = f"node: name, and voltage above it in {unit}" if op is not None else "node"
    axes.scatter([], [], s=20, c="#41b6c4" if op is not None else INK, edgecolor=INK, linewidth=0.7, label=label)


def voltage_texts(op: OperatingPoint | None, nodes: NDArray[np.integer[Any]]) -> tuple[list[str], str]:
    """Return the voltages of nodes as n texts, and their unit, such as ``"mV"``.

    All texts have the same number of decimals, so that the largest magnitude of all node voltages has four or five
    digits.  `op`: operating point with the voltages, None for empty texts; `nodes` (n,): node indices.
    """
    if op is None:
        return [""] * len(nodes), "V"
    largest = float(np.nanmax(np.abs(op.voltage), initial=0.0))
    power, prefix = (0, "") if 0.5 < largest < 1 else prefix_of(largest)
    digits = 4 - max(int(np.floor(np.log10(largest or 1.0) + 1e-9)) - power, 0)
    return [f"{value / 10.0**power:.{digits}f}" for value in op.voltage[nodes].tolist()], f"{prefix}V"


def _draw_drive(netlist: Netlist, axes: Axes) -> None:
    """Draw an arrow at every node into which a current source injects a current; the legend states the largest one."""
    if not len(netlist.current_nodes):
        return
    cell = netlist.cell_of_node()[netlist.current_nodes[:, 1]]
    label = f"current source, {format_quantity(float(netlist.current_amps.max()), 'A', 3)}"
    _draw_arrows(netlist, cell, _DRIVE, label, axes)


def _draw_leaks(netlist: Netlist, axes: Axes) -> None:
    """Draw an arrow to every node with a leak (a resistor to the obstacle rail)."""
    leaks = netlist.cells.leak_cell >= 0
    if leaks.any():
        ohms = format_quantity(float(np.median(1.0 / netlist.conductance[leaks])), "Ω", 3)
        label = f"leak from the obstacle rail, {ohms}"
        _draw_arrows(netlist, netlist.cells.leak_cell[leaks].astype(np.int64), OBSTACLE, label, axes)


def _draw_arrows(netlist: Netlist, cell: NDArray[np.int64], colour: str, label: str, axes: Axes) -> None:
    """Draw an arrow to the node of each cell.

    `cell` (n,): flat indices of the cells in C order; `label`: entry of the legend.
    """
    shape = netlist.cells.space.shape
    for x, y in np.stack(np.unravel_index(cell, (*shape, 1)[:2]), axis=1) + 0.5:
        axes.annotate(
            "", (x - 0.05, y - 0.05), (x - 0.32, y - 0.32), zorder=3,
            arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.0, "mutation_scale": 6, "shrinkB": 1.5},
        )  # fmt: skip
    axes.add_line(Line2D([], [], linestyle="", marker=r"$\nearrow$", markersize=8, color=colour, label=label))


def _supplies(netlist: Netlist) -> dict[tuple[str, float], list[int]]:
    """Return the indices of the voltage sources for every pair of a rail's name and a voltage in volts.

    All sources of a pair share one symbol in the diagram; several goal regions have several rails.
    """
    groups: dict[tuple[str, float], list[int]] = {}
    for number, supply in enumerate(zip(rail_names(netlist), netlist.source_volts.tolist(), strict=True)):
        groups.setdefault(supply, []).append(number)
    return groups


def _draw_supply(
    drawing: Any, axes: Axes, rail: tuple[str, float], count: int, amps: float | None, at: tuple[float, float]
) -> None:
    """Draw one symbol for all voltage sources of a rail.

    `rail`: name of the rail and voltage in volts; `count`: number of sources; `amps`: total current into the plus
    terminals in amperes, None to omit it; `at`: position of the plus terminal, in cell widths.
    """
    (name, volts), (x, y) = rail, at
    colour = {"obstacle": OBSTACLE, "goal": GOAL}.get(name.partition("_")[0], INK)
    axes.plot([x - 0.28, x + 0.28], [y, y], color=colour, linewidth=3.0, solid_capstyle="butt", zorder=2)
    add_symbol(drawing, "voltage source", (x, y), (x, y - 1.0))
    add_ground(drawing, (x, y - 1.0))
    text = format_quantity(volts, "V", 3)
    lines = [name, text] if count == 1 else [f"{name}, {count} sources", f"{text} each"]
    if amps is not None and np.isfinite(amps):
        lines.append(f"{'takes' if amps > 0 else 'gives'} {format_quantity(abs(amps), 'A', 3)}")
    axes.text(x + 0.34, y - 0.5, "\n".join(lines), va="center", ha="left", fontsize=SMALL, linespacing=1.25)


def rail_areas(cells: CellMap) -> tuple[BaseGeometry, BaseGeometry, BaseGeometry]:
    """Return the areas of the obstacle rails (also around the grid), the goal rails, and cells without a node.

    The areas are polygons in cell widths, from the lower corner of the grid.
    """
    cell = in_plane(cells.space.cell)
    has_node = in_plane(cells.node) >= 0
    edges = (*cells.wiring.edges(cells.space), "open")[:2]
    around = _bands(
        cell.shape, [rule == "obstacle" and cells.obstacle_node >= 0 and not cells.wiring.is_open for rule in edges]
    )
    obstacles, goals = (_squares((cell == code) & has_node) for code in (Cell.OBSTACLE, Cell.GOAL))
    merged = cells.wiring.rails == "merged"
    return (
        _area([[*around, *obstacles]] if merged else [around, *([one] for one in obstacles)]),
        _area([goals] if merged else [[one] for one in goals]),
        _area([[one] for one in _squares(~has_node)]),
    )


def in_plane(values: NDArray[Any]) -> NDArray[Any]:
    """Return values of cells of one or two axes, shape (n,) or (n, m), as an array (n, 1) or (n, m)."""
    return values.reshape(len(values), -1)


def resistor_ends(
    cells: CellMap,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return indices, lower ends, upper ends, and seam mask of the m resistors that cross a cell face.

    The indices (m,) are those of the netlist's resistors.  The ends (m, 2) are in cell widths from the lower corner of
    the grid: cell centres, or points between the resistor and the centre of a rail cell, 0.3 from this centre.  The
    lower end has the lower coordinate.  The mask (m,) is True for resistors across a periodic seam.  These are drawn
    outwards from the upper end of their axis, and their "lower end" is the open end, which lies outside the grid.
    """
    across, index = crossed_faces(cells.resistor_face, cells.space.shape)
    number = np.flatnonzero(across >= 0)
    along = np.eye(2, dtype=np.int64)[across[number]]
    face = np.zeros((len(number), 2), dtype=np.int64)
    face[:, : index.shape[1]] = index[number]
    cell = in_plane(cells.space.cell)
    lower, upper = _end(cell, face - along, along, 1), _end(cell, face, along, -1)
    seam = np.array(cells.space.periodic)[across[number]] & ((face * along).sum(axis=1) == 0)
    last = (face + (np.array(cell.shape) - 1) * along)[seam]
    lower[seam] = last + 0.5 + (0.5 + HALF) * along[seam]
    upper[seam] = _end(cell, last, along[seam], 1)
    return number, lower, upper, seam


def _end(cell: NDArray[np.uint8], at: NDArray[np.int64], along: NDArray[np.int64], side: int) -> NDArray[np.float64]:
    """Return the ends (n, 2) of resistors, in cell widths: cell centres, or borders of the squares of cells on rails.

    `cell` (n, m): `Cell` codes of the grid; `at` (n, 2): indices of the cells, which may lie outside the grid; `along`
    (n, 2): unit vectors of the axes along the resistors; `side`: 1 if the resistor leads from the cell towards higher
    coordinates, -1 towards lower ones.
    """
    inside = np.all((at >= 0) & (at < cell.shape), axis=1)
    free = inside & (cell[tuple(np.clip(at, 0, np.array(cell.shape) - 1).T)] == Cell.FREE)
    return np.asarray(at + 0.5 + side * along * np.where(free, 0.0, HALF)[:, None])


def _squares(mask: NDArray[np.bool_]) -> list[BaseGeometry]:
    """Return the squares of the cells in a mask (n, m) as polygons, in cell widths."""
    return [shapely.box(i, j, i + 1, j + 1) for i, j in np.argwhere(mask).tolist()]


def _bands(shape: tuple[int, ...], railed: list[bool]) -> list[BaseGeometry]:
    """Return the rectangles of the rail around a grid, in cell widths.

    `shape`: number of cells per axis; `railed`: for each of the two axes, True if the rail lies beyond both ends of
    the axis.
    """
    (width, height), (x, y) = shape, (_BAND * rail for rail in railed)
    sides = [(-x, -y, 0, height + y), (width, -y, width + x, height + y)] if railed[0] else []
    sides += [(-x, -y, width + x, 0), (-x, height, width + x, height + y)] if railed[1] else []
    return [shapely.box(*side) for side in sides]


def _area(groups: list[list[BaseGeometry]]) -> BaseGeometry:
    """Return the union of groups of squares as a polygon, in cell widths.

    The squares of a group are first united; then all sides of this union are moved inwards by `_GAP` cell widths.
    """
    joined = [shapely.union_all(group).buffer(-_GAP, join_style="mitre") for group in groups if group]
    return shapely.union_all(joined)
