"""Compile a configuration space into a netlist: nodes of cells, resistors between neighbours, and sources.

Face neighbours are connected by resistors (`resgrid.core.lattice_compiler` compiles the other lattices).  Voltage
sources tie obstacles and goals to their rails, or current sources drive the nodes (Tarassenko & Blake 1991; Connolly &
Grupen 1992, section 2).

Along axis ``a`` the conductance is ``(h_ref / h_a)**2 / R`` times the series combination ``2 c_i c_j / (c_i + c_j)`` of
the cells' conductivities ``c``.  Here ``h_a`` is the cell width along the axis, ``h_ref`` the smallest width, and ``R``
the resistance between neighbours.  Kirchhoff's current law at a node is then the finite-volume form of
``div(c grad phi) = 0``.

The contact, the resistor between two neighbours, depends on the kinds of both cells and on the boundary condition;
``R_wall`` is the wall resistance:

=================  ==========  ============================  =======================
neighbours         dirichlet   wall                          neumann
=================  ==========  ============================  =======================
free, free         ``G``       ``G``                         ``G``
free, goal         ``G``       ``G``                         ``G``
goal, goal         ``G``       ``G``                         ``G``
free, obstacle     ``G``       ``1 / (1 / G + R_wall)``      none
goal, obstacle     ``G``       ``1 / (1 / G + R_wall)``      none
obstacle, obstacle ``G``       ``G``                         none
=================  ==========  ============================  =======================

If exactly one of the two cells is free, ``G`` depends on its conductivity alone.  An edge that counts as an obstacle is
padded by obstacle cells on the obstacle rail, with the conductivity of the cells at the edge.  An open edge has no
contacts.  Resistors between obstacle or goal cells exist only if these have nodes (``rails="cells"``, as on a chip).

With a leak, every free node has one more resistor, of conductance ``leak * h_ref**2 / R``, to the obstacle rail.  The
drop ``u`` from that rail then solves the screened Poisson equation ``div(c grad u) = leak u``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.memory import FEWER_CELLS, Remedy, require_grid_memory
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.drive_checks import NO_GOAL, WALLED_IN
from resgrid.core.lattice import SQUARE, require_square
from resgrid.core.lattice_compiler import compile_lattice
from resgrid.core.netlist import GROUND, MOST_NODES, Netlist
from resgrid.core.regions import cells_at_faces, face_counts, face_shape, slab, with_margin
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, wiring_of
from resgrid.errors import CircuitError, InputError

_NO_NODE = -1
_PEAK = 80
"""Peak memory of the compilation, in bytes per cell and per axis of the grid, measured on open grids."""


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Node numbers of a compiled space.

    `cell` (shape of the space): node of every cell, -1 without a node; `free` (free nodes,): nodes of the free cells,
    in C order; `obstacle`: node of the obstacle rail, -1 without one; `goals`: nodes of the goal rails, one per goal
    region, if rails are merged, else empty; `count`: number of nodes, ground included.
    """

    cell: NDArray[np.int32]
    free: NDArray[np.int32]
    obstacle: int
    goals: tuple[int, ...]
    count: int


def compile_space(space: ConfigurationSpace, wiring: Wiring | None = None, **options: Unpack[WiringOptions]) -> Netlist:
    """Compile a configuration space into a resistor netlist.

    Parameters
    ----------
    space : ConfigurationSpace
        Space with one to four axes and, unless the drive is ``"none"``, at least one goal cell.
    wiring : Wiring, optional
        Boundary conditions, drive and element values.  By default obstacles are at 1 V, goals at 0 V, and neighbours
        are connected by 10 kohm.
    **options
        Fields of `Wiring`, such as ``boundary="neumann"``: instead of `wiring`, or as changes to it.

    Returns
    -------
    Netlist
        Netlist with a `CellMap`, or a `LatticeMap` for another lattice than "square".  The order of the nodes is
        ground, obstacle rail, goal rails, cells or sites in C order.

    Raises
    ------
    InputError
        If an option is unknown, missing or inconsistent with others, or there is no goal cell.
    CircuitError
        If no free cell is connected to a goal (with a uniform drive), or the driven start cell is not.
    BudgetError
        If the netlist does not fit in memory.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 4.0, 4)], [2, 0, 0, 1])
    >>> rg.compile_space(space, resistance=1e3).conductance
    array([0.001, 0.001, 0.001])
    >>> rg.compile_space(space, boundary="neumann").current_amps
    array([5.e-05, 5.e-05])

    Open obstacles leave free cells without a path to a goal out of the circuit.  A circuit for effective resistances
    contains them, and needs no goal:

    >>> parts = rg.ConfigurationSpace([rg.Axis("x", 0.0, 5.0, 5)], [0, 0, 1, 0, 2])
    >>> rg.compile_space(parts, boundary="neumann").cells.node
    array([-1, -1, -1,  2,  1], dtype=int32)
    >>> rg.compile_space(parts, boundary="neumann", drive="none").cells.node
    array([ 2,  3, -1,  4,  1], dtype=int32)
    """
    wiring = wiring_of(wiring, options).on(space)
    require_netlist_memory(space.shape, has_leak=wiring.leak > 0)
    if not space.goal_count and wiring.drive != "none":
        raise InputError(NO_GOAL)
    if wiring.lattice != SQUARE:
        return compile_lattice(space, wiring)
    contacts = contacts_of_box(space, wiring)
    nodes = _number_nodes(space, wiring, contacts.kind)
    pairs, conductance, face, upward = _resistors(space, contacts, nodes)
    cell_map = CellMap(
        space=space,
        wiring=wiring,
        node=nodes.cell,
        resistor_face=face,
        resistor_upward=upward,
        free_node=nodes.free,
        obstacle_node=nodes.obstacle,
        goal_nodes=nodes.goals,
    )
    columns = (
        pairs,
        conductance,
        *_voltage_sources(space, wiring, nodes),
        *_uniform_drive(wiring, nodes),
    )
    for column in columns:
        column.flags.writeable = False  # otherwise the netlist would copy it
    return Netlist(nodes.count, *columns, cell_map=cell_map)


def require_netlist_memory(shape: tuple[int, ...], remedy: Remedy = FEWER_CELLS, *, has_leak: bool = False) -> None:
    """Raise BudgetError for a grid whose netlist does not fit in memory.

    `shape`: number of cells along every axis; `remedy`: advice in the message; `has_leak`: whether every free node has
    a leak resistor.
    """
    require_grid_memory(shape, "compiling the grid", _PEAK * (len(shape) + has_leak), remedy)


def _number_nodes(space: ConfigurationSpace, wiring: Wiring, kind: NDArray[np.uint8]) -> _Nodes:
    """Return the node numbers of rails and cells.

    `kind`: `CellRole` of every cell (own node, a rail or no node), with a margin of one cell on every side.
    """
    own = kind[(slice(1, -1),) * space.ndim] == CellRole.NODE
    if wiring.start is not None:
        own[wiring.start] = True
    has_rail = wiring.leak > 0 or (not wiring.is_open and bool(np.any(kind == CellRole.HIGH)))
    obstacle = GROUND + 1 if has_rail else _NO_NODE
    first = GROUND + 1 + (obstacle >= 0)
    goals = tuple(range(first, first + space.goal_count)) if wiring.rails == "merged" else ()
    first += len(goals)
    node = np.full(space.shape, _NO_NODE, dtype=np.int32)
    count = int(np.count_nonzero(own))
    if first + count > MOST_NODES:
        raise InputError(f"{count:,} cells have a node; a netlist may have {MOST_NODES:,}: choose larger cells")
    numbers = np.arange(first, first + count, dtype=np.int32)
    node[own] = numbers
    free = numbers if wiring.rails == "merged" else node[own & (space.cell == Cell.FREE)]
    if wiring.rails == "merged":
        node[space.cell == Cell.OBSTACLE] = _NO_NODE if wiring.is_open else obstacle
        goal = space.cell == Cell.GOAL
        node[goal] = np.array(goals, dtype=np.int32)[space.goal_region[goal]]
    return _Nodes(node, free, obstacle, goals, first + count)


def _resistors(space: ConfigurationSpace, contacts: GridContacts, nodes: _Nodes) -> tuple[NDArray[Any], ...]:
    """Return nodes (m, 2), conductances (m,) in siemens, face numbers (m,) and directions (m,) of the resistors.

    `contacts`: contacts of the grid, each of which has one resistor; `nodes`: node numbers.  A direction is True if the
    second node lies at the higher coordinate.  Resistors are ordered by axis; for each axis, resistors at the border of
    the grid come last.  The leaks of the free nodes follow, with the face numbers ``-2 - (flat index of the cell)``.
    """
    wide = with_margin(nodes.cell, space.periodic, beyond=nodes.obstacle)
    parts = [
        (axis, *faces)
        for axis, (size, ring) in enumerate(zip(space.shape, space.periodic, strict=True))
        for faces in ((1, size), (0, 1), *([] if ring else [(size, size + 1)]))
    ]
    ends = np.cumsum([0, *(np.count_nonzero(slab(contacts.joined[axis], axis, *faces)) for axis, *faces in parts)])
    starts = np.cumsum([0, *face_counts(space.shape)])
    count = int(ends[-1]) + (nodes.free.size if contacts.leak else 0)
    pairs, siemens = np.empty((count, 2), dtype=np.int32), np.empty(count)
    face = np.empty(count, dtype=np.int32 if starts[-1] < 2**31 else np.int64)
    upward = np.empty(count, dtype=np.bool_)
    for (axis, first, last), at in zip(parts, map(slice, ends, ends[1:]), strict=False):
        kept = slab(contacts.joined[axis], axis, first, last)
        rises = space.periodic[axis] or first > 0  # otherwise the rail lies below the cell, and is the second node
        upward[at] = rises
        for side, end in zip(cells_at_faces(wide, axis), (0, 1) if rises else (1, 0), strict=True):
            pairs[at, end] = slab(side, axis, first, last)[kept]
        siemens[at] = contacts.siemens(axis, first, last)
        numbers = np.arange(*starts[axis : axis + 2], dtype=face.dtype).reshape(face_shape(space.shape, axis))
        face[at] = slab(numbers, axis, first, last)[kept]
        del numbers
    if contacts.leak:
        at = slice(ends[-1], count)
        pairs[at, 0], pairs[at, 1] = nodes.free, nodes.obstacle
        siemens[at], upward[at] = contacts.leak, True
        face[at] = -2 - np.flatnonzero((space.cell == Cell.FREE) & (nodes.cell != _NO_NODE))
    return pairs, siemens, face, upward


class CellRole(IntEnum):
    """Role of a cell, or of the margin around the grid, in the circuit: own node, high rail, low rail, or no node.

    The order NODE < HIGH < LOW < NONE determines which pairs of neighbours have a contact (a resistor): at least one
    cell has a node of its own, and neither cell has the role NONE.
    """

    NODE, HIGH, LOW, NONE = range(4)


@dataclass(frozen=True, eq=False)
class GridContacts:
    """All contacts (resistors between neighbouring cells, rail cells and edges included) of a box, without nodes.

    `wiring`: boundary conditions and resistances; `spacing` (ndim,): cell widths; `code`, `kind`, `conductivity`:
    `Cell`, `CellRole` and conductivity of every cell, with a margin of one cell along each axis, wrapped on periodic
    axes (`conductivity` None: 1 everywhere); `joined`: per axis, whether each face across this axis has a contact, in
    the shape of the box plus one along the axis.
    """

    wiring: Wiring
    spacing: NDArray[np.float64]
    code: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    conductivity: NDArray[np.float64] | None
    joined: tuple[NDArray[np.bool_], ...]

    def siemens(self, axis: int, first: int, last: int) -> NDArray[np.float64]:
        """Return the conductances (contacts,), in siemens, of the contacts in a range of faces, in C order.

        `axis`: axis that the faces are perpendicular to; `first`, `last`: range of the faces along the axis, without
        `last`.
        """
        kept = slab(self.joined[axis], axis, first, last)

        def ends(wide: NDArray[Any]) -> Iterator[NDArray[Any]]:
            return (slab(side, axis, first, last)[kept] for side in cells_at_faces(wide, axis))

        unit = (self.spacing.min() / self.spacing[axis]) ** 2 / self.wiring.resistance
        siemens = np.full(np.count_nonzero(kept), unit)
        if self.conductivity is not None:
            lower, upper = ends(self.conductivity)
            lower_free, upper_free = ends(self.code == Cell.FREE)
            lower = np.where(upper_free & ~lower_free, upper, lower)
            upper = np.where(lower_free & ~upper_free, lower, upper)
            siemens *= lower * (2.0 * upper / (lower + upper))
        if self.wiring.wall_resistance:
            walled = np.not_equal(*ends(self.code == Cell.OBSTACLE))
            siemens[walled] = 1.0 / (1.0 / siemens[walled] + self.wiring.wall_resistance)
        return siemens

    @property
    def leak(self) -> float:
        """Conductance of the leak of every free cell with a node to the high rail, in siemens; 0 without a leak."""
        return self.wiring.leak_conductance(self.spacing)

    @cached_property
    def conductance(self) -> tuple[NDArray[np.float64], ...]:
        """Conductances through all faces of the box, in siemens, one array per axis; 0 without a contact.

        The array of an axis has the shape of the box, plus one along this axis.
        """
        faces = tuple(np.zeros(joined.shape) for joined in self.joined)
        for axis, (siemens, joined) in enumerate(zip(faces, self.joined, strict=True)):
            siemens[joined] = self.siemens(axis, 0, joined.shape[axis])
        return faces


def contacts_of_box(
    space: ConfigurationSpace, wiring: Wiring, box: Sequence[tuple[int, int]] = (), *, connected: bool = True
) -> GridContacts:
    """Return the contacts of a box: resistors between neighbouring cells, rail cells and edges included.

    `wiring`: complete wiring, from ``wiring.on(space)``; `box`: range (first, end), without end, of cells along each of
    the first axes, the other axes are complete; `connected`: with open obstacles and a drive or leak, True leaves free
    cells that are not connected to a goal without a node, and False gives every free cell a node.
    """
    require_square(wiring.lattice, "this computation of currents through cell faces")
    code = with_margin(space.cell, space.periodic, box, beyond=Cell.OBSTACLE)
    high, low = (CellRole.HIGH, CellRole.LOW) if wiring.rails == "merged" else (CellRole.NODE, CellRole.NODE)
    leaves_out = wiring.is_open and connected and not wiring.has_islands
    free = CellRole.NONE if leaves_out else CellRole.NODE
    kind = np.array((free, CellRole.NONE if wiring.is_open else high, low), dtype=np.uint8)[code]
    if leaves_out:
        kind = np.where(with_margin(space.goal_connected, space.periodic, box), np.uint8(CellRole.NODE), kind)
    ranges = [*box, *((0, size) for size in space.shape[len(box) :])]
    for axis, (size, (first, last)) in enumerate(zip(space.shape, ranges, strict=True)):
        _set_margin(kind, axis, wiring, size, (first == 0, last == size))
    c = None if space.conductivity is None else with_margin(space.conductivity, space.periodic, box)
    sides = (cells_at_faces(kind, axis) for axis in range(space.ndim))
    joined = tuple((np.minimum(*both) == CellRole.NODE) & (np.maximum(*both) != CellRole.NONE) for both in sides)
    if wiring.start is not None:
        at = (np.arange(size) == place for size, place in zip(space.shape, wiring.start, strict=True))
        along = zip(at, space.periodic[:, np.newaxis], ([ends] for ends in ranges), strict=True)
        kind[np.ix_(*(with_margin(*each) for each in along))] = CellRole.HIGH
    return GridContacts(wiring, space.spacing, code, kind, c, joined)


def _set_margin(kind: NDArray[np.uint8], axis: int, wiring: Wiring, size: int, ends: tuple[bool, bool]) -> None:
    """Set the roles of the margin cells beyond both ends of an axis, in place.

    Beyond an edge of the space that acts as an obstacle, a margin cell belongs to the high rail.  Beyond an open edge,
    or if obstacles are open, or on a ring of one cell, a margin cell has no contact.  Inside the space and on other
    periodic axes a margin cell keeps its role.  `kind`: `CellRole` of every cell of the box, with a margin of one cell;
    `axis`: index of the axis; `wiring`: rules for edges and boundary; `size`: number of cells of the whole space along
    the axis; `ends`: whether the box reaches the lower and the upper end of the space along the axis.
    """
    edge = wiring.edge[axis]
    if edge == "periodic" and size > 1:
        return
    tied = edge == "obstacle" and not wiring.is_open
    for reached, place in zip(ends, (0, -1), strict=True):
        if reached:
            np.moveaxis(kind, axis, 0)[place] = CellRole.HIGH if tied else CellRole.NONE


def _voltage_sources(
    space: ConfigurationSpace, wiring: Wiring, nodes: _Nodes
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return nodes (s, 2) and voltages (s,), in volts, of the s sources at rails, rail cells and the start cell.

    The first node of a source is the plus node, the second is ground.
    """
    high, low = wiring.high, wiring.goal_voltage
    ties: list[tuple[Any, float]] = [([nodes.obstacle] if nodes.obstacle >= 0 else [], high), (nodes.goals, low)]
    if wiring.start is not None:
        ties.append(([nodes.cell[wiring.start]], high))
    if wiring.rails == "cells":
        ties.append((nodes.cell[(space.cell == Cell.OBSTACLE) & (nodes.cell >= 0)], high))
        ties.append((nodes.cell[space.cell == Cell.GOAL], low))
    tied = np.concatenate([np.asarray(some, dtype=np.int32) for some, _ in ties])
    volts = np.repeat([level for _, level in ties], [len(some) for some, _ in ties])
    return np.stack([tied, np.full_like(tied, GROUND)], axis=1), volts


def _uniform_drive(wiring: Wiring, nodes: _Nodes) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return nodes (c, 2) and currents (c,), in amperes, of equal current sources, one into each of the c free nodes.

    The current leaves the first node, ground, and enters the second one.  Both arrays are empty without a uniform
    drive; raise CircuitError if there is no free node.
    """
    if wiring.drive != "uniform":
        return np.empty((0, 2), dtype=np.int32), np.empty(0)
    free = nodes.free
    if not free.size:
        raise CircuitError(WALLED_IN)
    pairs = np.empty((free.size, 2), dtype=np.int32)
    pairs[:, 0], pairs[:, 1] = GROUND, free
    return pairs, np.full(free.size, wiring.supply / (wiring.resistance * free.size))
