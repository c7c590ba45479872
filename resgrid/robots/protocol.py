"""What every robot can do: say which cells of its configuration space are blocked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.robots.shapes import Point, Shape
from resgrid.space import Axis

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Sampling = Literal["conservative", "centre"]
"""How a cell is judged: by its whole square, or by its centre alone."""

Progress = Callable[[int, int], object]
"""Told now and then how much work is done, and how much there is in all."""


class GoalCells(NamedTuple):
    """The cells of a goal, and where in each of them it is.

    `cells`: one entry per cell, True where the closed cell holds a configuration that solves the goal; `points`
    (number of such cells, ndim): such a configuration for each of them, in C order, in axis units.
    """

    cells: NDArray[np.bool_]
    points: NDArray[np.float64]


@runtime_checkable
class Robot(Protocol):
    """A robot seen from its configuration space.

    A point robot's axes are those of the workspace; an arm's are its joint angles, a turning polygon's are
    ``(x, y, theta)``.  The obstacles are always shapes of the workspace.
    """

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Cells in which the robot would touch an obstacle.

        Parameters
        ----------
        axes : sequence of Axis
            The axes of the configuration space.
        obstacles : sequence of Shape
            What stands in the workspace.
        rule : {"conservative", "centre"}
            Whether a cell is blocked when the robot touches an obstacle anywhere inside it, or at its centre.
        progress : callable, optional
            Called as ``progress(done, total)``.

        Returns
        -------
        ndarray of bool
            One entry per cell, True where blocked.

        Raises
        ------
        InputError
            If a shape or an axis does not fit the robot.
        """
        ...

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Cells in which the robot has its reference point (an arm: its tip) in a region of the workspace.

        Parameters
        ----------
        axes : sequence of Axis
            The axes of the configuration space.
        region : Shape or tuple of float
            A region or a point of the workspace.

        Returns
        -------
        GoalCells
            The cells that hold a configuration which brings it there, and such a configuration for each.

        Raises
        ------
        InputError
            If the region does not fit the robot, or the robot cannot get there at all.
        """
        ...

    def shapes_at(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """The robot itself in the workspace.

        Parameters
        ----------
        configuration : array_like of float, shape (ndim,)
            In axis units.

        Returns
        -------
        list of shapely geometry
            One for each rigid part.

        Raises
        ------
        InputError
            If the configuration has another number of coordinates, or the workspace is not the plane.
        """
        ...
