"""Curves and tables of chip analyses: settling, converter bits of starts, yield over two parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator, PercentFormatter

from resgrid.chip.adc_resolution import ADCResolution
from resgrid.chip.build import value_text
from resgrid.chip.settling import Settling
from resgrid.chip.sweeps import Sweep
from resgrid.errors import InputError
from resgrid.plot.chip_maps import draw_adc_resolution, draw_settling
from resgrid.plot.figures import PAGE, add_title, axes_or_new, new_figure, panel_height
from resgrid.plot.plane import plane_of
from resgrid.plot.style import (
    FAILURE,
    LINE_STYLES,
    PATHS,
    SMALL,
    TEXT,
    add_colour_bar,
    dress,
    refresh_legend,
    strength_map,
)
from resgrid.scene.chip import Chip
from resgrid.scene.table_models import described_keys

_MOST_LABELS = 80
"""Largest number of pairs of values in a sweep for which the yield of every pair is also written as a number."""
_CONTOUR = "#E69F00"
_FRACTIONS = {"mismatch", "defects.open_density", "defects.short_density"}
"""Keys of a chip with dimensionless fractions, which are labelled in per cent."""


def draw_settled(result: Settling, ax: Axes | None = None, *, quantity: Literal["map", "curve"] = "map") -> Axes:
    """Draw the settling of a chip, as a map of times per cell or as a curve over time; return the axes.

    `ax`: axes to draw on, by default those of a new figure; `quantity`: "map" for the settling time of every cell in
    seconds, "curve" for the largest distance of any node voltage from its final value, in volts, over time.
    """
    return draw_settling(result, ax) if quantity == "map" else draw_settling_curve(result, ax)


def draw_settling_curve(result: Settling, ax: Axes | None = None) -> Axes:
    """Draw the largest distance of any node voltage from its final value, in volts, over time; return the axes.

    A second curve decays exponentially with the slowest time constant.  A horizontal line marks half a step of the
    read-out's converter; the chip counts as settled from where the curve stays below.  `ax`: axes to draw on, by
    default those of a new figure.
    """
    axes = axes_or_new(ax, 0.7)
    band = result.span / 2.0 ** (result.bits + 1)
    times, distance = result.times, result.distance
    axes.plot(times, distance, color=PATHS[3], linewidth=1.4, label="largest distance of a node from its final voltage")
    tau, end = float(result.time_constants[0]), result.settle_time
    slope = band * np.exp((end - times) / tau)
    near = slope < 3.0 * distance.max(initial=band)
    axes.plot(
        times[near], slope[near], color=PATHS[0], linewidth=1.0, linestyle=LINE_STYLES[1],
        label="exponential of the slowest time constant",
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


def draw_adc_resolutions(
    results: Mapping[str, ADCResolution], ax: Axes | None = None, *,
    quantity: Literal["page", "served", "histogram"] = "page", bits: int = 10, title: str = "",
) -> Axes | Figure:  # fmt: skip
    """Draw the converter bits that the starts of several chips require; return the axes, or the figure of a page.

    A start requires the bits that resolve the voltage step to the lowest neighbour in every cell of its path to a goal.
    `results`: resolutions by the name that the legend shows, such as the name of a boundary condition; `ax`: axes to
    draw on, by default those of a new figure, must be None for a page; `quantity`: "page" (maps, histogram and curve),
    "served" (fraction of starts that require at most the bits on the horizontal axis) or "histogram" of required bits;
    `bits`: resolution that is marked, in bits; `title`: title of the page, ignored without a page.
    """
    if quantity == "served":
        return _draw_served(results, ax, bits)
    if quantity == "histogram":
        return _draw_histogram(results, ax, bits)
    if ax is not None:
        raise InputError("a page of ADC resolutions has several panels and cannot use one ax; omit ax")
    return _adc_resolution_page(results, bits, title)


def _draw_served(results: Mapping[str, ADCResolution], ax: Axes | None, bits: int) -> Axes:
    """Draw the fraction of starts that require at most a number of bits, against this number; return the axes.

    `results`: resolutions by the name that the legend shows; `ax`: axes to draw on, None for a new figure; `bits`:
    resolution that is marked.
    """
    axes = axes_or_new(ax, 0.6)
    most = _most_bits(results, bits)
    ticks = np.linspace(0.0, most, 400)
    for number, (name, result) in enumerate(results.items()):
        fraction = np.searchsorted(np.sort(result.starts), ticks, side="right") / max(len(result.starts), 1)
        axes.plot(ticks, fraction, **_line(number), label=f"{name}: {result.sentence(bits)}")
    axes.axvline(bits, color="black", linewidth=0.8, linestyle=LINE_STYLES[3])
    axes.set(xlabel="bits of the read-out", ylabel="starts served", xlim=(0.0, most), ylim=(0.0, 1.03))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    dress(axes)
    refresh_legend(axes, columns=1)
    return axes


def _draw_histogram(results: Mapping[str, ADCResolution], ax: Axes | None, bits: int) -> Axes:
    """Draw the histogram of the whole numbers of bits that starts require; return the axes.

    A start that requires 9.3 bits counts at 10; starts for which no number of bits suffices are left out.  `results`:
    resolutions by the name that the legend shows; `ax`: axes to draw on, None for a new figure; `bits`: resolution that
    is marked.
    """
    axes = axes_or_new(ax, 0.6)
    most = int(np.ceil(_most_bits(results, bits)))
    for number, (name, result) in enumerate(results.items()):
        whole = np.ceil(result.starts[np.isfinite(result.starts)])
        axes.hist(whole, bins=[k - 0.5 for k in range(most + 2)], histtype="step", **_line(number), label=name)
    axes.axvline(bits, color="black", linewidth=0.8, linestyle=LINE_STYLES[3])
    axes.set(xlabel="whole bits that a start needs", ylabel="starts", xlim=(0.0, most + 0.5))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    dress(axes)
    refresh_legend(axes)
    return axes


def _adc_resolution_page(results: Mapping[str, ADCResolution], bits: int, title: str) -> Figure:
    """Return a figure with a map per result, a histogram of required bits, and their cumulative fraction of starts.

    `results`: resolutions by the name that titles and legend show; `bits`: resolution that is marked; `title`: title of
    the page.
    """
    aspect = max(plane_of(result.space).aspect for result in results.values())
    height = panel_height(PAGE / len(results) - 1.0, aspect) + 0.2
    figure = new_figure(PAGE, height + 3.2)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[height, 3.2])[:, 0]
    most = max(_largest(result) for result in results.values())
    maps = above.subplots(1, len(results), squeeze=False)[0]
    for axes, (name, result) in zip(maps, results.items(), strict=True):
        draw_adc_resolution(result, axes, most=most)
        axes.set_title(name, fontsize=TEXT + 1)
        refresh_legend(axes, columns=2)
    left, right = below.subplots(1, 2)
    _draw_histogram(results, left, bits)
    _draw_served(results, right, bits)
    add_title(figure, title)
    return figure


def _line(number: int) -> dict[str, Any]:
    """Return matplotlib's options ``color``, ``linestyle`` and ``linewidth`` of curve `number`, counted from 0."""
    colour, style = PATHS[number % len(PATHS)], LINE_STYLES[number % len(LINE_STYLES)]
    return {"color": colour, "linestyle": style, "linewidth": 1.4}


def _most_bits(results: Mapping[str, ADCResolution], bits: int) -> float:
    """Return the upper limit, in bits, of an axis that shows the required resolution.

    The axis contains all finite resolutions of `results` (resolutions by name) and the resolution `bits` plus 2.
    """
    return max(bits + 2.0, *(_largest(result) for result in results.values()))


def _largest(result: ADCResolution) -> float:
    """Return the largest finite number of bits that a start requires; 1 if this number is smaller than 1."""
    finite = result.starts[np.isfinite(result.starts)]
    return float(finite.max(initial=1.0))


def draw_sweep(result: Sweep, ax: Axes | None = None, *, share: float = 0.99) -> Axes:
    """Draw the yield over two parameters of a chip, with contours; return the axes.

    The yield is the fraction of all starts on all chips from which a robot reaches a goal, in percent.  `ax`: axes to
    draw on, by default those of a new figure; `share`: required yield, 0 to 1.  For each value of the first parameter,
    a mark shows the first value of the second parameter from which on all values have at least this yield.
    """
    axes = axes_or_new(ax, 0.8)
    values = 100.0 * result.share.T
    image = axes.imshow(
        values, origin="lower", aspect="auto", cmap=strength_map(), norm=Normalize(0, 100), interpolation="nearest"
    )
    levels = [level for level in (50.0, 90.0, 99.0) if values.min() < level < values.max()]
    if min(values.shape) > 1 and levels:
        lines = axes.contour(values, levels=levels, colors=_CONTOUR, linewidths=1.4)
        axes.clabel(lines, fmt=lambda level: f"{level:g} %", fontsize=SMALL)
    if values.size <= _MOST_LABELS:
        for (row, column), value in np.ndenumerate(values):
            colour = "white" if value > 62 else "black"
            text = f"{np.floor(10 * value + 1e-6) / 10:.4g}"
            axes.text(column, row - 0.28, text, ha="center", va="center", fontsize=SMALL, color=colour)
    _mark_cheapest(result, share, axes)
    for axis, key, ticks in (
        (axes.xaxis, result.first, result.first_values),
        (axes.yaxis, result.second, result.second_values),
    ):
        unit = described_keys(Chip)[key][0]
        texts = [value_text(100 * tick, "%") if key in _FRACTIONS else value_text(tick, unit) for tick in ticks]
        axis.set_ticks(range(len(ticks)), texts)
        axis.set_label_text(key.replace("_", " ").replace(".", ", "))
    add_colour_bar(image, axes, "starts served (%)")
    axes.set_title(f"{result.trials} chips at every point", fontsize=TEXT)
    dress(axes)
    refresh_legend(axes)
    return axes


def _mark_cheapest(result: Sweep, share: float, axes: Axes) -> None:
    """Mark the first value of the second parameter from which on all values have at least the yield `share` (0 to 1).

    There is one mark for each value of the first parameter; none if no value of the second parameter suffices.
    """
    marks = [(column, value) for column, value in enumerate(result.cheapest(share)) if value is not None]
    if marks:
        rows = [result.second_values.index(value) for _, value in marks]
        axes.plot(
            [column for column, _ in marks], rows, linestyle="", marker="o", markersize=6, color="white",
            markeredgecolor=FAILURE, markeredgewidth=1.6,
            label=f"least {result.second.rpartition('.')[2]} for {100 * share:g} %",
        )  # fmt: skip
