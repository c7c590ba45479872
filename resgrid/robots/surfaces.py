"""Triangulated surfaces of a robot's links and of shapes in space, and heights of floors, for pictures and 3-D."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.robots.bounded import Bounds
from resgrid.robots.convex import Solid
from resgrid.robots.drawn_surfaces import triangles_of
from resgrid.robots.shapes import Ball, Box, HalfSpace, Shape
from resgrid.robots.solids import Capsule, Cylinder
from resgrid.robots.urdf.tree import KinematicTree


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


def link_surfaces(tree: KinematicTree) -> list[Surface]:
    """Return the triangulated surfaces of the bodies of a robot, one per body, in the frames of their joints."""
    return [Surface(body.name, body.joint, *_surface(body.solid)) for body in tree.bodies]


def shape_surfaces(shapes: Iterable[Shape], name: str, within: Bounds) -> list[Surface]:
    """Return the triangulated surfaces of shapes in space, named ``name[0]`` and so on.

    `within`: lower and upper corner of a box, to which the border planes of half-spaces are cut.
    """
    drawn = [triangles_of(shape, within) for shape in shapes]
    return [
        Surface(f"{name}[{number}]", -1, points, triangles.astype(np.int32))
        for number, (points, triangles) in enumerate(drawn)
    ]


def is_floor(shape: Shape) -> bool:
    """Return whether a shape is a floor: the half-space below a horizontal plane, perpendicular to the z axis."""
    return isinstance(shape, HalfSpace) and shape.normal[:2] == (0.0, 0.0) and shape.normal[2] > 0


def floor_height(shapes: Iterable[Shape], otherwise: float) -> float:
    """Return the z coordinate of the highest floor among shapes, in metres; `otherwise` if none is a floor.

    A floor is the half-space below a horizontal plane.
    """
    floors = [shape for shape in shapes if isinstance(shape, HalfSpace) and is_floor(shape)]
    return max((shape.offset / shape.normal[2] for shape in floors), default=otherwise)


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
