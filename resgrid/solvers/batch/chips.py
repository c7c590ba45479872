"""What distinguishes one chip of many."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Chip(NamedTuple):
    """Equations of a chip whose nodes are joined as the nominal one's are.

    `entries` (entries,): of the edges, row by row, in siemens; `ground` (n,): in siemens; `drive` (n,): in amperes;
    `mostly, least`: by how much its conductances exceed the nominal ones: mostly, as a power of two, and at least.
    """

    entries: NDArray[np.float64]
    ground: NDArray[np.float64]
    drive: NDArray[np.float64]
    mostly: float
    least: float
