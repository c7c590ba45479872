"""Convex shapes in space (cylinders, capsules, boxes in any orientation); rotation matrices and rigid poses."""

from __future__ import annotations

from dataclasses import dataclass
from math import dist, pi, sqrt
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import checked
from resgrid.core.axis import LARGEST, Coordinate, Point
from resgrid.errors import InputError
from resgrid.robots.bounded import Bounded, Bounds, translated

SpacePoint = tuple[Coordinate, Coordinate, Coordinate]
"""Coordinates x, y and z."""

Length = Annotated[float, Gt(0), Le(LARGEST)]
Angle = Annotated[float, Ge(-8 * pi), Le(8 * pi)]


@checked
@dataclass(frozen=True)
class Cylinder(Bounded):
    """A solid circular cylinder in space.

    Parameters
    ----------
    start, end : tuple of (float, float, float)
        Centres of the two end faces, in axis units.
    radius : float
        Radius in axis units, above 0.

    Raises
    ------
    InputError
        If a number is not finite, the radius is not above 0, or both ends are equal.

    Examples
    --------
    >>> pillar = rg.Cylinder((1.0, 1.0, 0.0), (1.0, 1.0, 2.0), radius=0.25)
    >>> pillar.bounds
    ((0.75, 0.75, 0.0), (1.25, 1.25, 2.0))
    """

    start: SpacePoint
    end: SpacePoint
    radius: Length

    def __post_init__(self) -> None:
        _require_axis("cylinder", self.start, self.end)

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the cylinder's bounding box, in axis units."""
        length = dist(self.start, self.end)
        # An end face with unit normal n reaches radius * sqrt(1 - n_i**2) along axis i.
        reach = [
            self.radius * sqrt(max(0.0, (1.0 - (b - a) / length) * (1.0 + (b - a) / length)))
            for a, b in zip(self.start, self.end, strict=True)
        ]
        return _around(self.start, self.end, reach)

    def shifted(self, by: Point) -> Cylinder:
        """Return the cylinder translated by the vector `by`, in axis units."""
        return Cylinder(translated(self.start, by), translated(self.end, by), self.radius)  # type: ignore[arg-type]


@checked
@dataclass(frozen=True)
class Capsule(Bounded):
    """All points of space within a distance of a segment: a cylinder with round ends.

    Parameters
    ----------
    start, end : tuple of (float, float, float)
        Ends of the segment, in axis units.
    radius : float
        Distance from the segment in axis units, above 0.

    Raises
    ------
    InputError
        If a number is not finite, the radius is not above 0, or both ends are equal.

    Examples
    --------
    >>> rg.Capsule((1.0, 1.0, 0.0), (1.0, 1.0, 2.0), radius=0.25).bounds
    ((0.75, 0.75, -0.25), (1.25, 1.25, 2.25))
    """

    start: SpacePoint
    end: SpacePoint
    radius: Length

    def __post_init__(self) -> None:
        _require_axis("capsule", self.start, self.end, "; use a ball (rg.Ball) for a single point")

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the capsule's bounding box, in axis units."""
        return _around(self.start, self.end, [self.radius] * 3)

    def shifted(self, by: Point) -> Capsule:
        """Return the capsule translated by the vector `by`, in axis units."""
        return Capsule(translated(self.start, by), translated(self.end, by), self.radius)  # type: ignore[arg-type]


@checked
@dataclass(frozen=True)
class OrientedBox(Bounded):
    """A box in space whose edges need not be parallel to the axes.

    Parameters
    ----------
    centre : tuple of (float, float, float)
        Centre, in axis units.
    size : tuple of (float, float, float)
        Full lengths of the edges along the box's own x, y and z, in axis units, each above 0.
    rotation : tuple of (float, float, float)
        Roll, pitch and yaw in radians, as in URDF: rotations about the fixed x axis, then y, then z.

    Raises
    ------
    InputError
        If a number is not finite, or a length is not above 0.

    Examples
    --------
    >>> crate = rg.OrientedBox((0.0, 0.0, 0.5), (2.0, 1.0, 1.0), rotation=(0.0, 0.0, np.pi / 2))
    >>> np.round(crate.bounds, 9)
    array([[-0.5, -1. ,  0. ],
           [ 0.5,  1. ,  1. ]])
    """

    centre: SpacePoint
    size: tuple[Length, Length, Length]
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corners of the box, shape (8, 3), in axis units."""
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, -1).T
        return np.asarray(self.centre) + (signs * (np.array(self.size) / 2)) @ rotation_matrix(self.rotation).T

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the box's bounding box, in axis units."""
        reach = np.abs(rotation_matrix(self.rotation)) @ np.array(self.size) / 2
        return _around(self.centre, self.centre, reach.tolist())

    def shifted(self, by: Point) -> OrientedBox:
        """Return the box translated by the vector `by`, in axis units."""
        return OrientedBox(translated(self.centre, by), self.size, self.rotation)  # type: ignore[arg-type]


def rotation_matrix(rotation: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation matrix (3, 3) of roll, pitch and yaw (3,) in radians: ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    (cr, cp, cy), (sr, sp, sy) = _cosines_and_sines(np.asarray(rotation, dtype=np.float64))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _cosines_and_sines(angles: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return cosines and sines of angles (3,), exactly 0, 1 or -1 at multiples of a right angle.

    Otherwise a box that is turned by pi / 2 would extend beyond borders between cells by rounding errors.
    """
    quarters = np.rint(angles / (pi / 2))
    is_right = np.abs(angles - quarters * (pi / 2)) <= 8 * np.spacing(np.maximum(np.abs(angles), 1.0))
    turns = quarters.astype(np.int64) % 4
    cosines = np.where(is_right, np.array([1.0, 0.0, -1.0, 0.0])[turns], np.cos(angles))
    sines = np.where(is_right, np.array([0.0, 1.0, 0.0, -1.0])[turns], np.sin(angles))
    return cosines.tolist(), sines.tolist()


def rigid_pose(position: ArrayLike, rotation: ArrayLike) -> NDArray[np.float64]:
    """Return the pose (4, 4) of a position (3,) in metres and a rotation: (3,) roll, pitch, yaw, or a matrix (3, 3)."""
    pose, turn = np.eye(4), np.asarray(rotation, dtype=np.float64)
    pose[:3, :3] = turn if turn.shape == (3, 3) else rotation_matrix(turn)
    pose[:3, 3] = position
    return pose


def _require_axis(kind: str, start: SpacePoint, end: SpacePoint, remedy: str = "") -> None:
    """Raise InputError unless the two ends of the axis of a shape differ.

    `kind`: name of the shape; `remedy`: end of the message.
    """
    if not dist(start, end) >= 1 / LARGEST:
        raise InputError(f"the ends of a {kind} must differ, but both are {tuple(start)}; move one of them{remedy}")


def _around(start: SpacePoint, end: SpacePoint, reach: list[float]) -> Bounds:
    """Return the corners of the bounding box of two points, enlarged by `reach` (3,) along every axis."""
    lower = tuple(min(a, b) - by for a, b, by in zip(start, end, reach, strict=True))
    return lower, tuple(max(a, b) + by for a, b, by in zip(start, end, reach, strict=True))
