"""Currents through the faces of cells straight from the cells' voltages, without a netlist.

The conductances are those of the compiler (`resgrid.compiler.contacts_of_rows`), for ``rails="merged"``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.compiler import Kind, contacts_of_rows
from resgrid.grids import before_and_behind, with_margin
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
    contacts = contacts_of_rows(space, wiring.on(space), 0, space.shape[0])
    wide = with_margin(volts, space.periodic)
    wide[contacts.kind == Kind.HIGH] = wiring.high
    currents = []
    for axis, conductance in enumerate(contacts.conductance):
        before, behind = before_and_behind(wide, axis)
        current = conductance * (before - behind)
        current[np.isnan(current)] = 0.0
        currents.append(current)
    return tuple(currents)
