"""The cells near a polygon: those near its outline, and those whose centre it encloses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.shapes import Polygon
from resgrid.space import Axis


def mark_polygon(
    out: NDArray[np.bool_], axes: Sequence[Axis], half: Sequence[float], polygon: Polygon, reach: float
) -> None:
    """Mark, in place, the cells of a grid that come within a distance of a polygon.

    A cell meets a polygon if it meets the outline, or if its centre is enclosed.

    Parameters
    ----------
    out : ndarray of bool
        Cells found are set to True.
    axes : sequence of two Axis
        The grid.
    half : sequence of two float
        Half the width of what stands for a cell.
    polygon : Polygon
        The shape.
    reach : float
        The distance, at least 0.
    """
    from resgrid.robots.polygon_kernels import Plane, mark_enclosed, mark_parallelograms

    x, y = axes
    plane = Plane(x.lower, y.lower, x.spacing, y.spacing, half[0], half[1])
    edges = outline(polygon)
    mark_enclosed(out, edges, plane)
    sides = np.hstack([edges[:, :2], edges[:, 2:] - edges[:, :2], np.zeros((len(edges), 2))])
    mark_parallelograms(out, sides, reach, plane)


def outline(polygon: Polygon) -> NDArray[np.float64]:
    """Edges of a polygon, ring by ring.

    Parameters
    ----------
    polygon : Polygon

    Returns
    -------
    ndarray of float64, shape (e, 4)
        ``x0, y0, x1, y1``.
    """
    rings = [np.asarray(ring, dtype=np.float64) for ring in polygon.rings]
    return np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in rings])
