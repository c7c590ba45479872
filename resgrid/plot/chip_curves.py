"""Curves of a chip: how it settles over time, and how many starts a read-out serves against its bits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator, PercentFormatter

from resgrid.chip.precision import Precision
from resgrid.chip.settling import Settling
from resgrid.errors import InputError
from resgrid.plot.chips import plot_precision
from resgrid.plot.figures import axes_or_new, new_figure, panel_height
from resgrid.plot.plane import plane_of
from resgrid.plot.style import FAILURE, LINE_STYLES, PATHS, TEXT, dress, refresh_legend

_PAGE = 7.4


def plot_settling_curve(result: Settling, ax: Axes | None = None) -> Axes:
    """Draw how far the last node is from its final voltage over time, and the slowest exponential beside it.

    Parameters
    ----------
    result : Settling
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes
    """
    axes = axes_or_new(ax, 0.7)
    band = result.span / 2.0 ** (result.bits + 1)
    times, distance = result.times, result.distance
    axes.plot(times, distance, color=PATHS[3], linewidth=1.4, label="largest distance of a node from its end")
    tau, end = float(result.time_constants[0]), result.settle_time
    slope = band * np.exp((end - times) / tau)
    near = slope < 3.0 * distance.max(initial=band)
    axes.plot(
        times[near], slope[near], color=PATHS[0], linewidth=1.0, linestyle=LINE_STYLES[1],
        label="slowest time constant alone",
    )  # fmt: skip
    axes.axhline(band, color="black", linewidth=0.8, linestyle=LINE_STYLES[3], label=f"half a {result.bits}-bit step")
    axes.plot([end], [band], marker="o", markersize=4, color=FAILURE, linestyle="", label="settled")
    axes.set(yscale="log", xlabel="time after the switch", ylabel="distance from the operating point")
    axes.set_ylim(0.1 * band, 3.0 * max(float(distance.max(initial=0.0)), band))
    axes.set_xlim(0.0, 1.15 * end if end > 0 else None)
    axes.xaxis.set_major_formatter(EngFormatter("s"))
    axes.yaxis.set_major_formatter(EngFormatter("V"))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    dress(axes)
    refresh_legend(axes, columns=2)
    return axes


def plot_served(results: Mapping[str, Precision], ax: Axes | None = None, *, bits: int = 10) -> Axes:
    """Draw the share of starts that a read-out serves against its bits.

    Parameters
    ----------
    results : mapping of str to Precision
        By name, e.g. of the boundary.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    bits : int
        A read-out to mark.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If there is nothing to draw.
    """
    if not results:
        raise InputError("there is nothing to draw: give at least one precision analysis")
    axes = axes_or_new(ax, 0.6)
    most = max(bits + 2.0, *(_largest(result) for result in results.values()))
    ticks = np.linspace(0.0, most, 400)
    for number, (name, result) in enumerate(results.items()):
        share = np.searchsorted(np.sort(result.starts), ticks, side="right") / max(len(result.starts), 1)
        axes.plot(
            ticks, share, color=PATHS[number % len(PATHS)], linestyle=LINE_STYLES[number % len(LINE_STYLES)],
            linewidth=1.4, label=f"{name}: {result.sentence(bits)}",
        )  # fmt: skip
    axes.axvline(bits, color="black", linewidth=0.8, linestyle=LINE_STYLES[3])
    axes.set(xlabel="bits of the read-out", ylabel="starts served", xlim=(0.0, most), ylim=(0.0, 1.03))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    dress(axes)
    refresh_legend(axes, columns=1)
    return axes


def plot_bits_histogram(results: Mapping[str, Precision], ax: Axes | None = None, *, bits: int = 10) -> Axes:
    """Draw how many starts need how many bits.

    Parameters
    ----------
    results : mapping of str to Precision
        By name, e.g. of the boundary.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    bits : int
        A read-out to mark.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If there is nothing to draw.
    """
    if not results:
        raise InputError("there is nothing to draw: give at least one precision analysis")
    axes = axes_or_new(ax, 0.6)
    most = int(np.ceil(max(bits + 2.0, *(_largest(result) for result in results.values()))))
    for number, (name, result) in enumerate(results.items()):
        # A start that needs 9.3 bits is served by 10.
        whole = np.ceil(result.starts[np.isfinite(result.starts)])
        axes.hist(
            whole, bins=[k - 0.5 for k in range(most + 2)], histtype="step", color=PATHS[number % len(PATHS)],
            linestyle=LINE_STYLES[number % len(LINE_STYLES)], linewidth=1.4, label=name,
        )  # fmt: skip
    axes.axvline(bits, color="black", linewidth=0.8, linestyle=LINE_STYLES[3])
    axes.set(xlabel="whole bits that a start needs", ylabel="starts", xlim=(0.0, most + 0.5))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    dress(axes)
    refresh_legend(axes)
    return axes


def plot_precision_page(results: Mapping[str, Precision], *, bits: int = 10, title: str = "") -> Figure:
    """Draw the precision problem on a page: maps side by side, a histogram, and the share of starts served.

    Parameters
    ----------
    results : mapping of str to Precision
        By name, e.g. ``{"Dirichlet": ..., "Neumann": ..., "wall": ...}``, all of spaces of two axes.
    bits : int
        A read-out to mark.
    title : str
        Above the figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If there is nothing to draw, or a space does not have two axes.
    """
    if not results:
        raise InputError("there is nothing to draw: give at least one precision analysis")
    aspect = max(plane_of(result.space).aspect for result in results.values())
    width = _PAGE / len(results)
    height = panel_height(width - 1.0, aspect) + 0.2
    figure = new_figure(_PAGE, height + 3.2)
    parts = figure.subfigures(2, 1, squeeze=False, height_ratios=[height, 3.2])
    above, below = parts[:, 0]
    maps = above.subplots(1, len(results), squeeze=False)[0]
    most = max(_largest(result) for result in results.values())
    for axes, (name, result) in zip(maps, results.items(), strict=True):
        plot_precision(result, axes, most=most)
        axes.set_title(name, fontsize=TEXT + 1)
        refresh_legend(axes, columns=2)
    left, right = below.subplots(1, 2)
    plot_bits_histogram(results, left, bits=bits)
    plot_served(results, right, bits=bits)
    if title:
        figure.suptitle(title, fontsize=TEXT + 2)
    return figure


def _largest(result: Precision) -> float:
    finite = result.starts[np.isfinite(result.starts)]
    return float(finite.max(initial=1.0))
