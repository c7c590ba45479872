"""Bodies of shapes in space: exact solids for collision tests, and convex pieces for proofs of freedom."""

from __future__ import annotations

from math import cos, hypot, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import with_article
from resgrid.errors import InputError
from resgrid.robots.convex import Body, ConvexPiece, Solid, SolidKind
from resgrid.robots.mesh import Mesh
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape
from resgrid.robots.solids import Capsule, Cylinder, OrientedBox, rigid_pose
from resgrid.robots.voxels import Voxels

PRISM_SIDES = 24
"""Number of sides of the prism around a cylinder, whose edges lie 0.9 % of the radius outside the cylinder."""

_NO_POINTS, _NO_TRIANGLES = np.empty((0, 3)), np.empty((0, 3), np.int32)


def bodies_of(shape: Shape, name: str, padding: float = 0.0) -> tuple[Body, ...]:  # noqa: PLR0911
    """Return a shape in space as bodies that do not move.

    Parameters
    ----------
    shape : Shape
        Shape with three coordinates, in metres.
    name : str
        Name of the bodies, for messages.
    padding : float
        Distance in metres by which the convex pieces are enlarged; the exact solids are not.

    Returns
    -------
    tuple of Body
        One body; of `Voxels` one body for every box.

    Raises
    ------
    InputError
        If the shape does not have three coordinates, or is not a solid with a closed form.
    """
    if shape.ndim != 3:
        raise InputError(
            f"{name}: a robot arm moves in space: a shape needs 3 coordinates, got {shape.ndim}; use a shape in space, "
            "such as a box or a sphere"
        )
    match shape:
        case Voxels():
            return tuple(_box_body(low, high, name, padding) for low, high in shape.corners)
        case Box(lower, upper):
            return (_box_body(np.array(lower, np.float64), np.array(upper, np.float64), name, padding),)
        case Ball(centre, radius):
            solid = _solid("ball", (radius,), rigid_pose(centre, (0.0, 0.0, 0.0)))
            return (_convex_body(name, solid, [centre], radius + padding),)
        case OrientedBox(centre, size, rotation):
            solid = _solid("box", size, rigid_pose(centre, rotation))
            return (_convex_body(name, solid, shape.corners, padding),)
        case Capsule(start, end, radius):
            solid = _solid("capsule", (radius, _length(shape)), _axis_pose(start, end))
            return (_convex_body(name, solid, [start, end], radius + padding),)
        case Cylinder(start, end, radius):
            pose = _axis_pose(start, end)
            solid = _solid("cylinder", (radius, _length(shape)), pose)
            return (_convex_body(name, solid, prism_around(radius, _length(shape), pose), padding),)
        case HalfSpace(normal, offset):
            return (_half_space_body(normal, offset, name, padding),)
        case Mesh():
            return (_mesh_body(shape, name, padding),)
        case CellSet() | Polygon():
            raise InputError(f"{name}: {with_article(type(shape).__name__)} is not an obstacle for a robot arm")


def prism_around(radius: float, length: float, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners (48, 3) of a prism that contains a cylinder, whose sides touch the cylinder.

    `radius`, `length`: of the cylinder, in metres; `pose` (4, 4): of its centre, with the axis along z.
    """
    angle = 2 * pi * np.arange(PRISM_SIDES) / PRISM_SIDES
    outer = radius / cos(pi / PRISM_SIDES)
    ring = np.column_stack([outer * np.cos(angle), outer * np.sin(angle)])
    ends = [np.column_stack([ring, np.full(PRISM_SIDES, z)]) for z in (-length / 2, length / 2)]
    return np.asarray(np.concatenate(ends) @ pose[:3, :3].T + pose[:3, 3])


def _box_body(lower: NDArray[np.float64], upper: NDArray[np.float64], name: str, padding: float) -> Body:
    """Return the body of an axis-aligned box; `lower, upper` (3,): corners in metres."""
    pose = np.eye(4)
    pose[:3, 3] = (lower + upper) / 2
    ends = np.stack([lower, upper])
    corners = ends[[[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]], range(3)]
    return _convex_body(name, _solid("box", tuple((upper - lower).tolist()), pose), corners, padding)


def _half_space_body(normal: tuple[float, ...], offset: float, name: str, padding: float) -> Body:
    """Return the body of the half-space ``normal @ x <= offset``, whose frame has its z axis along the normal."""
    unit = np.asarray(normal, dtype=np.float64) / hypot(*normal)
    foot = unit * (offset / hypot(*normal))
    piece = ConvexPiece(foot[np.newaxis], padding, unit)
    return Body(name, -1, _solid("half_space", (), rigid_pose(foot, _frame_along(unit))), piece, (piece,))


def _mesh_body(mesh: Mesh, name: str, padding: float) -> Body:
    """Return the body of a mesh, with its convex hull as the only piece."""
    solid = Solid("mesh", (), np.eye(4), mesh.points, mesh.triangles)
    return _convex_body(name, solid, _extreme_points(mesh.points[np.unique(mesh.triangles)]), padding)


def _extreme_points(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners of the convex hull of points (n, 3); all points if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return points


def _solid(kind: SolidKind, size: tuple[float, ...], placement: NDArray[np.float64]) -> Solid:
    return Solid(kind, tuple(map(float, size)), placement, _NO_POINTS, _NO_TRIANGLES)


def _convex_body(name: str, solid: Solid, points: ArrayLike, radius: float) -> Body:
    """Return the body of a convex solid, covered by all points within a radius of the hull of `points` (n, 3)."""
    piece = ConvexPiece(np.array(points, dtype=np.float64), radius)
    return Body(name, -1, solid, piece, (piece,))


def _length(shape: Cylinder | Capsule) -> float:
    return float(np.linalg.norm(np.subtract(shape.end, shape.start)))


def _axis_pose(start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
    """Return the pose (4, 4) of the middle of a segment with the z axis along the segment."""
    low, high = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    return rigid_pose((low + high) / 2, _frame_along((high - low) / np.linalg.norm(high - low)))


def _frame_along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation matrix (3, 3) whose third column is the unit vector `direction` (3,)."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(direction, x), direction])
