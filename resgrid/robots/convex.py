"""Types of solid bodies in space: exact surfaces for collision tests, convex covers for proofs of freedom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen

SolidKind = Literal["mesh", "box", "ball", "cylinder", "capsule", "half_space"]
"""Kind of an exact solid; see `Solid`."""


@frozen
@dataclass(frozen=True, eq=False)
class ConvexPiece:
    """A convex set: all points within a distance of the convex hull of some points, or a half-space.

    Attributes
    ----------
    points : ndarray of float64, shape (v, 3)
        Points whose convex hull is the core, in metres, in the frame of the body; for a half-space one point of its
        border plane.
    radius : float
        Distance in metres from the core up to which points belong to the piece (Minkowski sum with a ball).
    normal : ndarray of float64, shape (3,), or None
        Unit normal of a half-space's border plane, which points out of the half-space; None for other pieces.
    """

    points: NDArray[np.float64]
    radius: float = 0.0
    normal: NDArray[np.float64] | None = None


@frozen
@dataclass(frozen=True, eq=False)
class Solid:
    """A body without approximation, for collision tests with coal.

    Attributes
    ----------
    kind : {"mesh", "box", "ball", "cylinder", "capsule", "half_space"}
        Kind of body.
    size : tuple of float
        Lengths in metres: the three sides of a box; radius of a ball; radius and length of a cylinder, and of a
        capsule (length of its straight part); empty for meshes and half-spaces.
    placement : ndarray of float64, shape (4, 4)
        Pose in the frame of the body.  Boxes and balls are centred at the origin of this pose; cylinders and capsules
        too, with their axis along z; a half-space is the set z <= 0.
    points : ndarray of float64, shape (v, 3)
        Vertices of a mesh, in metres, in the frame of `placement`; empty for other kinds.
    triangles : ndarray of int32, shape (t, 3)
        Indices of the three vertices of every triangle of a mesh; empty for other kinds.
    """

    kind: SolidKind
    size: tuple[float, ...]
    placement: NDArray[np.float64]
    points: NDArray[np.float64]
    triangles: NDArray[np.int32]


@frozen
@dataclass(frozen=True, eq=False)
class Body:
    """A solid of a link or of the surroundings, with a convex cover.

    Attributes
    ----------
    name : str
        Name for messages, such as ``"forearm_link"`` or ``"obstacle[2]"``.
    joint : int
        Index of the joint whose frame moves the body; -1 for a body that does not move.
    solid : Solid
        The body itself, in the frame of the joint (of the world for -1).
    hull : ConvexPiece
        One convex set that contains the solid, with the padding.
    pieces : tuple of ConvexPiece
        Convex sets whose union contains the solid, with the padding: closer than the hull if the solid is not convex,
        otherwise only the hull.
    """

    name: str
    joint: int
    solid: Solid
    hull: ConvexPiece
    pieces: tuple[ConvexPiece, ...]
