"""Views of bodies in space: images with hidden surfaces, and lines that are thin where a surface hides them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from resgrid.plot.raster import Camera, ImageLayer, Window, composite
from resgrid.plot.style import PATHS


class SpaceView:
    """A view of bodies in space from one direction.

    Parameters
    ----------
    camera : Camera
        Direction of the view.
    window : Window
        Part of the picture plane.
    hidden_depth : float
        Depth, in the unit of the world coordinates: a line is drawn as hidden where it lies farther than this depth
        behind the nearest surface.
    """

    def __init__(self, camera: Camera, window: Window, hidden_depth: float) -> None:
        self.camera, self.window, self.hidden_depth = camera, window, hidden_depth

    def show(self, layers: list[ImageLayer], axes: Axes) -> AxesImage:
        """Draw layers, which hide each other by depth, as one image on axes; return the image."""
        window = self.window
        return axes.imshow(
            composite(layers), origin="lower", extent=(window.left, window.right, window.bottom, window.top),
            interpolation="antialiased", aspect="equal", zorder=2.0,
        )  # fmt: skip

    def draw_line(
        self, points: NDArray[np.float64], axes: Axes, layers: Iterable[ImageLayer], label: str, **style: Any
    ) -> list[Line2D]:
        """Draw a line in space, thin and dotted where a layer hides it; return matplotlib's two lines.

        The first line is dotted and contains all points; the second one contains the visible points only.  `points` (n,
        3): in the world, so close to each other that tests at the points find the hidden parts; `layers`: images that
        can hide the line; `label`: legend entry; `style`: options of matplotlib's plot.
        """
        seen = self.camera.seen(points)
        hidden = self.hidden(points, layers)
        options: dict[str, Any] = {"color": PATHS[0], "linewidth": 1.5, "zorder": 6} | style
        whole = axes.plot(*seen.T[:2], **options | {"linewidth": 0.7, "zorder": 5.5, "linestyle": ":"})
        effects = [Stroke(linewidth=options["linewidth"] + 1.2, foreground="white"), Normal()]
        visible = np.where(hidden[:, np.newaxis], np.nan, seen[:, :2])
        return whole + axes.plot(*visible.T, label=label, path_effects=effects, **options)

    def hidden(self, points: NDArray[np.float64], layers: Iterable[ImageLayer]) -> NDArray[np.bool_]:
        """Return the mask (n,) of points in space that a layer hides; `points` (n, 3): in the world."""
        column, row, depth = self.window.pixels(self.camera.seen(points)).T
        rows, columns = self.window.rows, self.window.columns
        place = row.astype(np.int64).clip(0, rows - 1), column.astype(np.int64).clip(0, columns - 1)
        nearest = np.min([layer.depth[place] for layer in layers], axis=0, initial=np.inf)
        return np.asarray(depth > nearest + self.hidden_depth)


def window_around(seen: NDArray[np.float64], side: int, margin: float) -> Window:
    """Return the window that contains points of the picture plane.

    `seen` (n, 2): coordinates to the right and upwards in the camera's frame; `side`: number of pixels along the longer
    side; `margin`: width of the border around the points, in the unit of `seen`.
    """
    (left, bottom), (right, top) = seen.min(axis=0) - margin, seen.max(axis=0) + margin
    return Window(
        float(left), float(bottom), float(right), float(top), round(side * min(1.0, (top - bottom) / (right - left)))
    )


def subdivided(points: NDArray[np.float64], pieces: int) -> NDArray[np.float64]:
    """Return a polyline (m, ndim) with every segment of `points` (n, ndim) divided into equal pieces."""
    along = np.linspace(0.0, len(points) - 1.0, pieces * (len(points) - 1) + 1)
    return np.stack([np.interp(along, np.arange(len(points)), column) for column in points.T], axis=1)
