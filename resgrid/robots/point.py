"""A point, or a disc or ball that does not turn: its configuration space is the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.doors import checked
from resgrid.errors import InputError
from resgrid.robots.goals import cells_of_place
from resgrid.robots.protocol import GoalCells, Progress, Sampling
from resgrid.robots.reach import mark
from resgrid.robots.shapes import LARGEST, Point, Shape
from resgrid.space import Axis

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


@checked
@dataclass(frozen=True)
class PointRobot:
    """A robot that is a point, or a ball around its reference point, in one to four dimensions.

    Obstacles grow by the radius: a ball of radius ``r`` touches an obstacle exactly where its centre lies within
    ``r`` of it (Lozano-Perez, IEEE Trans. Computers C-32 (1983) 108).

    Parameters
    ----------
    radius : float
        In axis units, at least 0.

    Raises
    ------
    InputError
        If the radius is negative, not finite or above 1e60.
    """

    radius: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= float(self.radius) <= LARGEST:
            raise InputError(f"a robot's radius must be finite and at least 0, got {self.radius}")

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Cells that meet an obstacle grown by the robot's radius.

        Parameters
        ----------
        axes : sequence of Axis
            One to four axes.
        obstacles : sequence of Shape
            In the coordinates of the axes, with as many coordinates.
        rule : {"conservative", "centre"}
            ``"conservative"``: a cell is blocked if its interior meets a grown obstacle, so every point of a free
            cell is free; an obstacle that ends on a cell's border does not block that cell.  ``"centre"``: it is
            blocked if its centre lies in a grown obstacle.  "Interior" leaves out a rim of 1e-9 of the cell, so
            that an edge meant to lie on a border does so in floating point.
        progress : callable, optional
            Called as ``progress(done, total)``, in shapes.

        Returns
        -------
        ndarray of bool
            True where blocked.

        Raises
        ------
        InputError
            If a shape has another number of coordinates than the grid.
        """
        blocked = np.zeros(tuple(axis.cells for axis in axes), dtype=bool)
        for number, shape in enumerate(obstacles, 1):
            mark(blocked, tuple(axes), shape, self.radius, rule)
            if progress is not None:
                progress(number, len(obstacles))
        return blocked

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Cells that meet a region, or the one around a point; see `resgrid.robots.goals.cells_of_place`."""
        return cells_of_place(axes, region)

    def shapes_at(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """The point, or the disc around it as a polygon of 64 edges inside the circle.

        Parameters
        ----------
        configuration : array_like of float, shape (2,)
            In axis units.

        Returns
        -------
        list of one shapely geometry

        Raises
        ------
        InputError
            If there are not two coordinates.
        """
        import shapely

        place = np.asarray(configuration, dtype=np.float64)
        if place.shape != (2,):
            raise InputError(f"geometry is known in the plane alone: give 2 coordinates, not shape {place.shape}")
        point = shapely.Point(place)
        return [point.buffer(self.radius) if self.radius else point]
