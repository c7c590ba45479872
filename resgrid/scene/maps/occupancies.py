"""Cells of occupancies in percent, as in ``nav_msgs/OccupancyGrid`` messages."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell

OCCUPIED, FREE = 65, 25
"""Smallest occupancy of an occupied cell and largest one of a free cell, in percent, as map_server has them."""


def cells_of_occupancies(
    occupancy: NDArray[Any], unknown: str = "obstacle", lethal: int | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the codes of cells and the mask of unknown cells, both (width, height).

    `occupancy` (height, width): values in percent, bottom row first; `unknown`: treatment of unknown cells, obstacle or
    free; `lethal`: smallest occupancy of an obstacle.  Without `lethal`, occupancies from 26 to 64 are unknown; with
    it, all from 0 to below `lethal` are free.  Values below 0 or above 100 are unknown.
    """
    values = occupancy.T
    low, high = (FREE, OCCUPIED) if lethal is None else (lethal - 1, lethal)
    occupied, free = (values >= high) & (values <= 100), (values >= 0) & (values <= low)
    unseen = np.ascontiguousarray(~(occupied | free))
    blocked = occupied | unseen if unknown == "obstacle" else occupied
    cell = np.where(blocked, np.uint8(Cell.OBSTACLE), np.uint8(Cell.FREE))
    return np.ascontiguousarray(cell), unseen
