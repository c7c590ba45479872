"""Colours, sizes, labels and legends of all pictures.

The categorical colours are those of Okabe & Ito (2008), which can be distinguished with every kind of colour vision.
Line styles distinguish the same categories, so that no information depends on colour.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import ArrayLike

from resgrid._internal.colours import GOAL, HEIGHT, SURFACE
from resgrid.core.axis import Axis

OBSTACLE = "#3d3d3d"
UNREACHABLE = "#c4c4c4"
UNKNOWN = "#9db3c6"
UNDECIDED = "#CC79A7"
FREE = "#ffffff"
NO_DROP = "#e8d3e4"
FAILURE = "#B2182B"
HIDDEN = "#b96b6b"
PATHS = ("#D55E00", "#000000", "#CC79A7", "#0072B2", "#009E73", "#F0E442")
LINE_STYLES: tuple[str | tuple[int, tuple[float, ...]], ...] = (
    "-",
    (0, (4, 1.5)),
    (0, (6, 1.5, 1, 1.5)),
    (0, (1, 1)),
    (0, (8, 2)),
    (0, (2, 1)),
)

_ENDS = {0.0: "#0072B2", 1.0: "#E69F00"}
_BETWEEN = ("#000000", "#CC79A7", "#009E73", "#F0E442")
_WIDTHS = (2.8, 1.7, 1.2)

_MARKS: dict[str, dict[str, Any]] = {
    "start": {"s": 22, "marker": "o", "facecolor": "white", "edgecolor": "black", "linewidth": 0.8},
    "goal": {"s": 60, "marker": "*", "facecolor": GOAL, "edgecolor": "black", "linewidth": 0.8},
    "end": {"s": 24, "marker": "*", "facecolor": "white", "edgecolor": "black", "linewidth": 0.6},
    "failure": {
        "s": 34,
        "marker": "x",
        "color": FAILURE,
        "linewidth": 1.6,
        "path_effects": [Stroke(linewidth=3.0, foreground="white"), Normal()],
    },
}
_AMONG_MANY: dict[str, dict[str, Any]] = {
    "start": {"s": 1.5, "facecolor": "black", "linewidth": 0.0},
    "goal": {"s": 8, "linewidth": 0.2},
    "end": {"s": 6, "linewidth": 0.2},
    "failure": {"s": 4, "path_effects": []},
}
FEW = 40
"""Largest number of marks or paths that are drawn at full size; more than these are drawn small."""

TEXT = 8.0
"""Size of labels and titles, in points."""
SMALL = 7.0
"""Size of ticks and legends, in points."""
LONG_LABEL = 28
"""Smallest number of characters of an entry for which a legend of more than two columns has one column less."""
DPI = 200
"""Default resolution of picture files, in dots per inch."""

_GREEK = re.compile(r"(alpha|beta|gamma|theta|phi|psi|omega)(?:_(\w+))?")


def blend_styles(blends: Sequence[float | None]) -> list[dict[str, Any]]:
    """Return matplotlib's options ``color``, ``linestyle`` and ``linewidth`` for the paths of every k.

    `blends`: values of k in ascending order, None for paths of one field. k = 0 is blue and k = 1 orange, as on the
    live page.  Lines of larger k are narrower, so that all lines stay visible.
    """
    between = [blend for blend in blends if blend not in _ENDS]
    return [
        {
            "color": PATHS[0] if k is None else _ENDS.get(k) or _BETWEEN[between.index(k) % len(_BETWEEN)],
            "linestyle": LINE_STYLES[rank % len(LINE_STYLES)],
            "linewidth": 1.5 if len(blends) == 1 else _WIDTHS[min(rank, len(_WIDTHS) - 1)],
        }
        for rank, k in enumerate(blends)
    ]


def height_map() -> Colormap:
    """Return the colour map of the height (voltage above the goal rail): yellow at goals, dark blue at the maximum."""
    return LinearSegmentedColormap.from_list("height", HEIGHT, N=256)


def surface_map() -> Colormap:
    """Return the colour map of the z coordinate of an obstacle's surface: dark grey-blue below, pale above."""
    return LinearSegmentedColormap.from_list("surface", SURFACE, N=256)


def strength_map() -> Colormap:
    """Return the colour map of a magnitude on white ground, from pale blue (small) to dark purple (large)."""
    return LinearSegmentedColormap.from_list("strength", mpl.colormaps["BuPu"](np.linspace(0.3, 1.0, 64)), N=256)


def axis_label(axis: Axis, *, world: bool = False, of_map: bool = False) -> str:
    """Return the label of an axis: name (Greek letters as symbols), frame and unit.

    `world`: whether to add the word "world"; `of_map`: whether to add that the coordinates are those of the map.
    """
    greek = _GREEK.fullmatch(axis.name)
    name = axis.name
    if greek:
        name = f"$\\{greek[1]}$" if greek[2] is None else f"$\\{greek[1]}_{{{greek[2]}}}$"
    unit = f" ({axis.unit})" if axis.unit else ""
    return f"{name}{', world' if world else ' of the map' if of_map else ''}{unit}"


def dress(axes: Axes) -> None:
    """Set the text sizes of ticks and labels, and the line widths of ticks and frame."""
    axes.tick_params(labelsize=SMALL, width=0.6, length=2.5)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_fontsize(TEXT)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)


def add_swatch(axes: Axes, label: str, colour: str) -> None:
    """Add a coloured square with a label to the legend, for cells that are drawn as part of an image."""
    axes.add_line(
        Line2D([], [], linestyle="", marker="s", markersize=6, color=colour, markeredgecolor="#00000080", label=label)
    )


def mark(places: ArrayLike, axes: Axes, kind: str, label: str | None = None) -> None:
    """Mark points of the picture by symbols.

    `places` (n, 2): positions in coordinates of the picture; `kind`: "start", "goal", "end" (of a path, at a goal) or
    "failure"; `label`: legend entry, None for the kind, an empty text for no entry.
    """
    x, y = np.reshape(places, (-1, 2)).T
    if len(x):
        style = _MARKS[kind] if len(x) <= FEW else _MARKS[kind] | _AMONG_MANY[kind]
        axes.scatter(x, y, zorder=8, label=kind if label is None else label, **style)


def refresh_legend(axes: Axes, columns: int = 3, gap: float = 4.6) -> None:
    """Draw one legend below the axes, in which each label occurs once.

    `columns`: largest number of columns, one less if an entry is long; `gap`: distance from the axes, in units of the
    legend's font size.
    """
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(reversed(labels), reversed(handles), strict=True))
    names = list(dict.fromkeys(labels))
    if names:
        columns -= columns > 2 and max(map(len, names)) >= LONG_LABEL
        axes.legend(
            [unique[name] for name in names], names, ncols=min(len(names), columns), loc="upper center",
            bbox_to_anchor=(0.5, 0.0), borderaxespad=gap, fontsize=SMALL, frameon=False, handlelength=1.8,
            columnspacing=1.0,
        )  # fmt: skip


def add_colour_bar(colours: ScalarMappable, where: Axes | Figure, label: str) -> None:
    """Add a colour bar to the right of axes, or to the right of all axes of a figure.

    `colours`: image or lines with the colour scale; `where`: axes or figure; `label`: quantity and unit.
    """
    values, lowest = colours.get_array(), colours.norm.vmin
    below = values is not None and lowest is not None and bool(np.any(values < lowest))
    figure = where.get_figure(root=True)
    assert figure is not None
    place: dict[str, Any] = {"ax": where.axes, "fraction": 0.03, "pad": 0.02, "aspect": 30}
    if isinstance(where, Axes):
        place = {"cax": where.inset_axes((1.03, 0.0, 0.035, 1.0))}
    bar = figure.colorbar(colours, extend="min" if below else "neither", **place)
    bar.set_label(label, fontsize=SMALL)
    bar.ax.tick_params(which="both", labelsize=SMALL, width=0.6, length=2.5)
    bar.ax.yaxis.get_offset_text().set_fontsize(SMALL)


def spanning(low: float, high: float) -> Normalize:
    """Return a linear colour scale from `low` to `high`, or from `low` to ``low + 1`` if both are equal."""
    return Normalize(low, high if high > low else low + 1.0)
