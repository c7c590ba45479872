"""Fields along a line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from resgrid.errors import InputError
from resgrid.planning.fields import Field
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.plot.figures import new_figure
from resgrid.plot.paths import require_paths
from resgrid.plot.plane import PICTURES
from resgrid.plot.shading import shading_of
from resgrid.plot.style import FAILURE, GOAL, OBSTACLE, PATHS, TEXT, UNREACHABLE, axis_label, dress, refresh_legend
from resgrid.space import Cell


def plot_profile(
    field: Field, ax: Axes | None = None, *, scale: str = "auto", paths: Sequence[Streamline] = ()
) -> Axes:
    """Draw the potential of a space with one axis over its coordinate.

    Parameters
    ----------
    field : Field
        Of one axis.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    scale : {"auto", "linear", "log"}
        As in `plot_potential`.
    paths : sequence of Streamline
        Their starts are marked on the curve: a circle where the goal is reached, a cross where not.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have one axis, or the scale does not fit the field.
    """
    space = field.space
    if space.ndim != 1:
        raise InputError(f"a profile needs a space of one axis, this one has {space.ndim} ({PICTURES})")
    require_paths(paths, space)
    shading = shading_of(field, scale)
    axes = new_figure(4.8, 3.2).add_subplot() if ax is None else ax
    axis = space.axes[0]
    kinds = (
        ("obstacle", OBSTACLE, space.cell == Cell.OBSTACLE),
        ("goal", GOAL, space.cell == Cell.GOAL),
        ("no way to a goal", UNREACHABLE, (space.cell == Cell.FREE) & ~space.goal_connected),
    )
    for label, colour, where in kinds:
        for index in np.flatnonzero(where).tolist():
            axes.axvspan(axis.edges[index], axis.edges[index + 1], color=colour, linewidth=0, label=label, zorder=0.5)
    shown = np.where(space.cell == Cell.OBSTACLE, np.nan, shading.values)
    axes.plot(axis.centres, shown, marker="o", markersize=3, linewidth=1.2, color=PATHS[3], label="cells")
    for path in paths:
        reached = path.outcome == Outcome.REACHED
        axes.plot(
            path.axis_points[0, 0], shown[int(path.cells[0, 0])], linestyle="", marker="o" if reached else "x",
            color="white" if reached else FAILURE, markeredgecolor="black" if reached else FAILURE, zorder=4,
            label="start" if reached else path.outcome.value.replace("_", " "),
        )  # fmt: skip
    axes.set(xlim=(axis.lower, axis.upper), xlabel=axis_label(axis))
    dress(axes)
    axes.set_ylabel(shading.label, fontsize=TEXT)
    refresh_legend(axes)
    return axes
