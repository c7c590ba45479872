"""The cells near a polygon: those near its outline, and those whose centre it encloses."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.shapes import Box, Point, Polygon, as_polygon
from resgrid.space import Axis

FAR = 1e3
"""So many times the size of the grid a ring may stick out before it is cut off."""


def mark_polygon(
    out: NDArray[np.bool_], axes: Sequence[Axis], half: Sequence[float], polygon: Polygon, reach: float
) -> None:
    """Mark, in place, the cells of a grid that come within a distance of a polygon.

    A cell meets a polygon if it meets the outline, or if its centre is enclosed.
    """
    from resgrid.robots.polygon_kernels import Plane, mark_enclosed, mark_parallelograms

    x, y = axes
    plane = Plane(x.lower, y.lower, x.spacing, y.spacing, half[0], half[1])
    edges = outline(polygon, axes, reach)
    mark_enclosed(out, edges, plane)
    sides = np.hstack([edges[:, :2], edges[:, 2:] - edges[:, :2], np.zeros((len(edges), 2))])
    mark_parallelograms(out, sides, reach, plane)


def outline(shape: Box | Polygon, axes: Sequence[Axis], reach: float) -> NDArray[np.float64]:
    """Edges of a polygon or rectangle, ring by ring.  Returns (e, 4)."""
    margin = reach + max(axis.upper - axis.lower for axis in axes)
    lower, upper = (axes[0].lower - margin, axes[1].lower - margin), (axes[0].upper + margin, axes[1].upper + margin)
    return edges_of([_cut(ring, lower, upper, FAR * margin) for ring in as_polygon(shape).rings])


def edges_of(rings: Sequence[Sequence[Point]]) -> NDArray[np.float64]:
    """Edges of rings.  Returns (e, 4)."""
    corners = [np.asarray(ring, dtype=np.float64) for ring in rings]
    return np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in corners])


def _cut(ring: tuple[Point, ...], lower: Point, upper: Point, far: float) -> Sequence[Point]:
    """The part of a ring in a box, if it has corners far outside (Sutherland and Hodgman, 1974)."""
    beyond = max(max(low - c, c - high) for point in ring for c, low, high in zip(point, lower, upper, strict=True))
    if beyond <= far:
        return ring
    corners: list[tuple[Fraction, ...]] = [tuple(map(Fraction, point)) for point in ring]
    for k, end, sign in ((0, lower, -1), (0, upper, 1), (1, lower, -1), (1, upper, 1)):
        bound = Fraction(end[k])
        kept: list[tuple[Fraction, ...]] = []
        for a, b in zip(corners, [*corners[1:], *corners[:1]], strict=True):
            inside = sign * a[k] <= sign * bound
            if inside:
                kept.append(a)
            if inside != (sign * b[k] <= sign * bound):
                share = (bound - a[k]) / (b[k] - a[k])
                kept.append(tuple(p + share * (q - p) for p, q in zip(a, b, strict=True)))
        corners = kept
    return [tuple(map(float, point)) for point in corners] or [lower]
