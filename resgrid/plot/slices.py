"""Slices through fields of three axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.planning.fields import Field
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.plot.fields import draw_no_drop, draw_shading
from resgrid.plot.figures import new_figure, panel_height
from resgrid.plot.paths import pieces, require_paths
from resgrid.plot.plane import PICTURES, draw_cells, finish, plane_slice
from resgrid.plot.shading import Shading, no_drop, shading_of
from resgrid.plot.style import FAILURE, PATHS, SMALL, TEXT, axis_label
from resgrid.space import Axis, Cell, ConfigurationSpace

_PANELS = 6
_PAGE = 7.4


def plot_slices(
    field: Field,
    axis: int | None = None,
    *,
    indices: Sequence[int] | None = None,
    paths: Sequence[Streamline] = (),
    scale: str = "auto",
) -> Figure:
    """Draw slices of a field with three axes.

    Parameters
    ----------
    field : Field
        Of three axes.
    axis : int, optional
        The slices are normal to it.  None: one slice through the goal normal to each axis.
    indices : sequence of int, optional
        Which cells along ``axis``; by default six, the goal's among them.
    paths : sequence of Streamline
        Drawn faintly as seen along the axis, and boldly where they lie in the slice.
    scale : {"auto", "linear", "log"}
        As in `plot_potential`.

    Returns
    -------
    matplotlib.figure.Figure
        One panel a slice, one colour scale.

    Raises
    ------
    InputError
        If the space does not have three axes, or an index is not in it.
    """
    if field.space.ndim != 3:
        raise InputError(f"slices need a space of three axes, this one has {field.space.ndim} ({PICTURES})")
    cuts = _cuts(field.space, axis, indices)
    require_paths(paths, field.space)
    shading = shading_of(field, scale)
    columns = min(3, len(cuts))
    rows = -(-len(cuts) // columns)
    height = panel_height(_PAGE / 3 - 0.6, _tallest(field.space, cuts)) - 0.5
    figure = new_figure(max(_PAGE * columns / 3, 3.4), rows * height + 0.9)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, (normal, index) in zip(panels, cuts, strict=False):
        _draw_slice(field, shading, normal, index, paths, panel)
    for panel in panels[len(cuts) :]:
        panel.set_axis_off()
    _add_scale(figure, panels, shading)
    _add_legend(figure, panels[: len(cuts)])
    return figure


def _cuts(space: ConfigurationSpace, axis: int | None, indices: Sequence[int] | None) -> list[tuple[int, int]]:
    """Axis and index of every slice."""
    goals = np.argwhere(space.cell == Cell.GOAL)
    goal = goals[0] if len(goals) else np.array(space.shape) // 2
    if axis is None:
        if indices is not None:
            raise InputError("indices of slices need the axis they count along")
        return [(normal, int(goal[normal])) for normal in (2, 1, 0)]
    if axis not in (0, 1, 2):
        raise InputError(f"axis = {axis}, but the space has axes 0, 1 and 2")
    size = space.shape[axis]
    if indices is None:
        spread = np.linspace(0, size - 1, min(_PANELS, size)).round().astype(int)
        spread[np.abs(spread - goal[axis]).argmin()] = goal[axis]
        indices = np.unique(spread).tolist()
    wrong = [index for index in indices if not 0 <= index < size]
    if wrong or not len(indices):
        raise InputError(f"slice {wrong[0] if wrong else '(none)'} is not one of the cells 0 to {size - 1} of the axis")
    return [(axis, int(index)) for index in indices]


def _tallest(space: ConfigurationSpace, cuts: list[tuple[int, int]]) -> float:
    return max(plane_slice(space, normal, index).aspect for normal, index in cuts)


def _draw_slice(
    field: Field, shading: Shading, normal: int, index: int, paths: Sequence[Streamline], axes: Axes
) -> None:
    plane = plane_slice(field.space, normal, index)
    flat = replace(shading, edge=tuple(rule for number, rule in enumerate(shading.edge) if number != normal))
    draw_shading(plane, flat, _slab(shading.values, normal, index), axes)
    draw_no_drop(plane, _slab(no_drop(field, shading), normal, index), axes)
    draw_cells(plane, axes)
    for path in paths:
        _draw_path(path, field.space, normal, index, axes)
    finish(plane, axes)
    axes.set_title(_where(field.space, normal, index), fontsize=TEXT)


def _slab(values: NDArray[Any], normal: int, index: int) -> NDArray[Any]:
    return np.asarray(np.moveaxis(values, normal, 0)[index])


def _where(space: ConfigurationSpace, normal: int, index: int) -> str:
    axis: Axis = space.axes[normal]
    name = axis_label(replace(axis, unit=""))
    through_goal = bool(np.any(np.moveaxis(space.cell, normal, 0)[index] == Cell.GOAL))
    return f"{name} = {axis.centres[index]:.3g} {axis.unit}{' (through a goal)' if through_goal else ''}"


def _draw_path(path: Streamline, space: ConfigurationSpace, normal: int, index: int, axes: Axes) -> None:
    across, up = (number for number in range(3) if number != normal)
    if path.outcome != Outcome.REACHED:
        axes.plot(
            path.axis_points[0, across], path.axis_points[0, up], linestyle="", marker="x", color=FAILURE, zorder=6,
            label=path.outcome.value.replace("_", " "),
        )  # fmt: skip
        return
    lower, upper = space.axes[normal].edges[[index, index + 1]]
    for line in pieces(path, space):
        inside = (line[:, normal] >= lower) & (line[:, normal] <= upper)
        axes.plot(
            line[:, across], line[:, up], color=PATHS[0], linewidth=0.7, alpha=0.7, zorder=4, label="path, projected"
        )
        if inside.any():
            bold = np.where(inside[:, None], line, np.nan)
            axes.plot(bold[:, across], bold[:, up], color=PATHS[0], linewidth=2.2, zorder=5, label="path in the slice")
    axes.plot(
        path.axis_points[0, across], path.axis_points[0, up], linestyle="", marker="o", markersize=4, color="white",
        markeredgecolor="black", zorder=6, label="start",
    )  # fmt: skip


def _add_scale(figure: Figure, panels: NDArray[np.object_], shading: Shading) -> None:
    colours = ScalarMappable(Normalize(shading.lower, shading.upper), shading.colours)
    below: Literal["min", "neither"] = "min" if np.nanmin(shading.values) < shading.lower else "neither"
    bar = figure.colorbar(colours, ax=list(panels), fraction=0.03, pad=0.02, aspect=30, extend=below)
    bar.set_label(shading.label, fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL, width=0.6, length=2.5)


def _add_legend(figure: Figure, panels: NDArray[np.object_]) -> None:
    entries: dict[str, Artist] = {}
    for panel in panels:
        handles, labels = panel.get_legend_handles_labels()
        entries.update(zip(labels, handles, strict=True))
    figure.legend(
        handles=list(entries.values()), labels=list(entries), loc="outside lower center", ncols=4, fontsize=SMALL,
        frameon=False, columnspacing=1.2,
    )  # fmt: skip
