"""Conversion of occupancies in percent (``nav_msgs/OccupancyGrid``) to cell codes and conductivities."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell

OCCUPIED_FROM, FREE_TO = 65, 25
"""Smallest occupancy of an obstacle cell and largest occupancy of a free cell, in percent.

They are the defaults of ROS's map_server.
"""


def cells_of_occupancies(
    occupancy: NDArray[Any], unknown: str = "obstacle", lethal: int | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the codes of cells and the mask of unknown cells, both (width, height).

    `occupancy` (height, width): values in percent, bottom row first; `unknown`: treatment of unknown cells, obstacle or
    free; `lethal`: smallest occupancy of an obstacle.  Without `lethal`, occupancies from 26 to 64 are unknown; with
    it, all from 0 to below `lethal` are free.  Values below 0 or above 100 are unknown.
    """
    values = occupancy.T
    low, high = (FREE_TO, OCCUPIED_FROM) if lethal is None else (lethal - 1, lethal)
    occupied, free = (values >= high) & (values <= 100), (values >= 0) & (values <= low)
    unseen = np.ascontiguousarray(~(occupied | free))
    blocked = occupied | unseen if unknown == "obstacle" else occupied
    cell = np.where(blocked, np.uint8(Cell.OBSTACLE), np.uint8(Cell.FREE))
    return np.ascontiguousarray(cell), unseen


def conductivities(percent: NDArray[Any], least: float, lethal: int) -> NDArray[np.float64]:
    """Return the relative conductivities of cells: least ** (p / lethal) for an occupancy p below `lethal`, else 1.

    `percent`: occupancies p in percent, negative for unknown cells, whose conductivity is 1; `least`: limit of the
    conductivity as p rises to `lethal`; `lethal`: smallest occupancy of an obstacle. The result has the shape of
    `percent`.
    """
    known = np.clip(percent, 0, None)
    return np.ascontiguousarray(np.where(known < lethal, least ** (known / lethal), 1.0))
