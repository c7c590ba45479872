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
from resgrid.grids import before_and_behind, face_counts, faces_ahead, places_in_slab, slab, with_margin
from resgrid.netlist import GROUND, MOST_NODES, CellMap, Netlist
from resgrid.space import Cell, ConfigurationSpace
from resgrid.wiring import Wiring, wiring_of

_Codes = NDArray[np.uint8] | Cell

WALLED_IN = "nothing is driven: no free cell is connected to a goal; move the goal or open a way to it"

_NO_NODE = -1
_PEAK = 80
"""Peak memory of compiling, in bytes per cell and axis, measured on open grids."""

_PIECE = 2**16
"""Resistors filled in at a time: what they are made from stays in the cache."""


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Node numbers: of every cell (-1 for none), free cells, the obstacle rail (-1 for none) and the goal rails."""

    cell: NDArray[np.int32]
    free: NDArray[np.int32]
    obstacle: int
    goals: tuple[int, ...]
    count: int


@dataclass(frozen=True, eq=False)
class _Resistors:
    nodes: NDArray[np.int32]
    conductance: NDArray[np.float64]
    face: NDArray[np.integer[Any]]
    upward: NDArray[np.bool_]


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
    nodes = _number_nodes(space, wiring)
    resistors = _join(space, wiring, nodes)
    cell_map = CellMap(
        space=space,
        wiring=wiring,
        node=nodes.cell,
        resistor_face=resistors.face,
        resistor_upward=resistors.upward,
        free_node=nodes.free,
        obstacle_node=nodes.obstacle,
        goal_nodes=nodes.goals,
    )
    columns = (
        resistors.nodes,
        resistors.conductance,
        *_voltage_sources(space, wiring, nodes),
        *_uniform_drive(wiring, nodes),
    )
    for column in columns:
        column.flags.writeable = False  # or the netlist would copy it
    return Netlist(nodes.count, *columns, cell_map=cell_map)


def require_room(shape: tuple[int, ...]) -> None:
    """Refuse a grid whose netlist would not fit in memory."""
    require_grid_memory(shape, "compiling the grid", _PEAK * len(shape))


def _number_nodes(space: ConfigurationSpace, wiring: Wiring) -> _Nodes:
    obstacle = GROUND + 1 if _has_obstacle_rail(space, wiring) else _NO_NODE
    first = GROUND + 1 + (obstacle >= 0)
    goals = tuple(range(first, first + space.goal_count)) if wiring.rails == "merged" else ()
    first += len(goals)
    own = _cells_with_node(space, wiring)
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


def _has_obstacle_rail(space: ConfigurationSpace, wiring: Wiring) -> bool:
    if wiring.boundary == "neumann":
        return False
    return "obstacle" in wiring.edge or (wiring.rails == "merged" and bool(np.any(space.cell == Cell.OBSTACLE)))


def _cells_with_node(space: ConfigurationSpace, wiring: Wiring) -> NDArray[np.bool_]:
    free = space.goal_connected if wiring.boundary == "neumann" else space.cell == Cell.FREE
    if wiring.rails == "merged":
        return free
    tied = space.cell != Cell.FREE if wiring.boundary != "neumann" else space.cell == Cell.GOAL
    return np.asarray(free | tied)


def _join(space: ConfigurationSpace, wiring: Wiring, nodes: _Nodes) -> _Resistors:
    groups = list(_groups(space, wiring, nodes))
    ends = [0, *np.cumsum([np.count_nonzero(group.kept) for group in groups]).tolist()]
    count = ends[-1]
    pairs = np.empty((count, 2), dtype=np.int32)
    face = np.empty(count, dtype=np.int32 if sum(face_counts(space.shape)) < 2**31 else np.int64)
    joined = _Resistors(pairs, np.empty(count), face, np.empty(count, dtype=np.bool_))
    for group, first, last in zip(groups, ends, ends[1:], strict=False):
        part = _Resistors(*(column[first:last] for column in vars(joined).values()))
        _fill(space, wiring, nodes, group, part)
    return joined


@dataclass(frozen=True, eq=False)
class _Group:
    """Resistors that cross a slab of faces across one axis.

    ``kept`` tells which faces of the slab have one; ``faces`` is the slab, of those along the axis, which are numbered
    from ``first_face`` on; ``lower`` and ``upper`` are the slabs of cells before and behind them, the latter None where
    the obstacle rail lies beyond.
    """

    axis: int
    kept: NDArray[np.bool_]
    faces: tuple[int, int]
    first_face: int
    lower: tuple[int, int]
    upper: tuple[int, int] | None


def _groups(space: ConfigurationSpace, wiring: Wiring, nodes: _Nodes) -> Iterator[_Group]:
    first_face = 0
    present, free = nodes.cell >= 0, space.cell == Cell.FREE

    def pairs(axis: int, lower: tuple[int, int], upper: tuple[int, int]) -> NDArray[np.bool_]:
        kept = np.asarray(slab(present, axis, *lower) & slab(present, axis, *upper))
        if wiring.rails == "merged":
            kept &= slab(free, axis, *lower) | slab(free, axis, *upper)
        return kept

    for axis, size in enumerate(space.shape):
        lower, upper, first, last = (0, size - 1), (1, size), (0, 1), (size - 1, size)
        yield _Group(axis, pairs(axis, lower, upper), (1, size), first_face, lower, upper)
        if space.axes[axis].periodic and size > 1:
            yield _Group(axis, pairs(axis, last, first), first, first_face, last, first)
        elif wiring.edge[axis] == "obstacle" and nodes.obstacle >= 0:
            on_edge = free if wiring.rails == "merged" else present
            yield _Group(axis, slab(on_edge, axis, *first), first, first_face, first, None)
            yield _Group(axis, slab(on_edge, axis, *last), (size, size + 1), first_face, last, None)
        first_face += face_counts(space.shape)[axis]


def _fill(space: ConfigurationSpace, wiring: Wiring, nodes: _Nodes, group: _Group, part: _Resistors) -> None:
    """Resistors from the cells before the faces to those behind them, or to the obstacle rail."""
    here = places_in_slab(group.kept, space.shape, group.axis, group.lower)
    for first in range(0, len(here), _PIECE):
        piece = slice(first, first + _PIECE)
        _fill_piece(
            space, wiring, nodes, group, here[piece], _Resistors(*(column[piece] for column in vars(part).values()))
        )


def _fill_piece(
    space: ConfigurationSpace, wiring: Wiring, nodes: _Nodes, group: _Group, here: NDArray[np.int64], part: _Resistors
) -> None:
    axis, node, there = group.axis, nodes.cell.reshape(-1), None
    if group.upper is not None:
        there = here + (group.upper[0] - group.lower[0]) * int(np.prod(space.shape[axis + 1 :]))
    part.nodes[:, 0] = node[here]
    part.nodes[:, 1] = nodes.obstacle if there is None else node[there]
    faces = faces_ahead(here.astype(part.face.dtype), space.shape, axis, group.faces[0] - group.lower[0])
    part.face[:] = faces + group.first_face
    part.upward[:] = there is not None or group.faces[0] > 0
    cell = space.cell.reshape(-1)
    codes = cell[here], Cell.OBSTACLE if there is None else cell[there]
    c = None if space.conductivity is None else space.conductivity.reshape(-1)
    conductivities = None if c is None else (c[here], c[here if there is None else there])
    part.conductance[:] = _of_contacts(space, wiring, axis, codes, conductivities, here.shape)


def _of_contacts(
    space: ConfigurationSpace,
    wiring: Wiring,
    axis: int,
    codes: tuple[_Codes, _Codes],
    conductivities: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
    shape: tuple[int, ...],
) -> NDArray[np.float64]:
    """Conductances between cells before and behind faces across an axis, in siemens; all arrays of that shape."""
    conductance = np.full(shape, of_face(space.spacing, axis, wiring.resistance))
    if conductivities is not None:
        conductance *= in_series(*conductivities, *(code == Cell.FREE for code in codes))
    if wiring.wall_resistance:
        walled = has_wall(*(code == Cell.OBSTACLE for code in codes))
        conductance[walled] = behind_wall(conductance[walled], wiring.wall_resistance)
    return conductance


class Kind(IntEnum):
    """What a cell, or what lies beyond the border, is in the circuit of merged rails."""

    NODE, HIGH, LOW, NONE = range(4)


@dataclass(frozen=True, eq=False)
class Contacts:
    """All contacts of a slab of cells, rows of the first axis, without node numbers: the equations of grids too large.

    `kind`: of every cell of the slab and of those around it, a margin of one cell along each axis, wrapped where the
    axis is periodic; `conductance`: per axis, through the faces of the slab's cells, in siemens, one more along that
    axis than cells; 0 where there is no contact.
    """

    kind: NDArray[np.uint8]
    conductance: tuple[NDArray[np.float64], ...]


def contacts_of_rows(space: ConfigurationSpace, wiring: Wiring, first: int, last: int) -> Contacts:
    """The contacts of the rows from ``first`` to ``last``, as `compile_space` makes them with merged rails.

    `wiring`: as ``wiring.on(space)`` returns it.
    """
    rows = (first, last)
    code = with_margin(space.cell, space.periodic, rows)
    kind = np.choose(code, (Kind.NODE, Kind.HIGH, Kind.LOW)).astype(np.uint8)
    if wiring.boundary == "neumann":
        connected = with_margin(space.goal_connected, space.periodic, rows)
        kind[(code == Cell.OBSTACLE) | ((code == Cell.FREE) & ~connected)] = Kind.NONE
    if wiring.start is not None:
        at = (np.arange(size) == place for size, place in zip(space.shape, wiring.start, strict=True))
        ranges = (rows, *[None] * (space.ndim - 1))
        kind[np.ix_(*map(with_margin, at, space.periodic[:, np.newaxis], ranges))] = Kind.HIGH
    for axis, size in enumerate(space.shape):
        _set_beyond(code, kind, axis, wiring, size, (rows[0] == 0, rows[1] == size) if axis == 0 else (True, True))
    c = None if space.conductivity is None else with_margin(space.conductivity, space.periodic, rows)
    return Contacts(kind, tuple(_across(space, wiring, axis, code, kind, c) for axis in range(space.ndim)))


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
    lower, upper = before_and_behind(kind, axis)
    codes = before_and_behind(code, axis)
    conductivities = None if c is None else before_and_behind(c, axis)
    conductance = _of_contacts(space, wiring, axis, codes, conductivities, lower.shape)
    none = (lower == Kind.NONE) | (upper == Kind.NONE) | ((lower != Kind.NODE) & (upper != Kind.NODE))
    conductance[none] = 0.0
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
        raise CircuitError(WALLED_IN)
    pairs = np.empty((fed.size, 2), dtype=np.int32)
    pairs[:, 0], pairs[:, 1] = GROUND, fed
    return pairs, np.full(fed.size, wiring.supply / (wiring.resistance * fed.size))
