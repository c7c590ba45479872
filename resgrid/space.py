"""The configuration space: a regular grid of free, obstacle and goal cells in one to four dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.doors import checked
from resgrid.errors import InputError
from resgrid.frame import Frame

MAX_DIMENSIONS = 4


class Cell(IntEnum):
    """What a cell of a configuration space is."""

    FREE = 0
    OBSTACLE = 1
    GOAL = 2


@checked
@dataclass(frozen=True)
class Axis:
    """One coordinate of a configuration space, cut into equal cells.

    Cell ``i`` covers ``[lower + i h, lower + (i + 1) h]`` with ``h = spacing``; its centre is in the middle.

    Parameters
    ----------
    name : str
        The coordinate's name, e.g. ``"x"`` or ``"theta_1"``.
    lower, upper : float
        The ends of the axis, in ``unit``; ``lower < upper``.
    cells : int
        How many cells, at least 1.
    periodic : bool
        Whether the upper end joins the lower one.
    unit : str
        ``"m"``, ``"rad"``, ``"cell"``, ...; for labels only.

    Raises
    ------
    InputError
        If the ends are not finite and increasing, or there is no cell.
    """

    name: str
    lower: float
    upper: float
    cells: int
    periodic: bool = False
    unit: str = "m"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.lower) and np.isfinite(self.upper) and self.lower < self.upper):
            raise InputError(
                f"axis {self.name!r}: lower = {self.lower} and upper = {self.upper} must be finite, lower below upper"
            )
        if self.cells < 1:
            raise InputError(f"axis {self.name!r}: cells = {self.cells}, but an axis needs at least one cell")

    @property
    def spacing(self) -> float:
        """Width of a cell, in ``unit``."""
        return float((self.upper - self.lower) / self.cells)

    @property
    def centres(self) -> NDArray[np.float64]:
        """Cell centres, shape ``(cells,)``, in ``unit``."""
        return np.asarray(self.lower + (np.arange(self.cells) + 0.5) * self.spacing, dtype=np.float64)

    @property
    def edges(self) -> NDArray[np.float64]:
        """Cell borders, shape ``(cells + 1,)``, in ``unit``."""
        return np.linspace(self.lower, self.upper, self.cells + 1)


@checked
@dataclass(frozen=True, eq=False)
class ConfigurationSpace:
    """A grid of cells, each free, obstacle or goal, and what they cost.

    Parameters
    ----------
    axes : sequence of Axis
        One to four axes; array index 0 is the first axis.
    cell : array_like of int
        One of `Cell` for every cell; shape ``(axes[0].cells, ...)``; kept as a read-only uint8 array.
    conductivity : array_like of float, optional
        A positive, finite number for every cell (a cost map: a costly cell conducts badly), same shape;
        relative to 1, the default.
    frame : Frame, optional
        Where the axes lie in the world; the world's own unless it is given.
    goal_points : array_like of float, shape (number of goal cells, ndim), optional
        For every goal cell, in C order, a configuration within it, in axis units, that solves the goal; NaN where
        the cell as a whole is the goal.

    Attributes
    ----------
    cell : ndarray of uint8
    conductivity : ndarray of float64 or None
    frame : Frame
    goal_points : ndarray of float64 or None

    Raises
    ------
    InputError
        If the shapes do not match or a value is out of range.
    """

    axes: tuple[Axis, ...]
    cell: NDArray[np.uint8]
    conductivity: NDArray[np.float64] | None = None
    frame: Frame = field(default_factory=Frame)
    goal_points: NDArray[np.float64] | None = None

    def __init__(
        self,
        axes: Sequence[Axis],
        cell: ArrayLike,
        conductivity: ArrayLike | None = None,
        *,
        frame: Frame | None = None,
        goal_points: ArrayLike | None = None,
    ) -> None:
        axes = tuple(axes)
        cells = _checked_cells(axes, np.asarray(cell))
        object.__setattr__(self, "axes", axes)
        object.__setattr__(self, "cell", cells)
        object.__setattr__(self, "frame", Frame() if frame is None else frame)
        object.__setattr__(
            self,
            "conductivity",
            None if conductivity is None else _checked_conductivity(cells.shape, np.asarray(conductivity)),
        )
        object.__setattr__(
            self, "goal_points", None if goal_points is None else _checked_goal_points(axes, cells, goal_points)
        )

    def with_cells(self, cell: ArrayLike) -> ConfigurationSpace:
        """The same space with other cells; goal cells that stay keep their points.

        Parameters
        ----------
        cell : array_like of int, shape of `cell`
            One of `Cell` for every cell.

        Returns
        -------
        ConfigurationSpace

        Raises
        ------
        InputError
            If the shape does not match or a value is out of range.
        """
        changed = ConfigurationSpace(self.axes, cell, self.conductivity, frame=self.frame)
        if self.goal_points is None:
            return changed
        points = np.full((*self.shape, self.ndim), np.nan)
        points[self.cell == Cell.GOAL] = self.goal_points
        kept = points[changed.cell == Cell.GOAL]
        return ConfigurationSpace(self.axes, cell, self.conductivity, frame=self.frame, goal_points=kept)

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
        """Lower corner, shape ``(ndim,)``, in axis units."""
        return np.array([axis.lower for axis in self.axes])

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper corner, shape ``(ndim,)``, in axis units."""
        return np.array([axis.upper for axis in self.axes])

    @property
    def spacing(self) -> NDArray[np.float64]:
        """Cell widths, shape ``(ndim,)``, in axis units."""
        return np.array([axis.spacing for axis in self.axes])

    @property
    def periodic(self) -> NDArray[np.bool_]:
        """Which axes are periodic, shape ``(ndim,)``."""
        return np.array([axis.periodic for axis in self.axes])

    @cached_property
    def goal_region(self) -> NDArray[np.int32]:
        """Number of the goal region each cell belongs to, -1 elsewhere.

        Goal regions are the face-connected components of goal cells, periodic axes included, numbered from 0 in
        C order of their first cell.
        """
        goal = self.cell == Cell.GOAL
        around = _box_around(goal)
        whole = [ends.stop - ends.start == size for ends, size in zip(around, self.shape, strict=True)]
        region = np.full(self.shape, -1, dtype=np.int32)
        region[around] = label_regions(goal[around], self.periodic & whole) - 1
        region.flags.writeable = False
        return region

    @cached_property
    def goal_count(self) -> int:
        """Number of goal regions."""
        return int(self.goal_region.max(initial=-1)) + 1

    @cached_property
    def goal_connected(self) -> NDArray[np.bool_]:
        """Free cells from which a chain of face neighbours leads to a goal through free cells alone."""
        region = label_regions(self.cell != Cell.OBSTACLE, self.periodic)
        served = np.zeros(region.max(initial=0) + 1, dtype=bool)
        served[region[self.cell == Cell.GOAL]] = True
        connected = np.asarray(self.cell == Cell.FREE)
        if not served[1:].all():
            connected &= served[region]
        connected.flags.writeable = False
        return connected

    def centre(self, cell: ArrayLike) -> NDArray[np.float64]:
        """Centre of a cell, or of many.

        Parameters
        ----------
        cell : array_like of int, shape (..., ndim)
            Cell indices.

        Returns
        -------
        ndarray of float64, shape (..., ndim)
            Coordinates in axis units.
        """
        return self.lower + (np.asarray(cell, dtype=np.float64) + 0.5) * self.spacing

    def locate(self, point: ArrayLike) -> NDArray[np.int64]:
        """Cell that a point lies in, or many.

        A point on a border between cells belongs to the upper cell, except on the upper end of the axis; a periodic
        coordinate is wrapped first.

        Parameters
        ----------
        point : array_like of float, shape (..., ndim)
            Coordinates in axis units.

        Returns
        -------
        ndarray of int64, shape (..., ndim)

        Raises
        ------
        InputError
            If a point is not finite or lies outside the grid.
        """
        cells, _ = self.split(point)
        return cells

    def split(self, point: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Cell and position within the cell, in [0, 1], of a point or of many; as `locate` otherwise.

        Parameters
        ----------
        point : array_like of float, shape (..., ndim)
            Coordinates in axis units.

        Returns
        -------
        cells : ndarray of int64, shape (..., ndim)
        local : ndarray of float64, shape (..., ndim)

        Raises
        ------
        InputError
            If a point is not finite or lies outside the grid.
        """
        points = np.asarray(point, dtype=np.float64)
        if points.shape[-1:] != (self.ndim,):
            raise InputError(f"a point of this space has {self.ndim} coordinates, got {points.tolist()!r}")
        scaled = (points - self.lower) / self.spacing
        size = np.array(self.shape)
        with np.errstate(invalid="ignore"):
            scaled = np.where(self.periodic, np.mod(scaled, size), scaled)
        inside = np.all((scaled >= 0) & (scaled <= size), axis=-1)
        if not np.all(inside):
            wrong = np.atleast_2d(points)[~np.atleast_1d(inside)][0]
            ranges = ", ".join(f"{axis.name} in [{axis.lower:g}, {axis.upper:g}]" for axis in self.axes)
            raise InputError(f"the point {tuple(wrong.tolist())} lies outside the grid ({ranges})")
        cells = np.minimum(np.floor(scaled).astype(np.int64), size - 1)
        return cells, np.clip(scaled - cells, 0.0, 1.0)


def _box_around(mask: NDArray[np.bool_]) -> tuple[slice, ...]:
    """The smallest box that holds all of a mask."""
    axes = range(mask.ndim)
    lines = [np.flatnonzero(mask.any(axis=tuple(other for other in axes if other != axis))) for axis in axes]
    return tuple(slice(int(line[0]), int(line[-1]) + 1) if len(line) else slice(0, 0) for line in lines)


def label_regions(mask: NDArray[np.bool_], periodic: ArrayLike) -> NDArray[np.int32]:
    """Face-connected components of a mask, numbered from 1 in C order of their first cell; 0 outside.

    Parameters
    ----------
    mask : ndarray of bool
        The cells that belong to some region.
    periodic : array_like of bool, shape (mask.ndim,)
        Which axes are periodic.

    Returns
    -------
    ndarray of int32, shape of mask
    """
    from scipy import ndimage

    labels = np.empty(mask.shape, dtype=np.int32)
    count = ndimage.label(mask, output=labels)
    wrapped = [axis for axis, ring in enumerate(np.asarray(periodic)) if ring]
    if not wrapped or count < 2:
        return labels
    return _join_across_seams(labels, count, wrapped)


def _join_across_seams(labels: NDArray[np.int32], count: int, wrapped: list[int]) -> NDArray[np.int32]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = [np.stack([labels.take(0, axis).ravel(), labels.take(-1, axis).ravel()]) for axis in wrapped]
    first, last = np.concatenate(pairs, axis=1)
    both = (first > 0) & (last > 0)
    graph = coo_array((np.ones(both.sum()), (first[both], last[both])), shape=(count + 1, count + 1))
    _, group = connected_components(graph, directed=False)
    # Old labels come in C order of first cells, so a group's smallest label orders the groups.
    _, order = np.unique(group[1:], return_index=True)
    rank = np.zeros(group.max() + 1, dtype=np.int32)
    rank[group[1:][np.sort(order)]] = np.arange(1, len(order) + 1, dtype=np.int32)
    new_label = rank[group]
    new_label[0] = 0
    return np.asarray(new_label[labels])


def _checked_cells(axes: tuple[Axis, ...], cell: NDArray[np.generic]) -> NDArray[np.uint8]:
    if not 1 <= len(axes) <= MAX_DIMENSIONS:
        raise InputError(f"a configuration space has 1 to {MAX_DIMENSIONS} axes, got {len(axes)}")
    expected = tuple(axis.cells for axis in axes)
    if cell.shape != expected:
        raise InputError(f"cell has shape {cell.shape}, but the axes say {expected}")
    names = [axis.name for axis in axes]
    if len(set(names)) < len(names):
        raise InputError(f"two axes share a name: {names}")
    plain = cell.dtype.kind == "u" and cell.max(initial=0) <= max(Cell)
    if not plain and not np.all(np.isin(cell, list(Cell))):
        raise InputError("cell may hold only 0 (free), 1 (obstacle) and 2 (goal)")
    return _read_only(np.array(cell, dtype=np.uint8, order="C"))


def _checked_conductivity(shape: tuple[int, ...], value: NDArray[np.generic]) -> NDArray[np.float64]:
    conductivity = np.array(value, dtype=np.float64, order="C")
    if conductivity.shape != shape:
        raise InputError(f"conductivity has shape {conductivity.shape}, but the cells have {shape}")
    good = np.isfinite(conductivity) & (conductivity > 0)
    if not good.all():
        where = tuple(int(i) for i in np.argwhere(~good)[0])
        raise InputError(f"conductivity must be positive and finite; cell {where} has {conductivity[where]}")
    return _read_only(conductivity)


def _checked_goal_points(axes: tuple[Axis, ...], cell: NDArray[np.uint8], value: ArrayLike) -> NDArray[np.float64]:
    points = np.array(value, dtype=np.float64, order="C")
    cells = np.argwhere(cell == Cell.GOAL)
    if points.shape != cells.shape:
        raise InputError(f"goal_points have shape {points.shape}, but the goal cells need {cells.shape}")
    lower, step = np.array([axis.lower for axis in axes]), np.array([axis.spacing for axis in axes])
    local = (points - lower) / step - cells
    # What coordinates far from 0 round to is no error.
    slack = 1e-9 + 8 * np.spacing(np.abs(lower) + step * cell.shape) / step
    outside = np.any(np.abs(local - 0.5) > 0.5 + slack, axis=1)
    if outside.any() or np.isinf(points).any():
        first = int(np.argmax(outside | np.isinf(points).any(axis=1)))
        raise InputError(
            f"the goal point {points[first].tolist()} does not lie in its cell {tuple(cells[first].tolist())}"
        )
    return _read_only(points)


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array
