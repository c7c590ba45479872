"""Bar chart of the causes of yield loss: the change of the yield when each effect of a chip is switched off."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from resgrid.chip.yield_loss import YieldLoss
from resgrid.plot.figures import axes_or_new
from resgrid.plot.style import PATHS, TEXT, dress


def draw_yield_loss(result: YieldLoss, ax: Axes | None = None) -> Axes:
    """Draw the change of the yield when each effect is switched off, with its confidence interval; return the axes.

    A change is the yield without the effect minus the yield with all effects, in percentage points.  The level of the
    interval is `result.confidence`.  `ax`: axes to draw on, by default those of a new figure.
    """
    axes = axes_or_new(ax, 0.25 + 0.06 * len(result.causes))
    places = np.arange(len(result.causes))[::-1]
    gain, low, high = (
        100.0 * np.array([getattr(cause, name) for cause in result.causes], dtype=np.float64)
        for name in ("gain", "low", "high")
    )
    axes.barh(places, gain, height=0.6, color=PATHS[3])
    seen = np.array([cause.changed > 0 for cause in result.causes], dtype=np.bool_)
    ends = np.where(seen, [gain - low, high - gain], 0.0)  # an effect that changes no chip has no bar
    axes.errorbar(gain, places, xerr=ends, fmt="none", ecolor="black", elinewidth=1.0, capsize=3)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_yticks(places, [cause.name for cause in result.causes])
    axes.set_xlabel("change of the yield without the effect (percentage points)")
    axes.set_title(f"yield {result.overall}, {result.trials} chips", fontsize=TEXT)
    dress(axes)
    return axes
