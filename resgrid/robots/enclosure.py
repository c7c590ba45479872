"""Test whether points are enclosed by a surface of triangles, by rays that escape from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ESCAPES = 0.1
"""Smallest fraction of rays from a point that miss the surface for which the point counts as outside.

With a smaller fraction the point counts as inside, so that small holes in the surface do not matter.
"""

_RAYS = 128
"""Number of rays from every point."""

_WIDENING = 1e-6
"""Distance, as a fraction of the extent of the surface, by which triangles are widened, so that cracks are closed."""

_BLOCK = 100_000
"""Maximum number of pairs of a ray and a triangle that are held in memory at once."""


def enclosed(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether points lie inside a surface: whether fewer than a tenth of 128 rays from them escape.

    The orientation of the triangles does not matter, and the surface may have cracks and small holes.  For a closed
    surface every ray from a point inside is blocked, so that no such point counts as outside.

    Parameters
    ----------
    points : ndarray of float64, shape (n, 3)
        Points.
    corners : ndarray of float64, shape (t, 3, 3)
        Corners of the triangles.

    Returns
    -------
    ndarray of bool, shape (n,)
        True for points inside; all False without triangles.
    """
    return np.array([_is_enclosed(point, corners) for point in points], dtype=np.bool_)


def _is_enclosed(point: NDArray[np.float64], corners: NDArray[np.float64]) -> bool:
    """Return whether fewer than a tenth of 128 rays from one point (3,) miss all triangles (t, 3, 3)."""
    if not len(corners):
        return False
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    widening = _WIDENING * float((high - low).max())
    if ((point < low - widening) | (point > high + widening)).any():
        return False
    rays = _directions(_RAYS)
    blocked = np.zeros(len(rays), dtype=np.bool_)
    block = max(1, _BLOCK // len(rays))
    for start in range(0, len(corners), block):
        open_rays = np.flatnonzero(~blocked)
        blocked[open_rays] = _blocked(point, rays[open_rays], corners[start : start + block], widening)
    return bool(blocked.mean() > 1 - ESCAPES)


def _blocked(
    point: NDArray[np.float64], rays: NDArray[np.float64], corners: NDArray[np.float64], widening: float
) -> NDArray[np.bool_]:
    """Return the mask (r,) of rays from a point that hit a triangle or pass within a distance of its edges.

    A ray hits a triangle if it passes all three edges on the same side. `point` (3,): start of the rays; `rays` (r, 3):
    unit vectors; `corners` (t, 3, 3): triangles; `widening`: the distance, in the unit of the coordinates.
    Source: triple products of Plücker coordinates (Platis & Theoharis 2003).
    """
    a, b, c = (corners[:, index] - point for index in range(3))
    normal = np.cross(b - a, c - a)
    towards = rays @ normal.T
    distance = np.einsum("tk,tk->t", normal, a)
    ahead = distance * np.sign(towards) >= -widening * np.linalg.norm(normal, axis=1)
    hits = ahead & (towards != 0)
    for start, end in ((a, b), (b, c), (c, a)):
        side = np.cross(start, end)
        hits &= (rays @ side.T) * np.sign(towards) >= -widening * np.linalg.norm(end - start, axis=1)
    return np.asarray(hits.any(axis=1), dtype=np.bool_)


def _directions(count: int) -> NDArray[np.float64]:
    """Return unit vectors (count, 3) spread evenly over the sphere: a Fibonacci lattice."""
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    z = 1.0 - (2 * np.arange(count) + 1.0) / count
    radius = np.sqrt(1.0 - z * z)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])
