"""Picture of a run: times of all contenders relative to resgrid, one panel per problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.rows import RATIO, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 2
OURS, THEIRS, SHORT = "#0b5394", "#444444", "#c0504d"


def panels(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows that compare contenders, by problem."""
    grouped: dict[str, list[Row]] = {}
    for row in rows:
        if row.unit == RATIO and ": " not in row.name:
            grouped.setdefault(row.name, []).append(row)
    return {name: group for name, group in grouped.items() if any(row.value for row in group)}


def draw(rows: Sequence[Row]) -> Figure | None:
    """Draw all panels; return None if there is nothing to compare.

    Dots are medians, and bars are ranges from the fastest to the slowest round.  All panels share a logarithmic axis.
    Contenders are in the order of their times.
    """
    from matplotlib.figure import Figure

    grouped = panels(rows)
    if not grouped:
        return None
    lines = -(-len(grouped) // COLUMNS)
    tallest = max(len(group) for group in grouped.values())
    figure = Figure(figsize=(12, 0.8 + lines * (0.9 + 0.27 * tallest)), layout="constrained")
    axes = figure.subplots(lines, COLUMNS, sharex=True, squeeze=False).ravel()
    for ax, (name, group) in zip(axes, grouped.items(), strict=False):
        panel(ax, name, group)
    for ax in axes[len(grouped) :]:
        ax.set_axis_off()
    for ax in axes[max(len(grouped) - COLUMNS, 0) : len(grouped)]:
        ax.tick_params(labelbottom=True)
        ax.set_xlabel("time / resgrid's time (less than 1 is faster than resgrid)")
    figure.suptitle("Setup and solution to a residual of 1e-8, one thread, alternating runs: median and range")
    return figure


def panel(ax: Axes, name: str, group: Sequence[Row]) -> Axes:
    """Draw one problem with a line for every contender."""
    from matplotlib.ticker import LogLocator, NullFormatter

    for place, row in enumerate(group):
        _line(ax, place, row)
    ax.axvline(1.0, color=OURS, linewidth=1.0, alpha=0.5, zorder=0)
    ax.set_xscale("log")
    ax.margins(x=0.12)
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_yticks(range(len(group)), [row.contender for row in group])
    ax.set_ylim(len(group) - 0.4, -0.6)
    for label, row in zip(ax.get_yticklabels(), group, strict=True):
        label.set_color(OURS if row.contender == "resgrid" else THEIRS)
        label.set_fontweight("bold" if row.contender == "resgrid" else "normal")
    ax.grid(axis="x", which="both", color="#e4e4e4", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
    ax.set_title(name, loc="left", fontsize=11)
    return ax


def _line(ax: Axes, place: int, row: Row) -> None:
    if row.value is None or row.seconds is None:
        from matplotlib.transforms import blended_transform_factory

        where = blended_transform_factory(ax.transAxes, ax.transData)
        remark = row.note if len(row.note) <= 60 else f"{row.note[:59]}..."
        ax.text(0.01, place, remark, transform=where, va="center", fontsize=8, color=SHORT, style="italic")
        return
    missed = "residual" in row.note
    colour = OURS if row.contender == "resgrid" else SHORT if missed else THEIRS
    ax.plot([row.value.low, row.value.high], [place, place], color=colour, linewidth=3, alpha=0.35, zorder=2)
    ax.plot(row.value.median, place, "o", color=colour, markersize=6, zorder=3)
    seconds = f"{row.seconds:.2g} s" if row.seconds >= 0.0995 else f"{1e3 * row.seconds:.2g} ms"
    ratio = f"{row.value.median:.2g}" if row.value.median < 100 else f"{row.value.median:.0f}"
    text = f"{ratio}  ({seconds}{', residual missed' if missed else ''})"
    ax.annotate(
        text, (row.value.high, place), xytext=(7, 0), textcoords="offset points", va="center", fontsize=8, color=colour
    )


def write_picture(path: Path, sections: Mapping[str, Sequence[Row]]) -> bool:
    """Write the picture of several sections; return whether there was anything to draw."""
    figure = draw([row for rows in sections.values() for row in rows])
    if figure is not None:
        figure.savefig(path, dpi=110)
    return figure is not None
