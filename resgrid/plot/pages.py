"""Pictures of fields whatever their dimension: a profile, a plane, slices; and a page with paths and currents."""

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
from resgrid.plot.fields import draw_currents, draw_no_drop, draw_potential, draw_shading
from resgrid.plot.figures import PAGE, add_title, axes_or_new, figure_of, new_figure, panel_height
from resgrid.plot.paths import draw_streamlines, mark_outcome, require_paths, seam_pieces
from resgrid.plot.plane import draw_cells, finish, kinds_of, plane_of, plane_slice
from resgrid.plot.shading import Scale, Shading, no_drop, shading_of
from resgrid.plot.style import PATHS, SMALL, TEXT, axis_label, dress, refresh_legend
from resgrid.space import Cell, ConfigurationSpace

_PANELS = 6
_WIDE = 0.55
"""Height over width below which a map is so wide that panels are stacked."""


def draw_field(
    field: Field,
    ax: Axes | None = None,
    *,
    quantity: Literal["potential", "currents"] = "potential",
    scale: Scale = "auto",
    contours: bool = True,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw the potential of a field, as a profile, an image or slices by its number of axes, or its currents."""
    ndim = field.space.ndim
    if quantity == "currents":
        return draw_currents(field, ax)
    if ndim == 1:
        return draw_profile(field, ax, scale=scale)
    if ndim == 2:
        return draw_potential(field, ax, scale=scale, contours=contours)
    if ax is not None:
        raise InputError(f"a field of {ndim} axes is drawn in several slices, not into one ax: leave ax out")
    return draw_slices(field, axis, indices=indices, scale=scale)


def draw_page(
    field: Field, paths: Sequence[Streamline] = (), *, k: Sequence[float] | None = None, title: str = "",
    scale: Scale = "auto",
) -> Figure:  # fmt: skip
    """Draw the overview of a field and its paths, whatever its dimension.

    Two axes: obstacles, potential, equipotentials and paths beside the currents (below, where the map is wide).  One
    axis: a profile.  Three axes: slices through the goal.

    Parameters
    ----------
    field : Field
        Of one to three axes.
    paths : sequence of Streamline
        To draw on it.
    k : sequence of float, optional
        Blend of each path.
    title : str
        Above the figure.
    scale : {"auto", "linear", "log"}
        As in `draw`.

    Returns
    -------
    matplotlib.figure.Figure
        17 to 19 cm wide, which a page of two columns bears unscaled.

    Raises
    ------
    InputError
        If the space has four axes, or the paths are not of this space.
    """
    require_paths(paths, field.space)
    if field.space.ndim == 1:
        figure = figure_of(draw_profile(field, scale=scale, paths=paths))
    elif field.space.ndim == 2:
        figure = _plane_page(field, paths, k, scale)
    else:
        figure = draw_slices(field, paths=paths, scale=scale)
    add_title(figure, title)
    return figure


def _plane_page(field: Field, paths: Sequence[Streamline], k: Sequence[float] | None, scale: Scale) -> Figure:
    aspect = plane_of(field.space).aspect
    stacked = aspect < _WIDE
    width = PAGE if stacked else PAGE / 2
    height = panel_height(width - 1.1, aspect) + 0.25
    figure = new_figure(PAGE, 2 * height if stacked else height)
    left, right = figure.subplots(2, 1) if stacked else figure.subplots(1, 2)
    draw_potential(field, left, scale=scale)
    if paths:
        draw_streamlines(paths, left, k=k)
    left.set_title("Potential and paths" if paths else "Potential", fontsize=TEXT)
    draw_currents(field, right)
    right.set_title("Current", fontsize=TEXT)
    return figure


def draw_profile(
    field: Field, ax: Axes | None = None, *, scale: Scale = "auto", paths: Sequence[Streamline] = ()
) -> Axes:
    """Draw the potential of a space with one axis over its coordinate, with the starts of paths on the curve."""
    space = field.space
    shading = shading_of(field, scale)
    axes = axes_or_new(ax, 0.6)
    axis = space.axes[0]
    for label, colour, where in kinds_of(space.cell, space.goal_connected):
        for index in np.flatnonzero(where).tolist():
            axes.axvspan(axis.edges[index], axis.edges[index + 1], color=colour, linewidth=0, label=label, zorder=0.5)
    shown = np.where(space.cell == Cell.OBSTACLE, np.nan, shading.values)
    axes.plot(axis.centres, shown, marker="o", markersize=3, linewidth=1.2, color=PATHS[3], label="cells")
    for path in paths:
        mark_outcome(path, (path.axis_points[0, 0], shown[int(path.cells[0, 0])]), axes)
    axes.set(xlim=(axis.lower, axis.upper), xlabel=axis_label(axis))
    dress(axes)
    axes.set_ylabel(shading.label, fontsize=TEXT)
    refresh_legend(axes)
    return axes


def draw_slices(
    field: Field, axis: int | None = None, *, indices: Sequence[int] | None = None, paths: Sequence[Streamline] = (),
    scale: Scale = "auto",
) -> Figure:  # fmt: skip
    """Draw slices of a field with three axes normal to one of them, or through the goal normal to each.

    Paths are drawn faintly as seen along the axis, and boldly where they lie in the slice.
    """
    space = field.space
    if space.ndim != 3:
        raise InputError(f"a field of {space.ndim} axes has no picture: fix an axis, and draw what is left")
    cuts = _cuts(space, axis, indices)
    shading = shading_of(field, scale)
    columns = min(3, len(cuts))
    rows = -(-len(cuts) // columns)
    tallest = max(plane_slice(space, normal, index).aspect for normal, index in cuts)
    figure = new_figure(max(PAGE * columns / 3, 3.4), rows * (panel_height(PAGE / 3 - 0.6, tallest) - 0.5) + 0.9)
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
    finish(plane, axes, columns=0)
    axes.set_title(_where(field.space, normal, index), fontsize=TEXT)


def _slab(values: NDArray[Any], normal: int, index: int) -> NDArray[Any]:
    return np.asarray(np.moveaxis(values, normal, 0)[index])


def _where(space: ConfigurationSpace, normal: int, index: int) -> str:
    axis = space.axes[normal]
    name = axis_label(replace(axis, unit=""))
    through_goal = bool(np.any(np.moveaxis(space.cell, normal, 0)[index] == Cell.GOAL))
    return f"{name} = {axis.centres[index]:.3g} {axis.unit}{' (through a goal)' if through_goal else ''}"


def _draw_path(path: Streamline, space: ConfigurationSpace, normal: int, index: int, axes: Axes) -> None:
    across, up = (number for number in range(3) if number != normal)
    mark_outcome(path, path.axis_points[0, [across, up]], axes)
    lower, upper = space.axes[normal].edges[[index, index + 1]]
    for line in seam_pieces(path) if path.outcome == Outcome.REACHED else ():
        inside = (line[:, normal] >= lower) & (line[:, normal] <= upper)
        axes.plot(
            line[:, across], line[:, up], color=PATHS[0], linewidth=0.7, alpha=0.7, zorder=4, label="path, projected"
        )
        if inside.any():
            bold = np.where(inside[:, None], line, np.nan)
            axes.plot(bold[:, across], bold[:, up], color=PATHS[0], linewidth=2.2, zorder=5, label="path in the slice")


def _add_scale(figure: Figure, panels: NDArray[np.object_], shading: Shading) -> None:
    colours = ScalarMappable(Normalize(shading.lower, shading.upper), shading.colours)
    bar = figure.colorbar(
        colours, ax=list(panels), fraction=0.03, pad=0.02, aspect=30,
        extend="min" if np.nanmin(shading.values) < shading.lower else "neither",
    )  # fmt: skip
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
