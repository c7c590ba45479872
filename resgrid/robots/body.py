"""Conversion of shapes in space to exact solids for collision tests, and to bodies, which add convex covers."""

from __future__ import annotations

from math import hypot

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import with_article
from resgrid.errors import InputError
from resgrid.robots.convex import Body, ConvexPiece, Solid, SolidKind
from resgrid.robots.convex_cover import body_of
from resgrid.robots.mesh import Mesh
from resgrid.robots.shapes import Ball, Box, HalfSpace, Shape
from resgrid.robots.solids import Capsule, Cylinder, OrientedBox, rigid_pose
from resgrid.robots.voxels import Voxels

_NO_POINTS, _NO_TRIANGLES = np.empty((0, 3)), np.empty((0, 3), np.int32)


def bodies_of(shape: Shape, name: str, padding: float = 0.0) -> tuple[Body, ...]:
    """Return a shape in space as bodies that do not move: exact solids with convex pieces that contain them.

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
        One body; for `Voxels`, one body for every box of occupied voxels.

    Raises
    ------
    InputError
        If the shape does not have three coordinates, or is a set of cells.
    """
    if shape.ndim != 3:
        raise InputError(
            f"{name}: a robot arm moves in space: a shape needs 3 coordinates, got {shape.ndim}; use a shape in space, "
            "such as a box or a sphere"
        )
    if isinstance(shape, Voxels):
        return tuple(_box(low, high, name, padding) for low, high in shape.corners)
    if isinstance(shape, Box):
        return (_box(np.array(shape.lower, np.float64), np.array(shape.upper, np.float64), name, padding),)
    pieces = shape.pieces if isinstance(shape, Mesh) else 1
    return (body_of(name, -1, solid_of(shape, name), padding=padding, pieces=pieces),)


def solid_of(shape: Shape, name: str) -> Solid:
    """Return a shape with three coordinates as one exact solid, in the frame of the world, in metres.

    `name`: name of the shape, for messages. Raises InputError for axis-aligned boxes and voxels, which `bodies_of`
    converts directly to bodies, and for shapes that are not solids in space.
    """
    match shape:
        case Ball(centre, radius):
            return _solid("ball", (radius,), rigid_pose(centre, np.eye(3)))
        case OrientedBox(centre, size, rotation):
            return _solid("box", size, rigid_pose(centre, rotation))
        case Capsule(start, end, radius):
            return _solid("capsule", (radius, _length(shape)), axis_pose(start, end))
        case Cylinder(start, end, radius):
            return _solid("cylinder", (radius, _length(shape)), axis_pose(start, end))
        case HalfSpace(normal, offset):
            unit = np.asarray(normal, dtype=np.float64) / hypot(*normal)
            return _solid("half_space", (), rigid_pose(unit * (offset / hypot(*normal)), _frame_along(unit)))
        case Mesh():
            used, triangles = np.unique(shape.triangles, return_inverse=True)
            return Solid("mesh", (), np.eye(4), shape.points[used], triangles.reshape(-1, 3).astype(np.int32))
    raise InputError(f"{name}: {with_article(type(shape).__name__)} is not an obstacle for a robot arm")


def _box(lower: NDArray[np.float64], upper: NDArray[np.float64], name: str, padding: float) -> Body:
    """Return the body of an axis-aligned box that does not move, whose solid and hull are this box.

    `lower, upper` (3,): corners in metres; `name`: name of the body; `padding`: distance in metres by which proofs
    enlarge the hull.
    """
    ends = np.stack([lower, upper])
    corners = ends[[[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]], range(3)]
    piece = ConvexPiece(corners, padding)
    solid = _solid("box", tuple((upper - lower).tolist()), rigid_pose((lower + upper) / 2, np.eye(3)))
    return Body(name, -1, solid, piece, (piece,))


def _solid(kind: SolidKind, size: tuple[float, ...], placement: NDArray[np.float64]) -> Solid:
    return Solid(kind, tuple(map(float, size)), placement, _NO_POINTS, _NO_TRIANGLES)


def _length(shape: Cylinder | Capsule) -> float:
    return float(np.linalg.norm(np.subtract(shape.end, shape.start)))


def axis_pose(start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
    """Return the pose (4, 4) with the origin in the middle of a segment, and the z axis from its start to its end.

    The direction of the x axis is arbitrary.  `start, end` (3,): different ends of the segment, in metres.
    """
    low, high = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    return rigid_pose((low + high) / 2, _frame_along((high - low) / np.linalg.norm(high - low)))


def _frame_along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation matrix (3, 3) whose third column is the unit vector `direction` (3,)."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(direction, x), direction])
