"""A polygon that moves and turns in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi, tau
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.doors import checked
from resgrid.errors import InputError
from resgrid.robots.goals import cells_of_place
from resgrid.robots.protocol import GoalCells, Progress, Sampling
from resgrid.robots.shapes import Point, Polygon, Shape
from resgrid.space import Axis

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


@checked
@dataclass(frozen=True)
class PolygonRobot:
    """A polygon with configurations ``(x, y, theta)``: moved to ``(x, y)`` and turned about its reference point.

    The third coordinate is an arc, not an angle: ``theta = turning_length * angle``, in the unit of x and y, so that
    resistances, lengths and clearances weigh turning by one radian like moving by ``turning_length``.  With the
    default of 1 it reads like radians.

    Parameters
    ----------
    vertices : tuple of (float, float)
        Corners of a simple polygon, in either sense; the reference point is the origin.
    turning_length : float
        Above 0.

    Raises
    ------
    InputError
        If the polygon crosses itself or has fewer than three corners, or the length is not above 0 and finite.
    """

    vertices: tuple[Point, ...]
    turning_length: float = 1.0

    def __post_init__(self) -> None:
        if not (isfinite(self.turning_length) and 0 < self.turning_length <= 1e9):
            raise InputError(f"turning_length = {self.turning_length} must be above 0 and finite")
        Polygon(self.vertices)

    @property
    def farthest(self) -> float:
        """Distance from the reference point to the farthest corner."""
        return float(np.hypot(*np.transpose(self.vertices)).max())

    def turning_axis(self, cells: int, name: str = "theta") -> Axis:
        """The third axis: a full turn, periodic.

        Parameters
        ----------
        cells : int
            Number of cells.
        name : str
            Its name.

        Returns
        -------
        Axis
            From 0 to ``2 pi turning_length``.
        """
        return Axis(name, 0.0, tau * self.turning_length, cells, periodic=True)

    def check_axes(self, axes: Sequence[Axis]) -> None:
        """Refuse axes that are not ``(x, y, theta)``.

        Parameters
        ----------
        axes : sequence of Axis

        Raises
        ------
        InputError
            If there are not three, x or y is periodic, or a periodic third is not a full turn.
        """
        if len(axes) != 3:
            raise InputError(f"a turning polygon needs 3 axes (x, y, theta), got {len(axes)}")
        for axis in axes[:2]:
            if axis.periodic:
                raise InputError(f"axis {axis.name!r}: a turning polygon's x and y cannot be periodic")
        turn, full = axes[2], tau * self.turning_length
        if turn.periodic and abs(turn.upper - turn.lower - full) > 1e-9 * full:
            raise InputError(
                f"axis {turn.name!r}: a full turn is 2 pi turning_length = {full:.15g}, but the axis spans "
                f"{turn.upper - turn.lower:.15g}; leave lower and upper out, or set periodic = false"
            )

    def corners(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Where the corners are.

        Parameters
        ----------
        configurations : array_like of float, shape (..., 3)
            x, y and theta, in axis units.

        Returns
        -------
        ndarray of float64, shape (..., v, 2)

        Raises
        ------
        InputError
            If there are not three coordinates.
        """
        pose = np.asarray(configurations, dtype=np.float64)
        if pose.shape[-1:] != (3,):
            raise InputError(f"a turning polygon's configuration is (x, y, theta), got shape {pose.shape}")
        angle = pose[..., 2, None] / self.turning_length
        x, y = np.transpose(self.vertices)
        turned = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=-1)
        return np.asarray(turned + pose[..., None, :2])

    def shapes_at(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """The polygon in the workspace, exact.

        Parameters
        ----------
        configuration : array_like of float, shape (3,)
            x, y and theta, in axis units.

        Returns
        -------
        list of one shapely polygon

        Raises
        ------
        InputError
            If there are not three coordinates.
        """
        import shapely

        return [shapely.Polygon(self.corners(np.asarray(configuration, dtype=np.float64).reshape(-1)))]

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Cells in which the polygon may touch an obstacle; see `resgrid.robots.turning.turning_occupancy`."""
        from resgrid.robots.turning import turning_occupancy

        return turning_occupancy(self, tuple(axes), obstacles, rule, progress)

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Cells that bring the reference point into a region of the plane, at any angle, or into one of (x, y, theta).

        Parameters
        ----------
        axes : sequence of Axis
            x, y and theta.
        region : Shape or tuple of float
            Two coordinates: a place in the plane; three: configurations.

        Returns
        -------
        GoalCells
            The cells that meet the region; a place in the plane is reached at the angle of the cell's centre.

        Raises
        ------
        InputError
            If the region has neither two nor three coordinates, or a point lies outside the grid.
        """
        self.check_axes(axes)
        count = len(region) if isinstance(region, tuple) else region.ndim
        if count == 3:
            return cells_of_place(axes, region)
        cells, places = cells_of_place(axes[:2], region)
        turns = axes[2].centres
        points = np.column_stack([np.repeat(places, len(turns), axis=0), np.tile(turns, len(places))])
        return GoalCells(np.repeat(cells[:, :, None], len(turns), axis=2), points)

    def travel(self, axis: Axis, parts: int = 1) -> float:
        """How far a point of the polygon can move while it turns from the middle of a cell to its border.

        Parameters
        ----------
        axis : Axis
            The third axis.
        parts : int
            Into how many parts the cell is cut.

        Returns
        -------
        float
            The chord, in the unit of the plane.
        """
        return float(2 * self.farthest * np.sin(min(axis.spacing / self.turning_length / (2 * parts), pi) / 2))
