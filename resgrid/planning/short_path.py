"""Shortened paths: the value type."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class ShortPath:
    """A streamline with straight lines in place of its bends; made by `shorten`, checked by `certify_free`.

    Attributes
    ----------
    points : ndarray of float64, shape (n, ndim)
        Corners in axis units, from the streamline's start to its end.  Periodic coordinates are continuous: they may
        leave the axis.
    goal : int or None
        Number of the goal region it ends at.
    length : float
        In axis units; at most ``original_length``.
    original_length : float
        Of the streamline.
    clearance : float
        Smallest distance to an obstacle cell's box or an edge that counts as an obstacle; infinite where there is none.
    """

    points: NDArray[np.float64]
    goal: int | None
    length: float
    original_length: float
    clearance: float

    def __post_init__(self) -> None:
        self.points.flags.writeable = False
