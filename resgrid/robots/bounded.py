"""`Bounded`, the base class of shapes: their bounding box and number of coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod

from resgrid.core.axis import Point

Bounds = tuple[Point, Point]


class Bounded(ABC):
    """Base class of shapes: a subclass defines the bounding box, which gives the number of coordinates."""

    @property
    @abstractmethod
    def bounds(self) -> Bounds:
        """Lower and upper corner of the shape's bounding box, in axis units."""

    @property
    def ndim(self) -> int:
        """Number of coordinates of the shape's points."""
        return len(self.bounds[0])


def translated(point: Point, by: Point) -> Point:
    """Return the point translated by the vector `by`."""
    return tuple(a + b for a, b in zip(point, by, strict=True))
