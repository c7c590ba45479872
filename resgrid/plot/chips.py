"""Maps of what a chip does, cell by cell: settling, noise, heat, droop, bits, and the resistors that decide a step."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from resgrid.chip.noise import Noise
from resgrid.chip.power import Power
from resgrid.chip.precision import Precision
from resgrid.chip.sensitivity import Sensitivity
from resgrid.chip.settling import Settling
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.plot.fields import add_colour_bar
from resgrid.plot.figures import axes_or_new
from resgrid.plot.plane import draw_cells, draw_image, finish, plane_of
from resgrid.plot.style import FAILURE, TEXT, add_swatch, refresh_legend, strength_map
from resgrid.plot.symbols import engineering
from resgrid.space import Cell, ConfigurationSpace

_HOPELESS = "#e8d3e4"
_WORTH_SHOWING = 100.0
"""Drift in per cent above which a resistor is left out of the picture."""

_HEAT_DECADES = 5.0
_NOISE = {
    "total": ("rms noise within the band", "V"),
    "limit": ("rms noise, all frequencies", "V"),
    "resistance": ("resistance to the rails", "Ω"),
}
_POWER = {"heat": ("heat per cell", "W"), "droop": ("droop of rail cells", "V")}


def plot_settling(result: Settling, ax: Axes | None = None) -> Axes:
    """Draw when every cell has settled.

    Parameters
    ----------
    result : Settling
        Of a netlist compiled from a space of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes, or there is none.
    """
    space = space_of(result.netlist)
    values = _free_cells(result.netlist, result.node_time)
    axes = draw_map(space, values, ax, f"time to settle to {result.bits} bits", "s")
    axes.set_title(
        f"settles in {engineering(result.settle_time, 's')}; "
        f"slowest time constant {engineering(float(result.time_constants[0]), 's')}",
        fontsize=TEXT,
    )
    return axes


def plot_noise(result: Noise, ax: Axes | None = None, *, quantity: str | None = None) -> Axes:
    """Draw the thermal noise of every cell.

    Parameters
    ----------
    result : Noise
        Of a netlist compiled from a space of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    quantity : {"total", "limit", "resistance"}, optional
        Noise within the band, noise over all frequencies, or effective resistance; by default the first that is there.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the quantity is unknown or was not computed, the space does not have two axes, or there is none.
    """
    shown = quantity or ("resistance" if result.total is None else "total")
    if shown not in _NOISE:
        raise InputError(f"quantity = {shown!r} is unknown; it may be one of {', '.join(_NOISE)}")
    values = getattr(result, shown)
    if values is None:
        raise InputError("the noise within a band was not computed: give analyse_noise a band")
    label, unit = _NOISE[shown]
    axes = draw_map(space_of(result.netlist), _free_cells(result.netlist, values), ax, label, unit)
    if shown == "total" and result.band is not None:
        low, high = (engineering(limit, "Hz") for limit in result.band)
        axes.set_title(f"thermal noise from {low} to {high} at {result.temperature:.4g} K", fontsize=TEXT)
    return axes


def plot_power(result: Power, ax: Axes | None = None, *, quantity: str = "heat") -> Axes:
    """Draw where heat arises, with the hottest resistors, or how far rail cells droop.

    Parameters
    ----------
    result : Power
        Of a netlist compiled from a space of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    quantity : {"heat", "droop"}

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the quantity is unknown, the space does not have two axes, or there is none.
    """
    if quantity not in _POWER:
        raise InputError(f"quantity = {quantity!r} is unknown; it may be one of {', '.join(_POWER)}")
    netlist = result.op.netlist
    space = space_of(netlist)
    label, unit = _POWER[quantity]
    if quantity == "droop":
        cell_map = netlist.cells
        droop = np.where(cell_map.node >= 0, result.droop[cell_map.node], np.nan)
        axes = draw_map(space, np.abs(droop), ax, label, unit, rails=True)
        axes.set_title(f"largest droop {engineering(result.largest_droop, 'V')}", fontsize=TEXT)
        return axes
    heat = np.where(space.cell == Cell.FREE, result.cell_heat, np.nan)
    hottest = float(np.nanmax(heat)) if np.nanmax(heat, initial=0.0) > 0 else 0.0
    heat = np.maximum(heat, hottest * 10.0**-_HEAT_DECADES)
    axes = draw_map(space, heat, ax, label, unit, log=hottest > 0)
    worst = result.worst()
    worst = worst[result.resistor[worst] > 0]
    lines = draw_resistors(netlist, worst, axes)
    lines.set(color=FAILURE, linewidth=2.0, label=f"the {len(worst)} hottest resistors")
    axes.set_title(f"{engineering(result.total, 'W')} in all", fontsize=TEXT)
    refresh_legend(axes)
    return axes


def plot_sensitivity(result: Sensitivity, ax: Axes | None = None, *, drift: float = 0.01) -> Axes:
    """Draw the resistors by the drift of each that changes one of the robot's steps.

    Parameters
    ----------
    result : Sensitivity
        In a space of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    drift : float
        Resistors that need no more than this are drawn in red.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes.
    """
    netlist = result.op.netlist
    space = space_of(netlist)
    plane = plane_of(space)
    axes = axes_or_new(ax, plane.aspect)
    draw_cells(plane, axes)
    per_cent = 100.0 * result.flip_drift[: len(netlist.conductance)]
    shown = np.flatnonzero(per_cent <= _WORTH_SHOWING)
    if shown.size:
        order = shown[np.argsort(-per_cent[shown], kind="stable")]
        lines = draw_resistors(netlist, order, axes)
        lowest = max(float(per_cent[order].min()), 0.01)
        lines.set(
            array=np.maximum(per_cent[order], lowest), cmap=strength_map().reversed(), linewidth=1.6,
            norm=LogNorm(lowest, max(float(per_cent[order].max()), 2 * lowest)),
        )  # fmt: skip
        add_colour_bar(lines, axes, "drift of one resistor that changes a step (%)")
        plain_ticks(lines)
    flips = result.flips(drift)
    marked = draw_resistors(netlist, flips[flips < len(netlist.conductance)], axes)
    marked.set(color=FAILURE, linewidth=2.4, label=f"{len(flips)} resistors: {100 * drift:g} % suffices")
    centres = plane.place(space.axis_centre(result.cells))
    axes.scatter(
        centres[:, 0], centres[:, 1], s=9, color="white", edgecolor="black", linewidth=0.7, zorder=5, label="decisions"
    )
    finish(plane, axes)
    refresh_legend(axes, columns=2)
    return axes


def plot_precision(
    result: Precision, ax: Axes | None = None, *, starts: bool = True, most: float | None = None
) -> Axes:
    """Draw how many converter bits every start needs.

    Parameters
    ----------
    result : Precision
        Of a space of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    starts : bool
        The most along the way from each cell; otherwise what the cell itself needs.
    most : float, optional
        Upper end of the colour scale, in bits; by default the largest value.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes.
    """
    values = result.start_bits if starts else result.cell_bits
    shown = np.where(np.isfinite(values), values, np.nan)
    label = "bits that a start needs" if starts else "bits that a cell needs"
    norm = Normalize(0.0, most) if most is not None else None
    axes = draw_map(result.space, shown, ax, label, "bit", norm=norm)
    hopeless = np.isinf(values) & result.space.goal_connected
    if hopeless.any():
        from resgrid.plot.paint import paint_cells

        paint_cells(result.space, hopeless, _HOPELESS, "no number of bits will do", axes)
        refresh_legend(axes)
    axes.set_title(result.sentence(), fontsize=TEXT)
    return axes


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
    """Draw a value per cell with its colour bar; over obstacles and goals, or (``rails``) on them."""
    plane = plane_of(space)
    axes = axes_or_new(ax, plane.aspect)
    factor, prefixed = _prefixed(values, unit)
    finite = values[np.isfinite(values)] * factor
    if norm is None and finite.size and finite.max() == finite.min():
        norm = Normalize(0.9 * float(finite.min()), 1.1 * float(finite.max()) or 1.0)
    elif log:
        norm = LogNorm(float(finite.min()), float(finite.max()))
    image = draw_image(
        plane, np.where(np.isfinite(values), values * factor, np.nan), axes, cmap=strength_map(), norm=norm,
        zorder=2.1 if rails else 0.5,
    )  # fmt: skip
    draw_cells(plane, axes)
    if rails:
        add_swatch(axes, "droop: on obstacles and goals", "white")
    finish(plane, axes)
    add_colour_bar(image, axes, f"{label} ({prefixed})" if prefixed else label)
    if log:
        plain_ticks(image)
    refresh_legend(axes)
    return axes


def plain_ticks(mappable: ScalarMappable) -> None:
    """Write 0.01, 20, 500 on a logarithmic colour bar."""
    bar = mappable.colorbar
    low, high = mappable.get_clim()
    if bar is not None and low and high:
        steps = (1.0,) if high > 1e3 * low else (1.0, 2.0, 5.0)
        bar.ax.yaxis.set_major_locator(LogLocator(subs=steps, numticks=12))
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_locator(NullLocator())


def _prefixed(values: NDArray[np.float64], unit: str) -> tuple[float, str]:
    """Factor to an engineering prefix that suits the values, and the unit with it."""
    finite = np.abs(values[np.isfinite(values)])
    largest = float(finite.max(initial=0.0))
    if unit in {"bit", "%"} or largest == 0.0:
        return 1.0, unit
    power = int(np.clip(3 * np.floor(np.log10(largest) / 3.0), -24, 24))
    return 10.0**-power, EngFormatter.ENG_PREFIXES[power] + unit


def draw_resistors(
    netlist: Netlist, which: NDArray[np.int64], axes: Axes, faces: NDArray[np.integer[Any]] | None = None
) -> LineCollection:
    """Draw resistors as segments between the centres of their cells, to the border where they lead to the edge.

    ``faces`` are those that the numbers stand for, by default the resistors'.
    """
    cell_map = netlist.cells
    crossed = cell_map.resistor_face if faces is None else faces
    space = cell_map.space
    lower = np.array([axis.lower for axis in space.axes])
    upper = np.array([axis.upper for axis in space.axes])
    segments = []
    first = 0
    for axis in range(space.ndim):
        grid = tuple(n + (a == axis) for a, n in enumerate(space.shape))
        count = int(np.prod(grid))
        for number in which.tolist():
            face = int(crossed[number])
            if first <= face < first + count:
                index = np.array(np.unravel_index(face - first, grid), dtype=np.float64)
                middle = lower + (index + np.where(np.arange(space.ndim) == axis, 0.0, 0.5)) * space.spacing
                half = np.where(np.arange(space.ndim) == axis, 0.5 * space.spacing, 0.0)
                segments.append((number, space.to_world(np.clip([middle - half, middle + half], lower, upper))))
        first += count
    place = dict(segments)
    ordered = [place.get(number, np.full((2, 2), np.nan)) for number in which.tolist()]
    lines = LineCollection(ordered, zorder=4, capstyle="butt")
    axes.add_collection(lines, autolim=False)
    return lines


def _free_cells(netlist: Netlist, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values of nodes on the free cells, NaN elsewhere; shape of the space."""
    cell_map = netlist.cells
    own = (cell_map.space.cell == Cell.FREE) & (cell_map.node >= 0)
    return np.where(own, value[cell_map.node], np.nan)


def space_of(netlist: Netlist) -> ConfigurationSpace:
    """The space that a netlist was compiled from, for a map."""
    if netlist.cell_map is None:
        raise InputError("this netlist was not compiled from a space, so there is no map to draw on")
    return netlist.cells.space
