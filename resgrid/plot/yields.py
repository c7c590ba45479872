"""What becomes of robots on many chips: yield by start, yield over two values, and the faults that cost starts."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from numpy.typing import NDArray

from resgrid.chip.criticality import Criticality
from resgrid.chip.exploration import Exploration
from resgrid.chip.yields import Yield
from resgrid.errors import InputError
from resgrid.plot.chips import draw_map, draw_resistors, plain_ticks, space_of
from resgrid.plot.fields import add_colour_bar
from resgrid.plot.figures import axes_or_new
from resgrid.plot.plane import draw_cells, finish, plane_of
from resgrid.plot.style import FAILURE, SMALL, TEXT, dress, refresh_legend, strength_map
from resgrid.plot.symbols import engineering

_FAULTS = ("open", "short")
_MOST_LABELS = 80
_HARMLESS, _CONTOUR = "#c8c8c8", "#E69F00"
_UNITS = {
    "resistance": "Ω",
    "on": "Ω",
    "off": "Ω",
    "offset": "V",
    "supply": "V",
    "voltage": "V",
    "capacitance": "F",
    "bandwidth": "Hz",
    "temperature": "°C",
    "width": "m",
    "length": "m",
}
"""By the last word of a key."""


def plot_yield(result: Yield, ax: Axes | None = None) -> Axes:
    """Draw on which share of the chips a robot reaches the goal, start by start.

    Parameters
    ----------
    result : Yield
        Of a space of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes.
    """
    axes = draw_map(
        result.space, 100.0 * result.probability, ax, "chips on which a start is served", "%", norm=Normalize(0, 100)
    )
    overall = result.overall
    interval = f" ({100 * overall.low:.1f} to {100 * overall.high:.1f} %)" if result.random else ""
    axes.set_title(
        f"{100 * overall.value:.1f} % of the starts are served{interval}; "
        f"{result.trials} {'chip' if result.trials == 1 else 'chips'}",
        fontsize=TEXT,
    )
    return axes


def plot_exploration(result: Exploration, ax: Axes | None = None, *, share: float = 0.99) -> Axes:
    """Draw the yield over two values of a chip, with contours, and the cheapest points of a wanted yield.

    Parameters
    ----------
    result : Exploration
    ax : matplotlib.axes.Axes, optional
        Made when None.
    share : float
        The wanted yield.

    Returns
    -------
    matplotlib.axes.Axes
    """
    axes = axes_or_new(ax, 0.8)
    values = 100.0 * result.share.T
    image = axes.imshow(
        values, origin="lower", aspect="auto", cmap=strength_map(), norm=Normalize(0, 100), interpolation="nearest"
    )
    if min(values.shape) > 1:
        levels = [level for level in (50.0, 90.0, 99.0) if values.min() < level < values.max()]
        if levels:
            lines = axes.contour(values, levels=levels, colors=_CONTOUR, linewidths=1.4)
            axes.clabel(lines, fmt=lambda level: f"{level:g} %", fontsize=SMALL)
    if values.size <= _MOST_LABELS:
        for (row, column), value in np.ndenumerate(values):
            colour = "white" if value > 62 else "black"
            text = f"{np.floor(10 * value + 1e-6) / 10:.4g}"
            axes.text(column, row - 0.28, text, ha="center", va="center", fontsize=SMALL - 1.5, color=colour)
    _mark_cheapest(result, share, axes)
    for axis, key, ticks in (
        (axes.xaxis, result.first, result.first_values),
        (axes.yaxis, result.second, result.second_values),
    ):
        axis.set_ticks(range(len(ticks)), [_told(key, tick) for tick in ticks])
        unit = _UNITS.get(key.split("_")[-1].split(".")[-1])
        axis.set_label_text(key.replace("_", " ").replace(".", ", ") + (f" ({unit})" if unit else ""))
    add_colour_bar(image, axes, "starts served (%)")
    axes.set_title(f"{result.trials} chips at every point", fontsize=TEXT)
    dress(axes)
    refresh_legend(axes)
    return axes


def _mark_cheapest(result: Exploration, share: float, axes: Axes) -> None:
    least = result.cheapest(share)
    column = [number for number, value in enumerate(least) if value is not None]
    if column:
        row = [result.second_values.index(least[number]) for number in column]
        axes.plot(
            column, row, linestyle="", marker="o", markersize=6, color="white", markeredgecolor=FAILURE,
            markeredgewidth=1.6, label=f"least {result.second.rpartition('.')[2]} for {100 * share:g} %",
        )  # fmt: skip


def _told(key: str, value: Any) -> str:
    """A value as its owner would write it."""
    if value is None:
        return "none"
    if key in {"mismatch", "defects.open_density", "defects.short_density"}:
        return f"{100 * value:g} %"
    if isinstance(value, float) and value:
        return engineering(value, "").strip()
    return f"{value:g}" if isinstance(value, float) else f"{value}"


def plot_criticality(result: Criticality, ax: Axes | None = None, *, fault: str = "open") -> Axes:
    """Draw how many starts every resistor costs when it is open, or shorted; switches as dots in their cells.

    Parameters
    ----------
    result : Criticality
        Of a chip of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    fault : {"open", "short"}

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the fault is unknown, or the space does not have two axes.
    """
    if fault not in _FAULTS:
        raise InputError(f"fault = {fault!r} is unknown; it may be open or short")
    netlist = result.netlist
    space = space_of(netlist)
    plane = plane_of(space)
    axes = axes_or_new(ax, plane.aspect)
    draw_cells(plane, axes)
    lost = result.open if fault == "open" else result.short
    cell_map = netlist.cells
    norm = LogNorm(1.0, max(float(np.nanmax(lost, initial=0.0)), 2.0))
    bent = bool(cell_map.nonlinear_face.size)
    face = cell_map.nonlinear_face if bent else cell_map.resistor_face
    value = lost[len(netlist.conductance) :] if bent else lost[: len(face)]
    grid = np.flatnonzero((face >= 0) & np.isfinite(value))
    draw_resistors(netlist, grid[value[grid] == 0], axes, face).set(color=_HARMLESS, linewidth=0.8)
    order = grid[np.argsort(value[grid], kind="stable")]
    order = order[value[order] > 0]
    lines = draw_resistors(netlist, order, axes, face)
    lines.set(array=value[order], cmap=strength_map(), norm=norm, linewidth=2.0)
    cell, worst = _switches(result, lost)
    if cell.size:
        centre = plane.place(space.axis_centre(np.stack(np.unravel_index(cell, space.shape), axis=1)))
        axes.scatter(
            centre[:, 0], centre[:, 1], c=worst, cmap=strength_map(), norm=norm, s=16, marker="s", edgecolor="white",
            linewidth=0.4, zorder=5, label="a switch or load of the cell",
        )  # fmt: skip
    finish(plane, axes)
    add_colour_bar(lines, axes, "starts lost")
    plain_ticks(lines)
    critical = int((np.nan_to_num(lost) > 0).sum())
    what = "open" if fault == "open" else f"shorted by {engineering(result.short_resistance, 'Ω')}"
    axes.set_title(
        f"{what}: {critical} of {result.examined:,} elements cost some of {result.served} starts",
        fontsize=TEXT,
    )
    refresh_legend(axes)
    return axes


def _switches(result: Criticality, lost: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cells with a switch or load whose fault costs starts, and how many the worst of theirs costs."""
    netlist = result.netlist
    cell_map = netlist.cells
    cell_of = netlist.cell_of_node()
    extra = np.flatnonzero(cell_map.resistor_face < 0)
    cell = cell_of[netlist.resistor_nodes[extra, 0]]
    own = (cell >= 0) & (np.nan_to_num(lost[extra]) > 0)
    worst = np.zeros(cell_map.space.cell.size)
    np.maximum.at(worst, cell[own], lost[extra[own]])
    found = np.flatnonzero(worst > 0)
    return found, worst[found]
