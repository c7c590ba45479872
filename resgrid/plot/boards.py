"""Pictures of boards: the plan of solder bridges, or the board of one scene with its expected voltages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from resgrid._internal.colours import GOAL
from resgrid.core.cell import Cell
from resgrid.plot.style import OBSTACLE, SMALL, TEXT, dress

if TYPE_CHECKING:
    from resgrid.hardware.board import Board

_PALE = "#e9e9e9"


def draw_board(board: Board, ax: Axes) -> Axes:
    """Draw the cells of a board: the jumper plan of a board with jumpers, or expected voltages of a fixed board.

    Starts have a blue frame.  In a jumper plan, ``O`` marks a bridge to the obstacle rail, ``G`` one to the goal rail, and an empty cell an
    open jumper.  `board`: the board; `ax`: axes to draw on.
    """
    cell = board.circuit.space.cell
    columns, rows = cell.shape
    ax.set_xlim(-1.0, columns)
    ax.set_ylim(-1.0, rows)
    ax.set_aspect("equal")
    points = _points_per_cell(ax, columns, rows)
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


def _points_per_cell(ax: Axes, columns: int, rows: int) -> float:
    """Return the approximate width of a cell in the picture, in points."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    width, height = figure.get_size_inches() * (ax.get_position().width, ax.get_position().height)
    return float(72 * min(width / (columns + 1), height / (rows + 1)))


def _draw_cell(board: Board, ax: Axes, at: tuple[int, int], kind: Cell, points: float) -> None:
    """Draw one cell; `at`: its index; `kind`: its state; `points`: width of a cell in points."""
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
    """Return the title of the picture."""
    count = len(board.closed)
    if board.kind == "jumpers":
        bridges = "1 bridge" if count == 1 else f"{count} bridges"
        return f"{board.title}: {bridges} (O: middle pad with O, G: middle pad with G)"
    return f"{board.title}: expected voltages at {board.circuit.wiring.supply:g} V"
