"""Choice of the picture of paths by their space: a plane, slices, or for a point or ball the surface of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeGuard

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.core.space import ConfigurationSpace
from resgrid.planning.any_field import FieldPath
from resgrid.planning.any_path import AnyPath
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Polyline
from resgrid.plot import paths as plane_paths
from resgrid.plot.figures import PAGE, new_figure, panel_height
from resgrid.plot.panels import Panel, add_figure_legend, draw_known, paint_unknown, painter
from resgrid.plot.paths import blend_label, line_layer, path_layer
from resgrid.plot.plane import Cut, plane_of, unknown_cells
from resgrid.plot.slices import slice_title
from resgrid.plot.space_view import subdivided
from resgrid.plot.style import TEXT, blend_styles
from resgrid.plot.voxels import PIECES, draw_paths_in_view, points_of
from resgrid.robots.voxel_surfaces import is_voxel_world

_SLICES = 3
"""Largest number of horizontal slices below the picture of the obstacles' surface."""


def draw_path(
    path: FieldPath, ax: Axes | None = None, *, axis: int | None = None, indices: Sequence[int] | None = None
) -> Axes | Figure:
    """Draw a streamline; return the axes, or the figure of a space with more than two axes.

    For a point or a ball in space, the figure shows the surface of the obstacles and horizontal slices, unless `axis`
    is given.  `ax`: axes to draw on, by default those of a new figure; `axis`: number of the space's axis normal to the
    slices of a space with three or four axes, None for one slice through the end of the path (or through a goal if the
    path reaches none) for each pair of axes; `indices`: cell indices of the slices along `axis`, by default at most
    six.
    """
    return draw_streamlines([path], ax, axis=axis, indices=indices)


def draw_streamlines(
    paths: Sequence[FieldPath],
    ax: Axes | None = None,
    *,
    k: Sequence[float] | None = None,
    unknown: NDArray[np.bool_] | None = None,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw streamlines; return the axes, or the figure of a space with more than two axes.

    For a point or a ball in space, the figure shows the surface of the obstacles and horizontal slices, unless `axis`
    is given.  `ax`: axes to draw on, by default those of a new figure; `k`: weight k of the Dirichlet field of each
    path, None for paths of one field; `unknown`: mask of obstacle cells of unknown occupancy, shape of the space;
    `axis`: number of the space's axis normal to the slices, None for one slice for each pair of axes, through the end
    of the first path that reaches a goal; `indices`: cell indices of the slices along `axis`, by default at most six.
    """
    if ax is None and axis is None and indices is None and is_voxel_world(paths[0].space):
        plane_paths.require_paths(paths, paths[0].space)
        return draw_voxel_page(paths, k, unknown)
    picture = plane_paths.draw_streamlines(paths, ax, k=k, axis=axis, indices=indices)
    paint_unknown(picture, paths[0].space, unknown)
    return picture


def draw_line(
    path: Polyline | ShortPath,
    ax: Axes | None = None,
    *,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw a polyline; return the axes, or the figure of a space with more than two axes.

    For a point or a ball in space, the figure shows the surface of the obstacles and horizontal slices, unless `axis`
    is given.  `ax`: axes to draw on, by default those of a new figure; `axis`: number of the space's axis normal to the
    slices of a space with three or four axes, None for one slice through a goal for each pair of axes; `indices`: cell
    indices of the slices along `axis`, by default at most six.
    """
    if ax is None and axis is None and indices is None and is_voxel_world(path.space):
        return draw_voxel_page([path])
    return plane_paths.draw_line(path, ax, axis=axis, indices=indices)


def _are_streamlines(paths: Sequence[AnyPath]) -> TypeGuard[Sequence[FieldPath]]:
    """Return whether all paths are streamlines or node paths, which belong to a field."""
    return all(isinstance(path, FieldPath) for path in paths)


def draw_voxel_page(
    paths: Sequence[AnyPath], k: Sequence[float] | None = None,
    unknown: NDArray[np.bool_] | None = None,
) -> Figure:  # fmt: skip
    """Draw paths of one space with three axes: the surface of the obstacles, and horizontal slices through the paths.

    `k`: weight k of the Dirichlet field of each streamline, None for paths of one field; `unknown`: mask of obstacle
    cells of unknown occupancy, shape of the space, None for no such cells.
    """
    space = paths[0].space
    layer = path_layer(paths, k) if _are_streamlines(paths) else line_layer(paths)
    styles = _styles_of([None] * len(paths) if k is None else k)
    cuts = _cuts_through(paths, space)
    planes = [plane_of(space, cut) for cut in cuts]
    below = panel_height(PAGE / _SLICES - 0.6, max(plane.aspect for plane in planes)) - 0.4
    above = 0.62 * PAGE
    figure = new_figure(PAGE, above + below + 0.5)
    grid = figure.add_gridspec(2, len(cuts), height_ratios=[above, below])
    surface = draw_paths_in_view(space, paths, styles, figure.add_subplot(grid[0, :]), unknown=unknown)
    legend = surface.get_legend()
    if legend is not None:
        legend.remove()
    panels = [Panel(space, figure.add_subplot(grid[1, n]), planes[n], cut) for n, cut in enumerate(cuts)]
    for panel, plane in zip(panels, planes, strict=True):
        panel.axes.set_title(slice_title(space, plane, panel.cut), fontsize=TEXT)
        draw_known(panel)
        painter(*unknown_cells(space.cell, unknown))(panel)
        layer(panel)
    add_figure_legend(figure, [Panel(space, surface, None), *panels])
    return figure


def _styles_of(k: Sequence[float | None]) -> list[dict[str, Any]]:
    """Return the legend entry ``label`` and matplotlib's line options for each path in the picture of the surface.

    `k`: weight k of the Dirichlet field of each path; entries None for paths of one field.
    """
    blends = sorted(set(k), key=lambda blend: blend or 0.0)
    styles = dict(zip(blends, blend_styles(blends), strict=True))
    return [{"label": blend_label(blend), **styles[blend]} for blend in k]


def _cuts_through(paths: Sequence[AnyPath], space: ConfigurationSpace) -> list[Cut]:
    """Return at most `_SLICES` horizontal slices through the first path, from the lowest to the highest.

    Candidates, in this order, are the slices at the start and the end of the path, at its lowest and its highest point
    (first the point farther in z from start and end), and at the median of its z coordinates. Each slice of the result
    is a tuple with one pair: the axis number 2 and a cell index. `space`: the space of all paths.
    """
    path, axis = paths[0], space.axes[2]
    line = subdivided(points_of(path, space), PIECES)
    heights = np.clip(np.floor((line[:, 2] - axis.lower) / axis.spacing).astype(int), 0, axis.cells - 1)
    ends = [int(heights[0]), int(path.cells[-1][2]) if isinstance(path, FieldPath) else int(heights[-1])]
    extremes = sorted(
        (int(heights.max()), int(heights.min())), key=lambda number: -min(abs(number - end) for end in ends)
    )
    chosen: list[int] = []
    for number in (*ends, *extremes, int(np.median(heights))):
        if number not in chosen and len(chosen) < _SLICES:
            chosen.append(number)
    return [((2, number),) for number in sorted(chosen)]
