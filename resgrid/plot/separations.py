"""What separates a start from the goals, drawn in configuration space."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.planning.separation import Separation
from resgrid.planning.streamline import Outcome
from resgrid.plot.fields import plot_space
from resgrid.plot.paint import VIRTUAL, paint_cells
from resgrid.plot.style import FAILURE, TEXT, refresh_legend
from resgrid.space import Cell

_REGION = "#9ecae1"


def plot_separation(verdict: Separation, ax: Axes | None = None, *, virtual: NDArray[np.bool_] | None = None) -> Axes:
    """Draw the cells that a start can reach, and the obstacles that must go for a goal to be reached.

    Parameters
    ----------
    verdict : Separation
        In a space of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    virtual : ndarray of bool, shape of the space, optional
        Obstacle cells that stand for no body; drawn paler where they do not separate.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes.
    """
    space = verdict.space
    if space.ndim != 2:
        raise InputError(f"this picture needs a space of two axes, this one has {space.ndim}")
    axes = plot_space(space, ax)
    if virtual is not None and virtual.any():
        paint_cells(space, virtual, VIRTUAL, "virtual obstacle", axes)
    if verdict.region.any():
        paint_cells(space, verdict.region & (space.cell == Cell.FREE), _REGION, "can be reached from the start", axes)
    if verdict.mask.any():
        paint_cells(space, verdict.mask, FAILURE, "must go for a goal to be reached", axes)
    x, y = space.centre(verdict.start)
    reached = verdict.outcome is Outcome.REACHED
    axes.scatter(
        x, y, s=34, marker="o" if reached else "X", facecolor="white", edgecolor="black", linewidth=0.9, zorder=6,
        label=f"start: {verdict.outcome.value.replace('_', ' ')}",
    )  # fmt: skip
    axes.set_title("Configuration space", fontsize=TEXT)
    refresh_legend(axes, columns=2)
    return axes
