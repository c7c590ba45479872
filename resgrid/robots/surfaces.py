"""Triangulated surfaces of solid bodies, for pictures and three-dimensional views."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.robots.convex import Body, Solid

_SIDES = 32
"""Number of sides of the polygons that approximate circles."""

_UNIT_BOX = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


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
    match solid.kind:
        case "mesh":
            points, triangles = solid.points, solid.triangles
        case "box":
            points, triangles = _UNIT_BOX * solid.size, _fans(_BOX_SIDES)
        case "ball":
            points, triangles = _round(solid.size[0], 0.0)
        case "capsule":
            points, triangles = _round(*solid.size)
        case _:
            points, triangles = _cylinder(*solid.size)
    pose = solid.placement
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3]), triangles


def _square(solid: Solid, half: float, around: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return a square of the border plane of a half-space; `half`: half of its side; `around` (3,): see `surfaces_of`.

    Returns vertices (4, 3) and triangles (2, 3).
    """
    x, y, z = solid.placement[:3, :3].T
    foot = around - z * ((around - solid.placement[:3, 3]) @ z)
    corners = [foot + half * (a * x + b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return np.array(corners), _fans(((0, 1, 2, 3),))


def _fans(polygons: Iterable[tuple[int, ...]]) -> NDArray[np.int32]:
    """Return the triangles (t, 3) of convex polygons, each given by the indices of its corners."""
    fans = [(own[0], own[i], own[i + 1]) for own in polygons for i in range(1, len(own) - 1)]
    return np.array(fans, dtype=np.int32)


def _cylinder(radius: float, length: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return vertices and triangles of a cylinder along z, centred at the origin."""
    return _revolved(np.array([[0.0, -0.5], [1.0, -0.5], [1.0, 0.5], [0.0, 0.5]]) * (radius, length))


def _round(radius: float, length: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return vertices and triangles of a capsule along z, centred at the origin; `length`: of its straight part."""
    angles = np.linspace(-pi / 2, pi / 2, _SIDES // 2 + 1)
    profile = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    profile[[0, -1], 0] = 0.0
    half = len(profile) // 2
    shift = np.array([0.0, length / 2])
    lower, upper = profile[: half + 1] - shift, profile[half:] + shift
    return _revolved(np.concatenate([lower, upper]) if length else profile)


def _revolved(profile: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return vertices and triangles of a surface of revolution around z.

    `profile` (n, 2): distance from the axis and height of points of the profile, upwards; the first and the last point
    lie on the axis.
    """
    angle = 2 * pi * np.arange(_SIDES) / _SIDES
    radius, height = profile[1:-1].T
    rings = np.stack(
        [np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle)), np.repeat(height[:, None], _SIDES, axis=1)],
        -1,
    )
    points = np.concatenate([rings.reshape(-1, 3), [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]])
    here = np.arange(_SIDES)
    after, last = (here + 1) % _SIDES, _SIDES * (len(radius) - 1)
    bottom, top = len(points) - 2, len(points) - 1
    sides = [
        part
        for row in range(len(radius) - 1)
        for a, b in [(here + row * _SIDES, after + row * _SIDES)]
        for part in (np.column_stack([a, b, b + _SIDES]), np.column_stack([a, b + _SIDES, a + _SIDES]))
    ]
    caps = [
        np.column_stack([after, here, np.full(_SIDES, bottom)]),
        np.column_stack([last + here, last + after, np.full(_SIDES, top)]),
    ]
    return points, np.concatenate([*sides, *caps]).astype(np.int32)
