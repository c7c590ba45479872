"""The chip as an array of tiles: one per cell, with switches that a pattern sets, and the netlist that makes.

A tile holds the resistors to the next cells along each axis, a switch to the obstacle rail and one to the goal rail,
where obstacles can be open (or walls) an internodal switch in series with every resistor, and a capacitor to ground.
The scene is a pattern of states, one per cell; so one array serves many scenes.  Every cell is a node, and every switch
a resistance, closed or open; that is where tiles differ from a flat netlist with its ideal rails.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.conductances import has_wall
from resgrid.errors import InputError
from resgrid.grids import face_counts
from resgrid.netlist import GROUND, CellMap, Netlist
from resgrid.space import Cell
from resgrid.spice.analyses import MismatchAnalysis

_INTERNODAL_ON, _INTERNODAL_OFF = 10.0, 1e10


class State(IntEnum):
    """What the switches of a tile are set to."""

    FREE = 0
    BLOCKED = 1
    GOAL = 2
    DRIVEN = 3


@dataclass(frozen=True)
class Tile:
    """Component values of a tile, named as in a scene's ``[chip]`` table; ohms, farads.

    Attributes
    ----------
    resistance : float or None
        Resistance between neighbours along the finest axis at conductivity 1; None for the netlist's own.
    goal_switch_on, goal_switch_off, obstacle_switch_on, obstacle_switch_off : float
        Resistance of the switches to the rails, closed and open.
    internodal_switch_on, internodal_switch_off : float or None
        Of the switch in series with every resistor; where both are None it is left out if the boundary allows it, and
        has 10 ohm and 10 Gohm where obstacles are open or walls.
    capacitance : float
        From every cell to ground.
    """

    resistance: float | None = None
    goal_switch_on: float = 10.0
    goal_switch_off: float = 1e10
    obstacle_switch_on: float = 10.0
    obstacle_switch_off: float = 1e10
    internodal_switch_on: float | None = None
    internodal_switch_off: float | None = None
    capacitance: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if value is None:
                continue
            if not (np.isfinite(value) and (value > 0 or (value == 0 and item.name == "capacitance"))):
                raise InputError(f"tile: {item.name} = {value} must be positive and finite")
        for name in ("goal", "obstacle", "internodal"):
            on, off = getattr(self, f"{name}_switch_on"), getattr(self, f"{name}_switch_off")
            if on is not None and off is not None and on >= off:
                raise InputError(f"tile: {name}_switch_on = {on} ohm must be below {name}_switch_off = {off} ohm")

    @staticmethod
    def of(chip: Mapping[str, Any]) -> Tile:
        """Make a tile of a chip's values; what is None or no part of a tile is left to the defaults.

        Parameters
        ----------
        chip : mapping of str to float or None
            Such as the fields of a scene's chip.

        Returns
        -------
        Tile
        """
        known = {item.name for item in fields(Tile)}
        return Tile(**{key: float(value) for key, value in chip.items() if key in known and value is not None})


@dataclass(frozen=True, eq=False)
class TileArray:
    """An array of tiles without a scene.

    `shape`: cells along each axis; `tile`: values, complete; `boundary, drive`: what a blocked tile does, and whether
    free ones are fed (as `CellMap`); `internodal`: whether there are internodal switches; `wall_resistance`: in series
    with every contact of a blocked tile with one that is not, and with the edge, in ohms; 0 without; `link_wall,
    edge_wall`: the same with the mismatch of the resistor before it, in ohms; `link_cells` (l, 2): the cell whose
    tile holds the resistor, and the next one; `link_axis, link_face` (l,): along which axis it lies, and which face
    it crosses; `link_resistance` (l,): in ohms; `edge_cell, edge_face` (e,): cells on the border, which a resistor
    ties to the obstacle rail; `edge_upward` (e,): whether that is the upper border; `edge_resistance` (e,): in ohms,
    without the wall; `high, low`: voltages of the obstacle and the goal rail, the same where currents drive the chip.
    """

    shape: tuple[int, ...]
    tile: Tile
    boundary: str
    drive: str | None
    internodal: bool
    wall_resistance: float
    link_wall: NDArray[np.float64]
    edge_wall: NDArray[np.float64]
    link_cells: NDArray[np.int64]
    link_axis: NDArray[np.int64]
    link_face: NDArray[np.int64]
    link_resistance: NDArray[np.float64]
    edge_cell: NDArray[np.int64]
    edge_face: NDArray[np.int64]
    edge_upward: NDArray[np.bool_]
    edge_resistance: NDArray[np.float64]
    high: float
    low: float


@dataclass(frozen=True, eq=False)
class Pattern:
    """A scene, as tiles see it.

    `state` (cells,): `State` of every tile, in C order of the cells; `amps`: current into every free tile, in
    amperes; 0 without a uniform drive.
    """

    state: NDArray[np.uint8]
    amps: float


def tile_array(netlist: Netlist, tile: Tile = Tile(), mismatch: MismatchAnalysis | None = None) -> TileArray:
    """Lay out the array of tiles that a compiled netlist asks for.

    With a cost map, the resistors beside obstacles and goals follow the flat netlist's rule (the free cell's
    conductivity counts alone), so the array belongs to its scene; without one it serves every scene of its grid.
    """
    from resgrid.compiler import compile_space
    from resgrid.spice.write.flat import resistances

    cell_map = netlist.cells
    tile = complete_tile(tile, cell_map)
    wiring = cell_map.wiring
    edge = ["open" if wiring.is_driven and rule == "obstacle" else rule for rule in wiring.edge]
    full = compile_space(cell_map.space, edge=edge, rails="cells", resistance=tile.resistance or wiring.resistance)
    faces = full.cells
    first = full.node_count - cell_map.space.cell.size
    contact = full.resistor_nodes[:, 1] == faces.obstacle_node
    cells = full.resistor_nodes - first
    value, wall = resistances(full.conductance), np.full(len(full.conductance), cell_map.wiring.wall_resistance or 0.0)
    if mismatch is not None and not mismatch.runs:
        factor = mismatch.factors(full)[faces.resistor_face]
        value, wall = value * factor, wall * factor
    shape = cell_map.space.shape
    return TileArray(
        shape=shape,
        tile=tile,
        boundary=cell_map.wiring.boundary,
        drive=cell_map.wiring.drive,
        internodal=tile.internodal_switch_on is not None,
        wall_resistance=cell_map.wiring.wall_resistance or 0.0,
        link_wall=wall[~contact],
        edge_wall=wall[contact],
        link_cells=cells[~contact],
        link_axis=np.searchsorted(np.cumsum(face_counts(shape)), faces.resistor_face[~contact], side="right"),
        link_face=faces.resistor_face[~contact],
        link_resistance=value[~contact],
        edge_cell=cells[contact, 0],
        edge_face=faces.resistor_face[contact],
        edge_upward=faces.resistor_upward[contact],
        edge_resistance=value[contact],
        high=cell_map.wiring.goal_voltage + (0.0 if cell_map.wiring.drive == "uniform" else cell_map.wiring.supply),
        low=cell_map.wiring.goal_voltage,
    )


def complete_tile(tile: Tile, cell_map: CellMap) -> Tile:
    """A tile with the resistance, and the internodal switches, that its array needs."""
    switched = cell_map.wiring.boundary != "dirichlet" or bool(tile.internodal_switch_on or tile.internodal_switch_off)
    return replace(
        tile,
        resistance=tile.resistance or cell_map.wiring.resistance,
        internodal_switch_on=tile.internodal_switch_on or (_INTERNODAL_ON if switched else None),
        internodal_switch_off=tile.internodal_switch_off or (_INTERNODAL_OFF if switched else None),
    )


def pattern_of(netlist: Netlist) -> Pattern:
    """The switch settings of a compiled netlist's scene.

    With open obstacles, free cells that no goal serves count as blocked: they would float.
    """
    cell_map = netlist.cells
    space = cell_map.space
    state = space.cell.astype(np.uint8).ravel()
    if cell_map.wiring.boundary == "neumann":
        served = space.goal_connected | (space.cell == Cell.GOAL)
        state = np.where(served.ravel(), state, np.uint8(State.BLOCKED)).astype(np.uint8)
    if cell_map.wiring.start is not None:
        state[np.ravel_multi_index(cell_map.wiring.start, space.shape)] = State.DRIVEN
    amps = netlist.current_amps
    if amps.size and not np.allclose(amps, amps[0], rtol=1e-12, atol=0):
        raise InputError("tiles are fed the same current each, and this netlist is fed unevenly; write it flat")
    return Pattern(state, float(amps[0]) if amps.size else 0.0)


def expanded_netlist(netlist: Netlist, tile: Tile = Tile(), mismatch: MismatchAnalysis | None = None) -> Netlist:
    """What the tile form of a compiled netlist is, electrically: every switch a resistance.

    Parameters
    ----------
    netlist : Netlist
        From `compile_space`, whatever its rails.
    tile : Tile
    mismatch : MismatchAnalysis, optional
        As `tile_array`.

    Returns
    -------
    Netlist
        One node per cell, an obstacle and a goal rail; a resistor and the internodal switch behind it are one element.
        Its cell_map marks switches by face -1.

    Raises
    ------
    InputError
        As `tile_array` and `pattern_of`.
    """
    array, pattern = tile_array(netlist, tile, mismatch), pattern_of(netlist)
    cell_map = netlist.cells
    cells = len(pattern.state)
    obstacle, goal, first = GROUND + 1, GROUND + 2, GROUND + 3
    own = np.arange(first, first + cells, dtype=np.int32)
    edge = np.stack([first + array.edge_cell, np.full(len(array.edge_cell), obstacle)], axis=1)
    switches = [np.stack([own, np.full(cells, rail)], axis=1) for rail in (obstacle, goal)]
    resistance = [
        array.link_resistance + internodal_resistance(array, pattern),
        walled_edges(array, pattern),
        *rail_resistance(array, pattern),
    ]
    fed = own[pattern.state == State.FREE] if pattern.amps else np.empty(0, dtype=np.int32)
    stored = own if array.tile.capacitance else np.empty(0, dtype=np.int32)
    none = np.full(2 * cells, -1)
    return Netlist(
        node_count=first + cells,
        resistor_nodes=np.concatenate([first + array.link_cells, edge, *switches]),
        conductance=1 / np.concatenate(resistance),
        source_nodes=np.array([[obstacle, GROUND], [goal, GROUND]]),
        source_volts=np.array([array.high, array.low]),
        current_nodes=np.stack([np.full(len(fed), GROUND), fed], axis=1),
        current_amps=np.full(len(fed), pattern.amps),
        capacitor_nodes=np.stack([stored, np.full(len(stored), GROUND)], axis=1),
        capacitance=np.full(len(stored), array.tile.capacitance),
        cell_map=replace(
            cell_map,
            node=own.reshape(array.shape),
            resistor_face=np.concatenate([array.link_face, array.edge_face, none]),
            resistor_upward=np.concatenate(
                [np.ones(len(array.link_face), np.bool_), array.edge_upward, np.ones(2 * cells, np.bool_)]
            ),
            free_node=own[np.isin(pattern.state, (State.FREE, State.DRIVEN))],
            obstacle_node=obstacle,
            goal_nodes=(goal,),
            wiring=replace(
                cell_map.wiring, rails="cells", resistance=array.tile.resistance or cell_map.wiring.resistance
            ),
            nonlinear_face=np.empty(0, dtype=np.int64),
            nonlinear_upward=np.empty(0, dtype=np.bool_),
        ),
    )


def internodal_resistance(array: TileArray, pattern: Pattern) -> NDArray[np.float64]:
    """Resistance of the internodal switch of every link, in ohms; shape (links,), zero where there is none."""
    on, off = array.tile.internodal_switch_on, array.tile.internodal_switch_off
    if on is None or off is None:
        return np.zeros(len(array.link_axis))
    blocked = (pattern.state == State.BLOCKED)[array.link_cells]
    if array.boundary == "neumann":
        return np.where(blocked.any(axis=1), off, on)
    return np.where(has_wall(blocked[:, 0], blocked[:, 1]), on + array.link_wall, on)


def walled_edges(array: TileArray, pattern: Pattern) -> NDArray[np.float64]:
    """Resistance between cells on the border and the obstacle rail beyond, with its wall, in ohms; shape (edges,)."""
    walled = has_wall((pattern.state == State.BLOCKED)[array.edge_cell], True)
    return array.edge_resistance + np.where(walled, array.edge_wall, 0.0)


def rail_resistance(array: TileArray, pattern: Pattern) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Resistances of the switches to the obstacle and to the goal rail, in ohms; shape (cells,) each."""
    tile, state = array.tile, pattern.state
    tied = state == (State.DRIVEN if array.boundary == "neumann" else State.BLOCKED)
    return (
        np.where(tied, tile.obstacle_switch_on, tile.obstacle_switch_off),
        np.where(state == State.GOAL, tile.goal_switch_on, tile.goal_switch_off),
    )
