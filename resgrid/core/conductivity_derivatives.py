"""Conversion of derivatives with respect to conductances of a netlist to derivatives with respect to conductivities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.compiler import contacts_of_box
from resgrid.core.netlist import Netlist
from resgrid.core.regions import by_axis, cells_at_faces, face_counts, with_margin
from resgrid.errors import InputError


def conductivity_gradient(netlist: Netlist, conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert derivatives with respect to conductances to derivatives with respect to conductivities of cells.

    The contact of two cells with the conductivities ``a`` and ``b`` has the conductance ``G = s 2 a b / (a + b)`` with
    a constant ``s`` (`resgrid.compile_space`), so that ``d log G / da = b / (a (a + b))``.  Next to a rail cell, ``G =
    s a`` and ``d log G / da = 1 / a``.  A wall resistance ``R_wall`` multiplies the derivatives of contacts with
    obstacles by ``1 / (1 + G R_wall)``, where ``G`` is the conductance without the wall.

    Parameters
    ----------
    netlist : Netlist
        Netlist of a compiled space, with linear resistors.  A resistor whose conductance differs from the compiled one
        is taken to be a constant multiple of it.
    conductance : ndarray of float64, shape (resistors,)
        Derivatives of a function with respect to the conductances, per siemens.

    Returns
    -------
    ndarray of float64, shape of the space
        Derivatives of the function with respect to the conductivities of cells, which have no unit.

    Raises
    ------
    InputError
        If the netlist was not compiled from a space, or there is not one derivative per resistor.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 4.0, 4)], [2, 0, 0, 1])
    >>> netlist = rg.compile_space(space, resistance=1.0)
    >>> rg.circuit.conductivity_gradient(netlist, np.array([1.0, 1.0, 10.0]))
    array([ 0. ,  1.5, 10.5,  0. ])
    """
    if np.shape(conductance) != netlist.conductance.shape:
        raise InputError(
            f"conductance has shape {np.shape(conductance)}; give one derivative per resistor: "
            f"({len(netlist.conductance)},)"
        )
    cells = netlist.cells
    space, wiring = cells.space, cells.wiring
    contacts = contacts_of_box(space, replace(wiring, wall_resistance=0.0) if wiring.wall_resistance else wiring)
    crosses = cells.resistor_face >= 0
    relative = np.bincount(
        cells.resistor_face[crosses],
        (conductance * netlist.conductance)[crosses],
        minlength=sum(face_counts(space.shape)),
    ).astype(np.float64)
    found = np.zeros(space.shape)
    c = np.ones(space.shape) if space.conductivity is None else np.asarray(space.conductivity, dtype=np.float64)
    wide, free = with_margin(c, space.periodic), contacts.code == Cell.FREE
    for axis, (periodic, flow) in enumerate(zip(space.periodic, by_axis(relative, space.shape), strict=True)):
        (lower, upper), (lower_free, upper_free) = cells_at_faces(wide, axis), cells_at_faces(free, axis)
        below, above = upper / (lower + upper) / lower, lower / (lower + upper) / upper
        below = np.where(lower_free == upper_free, below, np.where(lower_free, 1.0 / lower, 0.0))
        above = np.where(lower_free == upper_free, above, np.where(upper_free, 1.0 / upper, 0.0))
        if wiring.wall_resistance:
            walled = np.not_equal(*cells_at_faces(contacts.code == Cell.OBSTACLE, axis))
            fraction = 1.0 / (1.0 + contacts.conductance[axis] * wiring.wall_resistance)
            below, above = np.where(walled, fraction, 1.0) * below, np.where(walled, fraction, 1.0) * above
        below, above = (np.moveaxis(part * flow, axis, 0) for part in (below, above))
        along = np.moveaxis(found, axis, 0)
        along += above[:-1]
        along += below[1:]
        along[-1 if periodic else 0] += below[0]  # beyond an edge the conductivity is that of the cell at the edge
        along[0 if periodic else -1] += above[-1]
    return found
