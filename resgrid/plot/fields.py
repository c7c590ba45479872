"""Pictures of fields: potential with equipotentials, arrows of the current, and an overview page with paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.planning.any_field import FieldPath
from resgrid.planning.fields import Field
from resgrid.planning.lattice_fields import LatticeField
from resgrid.plot.figures import PAGE, add_title, axes_or_new, figure_of, new_figure, panel_height
from resgrid.plot.images import draw_shading
from resgrid.plot.lattices import draw_lattice_field
from resgrid.plot.panels import Panel, draw_panels
from resgrid.plot.paths import end_of_first, mark_outcome, path_layer, require_paths
from resgrid.plot.plane import (
    draw_cells,
    finish,
    plane_of,
)
from resgrid.plot.shading import Scale, no_drop, shading_of, span
from resgrid.plot.style import NO_DROP, TEXT, add_colour_bar, spanning, strength_map

_ARROWS = 26
"""Largest number of blocks of cells, each with one current arrow, along the longer side of a map."""
_ARROW_LENGTH = 0.85
"""Length of a current arrow, as a fraction of the width of its block of cells."""

_WIDE = 0.55
"""Height over width of a map below which the two panels of a page are drawn one above the other."""


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
    """Draw the potential of a field with one to four axes (profile, image or slices), or the currents.

    `ax`: axes to draw on, by default those of a new figure; `quantity`: "potential", or "currents" of a field with two
    axes, for which the other options are ignored; `scale`: "linear", "log" (logarithm of the drop) or "auto" ("log" if
    the drop spans two orders of magnitude or more, otherwise "linear"); `contours`: whether to draw equipotentials;
    `axis`: number of the space's axis normal to the slices of a space with three or four axes, None for one slice
    through a goal for each pair of axes; `indices`: cell indices of the slices along `axis`, by default at most six.
    Returns the axes, or the figure of a space with more than two axes.
    """
    if quantity == "currents":
        return draw_currents(field, ax)
    return _draw_potential(field, ax, scale=scale, contours=contours, axis=axis, indices=indices)


def _draw_potential(
    field: Field,
    ax: Axes | None = None,
    *,
    scale: Scale,
    contours: bool = True,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
    paths: Sequence[FieldPath] = (),
    k: Sequence[float] | None = None,
) -> Axes | Figure:
    """Draw the potential and paths; return the axes, or the figure of a space with more than two axes.

    With one axis, a mark on the curve is the start of a path.  `ax`: axes to draw on, None for a new figure; `scale`:
    "linear", "log" (logarithm of the drop) or "auto" ("log" if the drop spans two orders of magnitude or more);
    `contours`: whether to draw equipotentials; `axis`: number of the space's axis normal to the slices, None for one
    slice for each pair of axes, through the end of the first path or through a goal; `indices`: cell indices of the
    slices along `axis`, by default at most six; `paths`: streamlines; `k`: weight k of the Dirichlet field of each
    path, None for paths of one field.
    """
    shading = shading_of(field, scale)
    shown = np.where(field.space.cell == Cell.OBSTACLE, np.nan, shading.values)
    high = no_drop(field, shading)

    def potential(panel: Panel) -> tuple[ScalarMappable, str] | None:
        if panel.plane is None:
            panel.draw_cells()
            panel.plot_curve(shown, shading.label, label="cells")
            for path in paths:
                mark_outcome(path, (path.axis_points[0, 0], shown[int(path.cells[0, 0])]), panel.axes)
            return None
        edge = tuple(rule for number, rule in enumerate(shading.edge) if number not in panel.normals)
        values, flat = panel.of(shading.values), replace(shading, edge=edge)
        image = draw_shading(panel.plane, flat, values, panel.axes, contours=contours)
        panel.paint((high, NO_DROP, "at the high rail"), order=1.0)
        panel.draw_cells()
        return image, shading.label

    layers = [potential, path_layer(paths, k)] if paths and field.space.ndim > 1 else [potential]
    return draw_panels(field.space, ax, *layers, axis=axis, indices=indices, through=end_of_first(paths), strip=0.6)


def draw_summary(
    field: Field | LatticeField, paths: Sequence[FieldPath] = (), *, k: Sequence[float] | None = None, title: str = "",
    scale: Scale = "auto",
) -> Figure:  # fmt: skip
    """Draw the overview of a field of one to four axes with its paths.

    With two axes, one panel shows obstacles, potential, equipotentials and paths; a second panel, to the right or for a
    wide map below, shows the currents.  With one axis the potential is a profile.  With more than two axes it is shown
    in slices through the end of the first path, or through a goal.

    Parameters
    ----------
    field : Field or LatticeField
        Field of one to four axes.  The page of a lattice has no panel of currents.
    paths : sequence of Streamline or NodePath
        Paths to draw on the potential.
    k : sequence of float, optional
        Weight k of the Dirichlet field of each path; by default all paths belong to one field.
    title : str
        Title above the figure.
    scale : {"auto", "linear", "log"}
        Scale of the potential: linear, or logarithm of the drop; "auto" is "log" if the drop spans two orders of
        magnitude or more, otherwise "linear".

    Returns
    -------
    matplotlib.figure.Figure
        Figure 17 to 19 cm wide, the width of a page with two columns.

    Raises
    ------
    InputError
        If the number of coordinates of a path differs from the number of axes, or `scale` is "log" and the field has
        no drop.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"))
    >>> figure = rg.plot.draw_summary(planner.field, planner.paths(), title="Eight by eight")
    """
    require_paths(paths, field.space)
    if isinstance(field, LatticeField):
        figure = figure_of(draw_lattice_field(field, scale=scale, paths=paths, k=k))
    elif field.space.ndim == 2:
        figure = _plane_page(field, paths, k, scale)
    else:
        figure = figure_of(_draw_potential(field, scale=scale, paths=paths, k=k))
    add_title(figure, title)
    return figure


def _plane_page(field: Field, paths: Sequence[FieldPath], k: Sequence[float] | None, scale: Scale) -> Figure:
    """Return a figure of a field with two axes: one panel with potential and paths, one panel with currents.

    `k`: weight k of the Dirichlet field of each path, None for paths of one field; `scale`: scale of the potential:
    "linear", "log" (logarithm of the drop) or "auto" ("log" if the drop spans two orders of magnitude or more).
    """
    aspect = plane_of(field.space).aspect
    stacked = aspect < _WIDE
    width = PAGE if stacked else PAGE / 2
    height = panel_height(width - 1.1, aspect) + 0.25
    figure = new_figure(PAGE, 2 * height if stacked else height)
    left, right = figure.subplots(2, 1) if stacked else figure.subplots(1, 2)
    _draw_potential(field, left, scale=scale, paths=paths, k=k)
    left.set_title("Potential and paths" if paths else "Potential", fontsize=TEXT)
    draw_currents(field, right)
    right.set_title("Current", fontsize=TEXT)
    return figure


def draw_currents(field: Field, ax: Axes | None = None) -> Axes:
    """Draw the currents through cells as arrows of equal length, coloured by log10 of the magnitude; return the axes.

    The magnitude is in units of supply / resistance.  Large maps have one arrow per block of cells.  `field`: field
    with two axes; `ax`: axes to draw on, by default those of a new figure.
    """
    plane = plane_of(field.space)
    axes = axes_or_new(ax, plane.aspect)
    draw_cells(plane, axes)
    arrows = current_arrows(field, -(-plane.cells_shown // _ARROWS))
    if len(arrows.tail):
        width = max(0.06 * axes.get_window_extent().width / min(plane.cells_shown, _ARROWS), 1.0)
        quiver = axes.quiver(
            *field.space.centre(arrows.tail).T, *plane.frame.turned_to_world(arrows.vector).T, arrows.decades,
            cmap=strength_map(), norm=spanning(*span(arrows.decades)), angles="xy", scale_units="xy", scale=1.0,
            pivot="mid", units="dots", width=width, zorder=3,
        )  # fmt: skip
        add_colour_bar(quiver, axes, r"$\log_{10}(I\,R\,/\,\mathrm{supply})$, current $I$")
    finish(plane, axes)
    return axes


class Arrows(NamedTuple):
    """Arrows of the current through cells.

    `tail` (n, 2): indices of the cells with an arrow; `vector` (n, 2): arrow in axis units, of equal length when
    measured in cells; `decades` (n,): log10 of the current through the cell in units of supply / resistance.
    """

    tail: NDArray[np.int64]
    vector: NDArray[np.float64]
    decades: NDArray[np.float64]


def current_arrows(field: Field, block: int) -> Arrows:
    """Return one arrow per block of `block` x `block` cells, for the current through a cell near the block's middle.

    The cell is the goal-connected cell nearest to the middle.  Along each axis, the current of the cell is the mean of
    the currents through its two faces across this axis.  The means are computed relative to the largest current
    through the four faces, because small currents underflow.  Blocks without current have no arrow.
    """
    cells = nearest_to_middles(field.space.goal_connected, block)
    log_face, sign = _both_faces(field.face_log_current, cells), _both_faces(field.face_direction, cells)
    largest = log_face.max(axis=(1, 2))
    flowing = np.isfinite(largest)
    cells, log_face, sign, largest = cells[flowing], log_face[flowing], sign[flowing], largest[flowing]
    mean = (sign * np.exp(log_face - largest[:, None, None])).mean(axis=2)
    length = np.linalg.norm(mean, axis=1)
    moving = length > 0
    vector = mean[moving] / length[moving, None] * field.space.spacing * block * _ARROW_LENGTH
    return Arrows(cells[moving], vector, (largest[moving] + np.log(length[moving])) / np.log(10.0))


def nearest_to_middles(eligible: NDArray[np.bool_], block: int) -> NDArray[np.int64]:
    """Return, for each block of `block` x `block` cells, the eligible cell nearest to the block's middle.

    `eligible` (n, m): mask of cells.  The result (blocks, 2) holds cell indices; blocks without an eligible cell are
    omitted.
    """
    padded = np.pad(eligible, [(0, -size % block) for size in eligible.shape])
    rows, columns = padded.shape[0] // block, padded.shape[1] // block
    blocks = padded.reshape(rows, block, columns, block).swapaxes(1, 2).reshape(rows * columns, block * block)
    offset = np.arange(block) - (block - 1) / 2
    distance = (offset[:, None] ** 2 + offset**2).ravel()
    best = np.where(blocks, distance, np.inf).argmin(axis=1)
    found = np.flatnonzero(blocks.any(axis=1))
    row, column = np.divmod(found, columns)
    inner_row, inner_column = np.divmod(best[found], block)
    return np.stack([row * block + inner_row, column * block + inner_column], axis=1).astype(np.int64)


def _both_faces(faces: Sequence[NDArray[Any]], cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the values on the four faces of cells, shape (n, 2, 2): cell, axis across the face, lower or upper face.

    `faces`: values on all faces across the first axis (nx + 1, ny) and the second axis (nx, ny + 1), where face i is
    the lower face of cell i; `cells` (n, 2): cell indices.
    """
    i, j = cells.T
    across, up = faces
    return np.array([[across[i, j], across[i + 1, j]], [up[i, j], up[i, j + 1]]], dtype=np.float64).transpose(2, 0, 1)
