"""Pictures of fields whatever the dimension: a profile, a plane, slices; and a page of a field, paths and currents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from resgrid.planning.fields import Field
from resgrid.planning.streamline import Streamline
from resgrid.plot.fields import draw_currents, draw_no_drop, draw_potential, draw_shading
from resgrid.plot.figures import PAGE, add_title, axes_or_new, figure_of, new_figure, panel_height
from resgrid.plot.panels import Panel, draw_in_slices, draw_strip
from resgrid.plot.paths import by_blend, draw_streamlines, mark_outcome, paint_paths, require_paths
from resgrid.plot.plane import draw_cells, finish, plane_of
from resgrid.plot.shading import Scale, no_drop, shading_of
from resgrid.plot.style import PATHS, TEXT, add_scale, refresh_legend
from resgrid.space import Cell

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
    return draw_slices(field, ax, axis=axis, indices=indices, scale=scale)


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

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"))
    >>> figure = rg.draw_page(planner.field, planner.paths(), title="Eight by eight")
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
    draw_strip(space, axes)
    shown = np.where(space.cell == Cell.OBSTACLE, np.nan, shading.values)
    axes.plot(axis.centres, shown, marker="o", markersize=3, linewidth=1.2, color=PATHS[3], label="cells")
    for path in paths:
        mark_outcome(path, (path.axis_points[0, 0], shown[int(path.cells[0, 0])]), axes)
    axes.set_ylabel(shading.label, fontsize=TEXT)
    refresh_legend(axes)
    return axes


def draw_slices(
    field: Field,
    ax: Axes | None = None,
    *,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
    paths: Sequence[Streamline] = (),
    scale: Scale = "auto",
) -> Figure:
    """Draw slices of a field with three axes normal to one of them, or through the goal normal to each."""
    shading = shading_of(field, scale)
    groups, high = by_blend(paths, None), no_drop(field, shading)

    def paint(panel: Panel) -> None:
        assert panel.plane is not None
        flat = replace(shading, edge=tuple(rule for number, rule in enumerate(shading.edge) if number != panel.normal))
        draw_shading(panel.plane, flat, panel.of(shading.values), panel.axes)
        draw_no_drop(panel.plane, panel.of(high), panel.axes)
        draw_cells(panel.plane, panel.axes)
        finish(panel.plane, panel.axes, columns=0)
        paint_paths(groups, paths, panel)

    figure = draw_in_slices(field.space, ax, paint, axis=axis, indices=indices)
    below = np.nanmin(shading.values) < shading.lower
    colours = ScalarMappable(Normalize(shading.lower, shading.upper), shading.colours)
    add_scale(figure, colours, shading.label, "min" if below else "neither")
    return figure
