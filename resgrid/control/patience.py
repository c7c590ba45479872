"""How long a robot is let alone that does not get anywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

LONGEST = 40.0
"""Cells that a robot could have crossed while it stayed within half a cell: then it stands."""

DITHERS = 10
"""How often it is shaken before it is given up."""


class Patience:
    """Notices that a robot stays within half a cell, by what it could have crossed at the speed of its command.

    `spacing` (ndim,); `place` (ndim,).
    """

    def __init__(self, spacing: Vector, place: Vector) -> None:
        self._spacing = spacing
        self.renew(place)

    def renew(self, place: Vector) -> None:
        """Begin anew here."""
        self._anchor, self.crossed, self._dithers = place, 0.0, 0

    def wait(self, place: Vector, cells: float) -> None:
        """The robot is here, and could have crossed so many cells since it was asked last."""
        if np.any(np.abs(place - self._anchor) > 0.5 * self._spacing):
            self.renew(place)
        else:
            self.crossed += cells

    @property
    def lost(self) -> bool:
        """Whether the robot has stood for long."""
        return self.crossed >= LONGEST * (1.0 - 1e-9)

    def shake(self) -> bool:
        """Whether it may be shaken once more."""
        if self._dithers >= DITHERS:
            return False
        self.crossed, self._dithers = 0.0, self._dithers + 1
        return True
