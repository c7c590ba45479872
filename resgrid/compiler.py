"""From a configuration space to a netlist: which cells have nodes, what joins them, and what drives them.

Face neighbours are joined by resistors, by the rules of `resgrid.conductances`; voltage sources stand at obstacles and
goals, or current sources at the nodes (Tarassenko & Blake 1991; Connolly & Grupen 1992, section 2).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.budget import require_grid_memory
from resgrid.conductances import behind_wall, has_wall, in_series, of_face
from resgrid.errors import CircuitError, InputError
from resgrid.grids import before_and_behind, by_axis, face_counts, slab, with_margin
from resgrid.netlist import GROUND, MOST_NODES, CellMap, Netlist
from resgrid.space import Cell, ConfigurationSpace
from resgrid.wiring import Wiring, wiring_of

_NO_NODE = -1
_PEAK = 80
"""Peak memory of compiling, in bytes per cell and axis, measured on open grids."""


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Node numbers: of every cell (-1 for none), free cells, the obstacle rail (-1 for none) and the goal rails."""

    cell: NDArray[np.int32]
    free: NDArray[np.int32]
    obstacle: int
    goals: tuple[int, ...]
    count: int


def compile_space(space: ConfigurationSpace, wiring: Wiring | None = None, **options: Any) -> Netlist:
    """Compile a configuration space into a resistor netlist.

    Parameters
    ----------
    space : ConfigurationSpace
        One to four axes, with at least one goal cell.
    wiring : Wiring, optional
        What obstacles, edges and goals are tied to, and by what; obstacles at 1 V, goals at 0 V and 10 kohm between
        neighbours unless it is given.
    **options
        Fields of `Wiring`, such as ``boundary="neumann"``: instead of a wiring, or changes to it.

    Returns
    -------
    Netlist
        Ground first, then the obstacle rail, the goal rails, and the cells in C order; with a `CellMap`.

    Raises
    ------
    InputError
        If an option is unknown, missing or does not fit the others, or there is no goal cell.
    CircuitError
        If nothing can be driven.
    BudgetError
        If the netlist would not fit in memory.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 4.0, 4)], [2, 0, 0, 1])
    >>> rg.compile_space(space, resistance=1e3).conductance
    array([0.001, 0.001, 0.001])
    >>> rg.compile_space(space, boundary="neumann").current_amps
    array([5.e-05, 5.e-05])
    """
    wiring = wiring_of(wiring, options).on(space)
    require_room(space.shape)
    if not space.goal_count:
        raise InputError("the space has no goal cell: add a goal, or make it at least one cell large")
    contacts = contacts_of_rows(space, wiring, 0, space.shape[0])
    nodes = _number_nodes(space, wiring, contacts.kind)
    pairs, conductance, face, upward = _join(space, contacts, nodes)
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
        column.flags.writeable = False  # or the netlist would copy it
    return Netlist(nodes.count, *columns, cell_map=cell_map)


def require_room(shape: tuple[int, ...]) -> None:
    """Refuse a grid whose netlist would not fit in memory."""
    require_grid_memory(shape, "compiling the grid", _PEAK * len(shape))


def _number_nodes(space: ConfigurationSpace, wiring: Wiring, kind: NDArray[np.uint8]) -> _Nodes:
    own = kind[(slice(1, -1),) * space.ndim] == Kind.NODE
    if wiring.start is not None:
        own[wiring.start] = True
    obstacle = GROUND + 1 if not wiring.is_driven and np.any(kind == Kind.HIGH) else _NO_NODE
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
    if goals:
        node[space.cell == Cell.OBSTACLE] = obstacle
        goal = space.cell == Cell.GOAL
        node[goal] = np.array(goals)[space.goal_region[goal]]
    return _Nodes(node, free, obstacle, goals, first + count)


def _join(space: ConfigurationSpace, contacts: Contacts, nodes: _Nodes) -> Iterator[NDArray[Any]]:
    """Nodes (m, 2), siemens, faces and directions (m,) of a resistor for every contact; on an axis border ones last."""
    wide = with_margin(nodes.cell, space.periodic)
    for axis in np.flatnonzero(~space.periodic).tolist():
        np.moveaxis(wide, axis, 0)[[0, -1]] = nodes.obstacle
    count = sum(face_counts(space.shape))
    numbers = by_axis(np.arange(count, dtype=np.int32 if count < 2**31 else np.int64), space.shape)
    parts: list[tuple[NDArray[Any], ...]] = []
    for axis, (conductance, number) in enumerate(zip(contacts.conductance, numbers, strict=True)):
        before, behind = before_and_behind(wide, axis)
        size, ring = space.shape[axis], space.axes[axis].periodic
        for first, last in ((1, size), (0, 1), *([] if ring else [(size, size + 1)])):
            kept = slab(conductance, axis, first, last) > 0.0
            columns = (before, behind, conductance, number)
            here, there, siemens, face = (slab(column, axis, first, last)[kept] for column in columns)
            upward = ring or first > 0  # else the rail lies below the cell, and counts as its second node
            pair = (here, there) if upward else (there, here)
            parts.append((np.stack(pair, axis=1), siemens, face, np.full(len(face), upward)))
    return map(np.concatenate, zip(*parts, strict=True))


class Kind(IntEnum):
    """What a cell, or what lies beyond the border, is in the circuit: the least is a node, the greatest nothing."""

    NODE, HIGH, LOW, NONE = range(4)


@dataclass(frozen=True, eq=False)
class Contacts:
    """All contacts of a slab of cells, rows of the first axis, without node numbers.

    `kind`: of every cell of the slab and of those around it, a margin of one cell along each axis, wrapped where the
    axis is periodic; `conductance`: per axis, through the faces of the slab's cells, in siemens, one more along that
    axis than cells; 0 where there is no contact.
    """

    kind: NDArray[np.uint8]
    conductance: tuple[NDArray[np.float64], ...]


def contacts_of_rows(space: ConfigurationSpace, wiring: Wiring, first: int, last: int) -> Contacts:
    """The contacts of the rows from ``first`` to ``last``; `wiring` as ``wiring.on(space)`` returns it."""
    rows = (first, last)
    code = with_margin(space.cell, space.periodic, rows)
    rails = (Kind.NODE, Kind.HIGH, Kind.LOW) if wiring.rails == "merged" else (Kind.NODE,) * 3
    kind = np.array(rails, dtype=np.uint8)[code]
    if wiring.boundary == "neumann":
        connected = with_margin(space.goal_connected, space.periodic, rows)
        kind[(code == Cell.OBSTACLE) | ((code == Cell.FREE) & ~connected)] = Kind.NONE
    for axis, size in enumerate(space.shape):
        _set_beyond(code, kind, axis, wiring, size, (first == 0, last == size) if axis == 0 else (True, True))
    c = None if space.conductivity is None else with_margin(space.conductivity, space.periodic, rows)
    contacts = Contacts(kind, tuple(_across(space, wiring, axis, code, kind, c) for axis in range(space.ndim)))
    if wiring.start is not None:
        at = (np.arange(size) == place for size, place in zip(space.shape, wiring.start, strict=True))
        ranges = (rows, *[None] * (space.ndim - 1))
        kind[np.ix_(*map(with_margin, at, space.periodic[:, np.newaxis], ranges))] = Kind.HIGH
    return contacts


def _set_beyond(
    code: NDArray[np.uint8], kind: NDArray[np.uint8], axis: int, wiring: Wiring, size: int, ends: tuple[bool, bool]
) -> None:
    """Write what lies beyond those ends of an axis which the slab reaches: the obstacle rail, or nothing."""
    edge = wiring.edge[axis]
    if edge == "periodic" and size > 1:
        return
    tied = edge == "obstacle" and wiring.boundary != "neumann"
    for reached, place in zip(ends, (0, -1), strict=True):
        if reached:
            np.moveaxis(code, axis, 0)[place] = Cell.OBSTACLE
            np.moveaxis(kind, axis, 0)[place] = Kind.HIGH if tied else Kind.NONE


def _across(
    space: ConfigurationSpace,
    wiring: Wiring,
    axis: int,
    code: NDArray[np.uint8],
    kind: NDArray[np.uint8],
    c: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    """Conductances through the faces across an axis, in siemens, 0 where there is no contact."""
    lower, upper = before_and_behind(kind, axis)
    codes = before_and_behind(code, axis)
    joined = (np.minimum(lower, upper) == Kind.NODE) & (np.maximum(lower, upper) != Kind.NONE)
    conductance = np.where(joined, of_face(space.spacing, axis, wiring.resistance), 0.0)
    if c is not None:
        conductance *= in_series(*before_and_behind(c, axis), *(part == Cell.FREE for part in codes))
    if wiring.wall_resistance:
        walled = joined & has_wall(*(part == Cell.OBSTACLE for part in codes))
        conductance[walled] = behind_wall(conductance[walled], wiring.wall_resistance)
    return conductance


def _voltage_sources(
    space: ConfigurationSpace, wiring: Wiring, nodes: _Nodes
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    high = wiring.goal_voltage + wiring.supply
    plus: list[NDArray[np.int32]] = []
    volts: list[NDArray[np.float64]] = []

    def tie(tied: NDArray[np.int32], level: float) -> None:
        plus.append(tied)
        volts.append(np.full(len(tied), level))

    if nodes.obstacle >= 0:
        tie(np.array([nodes.obstacle], dtype=np.int32), high)
    tie(np.array(nodes.goals, dtype=np.int32), wiring.goal_voltage)
    if wiring.start is not None:
        tie(nodes.cell[wiring.start].reshape(1), high)
    if wiring.rails == "cells":
        tie(nodes.cell[(space.cell == Cell.OBSTACLE) & (nodes.cell >= 0)], high)
        tie(nodes.cell[space.cell == Cell.GOAL], wiring.goal_voltage)
    tied = np.concatenate(plus)
    return np.stack([tied, np.full_like(tied, GROUND)], axis=1), np.concatenate(volts)


def _uniform_drive(wiring: Wiring, nodes: _Nodes) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The same current into every free node; with open obstacles these are connected to a goal."""
    if wiring.drive != "uniform":
        return np.empty((0, 2), dtype=np.int32), np.empty(0)
    fed = nodes.free
    if not fed.size:
        raise CircuitError("nothing is driven: no free cell is connected to a goal; move the goal or open a way to it")
    pairs = np.empty((fed.size, 2), dtype=np.int32)
    pairs[:, 0], pairs[:, 1] = GROUND, fed
    return pairs, np.full(fed.size, wiring.supply / (wiring.resistance * fed.size))
