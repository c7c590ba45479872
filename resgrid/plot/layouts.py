"""Pictures of chip layouts: the whole block, and one tile with all its layers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from resgrid.hardware.layout import Layout
from resgrid.hardware.layout_process import METALS
from resgrid.hardware.layout_rules import Layer
from resgrid.hardware.layout_shapes import Window, expanded_shapes
from resgrid.plot.figures import new_figure
from resgrid.plot.style import SMALL, TEXT

LINES: Mapping[str, dict[str, Any]] = {
    "marker": {"facecolor": "#F0E442", "alpha": 0.45},
    "poly": {"facecolor": "#D55E00", "alpha": 0.85},
    "metal 1": {"facecolor": "#0072B2", "alpha": 0.6},
    "metal 2": {"facecolor": "#009E73", "alpha": 0.3},
    "metal 3": {"facecolor": "#CC79A7", "alpha": 0.6},
    "pad": {"facecolor": "#9a9a9a", "alpha": 0.9},
    "contact": {"facecolor": "#000000"},
    "via": {"facecolor": "#ffffff", "edgecolor": "#000000", "linewidth": 0.6},
}
"""Matplotlib style of each kind of layer, by name, in the order of drawing."""

MOST_SHAPES = 150_000
"""Largest number of resistors for which the picture of a whole layout draws every resistor."""

_LENGTHS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
"""Possible lengths of the scale bar, in micrometres."""


def draw_layout(layout: Layout) -> Figure:
    """Draw a layout: the whole block with its pads, and one cell of the grid with all layers; return the figure.

    A dashed frame in the picture of the block shows the place of this cell.
    """
    x0, y0, x1, y1 = (edge * 1e-3 for edge in layout.outline)
    window = _tile_window(layout)
    width, zoomed = (x1 - x0) / (y1 - y0), (window[2] - window[0]) / (window[3] - window[1])
    share = np.clip([width, zoomed], 0.6, 2.6)
    figure = new_figure(9.0, 8.6 / float(share.sum()) + 1.0)
    block, tile = figure.subplots(1, 2, width_ratios=share.tolist())
    _draw_block(layout, block, window)
    _draw_tile(layout, tile, window)
    shown = [name for name, layers in _layers(layout).items() if layers]
    handles = [Patch(label=_named(layout, name), **{"edgecolor": "none", **LINES[name]}) for name in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=SMALL, frameon=False)
    return figure


def _named(layout: Layout, name: str) -> str:
    """Return the legend entry of a kind of layer; `name`: key of `LINES`."""
    metals = [metal.name for metal in layout.rules.metals]
    pads = ", pads" if len(metals) == METALS else ""
    return {
        "marker": "body of a resistor (marker)", "poly": "resistor", "contact": "contact", "via": "via",
        "metal 1": f"{metals[0]}: nodes", "metal 2": f"{metals[1]}: obstacle rail",
        "metal 3": f"{metals[2]}: goals{pads}",
        "pad": f"{metals[-1]}: pads",
    }[name]  # fmt: skip


def _layers(layout: Layout) -> dict[str, Sequence[Layer]]:
    """Return the GDSII layers of the process for each key of `LINES`."""
    rules = layout.rules
    first, second, third = rules.metals[:3]
    body, ends = list(rules.body.values()), list(rules.ends.values())
    return {
        "marker": [cover.layer for cover in rules.body_covers] or body[-1:],
        "poly": list(dict.fromkeys([body[0], ends[0]])),
        "metal 1": [first.layer],
        "metal 2": [second.layer],
        "metal 3": [third.layer],
        "pad": [] if third is rules.metals[-1] else [rules.metals[-1].layer],
        "contact": [rules.contact],
        "via": [first.via_layer, second.via_layer],
    }


def _tile_window(layout: Layout) -> Window:
    """Return the corners x0, y0, x1, y1, in micrometres, of a window around the drawing of one cell near a goal.

    The cell is the one nearest to the first goal cell among the free cells with resistors to the next cell along both
    axes; without such a cell, among all cells with a node.
    """
    tile, array = layout.tile, layout.array
    both = (array.along_x >= 0) & (array.along_y >= 0) & (array.region < 0) & ~array.obstacle
    places = np.argwhere(both) if both.any() else np.argwhere(array.node)
    goal = np.argwhere(array.region >= 0)[0]
    i, j = (places[np.argmin(np.abs(places - goal).sum(axis=1))] - 1).tolist()
    px, py = tile.px * 1e-3, tile.py * 1e-3
    return i * px - 0.3 * px, j * py - 0.35 * py, (i + 1.3) * px, (j + 1.35) * py


def _draw_block(layout: Layout, axes: Axes, window: Window) -> None:
    """Draw the whole block with metals, resistors and pads, and a dashed frame.

    `window`: corners x0, y0, x1, y1 of the frame, in micrometres.
    """
    layers = _layers(layout)
    names = ["metal 2", "marker", "metal 3", "pad"]
    if len(layout.value) > MOST_SHAPES:
        names.remove("marker")
        _fill_array(layout, axes)
    shapes = expanded_shapes(layout, layers={layer for name in names for layer in layers[name]})
    for name in names:
        style = LINES[name] | ({"facecolor": LINES["poly"]["facecolor"], "alpha": 0.8} if name == "marker" else {})
        _add(axes, [shapes[layer] for layer in layers[name] if layer in shapes], style)
    wires = [box[1:] for box in layout.cells[-1].boxes if box[0] in layers["metal 1"]]
    _add(axes, [np.array(wires, dtype=np.float64).reshape(-1, 4)], LINES["metal 1"])
    for pad in layout.rails.pads:
        name = pad.net.replace("_", " ")
        text = axes.text(pad.x * 1e-3, pad.y * 1e-3, name, ha="center", va="center", fontsize=SMALL)
        text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    x0, y0, x1, y1 = window
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, linestyle="--", linewidth=0.8))
    low_x, low_y, high_x, high_y = (edge * 1e-3 for edge in layout.outline)
    axes.add_patch(Rectangle((low_x, low_y), high_x - low_x, high_y - low_y, fill=False, linewidth=0.8, clip_on=False))
    width, height = layout.size
    title = f"{layout.process}: {len(layout.value):,} resistors, {width * 1e6:.4g} x {height * 1e6:.4g} um"
    _finish(axes, (low_x, low_y, high_x, high_y), title)


def _fill_array(layout: Layout, axes: Axes) -> None:
    """Draw the whole array of resistors as one rectangle, because it has too many resistors to draw every one."""
    columns, rows = layout.op.netlist.cells.space.shape
    size = columns * layout.tile.px * 1e-3, rows * layout.tile.py * 1e-3
    axes.add_patch(Rectangle((0.0, 0.0), *size, facecolor=LINES["poly"]["facecolor"], alpha=0.5))


def _draw_tile(layout: Layout, axes: Axes, window: Window) -> None:
    """Draw all layers inside a window, with the names of the nodes.

    `window`: corners x0, y0, x1, y1, in micrometres.
    """
    x0, y0, x1, y1 = window
    shapes = expanded_shapes(layout, (x0 * 1e3, y0 * 1e3, x1 * 1e3, y1 * 1e3))
    for name, layers in _layers(layout).items():
        _add(axes, [shapes[layer] for layer in layers if layer in shapes], LINES[name])
    cell = layout.op.netlist.cells.space.cell
    px, py = layout.tile.px * 1e-3, layout.tile.py * 1e-3
    nets = {0: "cell {} {}", 1: "obstacle", 2: "goal"}
    for i, j in np.ndindex(cell.shape):
        x, y = i * px, j * py
        if x0 < x < x1 and y0 < y < y1:
            text = axes.annotate(
                nets[int(cell[i, j])].format(i, j), (x, y), (-4, -3), textcoords="offset points", fontsize=SMALL,
                ha="right", va="top", annotation_clip=False,
            )  # fmt: skip
            text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    shape = layout.resistors[int(layout.value[0])]
    title = f"one tile: {px:.4g} x {py:.4g} um, two resistors of {shape.resistance:.5g} ohm"
    _finish(axes, window, title if len(layout.resistors) == 1 else f"one tile: {px:.4g} x {py:.4g} um")


def _add(axes: Axes, boxes: Sequence[NDArray[np.float64]], style: Mapping[str, Any]) -> None:
    """Add rectangles to axes.

    `boxes`: arrays (n, 4) of corners x0, y0, x1, y1, in nanometres; `style`: options of matplotlib.
    """
    if not boxes:
        return
    corners = np.concatenate(boxes)[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2) * 1e-3
    axes.add_collection(PolyCollection(list(corners), **{"edgecolor": "none", "linewidth": 0.0, **style}))


def _finish(axes: Axes, window: Window, title: str) -> None:
    """Set limits and title of axes, hide their ticks, and add a scale bar.

    `window`: limits x0, y0, x1, y1, in micrometres.
    """
    x0, y0, x1, y1 = window
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xticks=[], yticks=[])
    axes.set_title(title, fontsize=TEXT)
    length = max([one for one in _LENGTHS if one <= (x1 - x0) / 4] or [1])
    end, place = 0.03 + length / (x1 - x0), axes.transAxes
    axes.plot([0.03, end], [-0.03] * 2, color="black", lw=2, clip_on=False, transform=place, solid_capstyle="butt")
    axes.text(end + 0.02, -0.03, f"{length} um", fontsize=SMALL, va="center", transform=place)
