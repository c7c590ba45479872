"""A chip as an array of tiles: what each tile holds of the netlist that the chip's passes made.

A tile holds the resistors to the next cells along each axis, a switch to the obstacle rail and one to the goal rail,
where obstacles are open (or walls) an internodal switch in series with every resistor, and a capacitor to ground.  The
scene is a pattern of states, one a cell.  What is no part of a tile is refused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import Netlist
from resgrid.core.regions import face_counts
from resgrid.core.space import Cell
from resgrid.core.wiring import EdgeRule, Wiring
from resgrid.errors import CircuitError, InputError
from resgrid.scene.chip import Chip
from resgrid.spice.write.flat import resistances, rounded

RAILS = ("obstacle", "goal")
SWITCHES = (*RAILS, "internodal")
ENDS = ("on", "off")
_ON, _OFF = 10.0, 1e10


class State(IntEnum):
    """What the switches of a tile are set to."""

    FREE = 0
    BLOCKED = 1
    GOAL = 2
    DRIVEN = 3


@dataclass(frozen=True, eq=False)
class Tiles:
    """A chip's circuit, tile by tile.

    `ohms`: of its switches, by their keys in a chip; `capacitance`: of every cell, in farads; `amps`: into every free
    tile; `state` (cells,): `State` of every tile.  The others describe the resistors of the grid, shapes (n,): `cell`:
    whose tile holds it; `beyond`: the next cell, -1 for the obstacle rail behind the edge; `axis, upward`: which way
    that lies; `resistance`: of the resistor, in ohms; `wall`: of the wall it has where it leads to an obstacle;
    `series`: of all that is in series with it in this scene.
    """

    netlist: Netlist
    ohms: Mapping[str, float]
    capacitance: float
    amps: float
    state: NDArray[np.uint8]
    cell: NDArray[np.int64]
    beyond: NDArray[np.int64]
    axis: NDArray[np.int64]
    upward: NDArray[np.bool_]
    resistance: NDArray[np.float64]
    wall: NDArray[np.float64]
    series: NDArray[np.float64]

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis."""
        return self.netlist.cells.space.shape

    @property
    def wiring(self) -> Wiring:
        """How the space was wired."""
        return self.netlist.cells.wiring

    @property
    def links(self) -> NDArray[np.int64]:
        """Numbers of the resistors between cells."""
        return np.flatnonzero(self.beyond >= 0)

    @property
    def edges(self) -> NDArray[np.int64]:
        """Numbers of the resistors to the obstacle rail behind the edge."""
        return np.flatnonzero(self.beyond < 0)

    @property
    def rail_switches(self) -> dict[str, NDArray[np.float64]]:
        """Resistances of the switches to every rail, in ohms, shapes (cells,)."""
        closed = {"obstacle": State.DRIVEN if self.wiring.is_driven else State.BLOCKED, "goal": State.GOAL}
        return {
            rail: np.where(self.state == state, *(self.ohms[f"{rail}_switch_{end}"] for end in ENDS))
            for rail, state in closed.items()
        }


def with_tile_switches(chip: Chip, boundary: str) -> Chip:
    """A chip with the switches that its tiles need: 10 ohm and 10 Gohm where it has none."""
    assumed = {key: _ON if key.endswith("_on") else _OFF for key in _needed(chip, boundary)}
    changes: dict[str, Any] = {key: ohms for key, ohms in assumed.items() if getattr(chip, key) is None}
    return dataclasses.replace(chip, **changes)


def _needed(chip: Chip, boundary: str) -> list[str]:
    between = boundary in ("neumann", "wall") or any((chip.internodal_switch_on, chip.internodal_switch_off))
    return [f"{name}_switch_{end}" for name in (SWITCHES if between else RAILS) for end in ENDS]


def tile_values(netlist: Netlist, chip: Chip) -> dict[str, float | None]:
    """What the tiles of a chip are made of, by the keys of its table, in ohms and farads."""
    switches = {key: getattr(chip, key) for key in (f"{name}_switch_{end}" for name in SWITCHES for end in ENDS)}
    return {"resistance": netlist.cells.wiring.resistance, "capacitance": chip.capacitance or 0.0, **switches}


def difference_from_ideal(op: OperatingPoint) -> float | None:
    """Largest difference of a free cell's voltage between a chip and one of ideal rails, in volts, if it is driven."""
    cells = op.netlist.cells
    ideal = compile_space(cells.space, cells.wiring)
    if op.netlist.current_amps.size:
        ideal = ideal.replace(current_amps=op.netlist.current_amps)
    free = np.isin(ideal.cells.node, ideal.cells.free_node)
    try:
        voltage = solve(ideal).voltage
    except CircuitError:
        return None
    difference = np.abs(voltage[ideal.cells.node[free]] - op.voltage[cells.node[free]])
    return float(np.max(difference[np.isfinite(difference)], initial=0.0))


def tiles_of(netlist: Netlist, chip: Chip) -> Tiles:
    """Take the netlist that a chip's passes made apart into tiles.

    The grid that the space has without obstacles says which resistors there are, and what they are nominally; what
    passes made of a resistor and its wall is told by what the netlist has in their place, less the switch in series.
    """
    space, wiring = netlist.cells.space, netlist.cells.wiring
    ohms = {key: getattr(chip, key) for key in _needed(chip, wiring.boundary)}
    missing = [f"chip.{key}" for key, value in ohms.items() if not value]
    if missing:
        raise InputError(f"a tile has switches of some resistance: give {', '.join(missing)}, or write it flat")
    amps = netlist.current_amps
    if amps.size and not np.allclose(amps, amps[0], rtol=1e-12, atol=0):
        raise InputError("tiles are fed the same current each, and this netlist is fed unevenly; write it flat")
    edge: list[EdgeRule] = ["open" if wiring.is_driven and rule == "obstacle" else rule for rule in wiring.edges(space)]
    full = compile_space(space, edge=edge, rails="cells", resistance=wiring.resistance)
    face, nominal = full.cells.resistor_face, resistances(full.conductance)
    cell, beyond = full.cell_of_node()[full.resistor_nodes].T
    state = _states(netlist)
    blocked = np.append(state == State.BLOCKED, True)  # the last one lies behind the edge
    walled = blocked[cell] != blocked[beyond]
    crossing = netlist.cells.resistor_face >= 0
    total = np.full(sum(face_counts(space.shape)), np.nan)
    total[netlist.cells.resistor_face[crossing]] = resistances(netlist.conductance[crossing])
    total = total[face]
    closed = np.where(beyond < 0, 0.0, ohms.get("internodal_switch_on", 0.0))
    wall = np.full(len(face), wiring.wall_resistance or 0.0)
    factor = (total - closed) / (nominal + np.where(walled, wall, 0.0))
    factor[np.isnan(total)] = 1.0  # before an open switch
    resistance, wall = _tidy(nominal * factor, total), _tidy(wall * factor, total)
    series = closed + np.where(walled, wall, 0.0)
    if wiring.is_driven:
        series = np.where(blocked[cell] | blocked[beyond], ohms["internodal_switch_off"], series)
    tiles = Tiles(
        netlist=netlist,
        ohms=ohms,
        capacitance=chip.capacitance or 0.0,
        amps=float(amps[0]) if amps.size else 0.0,
        state=state,
        cell=cell,
        beyond=beyond,
        axis=np.searchsorted(np.cumsum(face_counts(space.shape)), face, side="right"),
        upward=full.cells.resistor_upward,
        resistance=resistance,
        wall=wall,
        series=series,
    )
    _check_whole(tiles)
    return tiles


def _tidy(ohms: NDArray[np.float64], total: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values as they were meant, where that is within the rounding of the sum that they are a part of."""
    with np.errstate(invalid="ignore"):
        short = rounded(ohms)
        return np.where(np.abs(short - ohms) <= 8 * np.finfo(float).eps * np.fmax(total, ohms), short, ohms)


def _states(netlist: Netlist) -> NDArray[np.uint8]:
    """With open obstacles, free cells that no goal serves count as blocked: they would float.  Returns (cells,)."""
    space, wiring = netlist.cells.space, netlist.cells.wiring
    state = space.cell.astype(np.uint8)
    if wiring.is_driven:
        state[(space.cell == Cell.FREE) & ~space.goal_connected] = State.BLOCKED
    if wiring.start is not None:
        state[tuple(wiring.start)] = State.DRIVEN
    return state.ravel()


def _check_whole(tiles: Tiles) -> None:
    """Make sure that the tiles are the whole circuit: cells and rails, links and switches."""
    netlist, cells = tiles.netlist, tiles.netlist.cells
    count = len(tiles.state)
    pins = dict(zip(RAILS, (cells.obstacle_node, *cells.goal_nodes), strict=False))
    cell = netlist.cell_of_node()
    fits = (
        netlist.node_count == count + 3
        and len(netlist.source_volts) == 2
        and len(netlist.conductance) == len(tiles.cell) + 2 * count
        and not netlist.nonlinear_nodes.size
        and not any(tc is not None and tc.any() for tc in (netlist.tc1, netlist.tc2))
        and bool((tiles.resistance > 0).all())
    )
    for rail, ohms in tiles.rail_switches.items():
        to_pin = (cells.resistor_face < 0) & (netlist.resistor_nodes[:, 1] == pins.get(rail, -1))
        own = np.full(count, np.nan)
        own[cell[netlist.resistor_nodes[to_pin, 0]]] = 1 / netlist.conductance[to_pin]
        fits = fits and np.allclose(own, ohms, rtol=1e-12, atol=0)
    if not fits:
        raise InputError(
            "this netlist is no array of tiles: build it of the same chip with one node a cell, without rail "
            "resistance, saturation, temperature coefficients, loads of a read-out and defects, or write it flat"
        )
