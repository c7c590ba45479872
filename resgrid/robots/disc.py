"""A disc that moves in the plane: turning does not change it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.doors import checked
from resgrid.errors import InputError
from resgrid.robots.goals import cells_of_place
from resgrid.robots.point import PointRobot
from resgrid.robots.protocol import GoalCells, Progress, Sampling
from resgrid.robots.shapes import LARGEST, Point, Shape
from resgrid.space import Axis

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


@checked
@dataclass(frozen=True)
class DiscRobot:
    """A disc around its reference point; its configuration space is the plane it moves in.

    Parameters
    ----------
    radius : float
        In axis units, above 0.

    Raises
    ------
    InputError
        If the radius is not above 0 and finite.
    """

    radius: float

    def __post_init__(self) -> None:
        if not 0 < float(self.radius) <= LARGEST:
            raise InputError(f"a disc needs a finite radius above 0, got {self.radius}")

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Cells that meet an obstacle grown by the radius; as `PointRobot.occupancy`, two axes."""
        if len(axes) != 2:
            raise InputError(f"a disc moves in the plane and needs 2 axes, got {len(axes)}; a point has any number")
        return PointRobot(self.radius).occupancy(axes, obstacles, rule, progress)

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Cells that meet a region, or the one around a point; see `resgrid.robots.goals.cells_of_place`."""
        return cells_of_place(axes, region)

    def shapes_at(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """The disc around a point, as a polygon of 64 edges inside the circle."""
        return PointRobot(self.radius).shapes_at(configuration)
