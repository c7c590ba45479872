"""Test whether two solids that do not move touch each other, by the collision library coal."""

from __future__ import annotations

import numpy as np

from resgrid.robots.convex import Body, ConvexPiece, Solid
from resgrid.robots.enclosure import enclosed
from resgrid.robots.urdf.exact_solids import coal_geometry, coal_module


def touch(first: Body, second: Body) -> bool:
    """Return whether the exact solids of two bodies in the same frame touch each other, at their placements.

    Bodies whose padded hulls a coordinate axis separates are apart, and so is a body whose padded hull lies outside a
    half-space; these cases do not need the package coal.  Other cases raise ToolMissingError if coal is not installed.
    A solid inside the surface of a mesh touches the mesh.
    """
    if _apart(first.hull, second.hull) or _apart(second.hull, first.hull):
        return False
    coal = coal_module()
    a, b = (coal_geometry(body.solid) for body in (first, second))
    poses = [coal.Transform3s(body.solid.placement[:3, :3], body.solid.placement[:3, 3]) for body in (first, second)]
    if coal.collide(a, poses[0], b, poses[1], coal.CollisionRequest(), coal.CollisionResult()):
        return True
    return _is_inside(first.solid, second.solid) or _is_inside(second.solid, first.solid)


def _is_inside(solid: Solid, mesh: Solid) -> bool:
    """Return whether one point of a solid lies inside the surface of a mesh; False if `mesh` is no mesh.

    If the solid does not cross the surface, all of it is then inside. The point is the first vertex of a mesh, or the
    centre of another solid; the result is False for a half-space.
    """
    if mesh.kind != "mesh" or solid.kind == "half_space":
        return False
    point = solid.placement[:3, 3] + (solid.placement[:3, :3] @ solid.points[0] if solid.kind == "mesh" else 0.0)
    own = mesh.placement[:3, :3].T @ (point - mesh.placement[:3, 3])
    return bool(enclosed(own[np.newaxis], mesh.points[mesh.triangles])[0])


def _apart(first: ConvexPiece, second: ConvexPiece) -> bool:
    """Return whether a coordinate axis, or the normal of a half-space, separates two convex pieces.

    The pieces are in one frame. The result is False if the second piece is a half-space, so that both orders must be
    tried; two half-spaces count as touching.
    """
    if second.normal is not None:
        return False
    if first.normal is not None:
        return bool((second.points @ first.normal).min() - second.radius > first.points[0] @ first.normal)
    gap = first.points.min(axis=0) - second.points.max(axis=0) - first.radius - second.radius
    return bool((gap > 0).any())
