"""Maps of chip analyses per cell or resistor: settling, noise, heat, converter bits, yield, faults."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from resgrid.chip.adc_resolution import ADCResolution
from resgrid.chip.fault_analysis import FaultAnalysis
from resgrid.chip.noise import Noise
from resgrid.chip.power import Power
from resgrid.chip.sensitivity import Sensitivity
from resgrid.chip.settling import Settling
from resgrid.chip.yields import Yield
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.netlist import Netlist
from resgrid.core.regions import crossed_faces
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.plot.figures import axes_or_new
from resgrid.plot.plane import draw_cells, draw_image, finish, paint, plane_of
from resgrid.plot.style import FAILURE, TEXT, add_colour_bar, add_swatch, refresh_legend, strength_map
from resgrid.scene.quantities import format_quantity, prefix_of

_UNSERVED = "#e8d3e4"
"""Colour of starts for which no resolution of the converter suffices."""
_HARMLESS = "#c8c8c8"
"""Colour of resistors whose fault makes no start lose its path."""
_MOST_DRIFT = 100.0
"""Largest drift (magnitude of the relative change of a resistance), in per cent, for which a resistor is drawn.

Resistors that change a step only at a larger drift are omitted.
"""

_HEAT_DECADES = 5.0
"""Number of powers of ten that the logarithmic colour scale of heat covers, counted down from the hottest cell.

Colder cells have the lowest colour.
"""
_NOISE = {
    "total": ("rms noise within the band", "V"),
    "limit": ("rms noise, all frequencies", "V"),
    "resistance": ("resistance to the rails", "Ω"),
}
"""Colour bar label and unit of each quantity of the noise, by the name of the quantity."""
_POWER = {"heat": ("heat per cell", "W"), "droop": ("droop of rail cells", "V")}


def draw_settling(result: Settling, ax: Axes | None = None) -> Axes:
    """Draw a map of the settling time of every free cell, in seconds; return the axes (`ax`, or those of a new figure).

    From the settling time of a cell on, the voltage of the cell differs from the final value by at most half a step of
    the read-out's converter.
    """
    values = _of_free_cells(result.netlist.cells, result.node_time)
    axes = draw_map(result.netlist.cells.space, values, ax, f"time to settle to {result.bits} bits", "s")
    settled, slowest = (format_quantity(t, "s", 3) for t in (result.settle_time, float(result.time_constants[0])))
    axes.set_title(f"settles in {settled}; slowest time constant {slowest}", fontsize=TEXT)
    return axes


def draw_noise(
    result: Noise, ax: Axes | None = None, *, quantity: Literal["total", "limit", "resistance"] | None = None
) -> Axes:
    """Draw the rms thermal noise of the voltage of every free cell, or the cell's resistance to the rails.

    Returns the axes.  `ax`: axes to draw on, by default those of a new figure; `quantity`: "total" (V, within the
    band), "limit" (V, all frequencies) or "resistance" (Ω); by default "total" if a band was analysed, otherwise
    "resistance".
    """
    shown = quantity or ("resistance" if result.total is None else "total")
    label, unit = _NOISE[shown]
    values = getattr(result, shown)
    if values is None:
        raise InputError("the noise within a band was not computed: call study.noise(band=(low, high))")
    cells = result.netlist.cells
    axes = draw_map(cells.space, _of_free_cells(cells, values), ax, label, unit)
    if shown == "total" and result.band is not None:
        low, high = (format_quantity(limit, "Hz", 3) for limit in result.band)
        axes.set_title(f"thermal noise from {low} to {high} at {result.temperature:.4g} K", fontsize=TEXT)
    return axes


def draw_power(result: Power, ax: Axes | None = None, *, quantity: Literal["heat", "droop"] = "heat") -> Axes:
    """Draw the heat of every free cell and the hottest resistors, or the droop of the rails; return the axes.

    The heat of a cell is half the dissipated power of the resistors at its node.  At most 10 hottest resistors are
    marked.  The droop is the magnitude of the voltage difference between a cell on a rail (obstacle or goal) and an
    ideal rail.  `ax`: axes to draw on, by default those of a new figure; `quantity`: "heat" (W) or "droop" (V).
    """
    label, unit = _POWER[quantity]
    netlist = result.op.netlist
    cells = netlist.cells
    if quantity == "droop":
        droop = np.where(cells.node >= 0, np.abs(result.droop[cells.node]), np.nan)
        axes = draw_map(cells.space, droop, ax, label, unit, rails=True)
        axes.set_title(f"largest droop {format_quantity(result.largest_droop, 'V', 3)}", fontsize=TEXT)
        return axes
    heat = np.where(cells.space.cell == Cell.FREE, result.cell_heat, np.nan)
    hottest = max(float(np.nanmax(heat, initial=0.0)), 0.0)
    axes = draw_map(
        cells.space, np.maximum(heat, hottest * 10.0**-_HEAT_DECADES), ax, label, unit, log=hottest > 0
    )  # fmt: skip
    worst = result.worst()
    worst = worst[result.resistor[worst] > 0]
    lines = draw_resistors(netlist, worst, axes)
    lines.set(color=FAILURE, linewidth=2.0, label=f"the {len(worst)} hottest resistors")
    axes.set_title(f"{format_quantity(result.total, 'W', 3)} in total", fontsize=TEXT)
    refresh_legend(axes)
    return axes


def draw_sensitivity(result: Sensitivity, ax: Axes | None = None, *, drift: float = 0.01) -> Axes:
    """Draw the resistors, coloured by the smallest drift that changes a step of the robot; return the axes.

    A drift is the magnitude of a relative change of one resistance.  A step leads from a cell to the neighbour with the
    lowest voltage; white dots mark the cells with a step.  Resistors that need a drift of more than 100 % are left out.
    Resistors for which a drift of at most `drift` (a fraction) suffices are marked in red.  `ax`: axes to draw on, by
    default those of a new figure.
    """
    netlist = result.op.netlist
    space = netlist.cells.space
    plane = plane_of(space)
    axes = axes_or_new(ax, plane.aspect)
    draw_cells(plane, axes)
    per_cent = 100.0 * result.flip_drift[: len(netlist.conductance)]
    shown = np.flatnonzero(per_cent <= _MOST_DRIFT)
    if shown.size:
        order = shown[np.argsort(-per_cent[shown], kind="stable")]
        lines = draw_resistors(netlist, order, axes)
        lowest = max(float(per_cent[order].min()), 0.01)
        lines.set(
            array=np.maximum(per_cent[order], lowest), cmap=strength_map().reversed(), linewidth=1.6,
            norm=LogNorm(lowest, max(float(per_cent[order].max()), 2 * lowest)),
        )  # fmt: skip
        add_colour_bar(lines, axes, "drift of one resistor that changes a step (%)")
        _plain_ticks(lines)
    flips = result.flips(drift)
    marked = draw_resistors(netlist, flips[flips < len(netlist.conductance)], axes)
    marked.set(color=FAILURE, linewidth=2.4, label=f"{len(flips)} resistors: {100 * drift:g} % suffices")
    x, y = space.centre(result.cells).T
    axes.scatter(x, y, s=9, color="white", edgecolor="black", linewidth=0.7, zorder=5, label="decisions")
    finish(plane, axes, columns=2)
    return axes


def draw_adc_resolution(
    result: ADCResolution, ax: Axes | None = None, *, starts: bool = True, most: float | None = None
) -> Axes:
    """Draw a map of the resolution, in bits, that the converter of the node voltages needs; return the axes.

    `ax`: axes to draw on, by default those of a new figure; `starts`: True for the resolution of the whole path from
    each cell to a goal, False for the step from each cell to the next cell only; `most`: upper limit of the colour
    scale, in bits, None for the largest value.
    """
    values = result.start_bits if starts else result.cell_bits
    shown = np.where(np.isfinite(values), values, np.nan)
    label = f"bits that a {'start' if starts else 'cell'} needs"
    norm = None if most is None else Normalize(0.0, most)
    axes = draw_map(result.space, shown, ax, label, "bit", norm=norm)
    never = np.isinf(values) & result.space.goal_connected
    paint(plane_of(result.space), axes, (never, _UNSERVED, "no resolution suffices"))
    refresh_legend(axes)
    axes.set_title(result.sentence(), fontsize=TEXT)
    return axes


def draw_yield(result: Yield, ax: Axes | None = None) -> Axes:
    """Draw, for every free cell, the percentage of chips on which a robot that starts there reaches a goal.

    Returns the axes.

    `ax`: axes to draw on, by default those of a new figure.
    """
    per_cent, label = 100.0 * result.probability, "chips on which a start is served"
    axes = draw_map(result.space, per_cent, ax, label, "%", norm=Normalize(0, 100))
    overall = result.overall
    interval = f" ({100 * overall.low:.1f} to {100 * overall.high:.1f} %)" if result.random else ""
    chips = f"{result.trials} {'chip' if result.trials == 1 else 'chips'}"
    axes.set_title(f"{100 * overall.value:.1f} % of the starts are served{interval}; {chips}", fontsize=TEXT)
    return axes


def draw_faults(result: FaultAnalysis, ax: Axes | None = None, *, fault: Literal["open", "short"] = "open") -> Axes:
    """Draw, for every resistor, the number of starts without a path to a goal if only this resistor is faulty.

    Only starts that have a path on the faultless chip are counted.  A square in a cell shows the worst fault of the
    cell's switches, leak and read-out load, if this fault costs a start.  Returns the axes.  `ax`: axes to draw on, by
    default those of a new figure; `fault`: kind of the fault: "open" (no current) or "short" (a small resistance).
    """
    netlist, cells = result.netlist, result.netlist.cells
    plane = plane_of(cells.space)
    axes = axes_or_new(ax, plane.aspect)
    draw_cells(plane, axes)
    lost = result.open if fault == "open" else result.short
    norm = LogNorm(1.0, max(float(np.nanmax(lost, initial=0.0)), 2.0))
    saturates = bool(cells.nonlinear_face.size)
    face = cells.nonlinear_face if saturates else cells.resistor_face
    value = lost[len(netlist.conductance) :] if saturates else lost[: len(face)]
    grid = np.flatnonzero((face >= 0) & np.isfinite(value))
    draw_resistors(netlist, grid[value[grid] == 0], axes, face).set(color=_HARMLESS, linewidth=0.8)
    order = grid[np.argsort(value[grid], kind="stable")]
    order = order[value[order] > 0]
    lines = draw_resistors(netlist, order, axes, face)
    lines.set(array=value[order], cmap=strength_map(), norm=norm, linewidth=2.0)
    cell, worst = _switches(netlist, lost)
    if cell.size:
        x, y = cells.space.centre(np.stack(np.unravel_index(cell, cells.space.shape), axis=1)).T
        axes.scatter(
            x, y, c=worst, cmap=strength_map(), norm=norm, s=16, marker="s", edgecolor="white", linewidth=0.4,
            zorder=5, label=f"a switch{', leak' if cells.wiring.leak else ''} or load of the cell",
        )  # fmt: skip
    finish(plane, axes)
    add_colour_bar(lines, axes, "starts lost")
    _plain_ticks(lines)
    critical = int((np.nan_to_num(lost) > 0).sum())
    state = "open" if fault == "open" else f"shorted by {format_quantity(result.short_resistance, 'Ω', 3)}"
    axes.set_title(
        f"{state}: {critical} of {result.examined:,} elements cost some of {result.served} starts", fontsize=TEXT
    )
    return axes


def _switches(netlist: Netlist, lost: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the flat indices (n,) of cells with a critical switch or load, and numbers of lost starts (n,).

    The indices are in C order.  A switch or load is critical if a fault of it makes starts lose their path; the second
    array counts these starts for the worst fault in the cell.  `lost` (resistors,): starts lost by a fault of each
    resistor, NaN if not analysed.
    """
    extra = np.flatnonzero(netlist.cells.resistor_face < 0)
    cell = netlist.cell_of_node()[netlist.resistor_nodes[extra, 0]]
    own = (cell >= 0) & (np.nan_to_num(lost[extra]) > 0)
    worst = np.zeros(netlist.cells.space.cell.size)
    np.maximum.at(worst, cell[own], lost[extra[own]])
    costly = np.flatnonzero(worst > 0)
    return costly, worst[costly]


def draw_map(
    space: ConfigurationSpace,
    values: NDArray[np.float64],
    ax: Axes | None,
    label: str,
    unit: str,
    *,
    norm: Normalize | None = None,
    log: bool = False,
    rails: bool = False,
) -> Axes:
    """Draw a map of one value per cell with its colour bar; return the axes.

    `values`: shape of the space, NaN in cells without a value; `ax`: axes to draw on, None for a new figure; `label`,
    `unit`: quantity and SI unit in the colour bar; `norm`: colour scale, None for a linear one from the smallest to the
    largest value; `log`: True for a logarithmic scale from the smallest to the largest value in place of `norm`;
    `rails`: True if the values of obstacles and goals (their droop) are drawn above their colours.
    """
    plane = plane_of(space)
    axes = axes_or_new(ax, plane.aspect)
    values = np.where(np.isfinite(values), values, np.nan)
    power, prefix = (0, "") if unit in ("bit", "%") else prefix_of(float(np.nanmax(np.abs(values), initial=0.0)))
    values = values / 10.0**power
    low, high = float(np.nanmin(values, initial=np.inf)), float(np.nanmax(values, initial=-np.inf))
    if norm is None and low == high:
        norm = Normalize(0.9 * low, 1.1 * high or 1.0)
    elif log:
        norm = LogNorm(low, high)
    image = draw_image(plane, values, axes, cmap=strength_map(), norm=norm, zorder=2.1 if rails else 0.5)
    draw_cells(plane, axes)
    if rails:
        add_swatch(axes, "droop: on obstacles and goals", "white")
    finish(plane, axes)
    add_colour_bar(image, axes, f"{label} ({prefix}{unit})")
    if log:
        _plain_ticks(image)
    return axes


def _plain_ticks(mappable: ScalarMappable) -> None:
    """Label the logarithmic colour bar of an image or of lines with plain decimal numbers: 0.01, 20, 500."""
    bar = mappable.colorbar
    low, high = mappable.get_clim()
    if bar is not None and low and high:
        axis = bar.ax.yaxis
        axis.set_major_locator(LogLocator(subs=(1.0,) if high > 1e3 * low else (1.0, 2.0, 5.0), numticks=12))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())


def draw_resistors(
    netlist: Netlist, which: NDArray[np.int64], axes: Axes, faces: NDArray[np.integer[Any]] | None = None
) -> LineCollection:
    """Draw resistors as lines between cell centres, or from a cell centre to the grid's edge; return the lines.

    `which` (n,): indices of the elements to draw; `faces` (elements,): number of the cell face that each element
    crosses, negative for an element that crosses no face and is not drawn; by default the faces of the netlist's
    resistors.  Faces are numbered axis by axis, ``cells + 1`` along an axis, in C order.
    """
    space = netlist.cells.space
    across, index = crossed_faces((netlist.cells.resistor_face if faces is None else faces)[which], space.shape)
    along = np.eye(space.ndim)[across]
    ends = index[:, None] + 0.5 - 0.5 * along[:, None] + [[-0.5], [0.5]] * along[:, None]
    segments = space.to_world(space.lower + np.clip(ends, 0.0, space.shape) * space.spacing)
    segments[across < 0] = np.nan
    lines = LineCollection(list(segments), zorder=4, capstyle="butt")
    axes.add_collection(lines, autolim=False)
    return lines


def _of_free_cells(cells: CellMap, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the node values of free cells as an array in the shape of the space.

    The result is NaN in other cells and in free cells without a node.  `value` (nodes,): value of every node.
    """
    return np.where((cells.space.cell == Cell.FREE) & (cells.node >= 0), value[cells.node], np.nan)
