"""Bodies with convex covers: few convex pieces whose union contains an exact solid."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import ceil, cos, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import check_number, check_whole
from resgrid.robots.convex import Body, ConvexPiece, Solid
from resgrid.robots.enclosure import enclosed
from resgrid.robots.hulls import TOLERANCE, check_points, convex_hull, distances, facets_of
from resgrid.robots.mesh_cuts import PlaneCut, best_cut, clip, is_concave

__all__ = ["body_of", "convex_cover", "convex_hull", "hull_of"]

_LEAST_GAIN = 0.005
"""Smallest useful reduction of the cost by a cut, as a fraction of the volume of the convex hull of the mesh.

The cost of a set of parts is the volume of their hulls plus 0.2 times the depth of the surface below the hulls,
integrated over the surface.
"""

_LEAST_SAVING = 0.1
"""Least saving of a cover of several pieces, as a fraction of the volume of the mesh's convex hull.

The saving is the volume of the hull minus the total volume of the pieces.  If it is smaller, the hull alone is the
cover.
"""

_PREFERENCE = 1.2
"""Ratio of the cost saved by the best cut along a principal axis to that along a coordinate axis of the mesh.

Above this ratio, the principal axes replace the coordinate axes as directions of cuts.
"""

_SEAM = 1e-14
"""Rounding error of the corners on a cut, as a fraction of the largest coordinate; added to the radius of a piece."""

_MOST_SIDES = 48
"""Maximum number of sides of the prism around a cylinder.

With this number the corners of the prism lie at 0.2 % of the radius outside the cylinder.
"""


def body_of(name: str, joint: int, solid: Solid, *, padding: float = 0.0, pieces: int = 1) -> Body:
    """Return a body with a convex cover.

    Boxes, balls, capsules and half-spaces are covered exactly, cylinders by a prism with up to 48 sides.

    Parameters
    ----------
    name : str
        Name for messages.
    joint : int
        Index of the joint whose frame carries the body; -1 for the world.
    solid : Solid
        Exact solid in the frame of the joint.
    padding : float
        Metres added to every piece in all directions, at least 0.
    pieces : int
        Maximum number of convex pieces of a mesh, at least 1.

    Returns
    -------
    Body
        The body; its hull and its pieces contain the solid.

    Raises
    ------
    InputError
        If the padding is negative, or a mesh has no points or a coordinate that is not finite.
    """
    check_number("padding", padding, "a number of metres, at least 0", least=0)
    check_whole("pieces", pieces, 1)
    hull = _padded(hull_of(solid), padding)
    if solid.kind != "mesh" or pieces == 1:
        return Body(name, joint, solid, hull, (hull,))
    points = _moved(solid.points, solid.placement)
    cover = tuple(_padded(piece, padding) for piece in convex_cover(points, solid.triangles, pieces))
    return Body(name, joint, solid, hull, cover if len(cover) > 1 else (hull,))


def hull_of(solid: Solid) -> ConvexPiece:
    """Return one convex piece that contains a solid, without padding, in metres in the frame of its body."""
    if solid.kind == "half_space":
        return ConvexPiece(solid.placement[np.newaxis, :3, 3].copy(), 0.0, solid.placement[:3, 2].copy())
    if solid.kind == "mesh":
        return convex_hull(_moved(solid.points, solid.placement))
    points, radius = _CORNERS[solid.kind](solid.size)
    return ConvexPiece(_moved(points, solid.placement), radius)


def _box(size: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Return the corners (8, 3) of a box, centred at the origin, and the radius 0; `size`: three sides in metres."""
    return np.array(list(product((-0.5, 0.5), repeat=3))) * size, 0.0


def _ball(size: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Return the centre (1, 3) of a ball, the origin, and its radius; `size`: radius in metres."""
    return np.zeros((1, 3)), size[0]


def _capsule(size: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Return the ends (2, 3) of the segment of a capsule along z, centred at the origin, and its radius.

    `size`: radius and length of the straight part, in metres.
    """
    return np.array([[0.0, 0.0, -size[1] / 2], [0.0, 0.0, size[1] / 2]]), size[0]


def _cylinder(size: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Return the corners (2 n, 3) of a prism around a cylinder along z, centred at the origin, and the radius 0.

    `size`: radius and length in metres.
    A circumscribed polygon of n sides has corners at ``r / cos(pi / n)``, about ``r pi^2 / (2 n^2)`` from the circle.
    The number of sides keeps this error below `TOLERANCE` if 48 sides suffice.
    """
    radius, length = size
    sides = min(_MOST_SIDES, max(8, ceil(pi * sqrt(radius / (2 * TOLERANCE)))))
    angles = 2 * pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * (radius / cos(pi / sides) * (1 + 1e-15))
    return np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-length / 2, length / 2)]), 0.0


_CORNERS = {"box": _box, "ball": _ball, "capsule": _capsule, "cylinder": _cylinder}
"""For every kind of primitive solid: function of its size that returns points (v, 3) and radius of a convex piece."""


def convex_cover(points: NDArray[np.float64], triangles: NDArray[np.int32], most: int) -> tuple[ConvexPiece, ...]:
    """Return convex pieces whose union contains a mesh with everything that its surface encloses.

    The mesh is cut by planes perpendicular to three axes, one part after the other, where a cut brings the hulls
    closest to the mesh.  Every part is the piece of the surface inside a box (unbounded where no cut bounds it), and
    its convex piece is the hull of the clipped triangles and of the enclosed corners of the box.

    The hull contains the enclosed points of the box, for these reasons.  From an enclosed point, both directions of any
    line reach the surface before infinity.  Within the box they reach the surface, which is in the hull, or they leave
    the box through a face at a point that is enclosed too.  The same holds for a line within the face, which reaches
    the surface or an edge of the box, and for the edge, which reaches the surface or an enclosed corner.  Therefore the
    point is a convex combination of points of the surface and enclosed corners.  Unbounded faces and edges end at the
    surface, so that parallel cuts need no corners.

    Parameters
    ----------
    points : ndarray of float64, shape (v, 3)
        Vertices in metres.
    triangles : ndarray of int, shape (t, 3)
        Indices of the corners of the triangles; their orientation does not matter.
    most : int
        Maximum number of pieces, at least 1.

    Returns
    -------
    tuple of ConvexPiece
        Pieces in the frame of the points, at least one.

    Raises
    ------
    InputError
        If there are no points, or a coordinate is not finite.
    """
    check_points(points)
    whole = (convex_hull(points),)
    if most == 1 or not len(triangles):
        return whole
    if _volume(whole[0]) - _mesh_volume(points[triangles]) <= _LEAST_SAVING * _volume(whole[0]):
        return whole
    axes = _axes(points, points[triangles])
    surface = points[triangles] @ axes.T
    parts = _parts(surface, most)
    if len(parts) == 1:
        return whole
    pieces = [_piece(part, surface) for part in parts]
    cover = tuple(ConvexPiece(piece.points @ axes, piece.radius) for piece in pieces if piece is not None)
    if sum(map(_volume, cover)) > (1 - _LEAST_SAVING) * _volume(whole[0]):
        return whole
    _check_cover(points[np.unique(triangles)], cover)
    return cover


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a surface inside a box.

    `corners` (t, 3, 3): clipped triangles of the surface in the box; `box` (2, 3): lower and upper corner, infinite
    where no cut bounds the box; `cut`: the cut of this part with the largest estimated gain, the reduction of the cost
    (volume of the hulls plus 0.2 times the depth below them, integrated over the surface) in cubic metres.
    """

    corners: NDArray[np.float64]
    box: NDArray[np.float64]
    cut: PlaneCut


def _axes(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return three unit vectors (3, 3) as rows, perpendicular to which a mesh is cut.

    These are the principal axes of the vertices if the best cut perpendicular to one of them gains more than
    1.2 times as much as the best one perpendicular to a coordinate axis; otherwise the coordinate axes.
    `points` (v, 3): vertices; `corners` (t, 3, 3): triangles.
    """
    centred = points - points.mean(axis=0)
    principal = np.linalg.eigh(centred.T @ centred)[1].T
    own = best_cut(corners).gain
    return principal if best_cut(corners @ principal.T).gain > _PREFERENCE * own else np.eye(3)


def _parts(surface: NDArray[np.float64], most: int) -> list[_Part]:
    """Return at most `most` parts of a surface (t, 3, 3); repeatedly cut the part whose cut reduces the cost most.

    The cost is the volume of the parts' hulls plus 0.2 times the depth of the surface below them, integrated over the
    surface.  The division ends when no cut reduces the cost by more than 0.005 times the volume of the surface's hull.
    """
    least = _LEAST_GAIN * facets_of(surface.reshape(-1, 3)).volume
    parts = [_part(surface, np.array([[-np.inf] * 3, [np.inf] * 3]), least)]
    while len(parts) < most:
        index = max(range(len(parts)), key=lambda number: parts[number].cut.gain)
        if parts[index].cut.gain <= least:
            break
        parts[index : index + 1] = _halves(parts[index], least)
    return parts


def _part(corners: NDArray[np.float64], box: NDArray[np.float64], least: float) -> _Part:
    """Return a part of a surface with its best cut: the cut with the largest gain (reduction of the cost).

    In a concave part, the cut through the middle of the longest side also counts, with a third of the summed gains of
    the best cuts of both halves.  This matters for rings: two halves have hulls as large as the ring's hull, four
    quarters have smaller hulls.
    `corners` (t, 3, 3): triangles in the box; `box` (2, 3): lower and upper corner; `least`: smallest useful gain, in
    cubic metres.
    """
    cut = best_cut(corners)
    if is_concave(corners, least):
        extent = np.ptp(corners, axis=(0, 1))
        axis = int(extent.argmax())
        position = float(corners[:, :, axis].min() + extent[axis] / 2)
        ahead = sum(best_cut(clip(corners, axis, position, side)).gain for side in (-1, 1))
        cut = PlaneCut(axis, position, ahead / 3) if ahead / 3 > cut.gain else cut
    return _Part(corners, box, cut)


def _halves(part: _Part, least: float) -> list[_Part]:
    """Return the two parts into which a part's cut divides it, the lower one first.

    `least`: smallest useful gain of the further cuts, in cubic metres.
    """
    halves = []
    for side in (-1, 1):
        box = part.box.copy()
        box[(1 - side) // 2, part.cut.axis] = part.cut.position
        halves.append(_part(clip(part.corners, part.cut.axis, part.cut.position, side), box, least))
    return halves


def _piece(part: _Part, surface: NDArray[np.float64]) -> ConvexPiece | None:
    """Return the hull of a part's triangles and of the corners of its box that the surface encloses.

    `surface` (t, 3, 3): the whole surface. The result is None if there are neither triangles nor such corners.
    """
    points = part.corners.reshape(-1, 3)
    corners = np.array(list(product(*part.box.T)))
    corners = corners[np.isfinite(corners).all(axis=1)]
    if len(corners) and len(points):
        corners = corners[distances(corners, facets_of(points)) > 0]
    points = np.concatenate([points, corners[enclosed(corners, surface)]])
    if not len(points):
        return None
    piece = convex_hull(points)
    return ConvexPiece(piece.points, piece.radius + _SEAM * float(np.abs(points).max()))


def _volume(piece: ConvexPiece) -> float:
    """Return the volume of the convex hull of a piece's points in cubic metres, without its radius."""
    return facets_of(piece.points).volume


def _mesh_volume(corners: NDArray[np.float64]) -> float:
    """Return the volume in cubic metres, not negative, inside a closed, oriented surface of triangles (t, 3, 3)."""
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return abs(float(np.einsum("tk,tk->", a, np.cross(b, c)))) / 6


def _check_cover(points: NDArray[np.float64], cover: tuple[ConvexPiece, ...]) -> None:
    """Raise AssertionError unless every vertex (v, 3) lies in a piece or at most 1e-9 m outside."""
    gaps = np.min([distances(points, facets_of(piece.points)) - piece.radius for piece in cover], axis=0)
    if gaps.max() > 1e-9:
        raise AssertionError(f"a vertex lies {gaps.max()} m outside the convex cover")


def _moved(points: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (v, 3) transformed by a pose (4, 4)."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def _padded(piece: ConvexPiece, padding: float) -> ConvexPiece:
    """Return a piece enlarged by a padding in metres; the border plane of a half-space is moved outwards."""
    if piece.normal is not None:
        return ConvexPiece(piece.points + padding * piece.normal, 0.0, piece.normal)
    return ConvexPiece(piece.points, piece.radius + padding)
