"""The configuration space: a regular grid of free, obstacle and goal cells in one to four dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.coordinates import span_text
from resgrid._internal.numbers import real_numbers
from resgrid._internal.validation import checked
from resgrid._internal.values import frozen, picture_html
from resgrid.core.axis import Axis, grid_axes, rounding, rounding_errors, split_points
from resgrid.core.cell import (
    Cell,
    checked_cells,
    checked_conductivity,
    checked_goal_points,
    checked_undecided,
)
from resgrid.core.frame import Frame, checked_frame
from resgrid.core.regions import box_around, label_regions
from resgrid.errors import InputError


@checked
@frozen
@dataclass(frozen=True, eq=False)
class ConfigurationSpace:
    """A grid of free, obstacle and goal cells in one to four dimensions, with an optional cost map.

    Parameters
    ----------
    axes : sequence of Axis
        One to four axes; array index 0 is the first axis.
    cell : array_like of int
        One of `Cell` for every cell; shape ``(axes[0].cells, ...)``; stored as a read-only uint8 array.
    conductivity : array_like of float, optional
        Conductivity of every cell relative to 1, the default: positive, finite, of the shape of `cell`.  In a cost map,
        a costly cell has a low conductivity.
    frame : Frame, optional
        Position and rotation of the axes in the world; by default the axes are the world's.  Only a plane, or a plane
        with a heading as third axis, may be moved or rotated.
    goal_points : array_like of float, shape (number of goal cells, ndim), optional
        Configuration in every goal cell that solves the goal (at which an arm's tip is on its target, for example),
        for goal cells in C order, in axis units; NaN if every configuration of the cell solves the goal.
    robot : Robot, optional
        The robot whose configurations the space describes; a point by default.
    undecided : array_like of bool, shape of the grid, optional
        True for obstacle cells that are obstacles only because neither freedom nor a collision was proven.

    Raises
    ------
    InputError
        If the shapes do not match or a value is out of range.

    Examples
    --------
    >>> axes = [rg.Axis("x", 0.0, 4.0, 4), rg.Axis("y", 0.0, 2.0, 2)]
    >>> space = rg.ConfigurationSpace(axes, [[0, 0], [0, 1], [0, 1], [0, 2]])
    >>> space.shape, space.spacing, space.goal_count
    ((4, 2), array([1., 1.]), 1)
    >>> space.locate((3.2, 1.9)), space.centre((3, 1))
    (array([3, 1]), array([3.5, 1.5]))
    >>> space.goal_connected.T
    array([[ True,  True,  True,  True],
           [ True, False, False, False]])
    >>> opened = space.with_cells(np.where(space.cell == rg.Cell.OBSTACLE, rg.Cell.FREE, space.cell))
    >>> opened
    <ConfigurationSpace of 4 x 2 cells, x 0 to 4 m, y 0 to 2 m: 0 obstacle, 1 goal>
    """

    axes: tuple[Axis, ...]
    cell: NDArray[np.uint8]
    conductivity: NDArray[np.float64] | None = None
    frame: Frame = field(default_factory=Frame)
    goal_points: NDArray[np.float64] | None = None
    robot: Any = None  # a Robot; its class is defined in a higher package
    undecided: NDArray[np.bool_] | None = None

    def __init__(
        self,
        axes: Sequence[Axis],
        cell: ArrayLike,
        conductivity: ArrayLike | None = None,
        *,
        frame: Frame | None = None,
        goal_points: ArrayLike | None = None,
        robot: Any = None,
        undecided: ArrayLike | None = None,
    ) -> None:
        axes = tuple(axes)
        cells = checked_cells(axes, cell)
        parts = {
            "axes": axes,
            "cell": cells,
            "conductivity": None if conductivity is None else checked_conductivity(cells.shape, conductivity),
            "frame": checked_frame(axes, Frame() if frame is None else frame),
            "goal_points": None,
            "robot": robot,
            "undecided": None if undecided is None else checked_undecided(cells, undecided),
        }
        for name, part in parts.items():
            object.__setattr__(self, name, part)
        if goal_points is not None:
            object.__setattr__(self, "goal_points", checked_goal_points(axes, cells, goal_points))

    def __repr__(self) -> str:
        cells = " x ".join(map(str, self.shape))
        axes = ", ".join(f"{axis.name} {span_text(axis.lower, axis.upper)} {axis.unit}".rstrip() for axis in self.axes)
        obstacle, goal = (int(np.count_nonzero(self.cell == code)) for code in (Cell.OBSTACLE, Cell.GOAL))
        open_cells = "" if self.undecided is None else f" ({int(self.undecided.sum())} of them undecided)"
        return f"<ConfigurationSpace of {cells} cells, {axes}: {obstacle} obstacle{open_cells}, {goal} goal>"

    _repr_html_ = picture_html

    @classmethod
    def from_array(
        cls,
        cell: ArrayLike,
        spacing: ArrayLike = 1.0,
        origin: ArrayLike = 0.0,
        *,
        periodic: bool | Sequence[bool] = False,
        unit: str = "m",
        conductivity: ArrayLike | None = None,
        frame: Frame | None = None,
        robot: Any = None,
    ) -> ConfigurationSpace:
        """Return a space for an array of `Cell` codes, with axes named x, y, z and w.

        Parameters
        ----------
        cell : array_like of int or bool
            One to four dimensions; array index 0 runs along x.  Of an image, whose rows run downwards, take
            ``image.T[:, ::-1]``.  True is an obstacle.
        spacing : float or array_like of float, shape (ndim,)
            Width of a cell along every axis, in `unit`.
        origin : float or array_like of float, shape (ndim,)
            Lower corner of the grid, in `unit`.
        periodic : bool or sequence of bool
            Whether the upper end of every axis joins the lower one.
        unit : str
            Unit of all axes, for labels.
        conductivity, frame, robot
            Passed on to `ConfigurationSpace`.

        Returns
        -------
        ConfigurationSpace

        Raises
        ------
        InputError
            If the array does not have one to four dimensions, or a value is out of range.

        Examples
        --------
        >>> cell = np.zeros((40, 30), dtype=np.uint8)
        >>> cell[10:12, :20], cell[35, 5] = rg.Cell.OBSTACLE, rg.Cell.GOAL
        >>> rg.ConfigurationSpace.from_array(cell, spacing=0.05, origin=(-1.0, 0.0))
        <ConfigurationSpace of 40 x 30 cells, x -1 to 1 m, y 0 to 1.5 m: 40 obstacle, 1 goal>
        """
        codes = real_numbers("cell", cell)
        axes = grid_axes(codes.shape, spacing, origin, periodic, unit)
        codes = codes.astype(np.uint8) if codes.dtype == bool else codes
        return cls(axes, codes, conductivity, frame=frame, robot=robot)

    def with_cells(self, cell: ArrayLike) -> ConfigurationSpace:
        """Return a copy with other cells, and with the same axes, conductivities, frame and robot.

        A cell that stays a goal keeps its goal point; in a new goal cell every configuration solves the goal.  An
        undecided cell (an obstacle for which neither a proof nor a collision was found) stays undecided if it stays an
        obstacle.  `cell`: `Cell` code of every cell, shape of the space.
        """
        cells, kept = checked_cells(self.axes, cell), None
        if self.goal_points is not None:
            points = np.full((*self.shape, self.ndim), np.nan)
            points[self.cell == Cell.GOAL] = self.goal_points
            kept = points[cells == Cell.GOAL]
        return ConfigurationSpace(
            self.axes, cells, self.conductivity, frame=self.frame, goal_points=kept, robot=self.robot,
            undecided=None if self.undecided is None else self.undecided & (cells == Cell.OBSTACLE),
        )  # fmt: skip

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each axis."""
        return self.cell.shape

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return self.cell.ndim

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower corner of the grid, shape ``(ndim,)``, in axis units."""
        return np.array([axis.lower for axis in self.axes])

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper corner of the grid, shape ``(ndim,)``, in axis units."""
        return np.array([axis.upper for axis in self.axes])

    @property
    def spacing(self) -> NDArray[np.float64]:
        """Cell widths, shape ``(ndim,)``, in axis units."""
        return np.array([axis.spacing for axis in self.axes])

    @property
    def periodic(self) -> NDArray[np.bool_]:
        """Whether each axis is periodic, shape ``(ndim,)``."""
        return np.array([axis.periodic for axis in self.axes])

    @cached_property
    def goal_region(self) -> NDArray[np.int32]:
        """Number of the goal region of every goal cell, -1 for other cells, in the shape of the space.

        Goal regions are the face-connected components of goal cells, periodic axes included, numbered from 0 in
        C order of their first cell.
        """
        goal = self.cell == Cell.GOAL
        around = box_around(goal)
        whole = [ends.stop - ends.start == size for ends, size in zip(around, self.shape, strict=True)]
        region = np.full(self.shape, -1, dtype=np.int32)
        region[around] = label_regions(goal[around], self.periodic & whole) - 1
        region.flags.writeable = False
        return region

    @cached_property
    def goal_count(self) -> int:
        """Number of goal regions."""
        return int(self.goal_region.max(initial=-1)) + 1

    def goal_point(self, cell: ArrayLike) -> NDArray[np.float64]:
        """Return goal configurations in axis units, (..., ndim); `cell` (..., ndim): indices of one or more cells.

        NaN if every configuration of the cell solves the goal, or if the cell is not a goal cell.
        """
        index = np.asarray(cell, dtype=np.int64)
        found = np.full(index.shape, np.nan)
        if self.goal_points is not None and len(self.goal_points):
            number = np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), self.shape)
            row = np.minimum(np.searchsorted(self._goal_numbers, number), len(self._goal_numbers) - 1)
            goal = self._goal_numbers[row] == number
            found[goal] = self.goal_points[row[goal]]
        return found

    @cached_property
    def _goal_numbers(self) -> NDArray[np.int64]:
        """Flat indices of the goal cells in C order, shape (goal cells,)."""
        return np.flatnonzero(self.cell == Cell.GOAL)

    @cached_property
    def goal_connected(self) -> NDArray[np.bool_]:
        """Mask of the free cells that a path of face-neighbouring free cells connects to a goal, shape of the space."""
        region = label_regions(self.cell != Cell.OBSTACLE, self.periodic)
        has_goal = np.zeros(region.max(initial=0) + 1, dtype=bool)
        has_goal[region[self.cell == Cell.GOAL]] = True
        connected = np.asarray(self.cell == Cell.FREE)
        if not has_goal[1:].all():
            connected &= has_goal[region]
        connected.flags.writeable = False
        return connected

    def to_world(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return points in world coordinates, shape (..., ndim), for points in axis units, shape (..., ndim).

        Raises
        ------
        InputError
            If a point has not one number per axis.
        """
        return self.frame.to_world(self.checked_points(points))

    def from_world(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return points in axis units, shape (..., ndim), for points in world coordinates, shape (..., ndim)."""
        return self.frame.from_world(self.checked_points(points))

    def checked_points(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return points as floats, (..., ndim); raise InputError for a wrong type or number of coordinates."""
        try:
            checked = np.asarray(points, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(f"a point of this space is {self.ndim} numbers, got {points!r}") from None
        if checked.shape[-1:] != (self.ndim,):
            raise InputError(f"a point of this space has {self.ndim} coordinates, got {checked.tolist()!r}")
        return checked

    def centre(self, cell: ArrayLike) -> NDArray[np.float64]:
        """Return cell centres in world coordinates, (..., ndim); `cell` (..., ndim): indices of one or more cells."""
        return self.to_world(self.axis_centre(cell))

    def axis_centre(self, cell: ArrayLike) -> NDArray[np.float64]:
        """Return cell centres in axis units, (..., ndim); `cell` (..., ndim): indices of one or more cells."""
        return self.lower + (np.asarray(cell, dtype=np.float64) + 0.5) * self.spacing

    def locate(self, point: ArrayLike) -> NDArray[np.int64]:
        """Return the cells that contain one or more points.

        A point on the border of two cells belongs to the upper cell, except at the upper end of the axis.  Periodic
        coordinates are wrapped first.

        Parameters
        ----------
        point : array_like of float, shape (..., ndim)
            Points in world coordinates.

        Returns
        -------
        ndarray of int64, shape (..., ndim)
            Index of the cell along every axis.

        Raises
        ------
        InputError
            If a point is not finite or lies outside the grid.
        """
        return self.split(self.from_world(point))[0]

    def split(self, point: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the cells of points (..., ndim), and the positions in these cells as fractions in [0, 1] (..., ndim).

        `point` (..., ndim): in axis units; `from_world` converts world coordinates.  A point on a border belongs to the
        upper cell, except at the upper end of the axis.  Periodic coordinates are wrapped.
        """
        return split_points(self.axes, point, self.frame.reach(self.axes))

    @cached_property
    def rounding(self) -> NDArray[np.float64]:
        """Tolerance for positions per axis, as fractions of a cell's width, shape (ndim,).

        The larger one of 1e-9 and the rounding error, which matters far from the origin of the axes or of the world.
        """
        return rounding(self.axes, self.frame.reach(self.axes))

    @cached_property
    def rounding_errors(self) -> NDArray[np.float64]:
        """Largest rounding error of coordinates per axis, as fractions of a cell's width, shape (ndim,)."""
        return rounding_errors(self.axes, self.frame.reach(self.axes))
