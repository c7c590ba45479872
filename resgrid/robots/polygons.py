"""The cells near a polygon: those near its outline, and those whose centre it encloses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.shapes import Box, Point, Polygon
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


def outline(shape: Box | Polygon) -> NDArray[np.float64]:
    """Edges of a polygon or rectangle, ring by ring.

    Parameters
    ----------
    shape : Box or Polygon
        Of the plane.

    Returns
    -------
    ndarray of float64, shape (e, 4)
        ``x0, y0, x1, y1``.
    """
    rings = [np.asarray(ring, dtype=np.float64) for ring in rings_of(shape)]
    return np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in rings])


def rings_of(shape: Box | Polygon) -> tuple[tuple[Point, ...], ...]:
    """Corners of a polygon or rectangle, ring by ring.

    Parameters
    ----------
    shape : Box or Polygon
        Of the plane.

    Returns
    -------
    tuple of rings
    """
    if isinstance(shape, Polygon):
        return shape.rings
    (x0, y0), (x1, y1) = shape.lower, shape.upper
    return (((x0, y0), (x1, y0), (x1, y1), (x0, y1)),)
