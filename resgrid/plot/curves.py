"""Curves: how far paths keep away from obstacles, against the knob that sets it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, NullLocator

from resgrid.planning.planner import ClearanceCurve
from resgrid.plot.figures import axes_or_new
from resgrid.plot.style import PATHS, TEXT, dress


def plot_clearance_curve(curve: ClearanceCurve, ax: Axes | None = None, *, unit: str = "", cell: float = 0.0) -> Axes:
    """Draw the mean clearance of paths against k or the wall resistance, with the spread between starts.

    Parameters
    ----------
    curve : ClearanceCurve
    ax : matplotlib.axes.Axes, optional
        Made when None.
    unit : str
        Unit of lengths, for the label.
    cell : float
        Width of a cell; if given, a bar of half of it shows how small a difference means nothing.

    Returns
    -------
    matplotlib.axes.Axes
    """
    axes = axes_or_new(ax, 0.7)
    part = curve.clearance[:, curve.counted]
    low, high = np.percentile(part, [25, 75], axis=1)
    axes.fill_between(curve.value, low, high, color=PATHS[3], alpha=0.18, linewidth=0, label="half of the starts")
    axes.plot(
        curve.value, curve.mean, color=PATHS[3], marker="o", markersize=3.5, linewidth=1.4,
        label=f"mean of {int(curve.counted.sum())} starts",
    )  # fmt: skip
    if cell:
        axes.errorbar(
            0.93 if curve.knob == "k" else 0.07, low.min() + cell / 4, yerr=cell / 4, color="black", linewidth=0.9,
            capsize=2.5, label="half a cell", transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    suffix = f" ({unit})" if unit else ""
    axes.set_xlabel("$k$ (0 Neumann, 1 Dirichlet)" if curve.knob == "k" else "wall resistance (Ω)", fontsize=TEXT)
    axes.set_ylabel(f"clearance of the path{suffix}", fontsize=TEXT)
    if curve.knob != "k" and (curve.value[np.isfinite(curve.value)] > 0).sum() > 1:
        axes.set_xscale("symlog", linthresh=float(curve.value[curve.value > 0].min()))
        axes.xaxis.set_major_locator(FixedLocator(curve.value[np.isfinite(curve.value)].tolist()))
        axes.xaxis.set_minor_locator(NullLocator())
    dress(axes)
    axes.legend(fontsize=TEXT - 1, frameon=False)
    return axes
