"""Pictures of resistor boards: a plan of the cells with solder bridges or expected voltages, and both sides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

from resgrid._internal.colours import GOAL
from resgrid.core.cell import Cell
from resgrid.plot.style import OBSTACLE, SMALL, TEXT, dress

if TYPE_CHECKING:
    from resgrid.hardware.board import Board
    from resgrid.hardware.kicad.footprints import PlacedFootprint

_PALE = "#e9e9e9"
_MASK, _COPPER, _GOLD, _TIN = "#1f4d36", "#4f7a3f", "#d9b13b", "#c8c8c8"
"""Colours of solder mask, copper under the mask, plated holes, and soldered pads."""


def draw_board(board: Board, ax: Axes, side: Literal["plan", "front", "back"] = "plan") -> Axes:
    """Draw the plan of a board's cells, or the board from the front or the back; return the axes.

    In the plan of a board with jumpers (solder bridges that select obstacles and goals), a letter in a cell marks the
    bridge to close: ``O`` to the obstacle rail, ``G`` to the goal rail. The plan of a board without jumpers shows the
    expected voltages in volts. Starts have a blue frame.

    `board`: the board; `ax`: axes to draw on; `side`: "plan"; or "front" or "back" for copper, pads and printed texts.
    """
    return _draw_plan(board, ax) if side == "plan" else _draw_side(board, ax, side)


def _draw_side(board: Board, ax: Axes, side: str) -> Axes:
    """Draw copper, pads, holes and printed texts of one side, as seen from this side; return the axes.

    `side`: "front" or "back".
    """
    from resgrid.hardware.board_files import silkscreen_of
    from resgrid.hardware.plane import fill_plane
    from resgrid.hardware.routing import route

    placement, routing = board.placement, route(board.placement)
    (x0, y0), (x1, y1) = placement.origin, placement.corner
    layer, silk = ("F.Cu", "F.SilkS") if side == "front" else ("B.Cu", "B.SilkS")
    ax.set_xlim((x0 - 1, x1 + 1) if side == "front" else (x1 + 1, x0 - 1))
    ax.set_ylim(y1 + 1, y0 - 1)
    ax.set_aspect("equal")
    ax.set_axis_off()
    points = _points_per_unit(ax)
    shape = FancyBboxPatch(
        (x0 + 3, y0 + 3), x1 - x0 - 6, y1 - y0 - 6, boxstyle="round,pad=3", facecolor=_MASK, edgecolor="none"
    )
    ax.add_patch(shape)
    if side == "back":
        plane = fill_plane(placement, routing)
        ax.add_collection(PolyCollection([np.array(part) for part in plane.filled], facecolors=_COPPER, zorder=2))
    tracks = [track for track in routing.tracks if track.layer == layer]
    widths = [track.width * points for track in tracks]
    ax.add_collection(LineCollection([(t.start, t.stop) for t in tracks], colors=_COPPER, linewidths=widths, zorder=3))
    for placed in placement.parts:
        _draw_pads(placed, ax, side)
    graphics = silkscreen_of(board)
    if side == "front":
        lines = [((a, b), (c, d)) for a, b, c, d, _, _ in graphics.lines]
        ax.add_collection(LineCollection(lines, colors="white", linewidths=0.15 * points, zorder=6))
    for text in graphics.texts:
        if text.layer == silk:
            _write(ax, text.text, (text.x, text.y), text.size[1] * points, text.turn, text.align)
    for placed in placement.parts:
        if side == "front" and placed.label is not None:
            _write(ax, placed.reference, placed.label, placed.label_size[1] * points, placed.label_turn, "")
    return ax


def _write(ax: Axes, words: str, at: tuple[float, float], height: float, turn: int, align: str) -> None:
    """Write a printed text of the board.

    `words`: the text; `at`: reference point (x, y) in mm; `height`: height of the letters, in points; `turn`: rotation
    in degrees, anticlockwise in the picture; `align`: which part of the text lies at the reference point: "left",
    "right", or "" for the centre.
    """
    anchor = align or "center"
    ax.text(*at, words, fontsize=1.15 * height, rotation=turn, ha=anchor, va="center", color="white", zorder=7)


def _draw_pads(placed: PlacedFootprint, ax: Axes, side: str) -> None:
    """Draw the pads and holes of a part on one side; `side`: "front" for all pads, "back" for pads with a hole."""
    for pad in placed.footprint.pads:
        (x, y), (width, height) = placed.place_of(pad), placed.size_of(pad)
        if pad.number and (pad.drill or side == "front"):
            colour = _GOLD if pad.drill else _TIN
            if pad.shape == "circle":
                ax.add_patch(Circle((x, y), width / 2, facecolor=colour, edgecolor="none", zorder=5))
            else:
                corner = (x - width / 2, y - height / 2)
                ax.add_patch(Rectangle(corner, width, height, facecolor=colour, edgecolor="none", zorder=5))
        if pad.drill:
            ax.add_patch(Circle((x, y), pad.drill / 2, facecolor="white", edgecolor="none", zorder=6))


def _points_per_unit(ax: Axes) -> float:
    """Return the number of points per unit of the axes, which is a millimetre of the board or a cell of the plan."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    width, height = figure.get_size_inches() * (ax.get_position().width, ax.get_position().height)
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    return float(72 * min(width / abs(right - left), height / abs(high - low)))


def _draw_plan(board: Board, ax: Axes) -> Axes:
    """Draw the plan of a board: cells with the letters of closed bridges or the expected voltages; return the axes."""
    cell = board.circuit.space.cell
    columns, rows = cell.shape
    ax.set_xlim(-1.0, columns)
    ax.set_ylim(-1.0, rows)
    ax.set_aspect("equal")
    points = _points_per_unit(ax)
    for i in range(columns):
        for j in range(rows):
            _draw_cell(board, ax, (i, j), Cell(int(cell[i, j])), points)
    for i, j in board.starts:
        frame = Rectangle((i - 0.44, j - 0.44), 0.88, 0.88, fill=False, edgecolor="#0072B2", linewidth=1.4, zorder=4)
        ax.add_patch(frame)
    step = 1 if max(columns, rows) <= 40 else 5
    ax.set_xticks(np.arange(0, columns, step), labels=[str(i) for i in range(0, columns, step)])
    ax.set_yticks(np.arange(0, rows, step), labels=[str(j) for j in range(0, rows, step)])
    ax.set_xlim(-0.6, columns - 0.4)
    ax.set_ylim(-0.6, rows - 0.4)
    ax.set_xlabel("column")
    ax.set_ylabel("row")
    dress(ax)
    ax.tick_params(length=0, top=False, labelsize=min(SMALL, max(3.0, 0.45 * points)))
    ax.set_title(_title(board), fontsize=TEXT)
    return ax


def _draw_cell(board: Board, ax: Axes, at: tuple[int, int], kind: Cell, points: float) -> None:
    """Draw one cell of the plan, with its text if the cell is large enough.

    The text is the letter of the bridge to close on a board with jumpers, otherwise the expected voltage in volts.
    `at`: column and row of the cell; `kind`: free, obstacle or goal; `points`: width of a cell in points.
    """
    is_plan = board.kind == "jumpers"
    colours = {Cell.OBSTACLE: OBSTACLE, Cell.GOAL: GOAL, Cell.FREE: "white"}
    ax.add_patch(
        Rectangle((at[0] - 0.5, at[1] - 0.5), 1, 1, facecolor=colours[kind], edgecolor=_PALE, linewidth=0.4, zorder=1)
    )
    words, size = {Cell.OBSTACLE: "O", Cell.GOAL: "G", Cell.FREE: ""}[kind], 0.6 * points
    if not is_plan:
        net = board.circuit.cell_nets.get(at)
        words, size = ("", 0.0) if net is None else (f"{board.voltages[net]:.3f}", 0.27 * points)
    if words and size > 1.5:
        colour = "white" if kind == Cell.OBSTACLE else "black"
        ax.text(*at, words, ha="center", va="center", fontsize=size, color=colour, zorder=3)


def _title(board: Board) -> str:
    """Return the title of the plan: the board's title, and the number of bridges to close (board with jumpers).

    For a board without jumpers, the title has the supply voltage in place of the number of bridges.
    """
    count = len(board.closed)
    if board.kind == "jumpers":
        bridges = "1 bridge" if count == 1 else f"{count} bridges"
        return f"{board.title}: {bridges} (O: middle pad with O, G: middle pad with G)"
    return f"{board.title}: expected voltages at {board.circuit.wiring.supply:g} V"
