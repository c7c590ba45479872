"""The wavefront of a change of the map, as it spreads through a grid that settles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.control.settling import GridSettling, LiveGrid, check_same_grid
from resgrid.errors import InputError
from resgrid.space import ConfigurationSpace


@dataclass(frozen=True, eq=False)
class Wavefront:
    """How a change of the map spreads.

    Attributes
    ----------
    before, after : ConfigurationSpace
        The map that the grid had settled to, and the one it is settling to.
    cells : ndarray of float64, shape (t,)
        When: in cells that the robot could have crossed.
    potential : ndarray of float64, shape (t, *shape of the space)
        At those times; NaN in cells without a node.
    distance : ndarray of float64, shape (t,)
        Largest distance of a potential from its end.
    first : ndarray of float64, shape of the space
        Potential before the change.
    """

    before: ConfigurationSpace
    after: ConfigurationSpace
    cells: NDArray[np.float64]
    potential: NDArray[np.float64]
    distance: NDArray[np.float64]
    first: NDArray[np.float64]

    def __post_init__(self) -> None:
        for array in (self.cells, self.potential, self.distance, self.first):
            array.flags.writeable = False


def wavefront(
    settling: GridSettling, before: ConfigurationSpace, after: ConfigurationSpace, cells: NDArray[np.float64]
) -> Wavefront:
    """Follow a change of the map through the grid.

    Parameters
    ----------
    settling : GridSettling
    before, after : ConfigurationSpace
        Of the same axes.
    cells : ndarray of float64, shape (t,)
        When to look: in cells that the robot could have crossed since the change, ascending.

    Returns
    -------
    Wavefront

    Raises
    ------
    InputError
        If the maps have different axes, or the times do not ascend.
    CircuitError
        If nothing can be driven.
    """
    when = np.asarray(cells, dtype=np.float64)
    if when.ndim != 1 or not len(when) or not np.isfinite(when).all() or when[0] < 0 or np.any(when[1:] < when[:-1]):
        raise InputError("times of a wavefront must be finite, at least 0 and ascending, in cells crossed")
    check_same_grid(before, after)
    grid = LiveGrid(settling, before)
    first = grid.field.potential
    grid.change(after)
    frames, distance = [], []
    for _ in _stops(grid, when):
        frames.append(grid.field.potential)
        distance.append(grid.distance)
    return Wavefront(before, after, when.copy(), np.array(frames), np.array(distance), first)


def _stops(grid: LiveGrid, when: NDArray[np.float64]) -> Iterator[float]:
    now = 0.0
    for time in when.tolist():
        grid.advance(time - now)
        now = time
        yield time
