"""Streamlines: the value type."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class Outcome(StrEnum):
    """How a streamline ended."""

    REACHED = "reached"
    NO_PATH = "no_path"
    NO_CURRENT = "no_current"
    START_BLOCKED = "start_blocked"
    GOAL_BLOCKED = "goal_blocked"


@dataclass(frozen=True, eq=False)
class Streamline:
    """The way of a robot that follows the current from a start to a goal.

    Attributes
    ----------
    points : ndarray of float64, shape (n, ndim)
        The start, every crossing of a cell face, the last one on the goal cell's face; in axis units.
        Periodic coordinates are wrapped into the axis.
    cells : ndarray of int64, shape (m, ndim)
        The cells visited, from the start's to the goal cell entered.
    outcome : Outcome
        How it ended.
    goal : int or None
        Number of the goal region reached.
    length : float
        Length of the polyline, in axis units (steps across a periodic seam count their true, short length).
    clearance : float
        Smallest distance from the polyline to an obstacle cell's box, or to an edge of the grid that counts as an
        obstacle; infinite where there is neither.
    log_duration : float
        Natural logarithm of the time that the velocity ``-conductivity * grad(phi)`` needs; NaN where nothing moved.
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    outcome: Outcome
    goal: int | None
    length: float
    clearance: float
    log_duration: float

    def __post_init__(self) -> None:
        self.points.flags.writeable = False
        self.cells.flags.writeable = False
