"""What a robot is: a new one is a subclass of `Robot` in a file of its own, and a line in `resgrid.robots.ROBOTS`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError
from resgrid.robots.cells import Progress, Sampling
from resgrid.robots.geometry import Part, Pose, obstacles_of
from resgrid.robots.goals import GoalCells, cells_of_place
from resgrid.robots.shapes import Point, Shape, require_plane
from resgrid.space import Axis

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

BATCH = 4096
"""Configurations looked at in one go."""

SLACK = 1e-9
"""Share of the farthest motion by which the default rule errs on the side of collision."""


class Robot(ABC):
    """A robot seen from its configuration space; the obstacles are shapes of its workspace.

    A robot must say where its parts are (`parts`) and how far they move (`travel`).  The rest has a default, right for
    bodies that move freely, with the place of their reference point as first coordinates: free cells follow from
    distances and travel.  What touches obstacles under `resgrid.simulation` needs a `pose` as well.
    """

    moves_in_workspace: ClassVar[bool] = False
    """Whether its configurations are places of the workspace, so that what is periodic in one is in the other."""

    reference: ClassVar[str] = "reference point"
    """What of it goals speak of."""

    remedy: ClassVar[str] = "make the robot smaller"
    """What to do where it does not fit."""

    base: Point | None = None
    """Where it is mounted; None if it moves freely."""

    turning_length: float | None = None
    """What a heading of one radian counts as, as the third coordinate of a configuration; None if it does not turn."""

    @property
    def reach(self) -> float:
        """Largest distance of its reference point from the base."""
        return inf

    @abstractmethod
    def parts(self, configurations: NDArray[np.float64]) -> list[Part]:
        """Its rigid parts in many configurations.

        Parameters
        ----------
        configurations : ndarray of float64, shape (n, ndim)
            In axis units.

        Returns
        -------
        list of Part
            Each with n shapely geometries, and a radius around them.

        Raises
        ------
        InputError
            If the workspace is not the plane.
        """

    @abstractmethod
    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bound of how far any point of it moves on straight lines in configuration space.

        Parameters
        ----------
        start, end : ndarray of float64, shape (n, ndim)
            Only their difference matters, and the bound is a convex function of it.

        Returns
        -------
        ndarray of float64, shape (n,)
            In the unit of the workspace.
        """

    def pose(self, configuration: NDArray[np.float64]) -> Pose:  # noqa: ARG002
        """How it lies in the plane, and how its points move, for contacts.

        Parameters
        ----------
        configuration : ndarray of float64, shape (ndim,)

        Returns
        -------
        Pose

        Raises
        ------
        InputError
            If that is not known.
        """
        name = type(self).__name__
        raise InputError(f"how a {name} touches obstacles is not known; give {name} a method pose(configuration)")

    def reference_point(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where its reference point (an arm's tip) is.

        Parameters
        ----------
        configurations : ndarray of float64, shape (n, ndim)

        Returns
        -------
        ndarray of float64, shape (n, d)
        """
        return configurations if self.moves_in_workspace else configurations[:, :2]

    def heading(self, configurations: NDArray[np.float64]) -> NDArray[np.float64] | None:  # noqa: ARG002
        """Direction that it looks in, in radians, shape (n,); None if it has none.

        Parameters
        ----------
        configurations : ndarray of float64, shape (n, ndim)

        Returns
        -------
        ndarray of float64, shape (n,), or None
        """
        return None

    def bare(self, *, self_collision: bool = True) -> Robot:  # noqa: ARG002
        """The robot without virtual obstacles, and if so asked without collisions with itself.

        Parameters
        ----------
        self_collision : bool

        Returns
        -------
        Robot
        """
        return self

    def axes_on_map(self, axes: Sequence[Axis], headings: int) -> tuple[Axis, ...]:  # noqa: ARG002
        """Axes of its configuration space on a map of the plane.

        Parameters
        ----------
        axes : sequence of Axis
            Of the map.
        headings : int
            Number of cells of a turn, where it turns.

        Returns
        -------
        tuple of Axis

        Raises
        ------
        InputError
            If its axes do not follow from the map's.
        """
        return tuple(axes)

    def check_axes(self, axes: Sequence[Axis]) -> None:  # noqa: B027
        """Refuse axes that are not this robot's.

        Parameters
        ----------
        axes : sequence of Axis

        Raises
        ------
        InputError
            If their number or kind does not fit.
        """

    def implied_axes(self) -> tuple[dict[str, Any], ...]:
        """What is known of its axes before a scene says anything: keys of tables of axes."""
        return ()

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Cells in which the robot would touch an obstacle.

        By default a cell is free if at its centre every part is farther from every obstacle than any point of the robot
        moves within the cell.

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
        self.check_axes(axes)
        solid = obstacles_of((require_plane(shape, "this robot") for shape in obstacles), self.workspace_axes(axes))
        reach = 0.0
        if rule == "conservative":
            corners = np.array(list(product(*([0.0, axis.spacing / 2] for axis in axes))))
            reach = float(self.travel(np.zeros_like(corners), corners).max()) * (1.0 + SLACK)
        shape = tuple(axis.cells for axis in axes)
        blocked = np.zeros(int(np.prod(shape)), dtype=np.bool_)
        for first in range(0, blocked.size, BATCH):
            cells = np.unravel_index(np.arange(first, min(first + BATCH, blocked.size)), shape)
            middle = np.column_stack([axis.centres[index] for axis, index in zip(axes, cells, strict=True)])
            for part in self.parts(middle):
                for obstacle in solid:
                    blocked[first : first + BATCH] |= obstacle.distance(part) <= reach
            if progress is not None:
                progress(first + len(middle), blocked.size)
        return blocked.reshape(shape)

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Cells in which the robot has its reference point in a region of the workspace, or is in one configuration.

        Parameters
        ----------
        axes : sequence of Axis
            The axes of the configuration space.
        region : Shape or tuple of float
            With as many coordinates as axes: configurations; with two: places in the plane, reached with the other
            coordinates at the centre of their cells.

        Returns
        -------
        GoalCells
            The cells that hold a configuration which brings it there, and such a configuration for each.

        Raises
        ------
        InputError
            If the region does not fit the robot, or the robot cannot get there at all.
        """
        self.check_axes(axes)
        count = len(region) if isinstance(region, tuple) else region.ndim
        if self.moves_in_workspace or count == len(axes):
            return cells_of_place(axes, region)
        cells, places = cells_of_place(axes[:2], region)
        rest = np.array(list(product(*(axis.centres for axis in axes[2:]))))
        points = np.column_stack([np.repeat(places, len(rest), axis=0), np.tile(rest, (len(places), 1))])
        shape = tuple(axis.cells for axis in axes)
        return GoalCells(np.repeat(cells.ravel(), len(rest)).reshape(shape), points)

    def shapes_at(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """The robot itself in the workspace.

        Parameters
        ----------
        configuration : array_like of float, shape (ndim,)
            In axis units.

        Returns
        -------
        list of shapely geometry
            One for each rigid part; round ends are polygons of 32 edges a half-circle, inside the circle.

        Raises
        ------
        InputError
            If the configuration has another number of coordinates, or the workspace is not the plane.
        """
        parts = self.parts(np.asarray(configuration, dtype=np.float64).reshape(1, -1))
        return [part.core[0].buffer(part.radius, quad_segs=16) if part.radius else part.core[0] for part in parts]

    def workspace_axes(self, axes: Sequence[Axis]) -> Sequence[Axis]:
        """The axes, if they are those of a plane workspace: obstacles then have copies across their seams."""
        return axes if self.moves_in_workspace and len(axes) == 2 else ()

    def within_seams(self, axes: Sequence[Axis], configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Configurations, shape (..., ndim), brought back into periodic axes of the workspace."""
        if not (self.moves_in_workspace and any(axis.periodic for axis in axes)):
            return configurations
        lower, upper, ring = np.array([(axis.lower, axis.upper, axis.periodic) for axis in axes]).T
        folded = lower + np.mod(configurations - lower, upper - lower)
        return np.asarray(np.where(ring.astype(bool), folded, configurations))
