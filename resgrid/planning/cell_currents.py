"""Currents through the faces of cells straight from the cells' voltages, without a netlist.

The conductances are those of the compiler (`resgrid.conductances`), for ``rails="merged"``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.window import across, beyond
from resgrid.grids import slab
from resgrid.netlist import face_shape
from resgrid.space import Cell, ConfigurationSpace
from resgrid.wiring import Wiring


def cell_volts(space: ConfigurationSpace, wiring: Wiring, voltage: NDArray[np.float64]) -> NDArray[np.float64]:
    """Voltages of all cells, shape of the space: also of rails, and of parts that goals alone hold; NaN of others."""
    flat = (space.cell == Cell.GOAL) | (space.goal_connected & np.isnan(voltage))
    volts = np.where(flat, wiring.goal_voltage, voltage)
    volts[space.cell == Cell.OBSTACLE] = np.nan if wiring.is_driven else wiring.high
    if wiring.start is not None:
        volts[wiring.start] = wiring.high
    return volts


def face_currents(
    space: ConfigurationSpace, wiring: Wiring, volts: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """Currents through the faces across every axis, in amperes, positive along it; 0 beside a cell without a voltage.

    Shapes: `volts` as the space; of every axis a face more along it, of which on a ring the last repeats the first.
    """
    return tuple(_across_axis(space, wiring, volts, axis) for axis in range(space.ndim))


def _across_axis(
    space: ConfigurationSpace, wiring: Wiring, volts: NDArray[np.float64], axis: int
) -> NDArray[np.float64]:
    size, free = space.shape[axis], space.cell == Cell.FREE
    current = np.zeros(face_shape(space.shape, axis))
    first, last = slab(current, axis, 0, 1), slab(current, axis, size, size + 1)
    slab(current, axis, 1, size)[...] = _between(space, wiring, volts, free, axis, slice(None))
    if space.axes[axis].periodic:
        if size > 1:
            first[...] = last[...] = _between(space, wiring, volts, free, axis, [size - 1, 0])
    else:
        for faces, end, sign in ((first, (0, 1), 1.0), (last, (size - 1, size), -1.0)):
            conductivity = None if space.conductivity is None else slab(space.conductivity, axis, *end)
            drop = wiring.high - slab(volts, axis, *end)
            faces[...] = np.where(slab(free, axis, *end), beyond(space, wiring, axis, conductivity) * sign * drop, 0.0)
    current[np.isnan(current)] = 0.0
    return current


def _between(
    space: ConfigurationSpace,
    wiring: Wiring,
    volts: NDArray[np.float64],
    free: NDArray[np.bool_],
    axis: int,
    which: slice | list[int],
) -> NDArray[np.float64]:
    """Currents from each of some cells along an axis to the next of them; between two rails there is no resistor."""
    some = (slice(None),) * axis + (which,)
    conductivity = None if space.conductivity is None else space.conductivity[some]
    edge = across(space, wiring, axis, space.cell[some], conductivity)
    n = edge.shape[axis]
    between = slab(free[some], axis, 0, n) | slab(free[some], axis, 1, n + 1)
    drop = slab(volts[some], axis, 0, n) - slab(volts[some], axis, 1, n + 1)
    return np.asarray(np.where(between, edge * drop, 0.0))
