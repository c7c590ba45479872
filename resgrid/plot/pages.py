"""Pictures whatever the dimension: a strip or profile, a plane, slices; and a page of a field, paths and currents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.planning.fields import Field
from resgrid.planning.separation import SceneSeparation, Separation
from resgrid.planning.streamline import Polyline, ShortPath, Streamline, unwrap
from resgrid.plot.fields import (
    CONDUCTIVITY,
    conductivity_style,
    draw_currents,
    draw_no_drop,
    draw_plane_space,
    draw_potential,
    draw_shading,
)  # fmt: skip
from resgrid.plot.figures import PAGE, add_title, axes_or_new, figure_of, new_figure, panel_height
from resgrid.plot.paths import (
    blend_label,
    by_blend,
    draw_in_slice,
    draw_plane_paths,
    draw_plane_separation,
    mark_outcome,
    require_paths,
    seam_pieces,
    separated,
)  # fmt: skip
from resgrid.plot.plane import VIRTUAL, draw_image, kinds_of, leading_on, paint_cells, plane_of, seam_shifts
from resgrid.plot.shading import Scale, no_drop, shading_of
from resgrid.plot.slices import Slice, draw_in_slices
from resgrid.plot.style import PATHS, SMALL, TEXT, axis_label, dress, mark, refresh_legend
from resgrid.plot.workspace import draw_plane_line
from resgrid.space import Cell, ConfigurationSpace

_PIECES = 256
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
    _refuse_ax(ax, "a field", ndim)
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
        draw_plane_paths(paths, left, k=k)
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
    _draw_bands(space, axes)
    shown = np.where(space.cell == Cell.OBSTACLE, np.nan, shading.values)
    axes.plot(axis.centres, shown, marker="o", markersize=3, linewidth=1.2, color=PATHS[3], label="cells")
    for path in paths:
        mark_outcome(path, (path.axis_points[0, 0], shown[int(path.cells[0, 0])]), axes)
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
    shading = shading_of(field, scale) if field.space.ndim == 3 else None

    def paint(part: Slice, axes: Axes) -> None:
        assert shading is not None
        flat = replace(shading, edge=tuple(rule for number, rule in enumerate(shading.edge) if number != part.normal))
        draw_shading(part.plane, flat, part.of(shading.values), axes)
        draw_no_drop(part.plane, part.of(no_drop(field, shading)), axes)
        _paint_paths(paths, None, part, axes)

    figure = draw_in_slices(field.space, paint, axis=axis, indices=indices)
    assert shading is not None
    below = np.nanmin(shading.values) < shading.lower
    colours = ScalarMappable(Normalize(shading.lower, shading.upper), shading.colours)
    _add_scale(figure, colours, shading.label, "min" if below else "neither")
    return figure


def draw_space(
    space: ConfigurationSpace,
    ax: Axes | None = None,
    *,
    virtual: NDArray[np.bool_] | None = None,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw obstacles, goals, the conductivity if there is one; obstacle cells that stand for no body are paler."""
    conductivity = space.conductivity
    if space.ndim == 1:
        axes = _draw_strip(space, ax, [] if virtual is None else [(virtual, VIRTUAL, "virtual obstacle")])
        if conductivity is not None:
            axes.plot(space.axes[0].centres, conductivity, marker="o", markersize=3, linewidth=1.2, color=PATHS[3])
            axes.set_ylabel(CONDUCTIVITY, fontsize=TEXT)
            axes.yaxis.set_major_locator(AutoLocator())
        return axes
    if space.ndim == 2:
        return draw_plane_space(space, ax, virtual=virtual)
    _refuse_ax(ax, "a space", space.ndim)
    style = None if conductivity is None else conductivity_style(conductivity)

    def paint(part: Slice, axes: Axes) -> None:
        if style is not None and conductivity is not None:
            draw_image(part.plane, part.of(conductivity), axes, **style, zorder=0.5)
        if virtual is not None:
            paint_cells(part.plane, part.of(virtual), VIRTUAL, "virtual obstacle", axes)

    figure = draw_in_slices(space, paint, axis=axis, indices=indices)
    if style is not None:
        _add_scale(figure, ScalarMappable(**style), CONDUCTIVITY)
    return figure


def draw_path(
    path: Streamline, ax: Axes | None = None, *, axis: int | None = None, indices: Sequence[int] | None = None
) -> Axes | Figure:
    """Draw a streamline; as `draw_streamlines` otherwise."""
    return draw_streamlines([path], ax, axis=axis, indices=indices)


def draw_streamlines(
    paths: Sequence[Streamline],
    ax: Axes | None = None,
    *,
    k: Sequence[float] | None = None,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw streamlines over what the ax shows, on cells of their space if there is none.

    Their starts and ends are marked, and a cross where a start leads nowhere; those of one k share a colour.
    """
    space = paths[0].space
    groups = by_blend(paths, k)
    if space.ndim == 1:
        axes = _draw_strip(space) if ax is None else ax
        height = float(np.mean(axes.get_ylim()))
        for rank, (blend, own) in enumerate(groups):
            for line in [line for path in own for line in seam_pieces(path)]:
                level = np.full(len(line), height)
                axes.plot(line[:, 0], level, color=PATHS[rank % len(PATHS)], zorder=4, label=blend_label(blend))
        for path in paths:
            mark_outcome(path, (path.axis_points[0, 0], height), axes)
        refresh_legend(axes)
        return axes
    if space.ndim == 2:
        return draw_plane_paths(paths, ax, k=k)
    _refuse_ax(ax, "a path", space.ndim)

    def paint(part: Slice, axes: Axes) -> None:
        _paint_paths(paths, k, part, axes)

    return draw_in_slices(space, paint, axis=axis, indices=indices)


def _paint_paths(paths: Sequence[Streamline], k: Sequence[float] | None, part: Slice, axes: Axes) -> None:
    for rank, (blend, own) in enumerate(by_blend(paths, k)):
        lines = [line for path in own for line in seam_pieces(path)]
        draw_in_slice(lines, part, axes, colour=PATHS[rank % len(PATHS)], label=blend_label(blend))
    for path in paths:
        mark_outcome(path, part.seen(path.axis_points[:1]), axes)


def draw_line(
    path: Polyline | ShortPath,
    ax: Axes | None = None,
    *,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw a path of straight lines over what the ax shows, on cells of its space if there is none."""
    space = path.space
    if space.ndim < 3:
        return draw_plane_line(path, ax)
    _refuse_ax(ax, "a path", space.ndim)
    points = _subdivided(unwrap(path))
    copies = [space.from_world(points + shift) for shift in seam_shifts(space)]

    def paint(part: Slice, axes: Axes) -> None:
        draw_in_slice(copies, part, axes)
        mark(part.seen(space.from_world(points[:1])), axes, "start")

    return draw_in_slices(space, paint, axis=axis, indices=indices)


def _subdivided(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points so close on straight lines that pictures show which part of each lies in a slice, shape (n, ndim)."""
    along = np.linspace(0.0, len(points) - 1.0, _PIECES * (len(points) - 1) + 1)
    return np.stack([np.interp(along, np.arange(len(points)), column) for column in points.T], axis=1)


def draw_separation(
    result: Separation | SceneSeparation,
    ax: Axes | None = None,
    *,
    virtual: NDArray[np.bool_] | None = None,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw the cells that a start can reach, and the obstacles that must go for a goal to be reached."""
    space, masks = result.space, separated(result)
    if virtual is not None:
        masks = [(virtual, VIRTUAL, "virtual obstacle"), *masks]
    label = f"start: {result.outcome.value.replace('_', ' ')}"
    if space.ndim == 1:
        axes = _draw_strip(space, ax, masks)
        mark((space.axis_centre(result.start)[0], float(np.mean(axes.get_ylim()))), axes, "start", label)
        refresh_legend(axes)
        return axes
    if space.ndim == 2:
        return draw_plane_separation(result, ax, virtual=virtual)
    _refuse_ax(ax, "a separation", space.ndim)

    def paint(part: Slice, axes: Axes) -> None:
        for mask, colour, name in masks:
            paint_cells(part.plane, part.of(mask), colour, name, axes)
        mark(part.seen(space.axis_centre(result.start)[np.newaxis]), axes, "start", label)

    return draw_in_slices(space, paint, axis=axis, indices=indices, through=result.start)


def _draw_strip(
    space: ConfigurationSpace, ax: Axes | None = None, masks: Sequence[tuple[NDArray[np.bool_], str, str]] = ()
) -> Axes:
    """The cells of a space with one axis, and masks of cells over them, as bands."""
    axes = axes_or_new(ax, 0.3)
    _draw_bands(space, axes, masks)
    axes.set_yticks([])
    refresh_legend(axes)
    return axes


def _draw_bands(
    space: ConfigurationSpace, axes: Axes, masks: Sequence[tuple[NDArray[np.bool_], str, str]] = ()
) -> None:
    axis = space.axes[0]
    kinds = [(where, colour, label) for label, colour, where in kinds_of(space.cell, leading_on(space))]
    for order, (where, colour, label) in enumerate([*kinds, *masks]):
        for index in np.flatnonzero(where).tolist():
            over = 0.5 + 0.1 * (order >= len(kinds))
            axes.axvspan(
                axis.edges[index], axis.edges[index + 1], color=colour, linewidth=0, label=label, zorder=over
            )  # fmt: skip
    axes.set(xlim=(axis.lower, axis.upper), xlabel=axis_label(axis))
    dress(axes)


def _refuse_ax(ax: Axes | None, what: str, ndim: int) -> None:
    if ax is not None:
        raise InputError(f"{what} of {ndim} axes is drawn in several slices, not into one ax: leave ax out")


def _add_scale(
    figure: Figure, colours: ScalarMappable, label: str, extend: Literal["min", "neither"] = "neither"
) -> None:
    bar = figure.colorbar(colours, ax=figure.axes, fraction=0.03, pad=0.02, aspect=30, extend=extend)
    bar.set_label(label, fontsize=SMALL)
    bar.ax.tick_params(which="both", labelsize=SMALL, width=0.6, length=2.5)
