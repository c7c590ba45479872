"""Compile a configuration space into the netlist of a lattice other than "square".

Sites of a lattice (`resgrid.core.lattices`) lie in cells.  A site in a free cell has a node of its own; sites in goal
cells belong to the rail of their goal region.  ``G`` is the conductance of the step between two sites, and ``R_wall``
the wall resistance.  A segment is the straight line between the two sites; it is blocked if it touches an obstacle cell
(closed, so that a corner blocks), and beyond the edge if its second end lies outside the grid:

===========================  ===================  ===============================  =======
segment                      dirichlet            wall                             neumann
===========================  ===================  ===============================  =======
free to free, clear          ``G``                ``G``                            ``G``
free to goal, clear          ``G`` to the goal    ``G`` to the goal                ``G`` to the goal
free, blocked                ``G`` to the rail    ``1 / (1 / G + R_wall)`` to the  none
                                                  rail
beyond an obstacle edge      as blocked           as blocked                       none
beyond an open edge          none                 none                             none
goal to goal or obstacle     none                 none                             none
===========================  ===================  ===============================  =======

On ``square8`` and ``cube26``, blocked steps across an edge or a corner of cells have no contact: there the weights of
face neighbours apply (`resgrid.core.cell_lattices.CellLattice`), and contacts are those of the lattice "square".  A
conductance is ``g c / R`` with the weight ``g`` of the step and the harmonic mean ``c`` of the conductivity along the
segment; if only one end is free, its conductivity replaces that of the goal cell, and contacts with the obstacle rail
have the conductivity of the free cell.  No resistor passes a blocked corner.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.memory import require_grid_memory
from resgrid.core.cell import Cell
from resgrid.core.drive_checks import WALLED_IN
from resgrid.core.lattice import Lattice
from resgrid.core.lattice_map import LatticeMap
from resgrid.core.lattices import lattice_of
from resgrid.core.netlist import GROUND, MOST_NODES, Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import CircuitError, InputError

_PEAK = 100
"""Peak memory of the compilation, in bytes per site and per step; 81 to 93 were measured on open grids."""


class _Links(NamedTuple):
    """Resistors of a lattice, given by sites, before the nodes are numbered.

    `first`, `second` (m,): flat indices of the sites at both ends; `step` (m,): index of the step from the first to the
    second site; `siemens` (m,): conductance, in siemens.  For a resistor to the obstacle rail, `second`, `step` are -1.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    step: NDArray[np.int8]
    siemens: NDArray[np.float64]


def compile_lattice(space: ConfigurationSpace, wiring: Wiring) -> Netlist:
    """Return the netlist of a lattice over a space; `wiring`: complete wiring, from ``wiring.on(space)``.

    The order of the nodes is ground, obstacle rail, goal rails, sites in C order.
    """
    lattice = lattice_of(wiring.lattice, space)
    require_grid_memory(lattice.shape, "compiling the lattice", _PEAK * len(lattice.steps))
    code = lattice.at_sites(space.cell)
    own = code == Cell.FREE
    if wiring.is_open and not wiring.has_islands:
        own &= lattice.at_sites(space.goal_connected)
    if wiring.drive == "uniform" and not own.any():
        raise CircuitError(WALLED_IN)
    parts = [_no_links()]  # rings of a single cell have no steps
    parts += [_resistors(lattice, wiring, own, step) for step in range(len(lattice.steps))]
    if not wiring.is_open:
        parts += [_contacts(lattice, wiring, own, step) for step in range(len(lattice.steps))]
    links = _Links(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    obstacle = GROUND + 1 if (links.step < 0).any() else -1
    first = GROUND + 1 + (obstacle >= 0)
    goals = tuple(range(first, first + space.goal_count))
    first += len(goals)
    count = int(np.count_nonzero(own))
    if first + count > MOST_NODES:
        raise InputError(f"{count:,} sites have a node; a netlist may have {MOST_NODES:,}: choose larger cells")
    free = np.arange(first, first + count, dtype=np.int32)
    node = np.full(lattice.shape, -1, dtype=np.int32)
    node[code == Cell.OBSTACLE] = obstacle
    is_goal = code == Cell.GOAL
    node[is_goal] = np.array(goals, dtype=np.int32)[lattice.at_sites(space.goal_region)[is_goal]]
    node[own] = free
    flat = node.ravel()
    lattice_map = LatticeMap(space, wiring, lattice, node, links.first, links.step, free, obstacle, goals)
    tied = [obstacle] * (obstacle >= 0) + [*goals]
    volts = [wiring.high] * (obstacle >= 0) + [wiring.goal_voltage] * len(goals)
    if wiring.start is not None:
        start = np.array(wiring.start, dtype=np.int64)
        tied.append(int(node[tuple(lattice.nearest(start, space.axis_centre(start)))]))
        volts.append(wiring.high)
    drives = free if wiring.drive == "uniform" else free[:0]
    return Netlist(
        first + count,
        np.stack([flat[links.first], np.where(links.second < 0, obstacle, flat[links.second])], axis=1),
        links.siemens,
        np.stack([tied, np.full(len(tied), GROUND)], axis=1),
        np.array(volts),
        np.stack([np.full_like(drives, GROUND), drives], axis=1),
        np.full(len(drives), wiring.supply / (wiring.resistance * max(count, 1))),
        lattice_map=lattice_map,
    )


def _no_links() -> _Links:
    """Return an empty list of resistors."""
    none = np.empty(0, dtype=np.int64)
    return _Links(none, none, none.astype(np.int8), none.astype(np.float64))


def _resistors(lattice: Lattice, wiring: Wiring, own: NDArray[np.bool_], step: int) -> _Links:
    """Return the resistors along one step of the lattice that join two sites with nodes, or such a site and a goal.

    `own` (shape of the lattice): whether a site, in a free cell, has a node of its own; `step`: index of the step.
    """
    weight, c = lattice.site_weights[step], lattice.conductivity_at(step)
    there, is_own = lattice.neighbours(step).ravel(), own.ravel()
    is_end = is_own | (lattice.at_sites(lattice.space.cell) == Cell.GOAL).ravel()
    joined = (weight > 0) & is_end & is_end[there] & (is_own | is_own[there])
    here = np.flatnonzero(joined)
    joined[here[there[here] == here]] = False  # a ring of one site leads back to it
    here = np.flatnonzero(joined)
    siemens = weight[here] / wiring.resistance
    if c is not None:
        siemens *= c.ravel()[here]
    return _Links(here, there[here], np.full(len(here), step, dtype=np.int8), siemens)


def _contacts(lattice: Lattice, wiring: Wiring, own: NDArray[np.bool_], step: int) -> _Links:
    """Return the resistors to the obstacle rail that replace blocked resistors along one step and its negative.

    A resistor is blocked if its segment touches an obstacle cell, or leaves the grid at an edge that acts as an
    obstacle.  `own` (shape of the lattice): whether a site has a node of its own; `step`: index of the step.
    """
    there, contact = lattice.neighbours(step), lattice.contact_weight(step)
    blocked = (lattice.site_weights[step].reshape(lattice.shape) == 0) & (there >= 0) & (contact > 0)
    ends = [np.flatnonzero(blocked & own)]
    back = there[blocked]
    ends.append(np.sort(back[own.ravel()[back]]))
    edges = wiring.edges(lattice.space)
    for sense in (-1, 1):
        outside, opened = np.zeros(lattice.shape, dtype=np.bool_), np.zeros(lattice.shape, dtype=np.bool_)
        for axis, rule in enumerate(edges):
            beyond = lattice.outside(step, sense, axis)
            outside |= beyond
            opened |= beyond & (rule == "open")
        ends.append(np.flatnonzero(outside & ~opened & own & (contact > 0)))
    site = np.concatenate(ends)
    siemens = np.full(len(site), contact / wiring.resistance)
    if lattice.space.conductivity is not None:
        siemens *= lattice.at_sites(lattice.space.conductivity).ravel()[site]
    if wiring.wall_resistance:
        siemens = 1.0 / (1.0 / siemens + wiring.wall_resistance)
    none = np.full(len(site), -1)
    return _Links(site, none, none.astype(np.int8), siemens)
