"""Pictures of timed paths: speed and position over time."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.core.axis import Axis
from resgrid.errors import InputError
from resgrid.planning.time_parameterization import Trajectory
from resgrid.plot.figures import PAGE, axes_or_new, new_figure
from resgrid.plot.style import LINE_STYLES, PATHS, TEXT, axis_label, dress, refresh_legend

_SAMPLES = 800
"""Number of evenly spaced times at which a trajectory is evaluated, in addition to its knots."""


def draw_trajectory(
    trajectory: Trajectory,
    ax: Axes | None = None,
    *,
    quantity: Literal["page", "speed", "position"] | None = None,
) -> Axes | Figure:
    """Draw the speed of a timed path over time, the positions over time, or both; return the axes, or a figure.

    Axes of the space with the same unit share a panel; a figure is returned if there are several panels.  `ax`: axes to
    draw on, None for a new figure; `quantity`: "speed", "position", "page" for both, or None for "page" without `ax`
    and "speed" with `ax`.
    """
    shown = quantity or ("page" if ax is None else "speed")
    groups = _axes_by_unit(trajectory.space.axes)
    if shown == "page":
        if ax is not None:
            raise InputError('quantity = "page" has several panels and cannot use one ax; omit ax')
        return _page(trajectory, groups)
    if len(groups) > 1:
        if ax is not None:
            units = ", ".join(unit or "no unit" for unit in groups)
            raise InputError(f"the axes have different units ({units}), which cannot share one ax; omit ax")
        return _page(trajectory, groups, shown)
    axes = axes_or_new(ax, 0.6)
    numbers = next(iter(groups.values()))
    (_draw_speed if shown == "speed" else _draw_positions)(trajectory, numbers, axes)
    axes.set_xlabel("time (s)", fontsize=TEXT)
    refresh_legend(axes)
    return axes


def _page(trajectory: Trajectory, groups: dict[str, list[int]], shown: str = "page") -> Figure:
    """Return a figure with the panels of a trajectory: a row for speed, a row for position, a column for each unit.

    `trajectory`: timed path; `groups`: indices of the axes with each unit, by unit; `shown`: "page" for both rows, or
    only "speed" or "position".
    """
    rows = [draw for name, draw in (("speed", _draw_speed), ("position", _draw_positions)) if shown in ("page", name)]
    figure = new_figure(PAGE if len(groups) > 1 else PAGE * 0.7, 0.6 + 2.2 * len(rows))
    panels = figure.subplots(len(rows), len(groups), squeeze=False, sharex=True)
    for row, draw in zip(panels, rows, strict=True):
        for axes, numbers in zip(row, groups.values(), strict=True):
            draw(trajectory, numbers, axes)
    for axes in panels[-1]:
        axes.set_xlabel("time (s)", fontsize=TEXT)
        refresh_legend(axes)
    return figure


def _axes_by_unit(axes: tuple[Axis, ...]) -> dict[str, list[int]]:
    """Return the indices of the axes with each unit, by unit (such as ``m``), in the order of first occurrence."""
    groups: dict[str, list[int]] = {}
    for number, axis in enumerate(axes):
        groups.setdefault(axis.unit, []).append(number)
    return groups


def _times(trajectory: Trajectory) -> NDArray[np.float64]:
    """Return ascending times (n,), in seconds, at which the curves of a trajectory are drawn.

    Each knot (time at which a piece of the trajectory begins) after the first occurs twice: just before it and at it.
    """
    knots = trajectory.times
    before = np.nextafter(knots[1:], 0.0)
    return np.unique(np.concatenate([np.linspace(0.0, trajectory.duration, _SAMPLES), knots, before]))


def _draw_speed(trajectory: Trajectory, numbers: list[int], axes: Axes) -> None:
    """Draw the Euclidean speed over some axes against time; for a single axis, draw its signed velocity.

    `numbers`: indices of axes with the same unit.
    """
    times = _times(trajectory)
    velocity = trajectory.at(times)[1][:, numbers]
    unit = trajectory.space.axes[numbers[0]].unit
    rate = f" ({unit}/s)" if unit else " (1/s)"
    if len(numbers) == 1:
        axis = trajectory.space.axes[numbers[0]]
        values, label = velocity[:, 0], f"velocity of {axis_label(axis).partition(' (')[0]}{rate}"
    else:
        values, label = np.linalg.norm(velocity, axis=1), f"speed{rate}"
    axes.plot(times, values, color=PATHS[3], linewidth=1.4)
    axes.set_ylabel(label, fontsize=TEXT)
    axes.margins(x=0.0)
    if values.min() >= 0.0:
        axes.set_ylim(bottom=0.0)
    dress(axes)


def _draw_positions(trajectory: Trajectory, numbers: list[int], axes: Axes) -> None:
    """Draw the world coordinates along some axes against time; `numbers`: indices of axes with the same unit."""
    times = _times(trajectory)
    position = trajectory.at(times)[0]
    for rank, number in enumerate(numbers):
        name = axis_label(trajectory.space.axes[number]).partition(" (")[0]
        colour, style = PATHS[rank % len(PATHS)], LINE_STYLES[rank % len(LINE_STYLES)]
        axes.plot(times, position[:, number], color=colour, linestyle=style, linewidth=1.4, label=name)
    unit = trajectory.space.axes[numbers[0]].unit
    axes.set_ylabel(f"position{f' ({unit})' if unit else ''}", fontsize=TEXT)
    axes.margins(x=0.0)
    dress(axes)
