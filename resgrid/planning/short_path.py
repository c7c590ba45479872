"""Shortened paths: the value type."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid.frame import Frame
from resgrid.planning.streamline import in_world


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

    def __post_init__(self) -> None:
        self.axis_points.flags.writeable = False

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """The same corners in the world, shape (n, ndim)."""
        return in_world(self.axis_points, self.frame)
