"""Streamlines: the value type."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid.frame import Frame


class Outcome(StrEnum):
    """How a streamline ended."""

    REACHED = "reached"
    NO_PATH = "no_path"
    NO_CURRENT = "no_current"
    START_BLOCKED = "start_blocked"
    GOAL_BLOCKED = "goal_blocked"


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

    def __post_init__(self) -> None:
        self.axis_points.flags.writeable = False
        self.cells.flags.writeable = False

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """The same points in the world, shape (n, ndim)."""
        return in_world(self.axis_points, self.frame)

    @property
    def point_cells(self) -> NDArray[np.int64]:
        """The cell of every point, shape (n, ndim); segment ``i`` runs in the cell of point ``i``."""
        return np.concatenate([self.cells, self.cells[-1:]])[: len(self.axis_points)]


def in_world(axis_points: NDArray[np.float64], frame: Frame) -> NDArray[np.float64]:
    """Points in axis units as read-only points of the world, shape (n, ndim)."""
    points = frame.to_world(axis_points)
    points.flags.writeable = False
    return points
