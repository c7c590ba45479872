"""Rigid transformation between the coordinates of a space and world coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, hypot, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import checked
from resgrid.core.axis import Axis, Coordinate, largest_coordinates, rounding_errors
from resgrid.errors import InputError

_COARSEST = 0.125
"""Largest accepted rounding error of a coordinate, as a fraction of a cell's width; beyond it InputError is raised."""


@checked
@dataclass(frozen=True)
class Frame:
    """Position and rotation of a space's coordinate system in the world.

    A frame is needed for a map with a rotated origin: the axes of the space then run along its rows and columns, and
    not along the axes of the world.

    Parameters
    ----------
    x, y : float
        World coordinates of the origin of the space, in axis units.
    yaw : float
        Angle from the world's x axis to the x axis of the space, in radians, anticlockwise.
    turning_length : float or None
        For a robot with a heading: length, in metres, by which the heading in radians is multiplied to give the third
        coordinate of the space.  The frame then adds `yaw` to the heading.  None for spaces without a heading.

    Raises
    ------
    InputError
        If a number is not finite.

    Examples
    --------
    >>> frame = rg.Frame(x=1.0, y=0.0, yaw=np.pi / 2)
    >>> frame.to_world((2.0, 0.0)).round(3)
    array([1., 2.])
    >>> frame.from_world((1.0, 2.0)).round(3)
    array([2., 0.])
    >>> frame.turned_to_world((1.0, 0.0)).round(3)
    array([0., 1.])
    """

    x: Coordinate = 0.0
    y: Coordinate = 0.0
    yaw: Coordinate = 0.0
    turning_length: float | None = None

    @property
    def is_world(self) -> bool:
        """Whether the coordinates of the space equal the world coordinates."""
        return self.x == 0 and self.y == 0 and self.yaw == 0

    def to_world(self, points: ArrayLike) -> NDArray[np.float64]:
        """Convert points from coordinates of the space to world coordinates.

        Parameters
        ----------
        points : array_like of float, shape (..., ndim)
            Points in axis units.

        Returns
        -------
        ndarray of float64, shape (..., ndim)
            Points in world coordinates.

        Raises
        ------
        InputError
            If the frame is not the world's, and a point has not 2 coordinates (2 or 3 with a turning length).
        """
        space = np.array(points, dtype=np.float64)
        return space if self.is_world else self._turned(space, self._rotation.T) + self._offset(space)

    def from_world(self, points: ArrayLike) -> NDArray[np.float64]:
        """Convert points from world coordinates to coordinates of the space.

        Parameters
        ----------
        points : array_like of float, shape (..., ndim)
            Points in world coordinates.

        Returns
        -------
        ndarray of float64, shape (..., ndim)
            Points in axis units.

        Raises
        ------
        InputError
            If the frame is not the world's, and a point has not 2 coordinates (2 or 3 with a turning length).
        """
        world = np.array(points, dtype=np.float64)
        return world if self.is_world else self._turned(world - self._offset(world), self._rotation)

    def turned_to_world(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """Rotate vectors (velocities, forces, differences) from the axes of the space to the world axes.

        Parameters
        ----------
        vectors : array_like of float, shape (..., ndim)
            Components along the axes of the space.

        Returns
        -------
        ndarray of float64, shape (..., ndim)
            Components along the world axes, in the unit of `vectors`.
        """
        along = np.array(vectors, dtype=np.float64)
        return along if self.yaw == 0 else self._turned(along, self._rotation.T)

    def turned_from_world(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """Rotate vectors (velocities, forces, differences) from the world axes to the axes of the space.

        Parameters
        ----------
        vectors : array_like of float, shape (..., ndim)
            Components along the world axes.

        Returns
        -------
        ndarray of float64, shape (..., ndim)
            Components along the axes of the space, in the unit of `vectors`.
        """
        world = np.array(vectors, dtype=np.float64)
        return world if self.yaw == 0 else self._turned(world, self._rotation)

    def reach(self, axes: Sequence[Axis]) -> NDArray[np.float64]:
        """Return the largest magnitude of a coordinate in the conversion between world and space, per axis, (ndim,).

        The result is in axis units.  The floating-point spacing at this magnitude bounds the rounding error of
        `to_world` and `from_world`.  For a map in UTM coordinates of 5e6 m the spacing is 1e-9 m, even if the axes
        start at 0.
        """
        largest = largest_coordinates(axes)
        if self.is_world:
            return largest
        offset = np.abs((self.x, self.y, self.yaw * (self.turning_length or 0.0))[: len(largest)])
        if self.yaw != 0:
            largest[:2], offset[:2] = hypot(*largest[:2]), hypot(*offset[:2])
        return np.asarray(largest + offset)

    @cached_property
    def _rotation(self) -> NDArray[np.float64]:
        return np.array([[cos(self.yaw), -sin(self.yaw)], [sin(self.yaw), cos(self.yaw)]])

    def _offset(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        self._check_size(points)
        return np.array((self.x, self.y, self.yaw * (self.turning_length or 0.0))[: points.shape[-1]])

    def _turned(self, points: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return vectors (..., ndim) whose first two components are multiplied by `rotation` (2, 2) from the right.

        `points` (..., ndim): the vectors before the multiplication.
        """
        self._check_size(points)
        plane = points[..., :2] @ rotation
        return plane if points.shape[-1] == 2 else np.concatenate([plane, points[..., 2:]], axis=-1)

    def _check_size(self, points: NDArray[np.float64]) -> None:
        sizes = (2,) if self.turning_length is None else (2, 3)
        if not points.shape or points.shape[-1] not in sizes:
            raise InputError(f"this map lies in the plane: a point needs 2 coordinates, got shape {points.shape}")


def checked_frame(axes: tuple[Axis, ...], frame: Frame) -> Frame:
    """Return `frame`; raise InputError for a wrong number of axes, or if rounding errors exceed 1/8 of a cell's width.

    Unless the frame is the world's, there must be 2 axes, or 3 with a turning length.
    """
    if not frame.is_world and len(axes) != (2 if frame.turning_length is None else 3):
        raise InputError(
            f"only a plane may be moved or rotated in the world, and this space has {len(axes)} axes; leave out frame"
        )
    if not frame.is_world and np.any(rounding_errors(axes, frame.reach(axes)) > _COARSEST):
        raise InputError(
            f"the frame lies so far from the world's origin, at ({frame.x:g}, {frame.y:g}), that rounding errors are "
            "larger than an eighth of a cell; move the origin of the world towards the map"
        )
    return frame
