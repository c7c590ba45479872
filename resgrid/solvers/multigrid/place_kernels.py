"""Between rows and the places of a board; indices without a sign need not be asked whether they count from the end."""

from __future__ import annotations

import numpy as np
from numba import njit

from resgrid.jit import inner
from resgrid.solvers.multigrid.board_passes import Floats, Indices


@inner
def place_of(number: int, margin: int, places: int) -> int:
    """Place of a numbered cell, as `resgrid.solvers.multigrid.lattice.Lattice.place`."""
    return (number & 1) * places + margin + (number >> 1)


@njit(cache=True, nogil=True)
def put_at_places(place: Indices, values: Floats, factor: float, at_places: Floats) -> None:
    """Write ``factor`` times the values of all rows to their places."""
    for k in range(len(values)):
        at_places[np.uint32(place[k])] = factor * values[k]


@njit(cache=True, nogil=True)
def take_from_places(place: Indices, at_places: Floats) -> Floats:
    """The values of all rows."""
    values = np.empty(len(place))
    for k in range(len(values)):
        values[k] = at_places[np.uint32(place[k])]
    return values
