"""Images of a field in a plane, with equipotentials."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from resgrid.plot.plane import MOST_CELLS, PicturePlane, block_means, block_size, draw_image
from resgrid.plot.shading import Shading, add_border, fill_open_walls


def draw_shading(
    plane: PicturePlane, shading: Shading, values: NDArray[np.float64], axes: Axes, *, contours: bool = True
) -> AxesImage:
    """Draw values of a field in a plane as an image, with equipotentials if `contours` is True; return the image.

    `values` (plane.x.cells, plane.y.cells): potential or log10 of the drop, NaN in cells without a value; `shading`:
    colour scale, and levels of the equipotentials.
    """
    image = draw_image(
        plane, values, axes, cmap=shading.colours, vmin=shading.lower, vmax=shading.upper,
        zorder=0.5,
    )  # fmt: skip
    if contours:
        _draw_contours(plane, shading, values, axes)
    return image


def _draw_contours(plane: PicturePlane, shading: Shading, values: NDArray[np.float64], axes: Axes) -> None:
    """Draw the equipotentials of values per cell, or of means over blocks on maps of more than 1024 cells a side.

    `values` (plane.x.cells, plane.y.cells): potential or log10 of the drop, NaN in cells without a value; `shading`:
    levels of the equipotentials, and values at obstacles and at the grid's edge.
    """
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
    where = plane.frame.to_world(corner + (index - 0.5) * block * spacing)
    lines = axes.contour(
        where[..., 0], where[..., 1], np.ma.masked_invalid(coarse), levels=levels, colors="black", alpha=0.55,
        linewidths=0.5, linestyles="solid", zorder=1.5,
    )  # fmt: skip
    lines.set_clip_path(Polygon(plane.corners, transform=axes.transData))
    axes.add_line(Line2D([], [], color="black", alpha=0.55, linewidth=0.5, label=shading.lines))
