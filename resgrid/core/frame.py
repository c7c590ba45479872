"""Where a space lies in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, hypot, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import checked
from resgrid.core.axis import Axis, Coordinate, largest_coordinates
from resgrid.errors import InputError


@checked
@dataclass(frozen=True)
class Frame:
    """Where the coordinates of the space lie in the world.

    A map with a turned origin has axes of its own, along its rows and columns; everything else shares the world's.

    Parameters
    ----------
    x, y : float
        World coordinates of the origin of the space.
    yaw : float
        Angle from the world's x axis to the space's, in radians, anticlockwise.
    turning_length : float or None
        Of a robot that turns: a third coordinate is its heading times this length, and turns along with the space.

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
        """Whether space and world coordinates are the same."""
        return self.x == 0 and self.y == 0 and self.yaw == 0

    def to_world(self, points: ArrayLike) -> NDArray[np.float64]:
        """World coordinates of points given in the space.

        Parameters
        ----------
        points : array_like of float, shape (..., ndim)
            In axis units.

        Returns
        -------
        ndarray of float64, shape (..., ndim)

        Raises
        ------
        InputError
            If the frame is turned or moved and the points are not in the plane, or not places with a heading.
        """
        space = np.array(points, dtype=np.float64)
        return space if self.is_world else self._turned(space, self._rotation.T) + self._offset(space)

    def from_world(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points of the world in axis units, shape (..., ndim); the inverse of `to_world`, with the same errors."""
        world = np.array(points, dtype=np.float64)
        return world if self.is_world else self._turned(world - self._offset(world), self._rotation)

    def turned_to_world(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """World components of vectors (velocities, forces, differences) given along the axes, shape (..., ndim)."""
        along = np.array(vectors, dtype=np.float64)
        return along if self.yaw == 0 else self._turned(along, self._rotation.T)

    def turned_from_world(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """Components along the axes of vectors given in the world, shape (..., ndim)."""
        world = np.array(vectors, dtype=np.float64)
        return world if self.yaw == 0 else self._turned(world, self._rotation)

    def reach(self, axes: Sequence[Axis]) -> NDArray[np.float64]:
        """Return the largest size of a coordinate on its way between world and space, per axis, shape (ndim,).

        Its spacing in floating point bounds the rounding error of `to_world` and `from_world`: a map in UTM coordinates
        of 5e6 m rounds to 1e-9 m, however near 0 its own axes lie.
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
        """Vectors with their first two components turned."""
        self._check_size(points)
        plane = points[..., :2] @ rotation
        return plane if points.shape[-1] == 2 else np.concatenate([plane, points[..., 2:]], axis=-1)

    def _check_size(self, points: NDArray[np.float64]) -> None:
        sizes = (2,) if self.turning_length is None else (2, 3)
        if not points.shape or points.shape[-1] not in sizes:
            raise InputError(f"this map lies in the plane: a point needs 2 coordinates, got shape {points.shape}")
