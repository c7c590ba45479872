"""Convex covers of solids: few convex pieces whose union contains the solid."""

from __future__ import annotations

from itertools import product
from math import ceil, cos, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import check_number, check_whole
from resgrid.robots.convex import Body, ConvexPiece, Solid
from resgrid.robots.hulls import TOLERANCE, convex_hull

__all__ = ["body_of", "convex_cover", "convex_hull", "hull_of"]

_MOST_SIDES = 48
"""Maximum number of sides of the prism around a cylinder; the error then is 0.2 % of the cylinder's radius."""


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
    """Return one convex piece that contains a solid, in the frame of its body."""
    if solid.kind == "half_space":
        return ConvexPiece(solid.placement[np.newaxis, :3, 3].copy(), 0.0, solid.placement[:3, 2].copy())
    if solid.kind == "mesh":
        return convex_hull(_moved(solid.points, solid.placement))
    points, radius = _CORNERS[solid.kind](solid.size)
    return ConvexPiece(_moved(points, solid.placement), radius)


def _box(size: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Return the eight corners of a box and the radius 0; `size`: three sides in metres."""
    return np.array(list(product((-0.5, 0.5), repeat=3))) * size, 0.0


def _ball(size: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Return the centre of a ball and its radius."""
    return np.zeros((1, 3)), size[0]


def _capsule(size: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Return the ends of the axis of a capsule and its radius; `size`: radius and length of the straight part."""
    return np.array([[0.0, 0.0, -size[1] / 2], [0.0, 0.0, size[1] / 2]]), size[0]


def _cylinder(size: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Return the corners of a prism around a cylinder and the radius 0; `size`: radius and length.

    A circumscribed polygon of n sides has corners at ``r / cos(pi / n)``, about ``r pi^2 / (2 n^2)`` from the circle.
    The number of sides keeps this error below `TOLERANCE` if 48 sides suffice.
    """
    radius, length = size
    sides = min(_MOST_SIDES, max(8, ceil(pi * sqrt(radius / (2 * TOLERANCE)))))
    angles = 2 * pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * (radius / cos(pi / sides) * (1 + 1e-15))
    return np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-length / 2, length / 2)]), 0.0


_CORNERS = {"box": _box, "ball": _ball, "capsule": _capsule, "cylinder": _cylinder}
"""Functions that return corners and radius of a primitive solid, by its kind."""


def convex_cover(points: NDArray[np.float64], triangles: NDArray[np.int32], most: int) -> tuple[ConvexPiece, ...]:
    """Return convex pieces whose union contains a mesh: for now its hull."""
    del triangles, most
    return (convex_hull(points),)


def _moved(points: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (v, 3) transformed by a pose (4, 4)."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def _padded(piece: ConvexPiece, padding: float) -> ConvexPiece:
    """Return a piece enlarged by a padding in metres; a half-space moves its border."""
    if piece.normal is not None:
        return ConvexPiece(piece.points + padding * piece.normal, 0.0, piece.normal)
    return ConvexPiece(piece.points, piece.radius + padding)
