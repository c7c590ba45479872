"""Page data of lattices other than "square": potential and currents per cell, and all nodes and resistors.

The page shows one node per cell: the site (place of a node) that is nearest to the centre of the cell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.cell import Cell
from resgrid.core.lattice import Lattice
from resgrid.planning.any_field import AnyField
from resgrid.planning.lattice_fields import LatticeField

_ARROWS = "→↗↑↖←↙↓↘"
"""Arrows of the eight directions, counterclockwise from the direction of the first axis."""


def at_cells(field: AnyField, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return one value of a field per cell, in the shape of the field's space.

    For a lattice this is the value at the site (place of a node) that is nearest to the centre of the cell.  `values`:
    one value per cell, or for a lattice one value per site.
    """
    return values.ravel()[field.lattice.central_sites] if isinstance(field, LatticeField) else values


def flows(field: LatticeField) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the flow through the node of each cell (nx, ny, 2), and the log of the node's largest current (nx, ny).

    A flow is the sum of the currents along all steps times their unit vectors, relative to the largest current of the
    node.  Each component is divided by the cell width of its axis, in multiples of the smallest cell width.  The
    logarithm is natural, of currents in units of supply / resistance, -inf without current.
    """
    lattice, site = field.lattice, field.lattice.central_sites
    parts = []
    for step in range(len(lattice.steps)):
        unit = _unit(lattice, step)
        direction, log = field.step_direction[step].ravel(), field.step_log_current[step].ravel()
        for start in (site, lattice.neighbours(step, -1).ravel()[site]):  # first ends of both resistors along the step
            sign = np.where(start >= 0, direction[start], 0)
            parts.append((sign[..., np.newaxis] * unit, np.where(sign == 0, -np.inf, log[start])))
    largest = np.max([log for _, log in parts], axis=0)
    base = np.where(np.isfinite(largest), largest, np.inf)
    flow = sum(unit * np.exp(log - base)[..., np.newaxis] for unit, log in parts)
    return np.asarray(flow) * field.space.spacing.min() / field.space.spacing, largest


def step_currents(field: LatticeField, index: tuple[int, int]) -> list[list[Any]]:
    """Return the currents from the node of a cell to its neighbours, as one list per neighbour.

    A list consists of an arrow for the direction, the outward current in units of supply / resistance, and whether
    paths take this step. `index`: index of the cell along each axis.
    """
    lattice = field.lattice
    site = int(lattice.central_sites[index])
    rows = []
    for number, (step, sense) in enumerate(lattice.directions):
        there = int(lattice.neighbours(step, sense).ravel()[site])
        if there < 0:
            continue
        inward = np.exp(field.outward(step, -sense)[there])
        angle = float(np.arctan2(*(sense * _unit(lattice, step))[::-1]))
        amperes = float(np.exp(field.outward(step, sense)[site]) - inward)
        rows.append((angle % (2 * np.pi), amperes, bool(field.move[site] == number)))
    return [[_ARROWS[round(angle / (np.pi / 4)) % 8], *rest] for angle, *rest in sorted(rows)]


def segments(op: OperatingPoint) -> dict[str, Any]:
    """Return the resistors of a lattice as a dictionary for JSON, with places in cell widths from the lower corner.

    Keys: `segments`: lists of x and y of both ends, ohms, and volts and amperes from the first to the second end;
    `contacts`: lists of x and y of a node and the ohms of its contacts with the obstacle rail in parallel; `nodes`:
    lists of x and y of all nodes in free cells.
    """
    netlist, found = op.netlist, op.netlist.lattice_map
    assert found is not None
    lattice, space = found.lattice, found.space

    def place(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return (points - space.lower) / space.spacing

    ohms, joins = 1.0 / netlist.conductance, found.resistor_step >= 0
    first = lattice.points_of(found.resistor_site)
    second = first + lattice.steps[found.resistor_step]
    columns = [*place(first).T, *place(second).T, ohms, ohms * op.resistor_current, op.resistor_current]
    contact = np.zeros(lattice.size)
    np.add.at(contact, found.resistor_site[~joins], netlist.conductance[~joins])
    tied = np.flatnonzero(contact)
    tied_places = place(lattice.points_of(tied))
    own = np.argwhere((lattice.at_sites(space.cell) == Cell.FREE) & (found.node >= 0))
    return {
        "segments": np.stack([column[joins] for column in columns], axis=1).tolist(),
        "contacts": np.column_stack([tied_places, 1.0 / contact[tied]]).tolist(),
        "nodes": place(lattice.points(own)).tolist(),
    }


def _unit(lattice: Lattice, step: int) -> NDArray[np.float64]:
    """Return the unit vector (2,) of a step to a neighbour in the plane of the axes; `step`: index into the steps."""
    return np.asarray(lattice.steps[step] / np.linalg.norm(lattice.steps[step]))
