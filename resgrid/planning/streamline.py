"""Paths: streamlines, shortened ones, and their points in coordinates without a jump at periodic seams."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.axis import rounding
from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.frozen import frozen
from resgrid.space import ConfigurationSpace


class Outcome(StrEnum):
    """How a streamline ended."""

    REACHED = "reached"
    NO_PATH = "no_path"
    NO_CURRENT = "no_current"
    START_BLOCKED = "start_blocked"
    GOAL_BLOCKED = "goal_blocked"


@frozen
@dataclass(frozen=True, eq=False)
class Streamline:
    """The way of a robot that follows the current from a start to a goal; its `points` lie in the world.

    Attributes
    ----------
    axis_points : ndarray of float64, shape (n, ndim)
        The start; every crossing of a cell face, the last one on the goal cell's; and the configuration within the
        goal cell that solves the goal, where the space names one (``ConfigurationSpace.goal_points``).  In axis units,
        as they were computed, each within its cell.
    cells : ndarray of int64, shape (m, ndim)
        The cells visited, from the start's to the goal cell entered.  Point ``i`` is where cell ``i`` is entered; with
        a last leg, straight from there to the goal, there is one point more than cells, in the last cell too.
    outcome : Outcome
        How it ended.
    goal : int or None
        Number of the goal region reached.
    length : float
        Length of the polyline, last leg included, in axis units (steps across a periodic seam count their true, short
        length).
    clearance : float
        Smallest distance from the polyline to an obstacle cell's box, or to an edge of the grid that counts as an
        obstacle; infinite where there is neither.
    log_duration : float
        Natural logarithm of the time that the velocity ``-conductivity * grad(phi)`` needs to the goal cell's face,
        where the current ends; NaN where nothing moved.
    frame : Frame
        Where the axes lie in the world.
    """

    axis_points: NDArray[np.float64]
    cells: NDArray[np.int64]
    outcome: Outcome
    goal: int | None
    length: float
    clearance: float
    log_duration: float
    frame: Frame

    def __repr__(self) -> str:
        end = f"{self.outcome}" + ("" if self.goal is None else f" goal {self.goal}")
        measures = f"length {self.length:.4g}, clearance {self.clearance:.4g}"
        return f"<Streamline {end}: {len(self.axis_points):,} points, {measures}>"

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """The same points in the world, shape (n, ndim)."""
        return in_world(self.axis_points, self.frame)

    @property
    def point_cells(self) -> NDArray[np.int64]:
        """The cell of every point, shape (n, ndim); segment ``i`` runs in the cell of point ``i``."""
        return np.concatenate([self.cells, self.cells[-1:]])[: len(self.axis_points)]


@frozen
@dataclass(frozen=True, eq=False)
class ShortPath:
    """A streamline with straight lines in place of its bends; made by `shorten`, checked by `certify_free`.

    Its `points` lie in the world.

    Attributes
    ----------
    axis_points : ndarray of float64, shape (n, ndim)
        Corners in axis units, as they were computed, from the streamline's start to its end.  Periodic coordinates
        are continuous: they may leave the axis.
    goal : int or None
        Number of the goal region it ends at.
    length : float
        In axis units; at most ``original_length``.
    original_length : float
        Of the streamline.
    clearance : float
        Smallest distance to an obstacle cell's box or an edge that counts as an obstacle; infinite where there is none.
    frame : Frame
        Where the axes lie in the world.
    """

    axis_points: NDArray[np.float64]
    goal: int | None
    length: float
    original_length: float
    clearance: float
    frame: Frame

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """The same corners in the world, shape (n, ndim)."""
        return in_world(self.axis_points, self.frame)


def unwrap(path: Streamline | ShortPath | ArrayLike, space: ConfigurationSpace) -> NDArray[np.float64]:
    """Points of a path in the world, in continuous coordinates, which may leave the range of a periodic axis.

    Nothing is guessed from distances: a streamline's point that enters a cell on its lower face came upwards, one on
    its upper face downwards, so every step across a seam is known, in a ring of two cells too.  A point differs from
    the streamline's own by whole turns only; the start by none.

    Parameters
    ----------
    path : Streamline, ShortPath or array_like of float, shape (n, ndim)
        An array holds points of the world.  What is no streamline is continuous already, and is checked and copied.
    space : ConfigurationSpace

    Returns
    -------
    ndarray of float64, shape (n, ndim)
        World coordinates.

    Raises
    ------
    InputError
        If the points do not fit the space or are not finite.
    """
    return space.to_world(axis_path(path, space))


def axis_path(path: Streamline | ShortPath | ArrayLike, space: ConfigurationSpace) -> NDArray[np.float64]:
    """Points of a path in axis units and continuous: the door of all that takes paths; as `unwrap` otherwise.

    Shapes: `path` (n, ndim); returns (n, ndim).
    """
    if not isinstance(path, Streamline | ShortPath):
        return space.from_world(_fitting(path, space))
    if path.frame != space.frame:
        raise InputError("the path lies elsewhere in the world than this space, so that it does not belong to it")
    points = _fitting(path.axis_points, space)
    if isinstance(path, ShortPath):
        return points
    return points + _turns(path, space) * (space.upper - space.lower)


def wrap(points: ArrayLike, space: ConfigurationSpace) -> NDArray[np.float64]:
    """Points with periodic coordinates brought back into their axes, ``lower <= x < upper``.

    Shapes: `points` (n, ndim); returns (n, ndim).
    """
    own = _fitting(points, space)
    turned = space.lower + np.mod(own - space.lower, space.upper - space.lower)
    return np.where(space.periodic, np.where(turned < space.upper, turned, space.lower), own)


def length_of(points: NDArray[np.float64]) -> float:
    """Length of a polyline in axis units."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _turns(path: Streamline, space: ConfigurationSpace) -> NDArray[np.int64]:
    """Whole turns of every point around every axis since the start, shape (n, ndim)."""
    cells = path.point_cells
    if cells.shape != path.axis_points.shape or len(path.axis_points) < len(path.cells):
        raise InputError(
            f"the path has {len(path.axis_points)} points and {len(path.cells)} cells; it is no streamline of ours"
        )
    local = (path.axis_points - space.lower) / space.spacing - cells
    step = np.where(np.diff(cells, axis=0) != 0, np.where(local[1:] < 0.5, 1, -1), 0)
    continuous = np.concatenate([cells[:1], cells[:1] + np.cumsum(step, axis=0)])
    turns, left = np.divmod(continuous - cells, np.array(space.shape))
    if left.any():
        raise InputError(f"the path leaps between cells {_leap(cells, left)}; it does not belong to this space")
    outside = np.abs(local - 0.5) > 0.5 + rounding(space.axes)
    if np.any(outside | (cells < 0) | (cells >= space.shape)):
        raise InputError("points of the path lie outside their cells in this space; it belongs to another")
    return np.asarray(turns, dtype=np.int64)


def _leap(cells: NDArray[np.int64], left: NDArray[np.int64]) -> str:
    at = int(np.argmax(left.any(axis=1)))
    return f"{tuple(cells[at - 1].tolist())} and {tuple(cells[at].tolist())}"


def _fitting(path: ArrayLike, space: ConfigurationSpace) -> NDArray[np.float64]:
    try:
        points = np.array(path, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("a path is a table of numbers, one point a row") from None
    if points.ndim != 2 or points.shape[1] != space.ndim or not len(points):
        raise InputError(f"a path in this space has shape (points, {space.ndim}), got {points.shape}")
    if not np.isfinite(points).all():
        row = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InputError(f"point {row} of the path is not finite: {points[row].tolist()}")
    return points


def in_world(axis_points: NDArray[np.float64], frame: Frame) -> NDArray[np.float64]:
    """Points in axis units as read-only points of the world, shape (n, ndim)."""
    points = frame.to_world(axis_points)
    points.flags.writeable = False
    return points
