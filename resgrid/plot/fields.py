"""Pictures of spaces and fields in the plane: cells, potential with equipotentials, currents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from resgrid.planning.fields import Field
from resgrid.plot.figures import axes_or_new
from resgrid.plot.plane import (
    MOST_CELLS,
    Plane,
    block_means,
    block_size,
    draw_cells,
    draw_image,
    finish,
    plane_of,
)  # fmt: skip
from resgrid.plot.shading import Scale, Shading, add_border, fill_open_walls, no_drop, shading_of, span
from resgrid.plot.style import NO_DROP, add_colour_bar, add_swatch, spanning, strength_map

_ARROWS = 26
_ARROW_LENGTH = 0.85
"""In blocks of cells."""


def draw_potential(field: Field, ax: Axes | None = None, *, scale: Scale = "auto", contours: bool = True) -> Axes:
    """Draw the potential of a field of two axes as an image with equipotential lines."""
    plane = plane_of(field.space)
    shading = shading_of(field, scale)
    axes = axes_or_new(ax, plane.aspect)
    image = draw_shading(plane, shading, shading.values, axes, contours=contours)
    draw_no_drop(plane, no_drop(field, shading), axes)
    draw_cells(plane, axes)
    finish(plane, axes)
    add_colour_bar(image, axes, shading.label)
    return axes


def draw_currents(field: Field, ax: Axes | None = None) -> Axes:
    """Draw the direction of the current by arrows of one length, and its magnitude by their colour."""
    plane = plane_of(field.space)
    axes = axes_or_new(ax, plane.aspect)
    draw_cells(plane, axes)
    arrows = current_arrows(field, -(-plane.cells_shown // _ARROWS))
    if len(arrows.tail):
        width = max(0.06 * axes.get_window_extent().width / min(plane.cells_shown, _ARROWS), 1.0)
        quiver = axes.quiver(
            *plane.place(field.space.axis_centre(arrows.tail)).T, *plane.turn(arrows.vector).T, arrows.decades,
            cmap=strength_map(), norm=spanning(*span(arrows.decades)), angles="xy", scale_units="xy", scale=1.0,
            pivot="mid", units="dots", width=width, zorder=3,
        )  # fmt: skip
        add_colour_bar(quiver, axes, r"$\log_{10}$ of current, in supply / $R$")
    finish(plane, axes)
    return axes


def draw_shading(
    plane: Plane, shading: Shading, values: NDArray[np.float64], axes: Axes, *, contours: bool = True
) -> AxesImage:
    """Draw values of a field in a plane, with equipotentials."""
    image = draw_image(
        plane, values, axes, cmap=shading.colours, vmin=shading.lower, vmax=shading.upper,
        zorder=0.5,
    )  # fmt: skip
    if contours:
        _draw_contours(plane, shading, values, axes)
    return image


def draw_no_drop(plane: Plane, where: NDArray[np.bool_], axes: Axes) -> None:
    """Colour the cells that stay at the high rail."""
    if where.any():
        draw_image(plane, np.where(where, 1.0, np.nan), axes, cmap=ListedColormap([NO_DROP]), zorder=1.0)
        add_swatch(axes, "at the high rail", NO_DROP)


def _draw_contours(plane: Plane, shading: Shading, values: NDArray[np.float64], axes: Axes) -> None:
    block = block_size(values.shape, MOST_CELLS)
    coarse = block_means(values, block)
    if shading.wall is None:
        coarse = fill_open_walls(coarse)
    coarse = add_border(coarse, shading.edge, shading.wall)
    finite = coarse[np.isfinite(coarse)]
    if not finite.size:
        return
    levels = shading.levels[(shading.levels > finite.min()) & (shading.levels < finite.max())]
    if not levels.size:
        return
    index = np.stack(np.meshgrid(*(np.arange(n) for n in coarse.shape), indexing="ij"), axis=-1)
    corner = np.array([plane.x.lower, plane.y.lower])
    spacing = np.array([plane.x.spacing, plane.y.spacing])
    where = plane.place(corner + (index - 0.5) * block * spacing)
    lines = axes.contour(
        where[..., 0], where[..., 1], np.ma.masked_invalid(coarse), levels=levels, colors="black", alpha=0.55,
        linewidths=0.5, linestyles="solid", zorder=1.5,
    )  # fmt: skip
    lines.set_clip_path(Polygon(plane.corners, transform=axes.transData))
    axes.add_line(Line2D([], [], color="black", alpha=0.55, linewidth=0.5, label=shading.lines))


class Arrows(NamedTuple):
    """Arrows of the current, all equally long when measured in cells.

    `tail` (n, 2): cells that show one; `vector` (n, 2): in axis units; `decades` (n,): log10 of the current through the
    cell, in units of supply / resistance.
    """

    tail: NDArray[np.int64]
    vector: NDArray[np.float64]
    decades: NDArray[np.float64]


def current_arrows(field: Field, block: int) -> Arrows:
    """One arrow in each block of cells, by the mean velocity of opposite faces; in logarithms, for faint currents."""
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
    """In every block of cells, the eligible one nearest to the middle.  Returns (n, 2)."""
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
    """Values on the lower and upper face of cells across both axes, shape (n, 2, 2)."""
    i, j = cells.T
    across, up = faces
    return np.array([[across[i, j], across[i + 1, j]], [up[i, j], up[i, j + 1]]], dtype=np.float64).transpose(2, 0, 1)
