"""Exact solids as geometries of the collision library coal, with poses and bounding boxes; points inside meshes."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.extras import install_command
from resgrid.errors import ToolMissingError
from resgrid.robots.convex import Solid

_Floats = NDArray[np.float64]

ENLARGED = 1e-9
"""Distance in metres by which every side of a bounding box is moved outwards, to allow for rounding errors."""


class PlacedSolid:
    """A solid as a coal geometry with a pose.

    Parameters
    ----------
    solid : Solid
        The solid.
    joint : int
        Index of the joint whose frame carries the solid; -1 for a solid that does not move.

    Attributes
    ----------
    joint : int
        Index of the joint whose frame carries the solid; -1 for a solid that does not move.
    geometry, pose : coal.CollisionGeometry, coal.Transform3s
        Geometry, and its present pose in the world (at first the solid's placement): arguments of coal's functions.
    """

    def __init__(self, solid: Solid, joint: int) -> None:
        self.joint, self._placement = joint, np.asarray(solid.placement)
        self.geometry, self.pose = coal_geometry(solid), coal_module().Transform3s()
        self.pose.setTransform(self._placement[:3, :3], self._placement[:3, 3])
        lower, upper = _extent(solid)
        self._is_bounded = bool(np.isfinite(lower).all())
        self._centre = (lower + upper) / 2 if self._is_bounded else np.zeros(3)
        self._half = (upper - lower) / 2 + ENLARGED
        self._interior = _Interior(solid) if solid.kind == "mesh" else None
        self._point = solid.points[0] if solid.kind == "mesh" else np.zeros(3)

    def worlds(self, frames: _Floats) -> _Floats:
        """Return the poses of the solid in the world, (n, 4, 4), or (1, 4, 4) for a solid that does not move.

        `frames` (n, k, 4, 4): poses of the k joints in the world at n configurations.
        """
        if self.joint < 0:
            return self._placement[np.newaxis]
        return np.asarray(frames[:, self.joint] @ self._placement)

    def boxes(self, worlds: _Floats) -> tuple[_Floats, _Floats]:
        """Return centres and half sides, (n, 3) each, in metres, of boxes along the axes of the world around the solid.

        `worlds` (n, 4, 4): poses of the solid in the world.  The half sides are infinite for a half-space.
        """
        rotations = worlds[:, :3, :3]
        half = np.abs(rotations) @ self._half if self._is_bounded else np.full((len(worlds), 3), np.inf)
        return rotations @ self._centre + worlds[:, :3, 3], half

    def move(self, worlds: _Floats, index: int) -> None:
        """Set `pose` to ``worlds[index]``; without effect for a solid that does not move.

        `worlds` (n, 4, 4): poses of the solid in the world.
        """
        if self.joint >= 0:
            self.pose.setTransform(worlds[index, :3, :3], worlds[index, :3, 3])

    def contains_a_point_of(self, other: PlacedSolid) -> bool:
        """Return whether this solid is a closed mesh that contains one point of another solid, at the present poses.

        The point is the first vertex of a mesh, or the centre of another solid; a half-space gives False.
        """
        if self._interior is None or not self._interior.is_closed or not other._is_bounded:
            return False
        return self._interior.contains(self.pose.inverseTimes(other.pose).transform(other._point))


class _Interior:
    """Test of points inside a mesh with a closed surface, by the winding number of van Oosterom and Strackee (1983).

    `lower, upper` (3,): corners of the mesh's bounding box; `is_closed`: whether every edge is used once in either
    direction; `corners` (t, 3, 3): vertices of the triangles, None for an open surface.
    """

    def __init__(self, solid: Solid) -> None:
        points, triangles = np.asarray(solid.points), np.asarray(solid.triangles)
        self.lower, self.upper = points.min(axis=0), points.max(axis=0)
        _, same = np.unique(points, axis=0, return_inverse=True)
        welded = same.reshape(-1)[triangles]
        welded = welded[(welded != np.roll(welded, 1, axis=1)).all(axis=1)]
        edges = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]])
        forward, count = np.unique(edges, axis=0, return_counts=True)
        backward = np.unique(edges[:, ::-1], axis=0)
        self.is_closed = bool((count == 1).all() and np.array_equal(forward, backward))
        self.corners = points[triangles] if self.is_closed else None

    def contains(self, point: _Floats) -> bool:
        """Return whether a point (3,) in the frame of the mesh is inside; always False for an open surface."""
        if self.corners is None or (point <= self.lower).any() or (point >= self.upper).any():
            return False
        a, b, c = np.moveaxis(self.corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.einsum("ti,ti->t", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("ti,ti->t", x, y) for x, y in ((a, b), (b, c), (c, a)))
        angle = np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        return bool(abs(angle.sum()) > np.pi)


def _extent(solid: Solid) -> tuple[_Floats, _Floats]:
    """Return the lower and upper corner (3,) of a bounding box, in metres, in the frame of the solid's placement.

    Coordinates are infinite for a half-space, except for its border at z = 0.
    """
    if solid.kind == "half_space":
        return np.full(3, -np.inf), np.array([np.inf, np.inf, 0.0])
    if solid.kind == "mesh":
        return np.asarray(solid.points.min(axis=0)), np.asarray(solid.points.max(axis=0))
    if solid.kind == "box":
        half = np.array(solid.size) / 2
    elif solid.kind == "ball":
        half = np.full(3, solid.size[0])
    else:
        radius, length = solid.size
        half = np.array([radius, radius, length / 2 + (radius if solid.kind == "capsule" else 0.0)])
    return -half, half


def coal_geometry(solid: Solid) -> Any:
    """Return a solid as a geometry of the package coal, in the frame of the solid's placement, in metres."""
    coal = coal_module()
    if solid.kind == "half_space":
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    if solid.kind == "mesh":
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(solid.triangles), len(solid.points))
        model.addVertices(np.asarray(solid.points, dtype=np.float64))
        model.addTriangles(np.asarray(solid.triangles, dtype=np.int64))
        model.endModel()
        return model
    makers = {"box": coal.Box, "ball": coal.Sphere, "cylinder": coal.Cylinder, "capsule": coal.Capsule}
    return makers[solid.kind](*(float(size) for size in solid.size))


@cache
def coal_module() -> Any:
    """Return the module coal; raise ToolMissingError if it is not installed."""
    try:
        return import_module("coal")
    except ImportError as error:
        raise ToolMissingError(
            f"collision tests of robots need the package coal; install it with: {install_command('robots')}"
        ) from error
