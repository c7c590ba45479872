"""Triangulated surfaces of solid bodies, for pictures and three-dimensional views."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.robots.convex import Body, Solid
from resgrid.robots.drawn_surfaces import triangles_of
from resgrid.robots.shapes import Ball, Box, Shape
from resgrid.robots.solids import Capsule, Cylinder


@frozen
@dataclass(frozen=True, eq=False)
class Surface:
    """A triangulated surface of a body.

    Attributes
    ----------
    name : str
        Name of the body.
    joint : int
        Index of the joint whose frame moves the surface; -1 for a surface that does not move.
    points : ndarray of float64, shape (v, 3)
        Vertices in metres, in the frame of the joint (of the world for -1).
    triangles : ndarray of int32, shape (t, 3)
        Indices of the three vertices of every triangle, anticlockwise seen from outside.
    """

    name: str
    joint: int
    points: NDArray[np.float64]
    triangles: NDArray[np.int32]


def surfaces_of(bodies: Iterable[Body], *, plane: float, around: NDArray[np.float64]) -> list[Surface]:
    """Return the triangulated surface of every body.

    `plane`: half the side, in metres, of the square that represents the border plane of a half-space; `around` (3,):
    point of the world, whose projection onto the plane is the centre of this square.
    """
    return [
        Surface(
            body.name,
            body.joint,
            *(_square(body.solid, plane, around) if is_half_space(body) else _surface(body.solid)),
        )
        for body in bodies
    ]


def is_half_space(body: Body) -> bool:
    """Return whether a body is a half-space, which has no bounded surface."""
    return body.solid.kind == "half_space"


def _surface(solid: Solid) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return vertices (v, 3) and triangles (t, 3) of a bounded solid, in the frame of its body."""
    if solid.kind == "mesh":
        points, triangles = solid.points, solid.triangles
    else:
        points, drawn = triangles_of(_shape(solid))
        triangles = drawn.astype(np.int32)
    pose = solid.placement
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3]), triangles


def _shape(solid: Solid) -> Shape:
    """Return a box, a ball, a cylinder or a capsule as a shape in the frame of its placement."""
    match solid.kind:
        case "box":
            x, y, z = solid.size
            return Box((-x / 2, -y / 2, -z / 2), (x / 2, y / 2, z / 2))
        case "ball":
            return Ball((0.0, 0.0, 0.0), solid.size[0])
    radius, length = solid.size
    kind = Capsule if solid.kind == "capsule" else Cylinder
    return kind((0.0, 0.0, -length / 2), (0.0, 0.0, length / 2), radius)


def _square(solid: Solid, half: float, around: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return a square of the border plane of a half-space; `half`: half of its side; `around` (3,): see `surfaces_of`.

    Returns vertices (4, 3) and triangles (2, 3).
    """
    x, y, z = solid.placement[:3, :3].T
    foot = around - z * ((around - solid.placement[:3, 3]) @ z)
    corners = [foot + half * (a * x + b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return np.array(corners), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
