"""Cells painted over a picture of a space."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from resgrid.plot.plane import draw_image, plane_of
from resgrid.plot.style import add_swatch
from resgrid.space import ConfigurationSpace

VIRTUAL = "#8c8c8c"


def paint_cells(space: ConfigurationSpace, mask: NDArray[np.bool_], colour: str, label: str, axes: Axes) -> None:
    """Paint cells of a space with two axes over whatever else there is, and name them in the legend.

    Shapes: `mask` as the space.
    """
    pixels = np.zeros((*space.shape, 4), dtype=np.uint8)
    pixels[mask] = np.round(255 * np.array(to_rgba(colour)))
    aspect = axes.get_aspect()
    draw_image(plane_of(space), pixels, axes, zorder=2.2)
    axes.set_aspect(aspect)
    add_swatch(axes, label, colour)
