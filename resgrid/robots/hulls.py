"""Convex hulls of points in space as convex pieces with few corners, and distances of points from hulls.

Points in a plane, on a line or in one place have hulls, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.robots.convex import ConvexPiece

TOLERANCE = 2e-4
"""Largest distance, in metres, between an omitted corner and the hull of the corners that a piece retains.

The radius of the piece is the largest distance that occurs, so that the piece still contains all points.
"""

_FEW = 16
"""Largest number of corners of a hull for which all corners are retained."""

_MANY = 96
"""Smallest number of retained corners for which `_COARSE` times the tolerance is accepted.

The cost of proofs grows with the number of corners.
"""

_COARSE = 10
"""Ratio of the tolerance for hulls of at least `_MANY` retained corners to that for hulls of fewer corners."""

_BATCH = 0.9
"""Fraction of the largest distance of any corner from the present hull; one step adds only corners farther than this.

A lower fraction adds corners that the hull no longer needs after the step.
"""

_FLAT = 1e-9
"""Largest extent of a point set along a principal axis for which the set counts as flat along this axis, as a fraction
of the largest extent along a principal axis.
"""

_ROUNDING = 1e-9
"""Distance in metres by which a point may lie outside its piece due to rounding; beyond it AssertionError is raised."""

_PLANE_ROUNDING = 1e-12
"""Largest distance in metres outside the plane of a face for which a point counts as inside of the plane."""

_BLOCK = 200_000
"""Maximum number of pairs of a point and a triangle that are held in memory at once."""

DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
"""The 26 directions (26, 3), not normalized, from the centre of a cube to its faces, edges and corners.

A simplified hull keeps the extreme corner in each of these directions.
"""


@dataclass(frozen=True, eq=False)
class Facets:
    """A convex hull of points in space.

    `corners` (v, 3): corners in metres; `triangles` (t, 3): triangles of the surface, as indices of corners; `planes`
    (f, 4): unit normal ``n`` and number ``d`` of every face, with ``n @ x + d <= 0`` inside; `first, counts` (f,): face
    i consists of the triangles ``first[i]`` to ``first[i] + counts[i] - 1``; `volume`: in cubic metres.  A flat hull
    has triangles, but no faces, and the volume 0.
    """

    corners: NDArray[np.float64]
    triangles: NDArray[np.int64]
    planes: NDArray[np.float64]
    first: NDArray[np.int64]
    counts: NDArray[np.int64]
    volume: float


def convex_hull(points: NDArray[np.float64], tolerance: float = TOLERANCE) -> ConvexPiece:
    """Return a convex piece that contains all points, with few corners.

    Corners that lie within `tolerance` of the hull of the others may be omitted; the radius of the piece then is an
    upper bound on their largest distance from the hull, so that the piece still contains them.

    Parameters
    ----------
    points : ndarray of float64, shape (v, 3)
        Points in metres; they may be repeated, or lie in a plane, on a line or in one place.
    tolerance : float
        Largest radius, in metres, of a piece of up to 96 corners; pieces of more corners may have a radius of up to ten
        times as much.  0 keeps all corners.

    Returns
    -------
    ConvexPiece
        The piece, in the frame of the points.

    Raises
    ------
    InputError
        If there are no points, or a coordinate is not finite.

    Examples
    --------
    >>> from resgrid.robots.hulls import convex_hull
    >>> convex_hull(np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]])).points
    array([[0., 0., 0.],
           [1., 0., 0.]])
    """
    check_points(points)
    hull = facets_of(points)
    kept = hull if len(hull.corners) <= _FEW or tolerance <= 0 else _simplified(hull, tolerance)
    radius = float(distances(hull.corners, kept).max())
    piece = ConvexPiece(kept.corners, radius)
    _check_containment(points, kept, radius)
    return piece


def check_points(points: NDArray[np.float64]) -> None:
    """Raise InputError unless an array (v, 3) holds at least one point, and finite coordinates only."""
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InputError(f"points of shape {points.shape} must be at least one point with three coordinates")
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        raise InputError(f"point {first} = {points[first].tolist()} is not finite; remove or repair it")


def facets_of(points: NDArray[np.float64]) -> Facets:
    """Return the convex hull of finite points (v, 3), computed by qhull in the number of dimensions that they span."""
    from scipy.spatial import ConvexHull, QhullError

    unique = np.unique(points, axis=0)
    rank, axes = _extent(unique)
    if rank == 3:
        try:
            hull = ConvexHull(unique, qhull_options="Qt")
        except QhullError:
            rank = 2
        else:
            number = np.full(len(unique), -1)
            number[hull.vertices] = np.arange(len(hull.vertices))
            planes, face, counts = np.unique(hull.equations, axis=0, return_inverse=True, return_counts=True)
            triangles = number[hull.simplices[np.argsort(face.ravel(), kind="stable")]]
            return Facets(
                unique[hull.vertices], triangles, planes, np.cumsum(counts) - counts, counts, float(hull.volume)
            )
    flat = (unique - unique.mean(axis=0)) @ axes.T
    if rank == 2:
        corners = unique[ConvexHull(flat[:, :2], qhull_options="Qt").vertices]
    else:
        corners = unique[np.unique([flat[:, 0].argmin(), flat[:, 0].argmax()])]
    fan = [(0, max(i, 0), min(i + 1, len(corners) - 1)) for i in range(min(1, len(corners) - 2), len(corners) - 1)]
    none = np.empty(0, dtype=np.int64)
    return Facets(corners, np.array(fan or [(0, 0, 0)]), np.empty((0, 4)), none, none, 0.0)


def _extent(points: NDArray[np.float64]) -> tuple[int, NDArray[np.float64]]:
    """Return the number of dimensions that points (v, 3) span, and their principal axes, longest extent first.

    The axes are the rows of an array (3, 3), unit vectors. Points in a plane span 2 dimensions, equal points 0.
    """
    centred = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    axes = axes.T[::-1]
    extents = np.ptp(centred @ axes.T, axis=0)
    return int((extents > max(_FLAT * extents.max(), 1e-12)).sum()), axes


def _simplified(hull: Facets, tolerance: float) -> Facets:
    """Return a hull of fewer corners, from which every corner of `hull` is at most `tolerance` metres away.

    With 96 or more retained corners, ten times the tolerance is accepted. The hull begins with the extreme corners in
    26 directions; every step adds, for each face, the corner of `hull` that lies farthest outside, if its distance
    exceeds `_BATCH` (0.9) of the largest one. A flat hull is returned unchanged.
    """
    if not len(hull.planes):
        return hull
    centred = hull.corners - hull.corners.mean(axis=0)
    chosen = np.unique((centred @ DIRECTIONS.T).argmax(axis=0))
    while True:
        kept = facets_of(hull.corners[chosen])
        if not len(kept.planes):
            return hull
        gaps = distances(hull.corners, kept)
        largest = gaps.max()
        if largest <= tolerance or (len(chosen) >= _MANY and largest <= _COARSE * tolerance):
            return kept
        outside = np.flatnonzero(gaps > max(tolerance, _BATCH * largest))
        facet = (hull.corners[outside] @ kept.planes[:, :3].T + kept.planes[:, 3]).argmax(axis=1)
        order = np.lexsort((-gaps[outside], facet))
        first = np.r_[True, np.diff(facet[order]) > 0]
        chosen = np.union1d(chosen, outside[order[first]])


def distances(points: NDArray[np.float64], hull: Facets) -> NDArray[np.float64]:
    """Return upper bounds (v,) of the distances of points (v, 3) from a hull; 0 inside.

    The bound is the distance to the face above whose plane the point lies highest; for a flat hull, the distance to the
    nearest triangle.
    """
    result = np.empty(len(points))
    block = max(1, _BLOCK // len(hull.triangles))
    for start in range(0, len(points), block):
        result[start : start + block] = _block_distances(points[start : start + block], hull)
    return result


def _block_distances(points: NDArray[np.float64], hull: Facets) -> NDArray[np.float64]:
    """Return upper bounds (v,) of the distances of points (v, 3) from a hull, without blocks; 0 inside.

    The memory is proportional to the number of points times the number of triangles, which `distances` limits.
    """
    if not len(hull.planes):
        pairs = np.repeat(points, len(hull.triangles), axis=0)
        triangles = np.tile(hull.corners[hull.triangles], (len(points), 1, 1))
        return np.min(_triangle_distances(pairs, triangles).reshape(len(points), -1), axis=1)  # type: ignore[no-any-return]
    heights = points @ hull.planes[:, :3].T + hull.planes[:, 3]
    plane = heights.argmax(axis=1)
    outside = np.flatnonzero(heights[np.arange(len(points)), plane] > _PLANE_ROUNDING)
    result = np.zeros(len(points))
    if len(outside):
        count = hull.counts[plane[outside]]
        first = np.cumsum(count) - count
        own = np.arange(count.sum()) + np.repeat(hull.first[plane[outside]] - first, count)
        pairs = _triangle_distances(np.repeat(points[outside], count, axis=0), hull.corners[hull.triangles[own]])
        result[outside] = np.minimum.reduceat(pairs, first)
    return result


def _triangle_distances(points: NDArray[np.float64], triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return distances (n,) of points (n, 3) from as many triangles (n, 3, 3), also from segments and single points."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    unit = normal / np.where(length > 0, length, 1.0)[:, np.newaxis]
    inside = length > 0
    result = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        along, offset = end - start, points - start
        square = np.einsum("nk,nk->n", along, along)
        part = np.einsum("nk,nk->n", offset, along) / np.where(square > 0, square, 1.0)
        result = np.minimum(result, np.linalg.norm(offset - np.clip(part, 0.0, 1.0)[:, np.newaxis] * along, axis=1))
        inside &= np.einsum("nk,nk->n", offset, np.cross(unit, along)) >= 0
    height: NDArray[np.float64] = np.abs(np.einsum("nk,nk->n", points - a, unit))
    result[inside] = np.minimum(result, height)[inside]
    return result


def _check_containment(points: NDArray[np.float64], kept: Facets, radius: float) -> None:
    """Raise AssertionError unless all points (v, 3) lie within the radius of a hull, apart from rounding errors."""
    worst = float(distances(points, kept).max())
    if worst > radius + _ROUNDING:
        raise AssertionError(f"a point lies {worst} m outside a convex piece of radius {radius} m")
