"""What the resistors of a netlist are on the die: the faces they cross, whatever passes made of them.

Resistors that cross no face (-1) are not the grid's own: switches, rails and loads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.grids import face_counts
from resgrid.netlist import Netlist


def identities(netlist: Netlist) -> int:
    """How many resistors a chip of this kind may have: the faces of its grid, or else the resistors of its netlist."""
    if netlist.cell_map is None:
        return len(netlist.conductance) + len(netlist.nonlinear_current)
    return sum(face_counts(netlist.cells.space.shape))


def identity(netlist: Netlist) -> tuple[NDArray[np.integer[Any]], NDArray[np.int64]]:
    """What resistors and nonlinear resistors are on the die, whatever passes did: their faces, -1 for extra ones."""
    if netlist.cell_map is None:
        m = len(netlist.conductance)
        return np.arange(m), np.arange(m, m + len(netlist.nonlinear_current))
    return netlist.cells.resistor_face, netlist.cells.nonlinear_face


def on_grid(netlist: Netlist) -> NDArray[np.bool_]:
    """Which resistors are the grid's own, shape (resistors,)."""
    return np.asarray(identity(netlist)[0] >= 0)


def per_resistor(netlist: Netlist, value: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spread a factor of every face over the resistors and the nonlinear resistors; 1 for those that cross none.

    Shapes: `value` (identities,); returns `linear` (resistors,), `nonlinear` (nonlinear resistors,).
    """
    padded = np.append(value, 1.0)
    linear, nonlinear = identity(netlist)
    return padded[linear], padded[nonlinear]


def scaled(netlist: Netlist, factor: NDArray[np.float64]) -> Netlist:
    """Multiply the resistance of the grid's resistors.  Shapes: `factor` (identities,)."""
    linear, nonlinear = per_resistor(netlist, factor)
    return netlist.replace(
        conductance=netlist.conductance / linear, nonlinear_current=netlist.nonlinear_current / nonlinear
    )
