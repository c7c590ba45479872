"""Decomposition of a chip's netlist into an array of tiles (circuits of one cell), and the switches that tiles need.

A tile holds the resistors to the next cells along each axis, a switch to the obstacle rail, a switch to the goal rail,
and a capacitor to ground.  With open obstacles or walls it also holds an internodal switch in series with every
resistor.  The scene is a pattern of states, one per cell.  A netlist with other elements is rejected.
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
from resgrid.core.cell import Cell
from resgrid.core.compiler import compile_space
from resgrid.core.drive_checks import require_drive
from resgrid.core.netlist import Netlist
from resgrid.core.regions import face_counts
from resgrid.core.wiring import EdgeRule, Wiring
from resgrid.errors import CircuitError, InputError
from resgrid.scene.chip import Chip
from resgrid.spice.write.flat import resistances, rounded

RAILS = ("obstacle", "goal")
"""Rails to which every tile has a switch; a rail is a node of fixed voltage that all tiles share."""
SWITCHES = (*RAILS, "internodal")
"""Kinds of switches of a tile: to the obstacle rail, to the goal rail, and in series with resistors between cells."""
ENDS = ("on", "off")
"""States of a switch; a chip's key for the resistance of a switch ends with one of them, as in ``goal_switch_on``."""
_ON, _OFF = 10.0, 1e10
"""Default resistances of a closed and an open switch, in ohms."""


class State(IntEnum):
    """State of a cell, which sets the switches of its tile: free, obstacle (blocked), goal, or start (driven)."""

    FREE = 0
    BLOCKED = 1
    GOAL = 2
    DRIVEN = 3


@dataclass(frozen=True, eq=False)
class Tiles:
    """A chip's circuit as an array of tiles; a tile is the circuit of one cell.

    `netlist`: the chip's circuit; `ohms`: resistances of the switches in ohms, by their keys in a chip; `capacitance`:
    capacitance of every cell, in farads, 0 without one; `amps`: current injected into every free tile, in amperes, 0
    unless the drive is uniform; `state` (cells,): `State` of every tile. The other arrays describe the n resistors
    between cells and at the grid's edge, shapes (n,): `cell`: flat index of the cell from which the resistor leads;
    `beyond`: index of the neighbouring cell, -1 for the obstacle rail beyond the grid's edge; `axis`: axis of the
    resistor, from 0; `upward`: whether it leads from the cell towards larger coordinates; `resistance`: of the resistor
    alone, in ohms; `wall`: wall resistance at a contact with an obstacle, in ohms, 0 without walls; `series`:
    resistance of wall and switch in series with the resistor in this scene, in ohms.
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
        """Number of cells of the grid along each axis."""
        return self.netlist.cells.space.shape

    @property
    def wiring(self) -> Wiring:
        """Wiring of the space, such as the boundary and the resistance between cells."""
        return self.netlist.cells.wiring

    @property
    def links(self) -> NDArray[np.int64]:
        """Indices of the resistors between two cells, into the arrays of all resistors such as `resistance`."""
        return np.flatnonzero(self.beyond >= 0)

    @property
    def edges(self) -> NDArray[np.int64]:
        """Indices of the resistors from edge cells to the obstacle rail, into the arrays of all resistors."""
        return np.flatnonzero(self.beyond < 0)

    @property
    def rail_switches(self) -> dict[str, NDArray[np.float64]]:
        """Resistances (cells,) of the switches to a rail in this scene, in ohms; the key is the name of the rail."""
        closed = {"obstacle": State.DRIVEN if self.wiring.is_driven else State.BLOCKED, "goal": State.GOAL}
        return {
            rail: np.where(self.state == state, *(self.ohms[f"{rail}_switch_{end}"] for end in ENDS))
            for rail, state in closed.items()
        }


def with_tile_switches(chip: Chip, boundary: str) -> Chip:
    """Return a copy of a chip with all switches that its tiles need, where missing ones get 10 ohm (on), 10 Gohm (off).

    `boundary`: boundary of the wiring, such as ``"neumann"``, which decides whether internodal switches are needed.
    """
    assumed = {key: _ON if key.endswith("_on") else _OFF for key in _needed_switches(chip, boundary)}
    changes: dict[str, Any] = {key: ohms for key, ohms in assumed.items() if getattr(chip, key) is None}
    return dataclasses.replace(chip, **changes)


def _needed_switches(chip: Chip, boundary: str) -> list[str]:
    """Return the chip's keys for the resistances of the switches that its tiles need, such as ``goal_switch_on``.

    All tiles need rail switches.  Tiles need switches between cells (internodal) if the boundary of the wiring,
    `boundary`, is ``"neumann"`` or ``"wall"``, or if the chip states their resistances.
    """
    between = boundary in ("neumann", "wall") or any((chip.internodal_switch_on, chip.internodal_switch_off))
    return [f"{name}_switch_{end}" for name in (SWITCHES if between else RAILS) for end in ENDS]


def tile_values(netlist: Netlist, chip: Chip) -> dict[str, float | None]:
    """Return the resistance, capacitance and switch resistances that all tiles of a chip have in common.

    The keys are those of the ``[chip]`` table: ``resistance`` (nominal, in ohms), ``capacitance`` (in farads, 0 without
    one), and on and off resistances such as ``goal_switch_on`` (in ohms, None for a switch that the chip does not
    have).
    """
    switches = {key: getattr(chip, key) for key in (f"{name}_switch_{end}" for name in SWITCHES for end in ENDS)}
    return {"resistance": netlist.cells.wiring.resistance, "capacitance": chip.capacitance or 0.0, **switches}


def difference_from_ideal(op: OperatingPoint) -> float | None:
    """Return the largest magnitude of the voltage difference, in volts, between a chip and its ideal circuit.

    All free cells with a voltage in both circuits are compared.  The ideal circuit is that of the same space without
    switches and mismatch, with the same injected currents.  `op`: operating point of the chip.  Returns None if the
    ideal circuit has no operating point.
    """
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
    """Return the tiles of a netlist that was built from a chip.

    The tiles contain the resistors of the same grid without obstacles.  Where the netlist has a resistor between two
    cells, the resistance of the tile's resistor and of its wall follows from the netlist's resistance, minus the closed
    switch in series; elsewhere it is nominal.  Raises InputError if the netlist is not an array of tiles.
    """
    space, wiring = netlist.cells.space, netlist.cells.wiring
    require_drive(wiring, "an array of tiles")
    if wiring.leak:
        raise InputError(
            f"leak = {wiring.leak:g}: a tile has no leak resistor; write a flat deck, or set leak = 0 (an open switch "
            "with obstacle_switch_off = R / (leak h^2) has the leakage of a leak)"
        )
    ohms = {key: getattr(chip, key) for key in _needed_switches(chip, wiring.boundary)}
    missing = [f"chip.{key}" for key, value in ohms.items() if not value]
    if missing:
        raise InputError(f"tiles need switches with a resistance: set {', '.join(missing)}, or write a flat deck")
    amps = netlist.current_amps
    if amps.size and not np.allclose(amps, amps[0], rtol=1e-12, atol=0):
        raise InputError(
            "all tiles inject the same current, but the currents of this netlist differ; write a flat deck"
        )
    edge: list[EdgeRule] = ["open" if wiring.is_driven and rule == "obstacle" else rule for rule in wiring.edges(space)]
    full = compile_space(space, edge=edge, rails="cells", resistance=wiring.resistance)
    face, nominal = full.cells.resistor_face, resistances(full.conductance)
    cell, beyond = full.cell_of_node()[full.resistor_nodes].T
    state = _states(netlist)
    blocked = np.append(state == State.BLOCKED, True)  # the last entry is the rail beyond the edge
    walled = blocked[cell] != blocked[beyond]
    crossing = netlist.cells.resistor_face >= 0
    total = np.full(sum(face_counts(space.shape)), np.nan)
    total[netlist.cells.resistor_face[crossing]] = resistances(netlist.conductance[crossing])
    total = total[face]
    closed = np.where(beyond < 0, 0.0, ohms.get("internodal_switch_on", 0.0))
    wall = np.full(len(face), wiring.wall_resistance or 0.0)
    factor = (total - closed) / (nominal + np.where(walled, wall, 0.0))
    factor[np.isnan(total)] = 1.0  # the netlist has no resistor at an open switch
    resistance, wall = _round_within_error(nominal * factor, total), _round_within_error(wall * factor, total)
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
    _check_complete(tiles)
    return tiles


def _round_within_error(ohms: NDArray[np.float64], total: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return resistances (n,), in ohms, rounded to 12 significant digits where rounding stays within rounding errors.

    Other resistances are unchanged.  The largest accepted change is 8 machine epsilons times `total`.  `ohms` (n,): the
    resistances, in ohms; `total` (n,): resistance of the series connection that contains each resistance, in ohms; a
    value that is NaN or smaller than the resistance is replaced by the resistance.
    """
    with np.errstate(invalid="ignore"):
        short = rounded(ohms)
        return np.where(np.abs(short - ohms) <= 8 * np.finfo(float).eps * np.fmax(total, ohms), short, ohms)


def _states(netlist: Netlist) -> NDArray[np.uint8]:
    """Return the `State` of every cell as a number, shape (cells,).

    In a grid with a drive (open obstacles), free cells without a path to a goal count as blocked, as their nodes would
    float.
    """
    space, wiring = netlist.cells.space, netlist.cells.wiring
    state = space.cell.astype(np.uint8)
    if wiring.is_driven:
        state[(space.cell == Cell.FREE) & ~space.goal_connected] = State.BLOCKED
    if wiring.start is not None:
        state[tuple(wiring.start)] = State.DRIVEN
    return state.ravel()


def _check_complete(tiles: Tiles) -> None:
    """Raise InputError unless the tiles contain every node, source, resistor and switch of the netlist."""
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
            "this netlist is not an array of tiles: build it from the same chip with one node per cell, without rail "
            "resistance, saturation, temperature coefficients, read-out loads and defects, or write a flat deck"
        )
