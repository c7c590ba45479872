"""Cells of a grid within a distance of a convex solid in space: proofs by separating planes.

The distance of two disjoint convex sets is the largest gap between their projections on a direction, over all unit
directions.  So every direction whose gap exceeds the reach proves that a cell is free.  For two polytopes the largest
gap occurs at one of finitely many directions: face normals, cross products of edges, and lines from a corner of one to
the nearest point of the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.solids import Capsule, Cylinder, OrientedBox, rotation_matrix

ITERATIONS = 60
"""Number of projections in the search for a direction that separates a cell's box from a cylinder.

A cell for which the search fails is marked as an obstacle.
"""

Vectors = NDArray[np.float64]
"""Points or directions in space, shape (n, 3)."""


def near_convex(
    shape: Cylinder | Capsule | OrientedBox, grids: Sequence[NDArray[np.float64]], half: Sequence[float], reach: float
) -> NDArray[np.bool_]:
    """Return the mask, shape of a block of cells, of cells whose tested box is within a distance of a convex solid.

    The result is exact up to rounding for capsules and oriented boxes.  For cylinders, boxes whose distance exceeds
    `reach` by a tiny amount may be marked too.
    `grids`: cell centres, an array per axis; `half` (3,): half the widths of the box that is tested in place of a cell,
    0 to test only the centre; `reach`: distance; lengths are in axis units.
    """
    centres = np.stack(np.broadcast_arrays(*grids), axis=-1).reshape(-1, 3)
    side = np.asarray(half, dtype=np.float64)
    nearest, within = nearest_point(shape), reach + (shape.radius if isinstance(shape, Capsule) else 0.0)
    distance = _distance(shape, centres)
    near = distance <= within
    open_ = np.flatnonzero(~near & (distance <= (within + np.linalg.norm(side)) * (1.0 + 1e-12)))
    if len(open_) and side.any():
        middle = centres[open_]
        if isinstance(shape, Cylinder):
            near[open_] = _near_cylinder(shape, nearest, middle, side, within)
        else:
            near[open_] = _polytope_gap(shape, nearest, middle, side) <= within
    return np.asarray(near.reshape(np.broadcast_shapes(*(grid.shape for grid in grids))))


def nearest_point(shape: Cylinder | Capsule | OrientedBox) -> Callable[[Vectors], Vectors]:
    """Return a function from points (n, 3) to the nearest points (n, 3) of a solid, the projection on the solid.

    For a capsule, the function returns the nearest points of the capsule's segment.
    """
    if isinstance(shape, OrientedBox):
        turn, extent, centre = rotation_matrix(shape.rotation), np.array(shape.size) / 2, np.array(shape.centre)
        return lambda points: np.asarray(np.clip((points - centre) @ turn, -extent, extent) @ turn.T + centre)
    start, axis = np.array(shape.start, dtype=np.float64), np.subtract(shape.end, shape.start)
    length = float(np.linalg.norm(axis))
    unit, radius = axis / length, shape.radius if isinstance(shape, Cylinder) else 0.0

    def nearest(points: Vectors) -> Vectors:
        along = (points - start) @ unit
        foot = start + along[:, np.newaxis] * unit
        off = points - foot
        shrink = np.minimum(1.0, radius / np.maximum(np.linalg.norm(off, axis=1), 1e-300))
        return np.asarray(start + np.clip(along, 0.0, length)[:, np.newaxis] * unit + shrink[:, np.newaxis] * off)

    return nearest


def _distance(shape: Cylinder | Capsule | OrientedBox, points: Vectors) -> NDArray[np.float64]:
    """Return the distances (n,) of points (n, 3) from a solid, in axis units; exactly 0 inside.

    For a capsule, the distances are those from the capsule's segment, not less its radius.
    """
    if isinstance(shape, OrientedBox):
        local = (points - np.array(shape.centre)) @ rotation_matrix(shape.rotation)
        return np.asarray(np.linalg.norm(np.maximum(np.abs(local) - np.array(shape.size) / 2, 0.0), axis=1))
    start, axis = np.array(shape.start, dtype=np.float64), np.subtract(shape.end, shape.start)
    length = float(np.linalg.norm(axis))
    along = (points - start) @ (axis / length)
    off = np.linalg.norm(points - start - along[:, np.newaxis] * (axis / length), axis=1)
    beyond = np.maximum(np.maximum(-along, along - length), 0.0)
    return np.asarray(np.hypot(np.maximum(off - (shape.radius if isinstance(shape, Cylinder) else 0.0), 0.0), beyond))


def _near_cylinder(
    shape: Cylinder, nearest: Callable[[Vectors], Vectors], centres: Vectors, half: NDArray[np.float64], reach: float
) -> NDArray[np.bool_]:
    """Return the mask (n,) of boxes that cannot be proven to be farther than `reach` from a cylinder.

    Accelerated projections (Nesterov) minimize the distance of a point of the box from the cylinder, which is convex;
    the vector between the two nearest points is the direction of the proof.
    `nearest`: function that returns the nearest points of the cylinder; `centres` (n, 3): centres of the boxes; `half`
    (3,): half their widths; all lengths are in axis units.
    """
    near = np.ones(len(centres), dtype=np.bool_)
    left, at = np.arange(len(centres)), centres.copy()
    tiny = 1e-12 * (shape.radius + float(np.linalg.norm(half)))  # a point inside may have a distance of rounding errors
    ahead, momentum = at.copy(), 1.0
    for _ in range(ITERATIONS):
        middle = centres[left]
        moved = np.clip(nearest(ahead), middle - half, middle + half)
        following = (1.0 + np.sqrt(1.0 + 4.0 * momentum**2)) / 2.0
        ahead = moved + (momentum - 1.0) / following * (moved - at)
        at, momentum = moved, following
        line = at - nearest(at)
        distance = np.linalg.norm(line, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            line /= distance[:, np.newaxis]
        is_free = np.sum(line * middle, axis=1) - np.abs(line) @ half - _cylinder_support(shape, line) > reach
        near[left[is_free]] = False
        keep = ~is_free & (distance > reach + tiny)
        left, at, ahead = left[keep], at[keep], ahead[keep]
        if not len(left):
            break
    return near


def _cylinder_support(shape: Cylinder, directions: Vectors) -> NDArray[np.float64]:
    """Return the largest scalar product (n,) of a point of the cylinder with unit directions (n, 3), in axis units."""
    axis = np.subtract(shape.end, shape.start)
    unit = axis / np.linalg.norm(axis)
    slope = directions @ unit
    ends = np.maximum(directions @ np.array(shape.start), directions @ np.array(shape.end))
    across = np.linalg.norm(directions - slope[:, np.newaxis] * unit, axis=1)
    return np.asarray(ends + shape.radius * across)


def _polytope_gap(
    shape: Capsule | OrientedBox,
    nearest: Callable[[Vectors], Vectors],
    centres: Vectors,
    half: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the distances (n,) of boxes from an oriented box or a capsule's segment; not positive if they meet.

    `nearest`: function that returns the nearest points of the oriented box or segment; `centres` (n, 3): centres of the
    boxes; `half` (3,): half their widths; all lengths are in axis units.
    """
    if isinstance(shape, Capsule):
        corners = np.array([shape.start, shape.end], dtype=np.float64)
        edges, faces = corners[1:] - corners[:1], np.empty((0, 3))
    else:
        corners, edges = shape.corners, rotation_matrix(shape.rotation).T
        faces = edges
    fixed = np.concatenate([np.eye(3), faces, np.cross(edges[:, np.newaxis], np.eye(3)).reshape(-1, 3)])
    length = np.linalg.norm(fixed, axis=1)
    fixed = fixed[length > 1e-12 * length.max()] / length[length > 1e-12 * length.max(), np.newaxis]
    middle, extent, span = centres @ fixed.T, np.abs(fixed) @ half, corners @ fixed.T
    gap = np.maximum(middle - extent - span.max(axis=0), span.min(axis=0) - middle - extent).max(axis=1)
    for corner in corners:
        gap = np.maximum(
            gap, _gap_along(np.clip(corner, centres - half, centres + half) - corner, centres, half, corners)
        )
    for signs in product((-1.0, 1.0), repeat=3):
        tip = centres + np.array(signs) * half
        gap = np.maximum(gap, _gap_along(tip - nearest(tip), centres, half, corners))
    return np.asarray(gap)


def _gap_along(
    directions: Vectors, centres: Vectors, half: NDArray[np.float64], corners: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the signed gaps (n,) between n boxes and a convex hull along directions (n, 3), in axis units.

    The gap is negative if the projections overlap, and minus infinity for a direction of length 0.  `centres` (n, 3):
    centres of the boxes; `half` (3,): half their widths; `corners` (v, 3): points of the hull.
    """
    length = np.linalg.norm(directions, axis=1)
    unit = directions / np.maximum(length, 1e-300)[:, np.newaxis]
    gap = np.sum(unit * centres, axis=1) - np.abs(unit) @ half - (unit @ corners.T).max(axis=1)
    return np.where(length > 0, gap, -np.inf)
