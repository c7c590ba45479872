"""Triangulation of shapes in space, for pictures."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.validation import with_article
from resgrid.errors import InputError
from resgrid.robots.body import axis_pose
from resgrid.robots.bounded import Bounds
from resgrid.robots.mesh import Mesh
from resgrid.robots.shapes import Ball, Box, HalfSpace, Shape
from resgrid.robots.solids import Capsule, Cylinder, OrientedBox, rigid_pose
from resgrid.robots.voxels import Voxels

SIDES = 24
"""Number of edges of a drawn circle."""

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
"""Triangles (12, 3) of a box, anticlockwise seen from outside, as numbers of corners (rows of `_CORNERS`).

The three numbers in a row of `_CORNERS` select the lower (0) or the upper (1) coordinate x, y and z.
"""

Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Points (v, 3), and triangles (t, 3) as indices of points."""


def triangles_of(shape: Shape, within: Bounds | None = None) -> Triangles:  # noqa: PLR0911
    """Return the surface of a shape in space as triangles, for pictures.

    Round shapes are approximated from inside, with 24 edges per circle.

    Parameters
    ----------
    shape : Shape
        Shape with three coordinates.
    within : tuple of (tuple of float, tuple of float), optional
        Lower and upper corner of the box of the picture, for half-spaces, whose border plane is cut to this box.

    Returns
    -------
    points : ndarray of float64, shape (v, 3)
        Vertices, in axis units.
    triangles : ndarray of int64, shape (t, 3)
        Indices of the three vertices of every triangle, anticlockwise if seen from outside.

    Raises
    ------
    InputError
        If the shape does not have three coordinates, or a half-space is given without `within`.

    Examples
    --------
    >>> from resgrid.robots.drawn_surfaces import triangles_of
    >>> points, triangles = triangles_of(rg.Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    >>> points.shape, triangles.shape
    ((8, 3), (12, 3))
    """
    if shape.ndim != 3:
        raise InputError(f"{with_article(type(shape).__name__)} with {shape.ndim} coordinates has no surface in space")
    match shape:
        case Mesh():
            return shape.points, shape.triangles.astype(np.int64)
        case Voxels():
            return _boxes(shape.corners)
        case Box(lower, upper):
            return _boxes(np.array([[lower, upper]], dtype=np.float64))
        case OrientedBox():
            return shape.corners, _FACES
        case Ball(centre, radius):
            return _revolved(rigid_pose(centre, np.eye(3)), _half_circle(radius, 0.0))
        case Capsule(start, end, radius):
            length = float(np.linalg.norm(np.subtract(end, start)))
            return _revolved(axis_pose(start, end), _half_circle(radius, length))
        case Cylinder(start, end, radius):
            length = float(np.linalg.norm(np.subtract(end, start)))
            profile = np.array([[0.0, -length], [radius, -length], [radius, length], [0.0, length]]) / [1, 2]
            return _revolved(axis_pose(start, end), profile)
        case HalfSpace(normal, offset) if within is not None:
            return _plane_within(np.asarray(normal, dtype=np.float64), offset, np.asarray(within, dtype=np.float64))
    raise InputError("a half-space has no bounded surface; give the box of the picture: within=(lower, upper)")


def _boxes(corners: NDArray[np.float64]) -> Triangles:
    """Return the triangles of axis-aligned boxes; `corners` (b, 2, 3): lower and upper corners."""
    points = np.where(_CORNERS == 1, corners[:, 1:], corners[:, :1])
    return points.reshape(-1, 3), (_FACES + 8 * np.arange(len(corners))[:, np.newaxis, np.newaxis]).reshape(-1, 3)


def _half_circle(radius: float, length: float) -> NDArray[np.float64]:
    """Return the profile (n, 2) of a ball or capsule: distance from the axis and coordinate z, lowest point first.

    The shape is centred at the origin. `length`: length of the capsule's segment, 0 for a ball.
    """
    angle = np.linspace(-np.pi / 2, np.pi / 2, SIDES // 2 + 1)
    profile = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    if not length:
        return profile
    middle = len(profile) // 2
    shift = np.array([0.0, length / 2])
    return np.concatenate([profile[: middle + 1] - shift, profile[middle:] + shift])


def _revolved(pose: NDArray[np.float64], profile: NDArray[np.float64]) -> Triangles:
    """Return the surface of revolution of a profile about the z axis of a pose (4, 4).

    `profile` (n, 2): distance from the axis and coordinate z of points from the lowest to the highest one, which both
    lie on the axis.
    """
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    rings = profile[1:-1]
    around = np.stack(
        [
            rings[:, :1] * np.cos(angle),
            rings[:, :1] * np.sin(angle),
            np.broadcast_to(rings[:, 1:], (len(rings), SIDES)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    local = np.vstack([around, [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]])
    return local @ pose[:3, :3].T + pose[:3, 3], _ring_triangles(len(rings))


@cache
def _ring_triangles(rings: int) -> NDArray[np.int64]:
    """Return the triangles (t, 3) between successive rings of `SIDES` points each, and of the caps at both ends.

    `rings`: number of rings. Points are numbered ring by ring from the lowest on, then the lowest and the highest point
    on the axis, the tips of the caps.
    """
    here = np.arange(SIDES)
    following, bottom, top = (here + 1) % SIDES, rings * SIDES, rings * SIDES + 1
    parts = [np.column_stack([following, here, np.full(SIDES, bottom)])]
    for ring in range(rings - 1):
        low, high = ring * SIDES, (ring + 1) * SIDES
        parts.append(np.column_stack([low + here, low + following, high + following]))
        parts.append(np.column_stack([low + here, high + following, high + here]))
    last = (rings - 1) * SIDES
    parts.append(np.column_stack([last + here, last + following, np.full(SIDES, top)]))
    found = np.concatenate(parts)
    found.setflags(write=False)
    return found


def _plane_within(normal: NDArray[np.float64], offset: float, box: NDArray[np.float64]) -> Triangles:
    """Return the part of the plane ``normal @ x = offset`` in a box (2, 3), as triangles; it may be empty."""
    corners = np.where(_CORNERS == 1, box[1], box[0])
    height = corners @ normal - offset
    edges = [(a, b) for a, b in combinations(range(8), 2) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]
    points = np.array(
        [
            corners[a] + (corners[b] - corners[a]) * (height[a] / (height[a] - height[b]))
            for a, b in edges
            if (height[a] < 0) != (height[b] < 0)
        ]
    ).reshape(-1, 3)
    if len(points) < 3:
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    first = points[0] - points.mean(axis=0)
    second = np.cross(normal, first)
    offsets = points - points.mean(axis=0)
    angle = np.arctan2(offsets @ second / np.linalg.norm(second), offsets @ first / np.linalg.norm(first))
    points = points[np.argsort(angle)]
    fan = [(0, index, index + 1) for index in range(1, len(points) - 1)]
    return points, np.array(fan, dtype=np.int64)
