"""From a configuration space to a netlist: which cells have nodes, what joins them, and what drives them.

Face neighbours are joined by resistors, by the rules of `resgrid.conductances`; voltage sources stand at obstacles and
goals, or current sources at the nodes (Tarassenko & Blake 1991; Connolly & Grupen 1992, section 2).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.budget import require_memory
from resgrid.conductances import behind_wall, has_wall, in_series, of_face
from resgrid.errors import CircuitError, InputError
from resgrid.netlist import GROUND, MOST_NODES, Layout, Netlist
from resgrid.slabs import face_counts, faces_ahead, places_in_slab, slab
from resgrid.space import Cell, ConfigurationSpace

BOUNDARIES = ("dirichlet", "neumann", "wall")
DRIVES = ("uniform", "start")
EDGES = ("obstacle", "open")
RAILS = ("merged", "cells")
_NO_NODE = -1
_PEAK = 80
"""Peak memory of compiling, in bytes per cell and axis, measured on open grids."""

_PIECE = 2**16
"""Resistors filled in at a time: what they are made from stays in the cache."""


@dataclass(frozen=True)
class _Rules:
    """The checked options of a compilation."""

    boundary: str
    drive: str | None
    edge: tuple[str, ...]
    rails: str
    resistance: float
    supply: float
    goal_voltage: float
    wall_resistance: float
    start: tuple[int, ...] | None


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


def compile_space(
    space: ConfigurationSpace,
    *,
    boundary: str = "dirichlet",
    drive: str | None = None,
    edge: str | Sequence[str] = "obstacle",
    rails: str = "merged",
    resistance: float = 10e3,
    supply: float = 1.0,
    goal_voltage: float = 0.0,
    wall_resistance: float | None = None,
    start: Sequence[int] | None = None,
) -> Netlist:
    """Compile a configuration space into a resistor netlist.

    Parameters
    ----------
    space : ConfigurationSpace
        One to four axes, with at least one goal cell.
    boundary : {"dirichlet", "neumann", "wall"}
        What an obstacle does: it is a rail, it is open, or it is a rail behind `wall_resistance`.
    drive : {"uniform", "start"}, optional
        With open obstacles: the same current into every goal-connected free node (default), or the start cell tied
        to the high rail.
    edge : {"obstacle", "open"} or a sequence of them
        What the border of the grid is, for all axes or one by one; periodic axes have none.
    rails : {"merged", "cells"}
        Whether each rail is one node, or every obstacle and goal cell has a node and a source of its own.
    resistance : float
        Resistance between neighbours along the finest axis at conductivity 1, in ohms.
    supply : float
        Voltage of the obstacle rail, or of the driven start, above the goal rail, in volts; not zero.  With a uniform
        drive the total current fed in is ``supply / resistance``.
    goal_voltage : float
        Voltage of the goal rail, in volts.
    wall_resistance : float, optional
        For ``boundary="wall"``: the resistance in series with every obstacle contact, in ohms; 0 is Dirichlet.
    start : sequence of int, optional
        For ``drive="start"``: the start cell.

    Returns
    -------
    Netlist
        Ground first, then the obstacle rail, the goal rails, and the cells in C order; with a `Layout`.

    Raises
    ------
    InputError
        If an option is unknown, missing or does not fit the others, or there is no goal cell.
    CircuitError
        If nothing can be driven.
    BudgetError
        If the netlist would not fit in memory.
    """
    _check_values(resistance, supply, goal_voltage)
    rules = _Rules(
        boundary=_one_of("boundary", boundary, BOUNDARIES),
        drive=_checked_drive(boundary, drive, start),
        edge=_checked_edges(space, edge),
        rails=_one_of("rails", rails, RAILS),
        resistance=float(resistance),
        supply=float(supply),
        goal_voltage=float(goal_voltage),
        wall_resistance=_checked_wall(boundary, wall_resistance),
        start=_checked_start(space, start),
    )
    require_memory(
        _PEAK * space.cell.size * space.ndim,
        f"compiling {space.cell.size:,} cells",
        "use a coarser grid, or a machine with more memory",
    )
    if not space.goal_count:
        raise InputError("the space has no goal cell: add a goal, or make it at least one cell large")
    nodes = _number_nodes(space, rules)
    resistors = _join(space, rules, nodes)
    layout = Layout(
        space=space,
        node=nodes.cell,
        resistor_face=resistors.face,
        resistor_upward=resistors.upward,
        free_node=nodes.free,
        obstacle_node=nodes.obstacle,
        goal_nodes=nodes.goals,
        **vars(rules),
    )
    columns = (
        resistors.nodes,
        resistors.conductance,
        *_voltage_sources(space, rules, nodes),
        *_uniform_drive(rules, nodes),
    )
    for column in columns:
        column.flags.writeable = False  # or the netlist would copy it
    return Netlist(nodes.count, *columns, layout=layout)


def _check_values(resistance: float, supply: float, goal_voltage: float) -> None:
    if not (0 < resistance < np.inf and 1.0 / float(resistance) < np.inf):
        raise InputError(f"resistance = {resistance}, but it must be positive and finite, in ohms")
    if not (np.isfinite(supply) and supply != 0 and np.isfinite(goal_voltage)):
        raise InputError(f"supply = {supply} V and goal_voltage = {goal_voltage} V must be finite, and supply not 0")


def _one_of(name: str, value: str, allowed: tuple[str, ...]) -> str:
    if value not in allowed:
        raise InputError(f"{name} = {value!r} is unknown; it may be one of {', '.join(allowed)}")
    return value


def _checked_drive(boundary: str, drive: str | None, start: Sequence[int] | None) -> str | None:
    if boundary != "neumann":
        if drive is not None or start is not None:
            raise InputError(
                f"a drive belongs to open obstacles: with boundary = {boundary!r} the obstacle rail drives the grid; "
                "leave out drive and start, or choose boundary = 'neumann'"
            )
        return None
    drive = "uniform" if drive is None else drive
    _one_of("drive", drive, DRIVES)
    if (drive == "start") != (start is not None):
        raise InputError("drive = 'start' needs a start cell, and only drive = 'start' takes one")
    return drive


def _checked_edges(space: ConfigurationSpace, edge: str | Sequence[str]) -> tuple[str, ...]:
    wanted = (edge,) * space.ndim if isinstance(edge, str) else tuple(edge)
    if len(wanted) != space.ndim:
        raise InputError(f"edge has {len(wanted)} entries, but the space has {space.ndim} axes")
    for axis, rule in zip(space.axes, wanted, strict=True):
        _one_of(f"edge of axis {axis.name!r}", rule, (*EDGES, "periodic") if axis.periodic else EDGES)
    return tuple("periodic" if axis.periodic else rule for axis, rule in zip(space.axes, wanted, strict=True))


def _checked_wall(boundary: str, wall_resistance: float | None) -> float:
    if boundary != "wall":
        if wall_resistance is not None:
            raise InputError(f"wall_resistance belongs to boundary = 'wall', not to {boundary!r}")
        return 0.0
    if wall_resistance is None or not (np.isfinite(wall_resistance) and wall_resistance >= 0):
        raise InputError(
            f"boundary = 'wall' needs a finite wall_resistance of at least 0 ohm, got {wall_resistance} "
            "(for an infinite one choose boundary = 'neumann')"
        )
    return float(wall_resistance)


def _checked_start(space: ConfigurationSpace, start: Sequence[int] | None) -> tuple[int, ...] | None:
    if start is None:
        return None
    cell = tuple(int(index) for index in start)
    if len(cell) != space.ndim or not all(0 <= i < n for i, n in zip(cell, space.shape, strict=True)):
        raise InputError(f"the start cell {cell} is not in the grid of {space.shape} cells")
    if space.cell[cell] != Cell.FREE:
        raise InputError(f"the start cell {cell} is an {Cell(space.cell[cell]).name.lower()} cell; it must be free")
    if not space.goal_connected[cell]:
        raise CircuitError(f"nothing is driven: no path of free cells joins the start cell {cell} to a goal")
    return cell


def _number_nodes(space: ConfigurationSpace, rules: _Rules) -> _Nodes:
    obstacle = GROUND + 1 if _has_obstacle_rail(space, rules) else _NO_NODE
    first = GROUND + 1 + (obstacle >= 0)
    goals = tuple(range(first, first + space.goal_count)) if rules.rails == "merged" else ()
    first += len(goals)
    own = _cells_with_node(space, rules)
    node = np.full(space.shape, _NO_NODE, dtype=np.int32)
    count = int(np.count_nonzero(own))
    if first + count > MOST_NODES:
        raise InputError(f"{count:,} cells have a node; a netlist may have {MOST_NODES:,}: choose larger cells")
    numbers = np.arange(first, first + count, dtype=np.int32)
    node[own] = numbers
    free = numbers if rules.rails == "merged" else node[own & (space.cell == Cell.FREE)]
    if goals:
        node[space.cell == Cell.OBSTACLE] = obstacle
        goal = space.cell == Cell.GOAL
        node[goal] = np.array(goals)[space.goal_region[goal]]
    return _Nodes(node, free, obstacle, goals, first + count)


def _has_obstacle_rail(space: ConfigurationSpace, rules: _Rules) -> bool:
    if rules.boundary == "neumann":
        return False
    return "obstacle" in rules.edge or (rules.rails == "merged" and bool(np.any(space.cell == Cell.OBSTACLE)))


def _cells_with_node(space: ConfigurationSpace, rules: _Rules) -> NDArray[np.bool_]:
    free = space.goal_connected if rules.boundary == "neumann" else space.cell == Cell.FREE
    if rules.rails == "merged":
        return free
    tied = space.cell != Cell.FREE if rules.boundary != "neumann" else space.cell == Cell.GOAL
    return np.asarray(free | tied)


def _join(space: ConfigurationSpace, rules: _Rules, nodes: _Nodes) -> _Resistors:
    groups = list(_groups(space, rules, nodes))
    ends = [0, *np.cumsum([np.count_nonzero(group.kept) for group in groups]).tolist()]
    count = ends[-1]
    pairs = np.empty((count, 2), dtype=np.int32)
    face = np.empty(count, dtype=np.int32 if sum(face_counts(space.shape)) < 2**31 else np.int64)
    joined = _Resistors(pairs, np.empty(count), face, np.empty(count, dtype=np.bool_))
    for group, first, last in zip(groups, ends, ends[1:], strict=False):
        part = _Resistors(*(column[first:last] for column in vars(joined).values()))
        _fill(space, rules, nodes, group, part)
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


def _groups(space: ConfigurationSpace, rules: _Rules, nodes: _Nodes) -> Iterator[_Group]:
    first_face = 0
    present, free = nodes.cell >= 0, space.cell == Cell.FREE

    def pairs(axis: int, lower: tuple[int, int], upper: tuple[int, int]) -> NDArray[np.bool_]:
        kept = np.asarray(slab(present, axis, *lower) & slab(present, axis, *upper))
        if rules.rails == "merged":
            kept &= slab(free, axis, *lower) | slab(free, axis, *upper)
        return kept

    for axis, size in enumerate(space.shape):
        lower, upper, first, last = (0, size - 1), (1, size), (0, 1), (size - 1, size)
        yield _Group(axis, pairs(axis, lower, upper), (1, size), first_face, lower, upper)
        if space.axes[axis].periodic and size > 1:
            yield _Group(axis, pairs(axis, last, first), first, first_face, last, first)
        elif rules.edge[axis] == "obstacle" and nodes.obstacle >= 0:
            on_edge = free if rules.rails == "merged" else present
            yield _Group(axis, slab(on_edge, axis, *first), first, first_face, first, None)
            yield _Group(axis, slab(on_edge, axis, *last), (size, size + 1), first_face, last, None)
        first_face += face_counts(space.shape)[axis]


def _fill(space: ConfigurationSpace, rules: _Rules, nodes: _Nodes, group: _Group, part: _Resistors) -> None:
    """Resistors from the cells before the faces to those behind them, or to the obstacle rail."""
    here = places_in_slab(group.kept, space.shape, group.axis, group.lower)
    for first in range(0, len(here), _PIECE):
        piece = slice(first, first + _PIECE)
        _fill_piece(
            space, rules, nodes, group, here[piece], _Resistors(*(column[piece] for column in vars(part).values()))
        )


def _fill_piece(
    space: ConfigurationSpace, rules: _Rules, nodes: _Nodes, group: _Group, here: NDArray[np.int64], part: _Resistors
) -> None:
    axis, node, there = group.axis, nodes.cell.reshape(-1), None
    if group.upper is not None:
        there = here + (group.upper[0] - group.lower[0]) * int(np.prod(space.shape[axis + 1 :]))
    part.nodes[:, 0] = node[here]
    part.nodes[:, 1] = nodes.obstacle if there is None else node[there]
    faces = faces_ahead(here.astype(part.face.dtype), space.shape, axis, group.faces[0] - group.lower[0])
    part.face[:] = faces + group.first_face
    part.upward[:] = there is not None or group.faces[0] > 0
    part.conductance[:] = of_face(space.spacing, axis, rules.resistance)
    cell = space.cell.reshape(-1)
    codes = cell[here], Cell.OBSTACLE if there is None else cell[there]
    if space.conductivity is not None:
        c = space.conductivity.reshape(-1)
        free = (code == Cell.FREE for code in codes)
        part.conductance[:] *= c[here] if there is None else in_series(c[here], c[there], *free)
    if rules.wall_resistance > 0:
        walled = has_wall(*(code == Cell.OBSTACLE for code in codes))
        part.conductance[walled] = behind_wall(part.conductance[walled], rules.wall_resistance)


def _voltage_sources(
    space: ConfigurationSpace, rules: _Rules, nodes: _Nodes
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    high = rules.goal_voltage + rules.supply
    plus: list[NDArray[np.int32]] = []
    volts: list[NDArray[np.float64]] = []

    def tie(tied: NDArray[np.int32], level: float) -> None:
        plus.append(tied)
        volts.append(np.full(len(tied), level))

    if nodes.obstacle >= 0:
        tie(np.array([nodes.obstacle], dtype=np.int32), high)
    tie(np.array(nodes.goals, dtype=np.int32), rules.goal_voltage)
    if rules.start is not None:
        tie(nodes.cell[rules.start].reshape(1), high)
    if rules.rails == "cells":
        tie(nodes.cell[(space.cell == Cell.OBSTACLE) & (nodes.cell >= 0)], high)
        tie(nodes.cell[space.cell == Cell.GOAL], rules.goal_voltage)
    tied = np.concatenate(plus)
    return np.stack([tied, np.full_like(tied, GROUND)], axis=1), np.concatenate(volts)


def _uniform_drive(rules: _Rules, nodes: _Nodes) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The same current into every free node; with open obstacles these are connected to a goal."""
    if rules.drive != "uniform":
        return np.empty((0, 2), dtype=np.int32), np.empty(0)
    fed = nodes.free
    if not fed.size:
        raise CircuitError("nothing is driven: no free cell is connected to a goal; move the goal or open a way to it")
    pairs = np.empty((fed.size, 2), dtype=np.int32)
    pairs[:, 0], pairs[:, 1] = GROUND, fed
    return pairs, np.full(fed.size, rules.supply / (rules.resistance * fed.size))
