"""A chip written as an array of tiles: a subcircuit per kind of tile, the array of them, and the scene as a pattern.

A tile holds the resistors to the next cells along each axis, a switch to the obstacle rail and one to the goal rail,
where obstacles are open (or walls) an internodal switch in series with every resistor, and a capacitor to ground.  The
circuit is the one that the chip's passes made; what is no part of a tile is refused.

Three files: the deck (title, supplies, and what it includes), the chip (tiles and array; the same for every scene of
its grid, if costs and passes leave it so) and the pattern (one parameter a cell, its `State`).  The expressions are
polynomials in the state, exact for the states there are, because simulators agree on nothing but arithmetic:

    blocked = s (2 - s) (3 - s) / 2,   goal = s (s - 1) (3 - s) / 2,   driven = s (s - 1) (s - 2) / 6
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.compiler import compile_space
from resgrid.conductances import has_wall
from resgrid.errors import CircuitError, InputError
from resgrid.grids import face_counts
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.solve import solve
from resgrid.scene.chip import Chip
from resgrid.space import Cell
from resgrid.spice.dialects.record import Dialect
from resgrid.spice.write.flat import Additions, Deck, fill, flatten, plain, resistances, rounded, spread_preamble
from resgrid.wiring import Wiring

_ON, _OFF = 10.0, 1e10
_BLOCKED = "{0}*(2-{0})*(3-{0})/2"
_GOAL = "{0}*({0}-1)*(3-{0})/2"
_DRIVEN = "{0}*({0}-1)*({0}-2)/6"
_FREE = "(1-{0})*(2-{0})*(3-{0})/6"
_RAILS = ("obstacle", "goal")
_SWITCHES = (*_RAILS, "internodal")
_ENDS = ("on", "off")


class State(IntEnum):
    """What the switches of a tile are set to."""

    FREE = 0
    BLOCKED = 1
    GOAL = 2
    DRIVEN = 3


@dataclass(frozen=True, eq=False)
class _Tiles:
    """A chip's circuit, tile by tile.

    `ohms`: of its switches, by their keys in a chip; `capacitance`: of every cell, in farads; `state` (cells,): `State`
    of every tile; `link_cells` (l, 2): the cell whose tile holds a resistor, and the next one; `link_axis,
    link_resistance, link_wall, link_switch` (l,): along which axis it lies, its ohms, those of its wall where it leads
    to an obstacle, and those of all that is in series with it now; `edge_*` (e,): the same of the resistors between
    border cells and the obstacle rail; `edge_upward`: whether that is the upper border; `amps`: into every free tile.
    """

    netlist: Netlist
    ohms: Mapping[str, float]
    capacitance: float
    state: NDArray[np.uint8]
    link_cells: NDArray[np.int64]
    link_axis: NDArray[np.int64]
    link_resistance: NDArray[np.float64]
    link_wall: NDArray[np.float64]
    link_switch: NDArray[np.float64]
    edge_cell: NDArray[np.int64]
    edge_axis: NDArray[np.int64]
    edge_resistance: NDArray[np.float64]
    edge_wall: NDArray[np.float64]
    edge_switch: NDArray[np.float64]
    edge_upward: NDArray[np.bool_]
    amps: float

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis."""
        return self.netlist.cells.space.shape

    @property
    def wiring(self) -> Wiring:
        """How the space was wired."""
        return self.netlist.cells.wiring

    @property
    def has_switched_links(self) -> bool:
        """Whether there are internodal switches."""
        return "internodal_switch_on" in self.ohms


def with_tile_switches(chip: Chip, boundary: str) -> Chip:
    """A chip with the switches that its tiles need: 10 ohm and 10 Gohm where it has none."""
    assumed = {key: _ON if key.endswith("_on") else _OFF for key in _needed(chip, boundary)}
    changes: dict[str, Any] = {key: ohms for key, ohms in assumed.items() if getattr(chip, key) is None}
    return dataclasses.replace(chip, **changes)


def _needed(chip: Chip, boundary: str) -> list[str]:
    between = boundary in ("neumann", "wall") or any((chip.internodal_switch_on, chip.internodal_switch_off))
    return [f"{name}_switch_{end}" for name in (_SWITCHES if between else _RAILS) for end in _ENDS]


def write_tiles(
    netlist: Netlist, chip: Chip, name: str, *, dialect: str, title: str | None, additions: Additions
) -> Deck:
    """Write the netlist that a chip's passes made as the tiles of a deck in a file of this name."""
    space, wiring = netlist.cells.space, netlist.cells.wiring
    missing = [f"chip.{key}" for key in _needed(chip, wiring.boundary) if not getattr(chip, key)]
    if missing:
        raise InputError(f"a tile has switches of some resistance: give {', '.join(missing)}, or write it flat")
    size = " x ".join(map(str, space.shape))
    tiles = _tiles_of(netlist, chip)
    if title is None:
        title = f"array of {size} tiles, {wiring.boundary} boundary"
    flat = flatten(netlist, dialect=dialect, title=title)
    labels = [node.removeprefix("n_") for node in netlist.names_of(netlist.cells.node.ravel())]
    names, values = _simulated_resistors(tiles, labels)
    return dataclasses.replace(
        flat,
        text="\n".join(_deck_lines(tiles, flat, name, additions)) + "\n",
        resistors=names,
        resistor_value=values,
        parts={
            "chip": "\n".join(_chip_lines(tiles, flat.dialect, labels, additions.spread)) + "\n",
            "pattern": "\n".join(_pattern_lines(tiles, flat, labels)) + "\n",
        },
    )


def tile_values(netlist: Netlist, chip: Chip) -> dict[str, float | None]:
    """What the tiles of a chip are made of, by the keys of its table, in ohms and farads."""
    switches = {key: getattr(chip, key) for key in (f"{name}_switch_{end}" for name in _SWITCHES for end in _ENDS)}
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


def _tiles_of(netlist: Netlist, chip: Chip) -> _Tiles:
    """Take a netlist apart into what its tiles hold."""
    cells = netlist.cells
    space, wiring = cells.space, cells.wiring
    ohms = {key: getattr(chip, key) for key in _needed(chip, wiring.boundary)}
    edge = ["open" if wiring.is_driven and rule == "obstacle" else rule for rule in wiring.edge]
    full = compile_space(space, edge=edge, rails="cells", resistance=wiring.resistance)
    face = full.cells.resistor_face
    ends = full.cell_of_node()[full.resistor_nodes]
    beyond = ends[:, 1] < 0
    state = _states(netlist)
    blocked = state == State.BLOCKED
    walled = has_wall(blocked[ends[:, 0]], beyond | blocked[ends[:, 1]])
    total = np.full(sum(face_counts(space.shape)), np.nan)
    own = cells.resistor_face >= 0
    total[cells.resistor_face[own]] = resistances(netlist.conductance[own])
    total = total[face]
    closed = np.where(beyond, 0.0, ohms.get("internodal_switch_on", 0.0))
    wall_resistance = wiring.wall_resistance or 0.0
    nominal = resistances(full.conductance)
    factor = (total - closed) / (nominal + np.where(walled, wall_resistance, 0.0))
    factor[np.isnan(total)] = 1.0  # before an open switch
    resistance, wall = (_tidy(value * factor, total) for value in (nominal, np.full(len(face), wall_resistance)))
    switch = closed + np.where(walled, wall, 0.0)
    if wiring.is_driven:
        switch = np.where(blocked[ends].any(axis=1), ohms["internodal_switch_off"], switch)
    axis = np.searchsorted(np.cumsum(face_counts(space.shape)), face, side="right")
    tiles = _Tiles(
        netlist=netlist,
        ohms=ohms,
        capacitance=chip.capacitance or 0.0,
        state=state,
        link_cells=ends[~beyond],
        link_axis=axis[~beyond],
        link_resistance=resistance[~beyond],
        link_wall=wall[~beyond],
        link_switch=switch[~beyond],
        edge_cell=ends[beyond, 0],
        edge_axis=axis[beyond],
        edge_resistance=resistance[beyond],
        edge_wall=wall[beyond],
        edge_switch=switch[beyond],
        edge_upward=full.cells.resistor_upward[beyond],
        amps=_even_amps(netlist),
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


def _even_amps(netlist: Netlist) -> float:
    amps = netlist.current_amps
    if amps.size and not np.allclose(amps, amps[0], rtol=1e-12, atol=0):
        raise InputError("tiles are fed the same current each, and this netlist is fed unevenly; write it flat")
    return float(amps[0]) if amps.size else 0.0


def _rail_switches(tiles: _Tiles) -> NDArray[np.float64]:
    """Resistances of the switches to the obstacle and to the goal rail, in ohms; shape (2, cells)."""
    closed = {"obstacle": State.DRIVEN if tiles.wiring.is_driven else State.BLOCKED, "goal": State.GOAL}
    return np.array(
        [
            np.where(tiles.state == state, *(tiles.ohms[f"{rail}_switch_{end}"] for end in _ENDS))
            for rail, state in closed.items()
        ]
    )


def _check_whole(tiles: _Tiles) -> None:
    """Make sure that the tiles are the whole circuit: cells and rails, links and switches."""
    netlist, cells = tiles.netlist, tiles.netlist.cells
    count = len(tiles.state)
    pins = (cells.obstacle_node, *cells.goal_nodes)
    extra = cells.resistor_face < 0
    cell = netlist.cell_of_node()
    found = np.full((2, count), np.nan)
    for row, pin in zip(found, pins, strict=False):
        to_pin = extra & (netlist.resistor_nodes[:, 1] == pin)
        row[cell[netlist.resistor_nodes[to_pin, 0]]] = 1 / netlist.conductance[to_pin]
    if not (
        netlist.node_count == count + 3
        and len(pins) == len(netlist.source_volts) == 2
        and len(netlist.conductance) == len(tiles.link_axis) + len(tiles.edge_axis) + 2 * count
        and not netlist.nonlinear_nodes.size
        and not any(tc is not None and tc.any() for tc in (netlist.tc1, netlist.tc2))
        and np.allclose(found, _rail_switches(tiles), rtol=1e-12, atol=0)
        and (tiles.link_resistance > 0).all()
    ):
        raise InputError(
            "this netlist is no array of tiles: build it of the same chip with one node a cell, without rail "
            "resistance, saturation, temperature coefficients, loads of a read-out and defects, or write it flat"
        )


def _deck_lines(tiles: _Tiles, flat: Deck, name: str, additions: Additions) -> list[str]:
    rules, netlist = flat.dialect, tiles.netlist
    supplies = {}
    for number, (node, volts) in enumerate(zip(netlist.source_nodes[:, 0], netlist.source_volts.tolist(), strict=True)):
        supplies[netlist.node_name(int(node))] = repr(volts + 0.0), additions.suffix.get(number, "")
    return [
        f"{rules.comment}{flat.title}",
        f"{rules.comment}{rules.name} dialect: the pattern sets the switches of the chip's tiles",
        *rules.preamble,
        *(rules.include.format(file=f"{name}.{part}") for part in ("pattern", "chip")),
        f"{rules.comment}supplies of the rails",
        *(
            rules.voltage_source.format(name=f"v_{node}", a=node, b=rules.ground, value=volts) + suffix
            for node, (volts, suffix) in sorted(supplies.items(), reverse=True)
        ),
        *([rules.end] if rules.end else []),
    ]


def _pattern_lines(tiles: _Tiles, flat: Deck, labels: Sequence[str]) -> list[str]:
    rules = flat.dialect
    lines = [
        f"{rules.comment}pattern: {flat.title}",
        f"{rules.comment}state of every tile: 0 free, 1 blocked, 2 goal, 3 driven",
    ]
    if tiles.wiring.drive == "uniform":
        lines.append(rules.parameter.format(name="drive", value=repr(tiles.amps)))
    states = {"name": [f"state_{label}" for label in labels], "value": map(str, tiles.state.tolist())}
    return lines + fill(rules.parameter, states)


def _chip_lines(tiles: _Tiles, rules: Dialect, labels: Sequence[str], spread: float) -> Iterator[str]:
    link = np.full((len(tiles.state), len(tiles.shape)), -1)
    link[tiles.link_cells[:, 0], tiles.link_axis] = np.arange(len(tiles.link_axis))
    kinds = (link >= 0) @ (1 << np.arange(len(tiles.shape)))
    yield f"{rules.comment}chip: array of {' x '.join(map(str, tiles.shape))} tiles"
    yield from spread_preamble(rules, spread)
    for kind in np.unique(kinds).tolist():
        yield from _subcircuit(rules, tiles, kind, spread)
    yield f"{rules.comment}the array"
    yield from _instances(rules, tiles, link, kinds, labels)
    yield from fill(rules.resistor, {
        "name": _edge_names(tiles, labels),
        "a": [f"n_{labels[cell]}" for cell in tiles.edge_cell.tolist()],
        "b": ["obstacle"] * len(tiles.edge_cell),
        "value": _edge_values(rules, tiles, labels),
    })  # fmt: skip


def _master(kind: int, dimensions: int) -> str:
    """Name of a tile: ``tile`` has a link along every axis, ``tile_0_2`` along the axes 0 and 2."""
    if kind == (1 << dimensions) - 1:
        return "tile"
    return "tile_" + ("_".join(str(axis) for axis in range(dimensions) if kind >> axis & 1) or "end")


def _usual_resistance(tiles: _Tiles, axis: int) -> float:
    values, count = np.unique(tiles.link_resistance[tiles.link_axis == axis], return_counts=True)
    return float(values[count.argmax()]) if values.size else 0.0


def _subcircuit(rules: Dialect, tiles: _Tiles, kind: int, spread: float) -> list[str]:
    axes = [axis for axis in range(len(tiles.shape)) if kind >> axis & 1]
    defaults: dict[str, float | int] = {"state": 0}
    if tiles.wiring.boundary in ("neumann", "wall"):
        defaults |= {_state_beside(tiles, axis): 0 for axis in axes}
    defaults |= {f"resistance_{axis}": _usual_resistance(tiles, axis) for axis in axes}
    for name in (*_RAILS, *(["internodal"] if tiles.has_switched_links and axes else [])):
        defaults |= {f"{name}_switch_{end}": tiles.ohms[f"{name}_switch_{end}"] for end in _ENDS}
    if tiles.wiring.wall_resistance and axes:
        defaults |= dict.fromkeys((_wall(tiles, axis) for axis in axes), tiles.wiring.wall_resistance)
    if tiles.capacitance:
        defaults["capacitance"] = tiles.capacitance
    nodes = " ".join(["n", *(f"next_{axis}" for axis in axes), *_RAILS])
    given = rules.parameters.format(values=" ".join(f"{name}={value!r}" for name, value in defaults.items()))
    master = _master(kind, len(tiles.shape))
    return [
        rules.subcircuit.format(name=master, nodes=nodes, defaults="" if rules.parameters_in_body else given),
        *([given] if rules.parameters_in_body else []),
        *_elements(rules, tiles, axes, spread),
        rules.end_subcircuit if rules.parameters_in_body else f"{rules.end_subcircuit} {master}",
    ]


def _elements(rules: Dialect, tiles: _Tiles, axes: Sequence[int], spread: float) -> Iterator[str]:
    def resistor(name: str, a: str, b: str, value: str) -> str:
        return rules.resistor.format(name=name, a=a, b=b, value=rules.expression.format(value=value))

    for axis in axes:
        far = f"m_{axis}" if tiles.has_switched_links else f"next_{axis}"
        if spread:
            template = rules.spread_resistor.replace("{sigma}", repr(spread))
            yield template.format(name=f"r_link_{axis}", a="n", b=far, value=f"resistance_{axis}")
        else:
            yield resistor(f"r_link_{axis}", "n", far, f"resistance_{axis}")
        if tiles.has_switched_links:
            yield resistor(f"r_internodal_{axis}", far, f"next_{axis}", _internodal(tiles, axis))
    tied = _DRIVEN if tiles.wiring.is_driven else _BLOCKED
    for rail, closed in zip(_RAILS, (tied, _GOAL), strict=True):
        yield resistor(f"r_{rail}", "n", rail, _switch(rail, closed.format("state")))
    if tiles.capacitance:
        value = rules.expression.format(value="capacitance")
        yield rules.capacitor.format(name="c_node", a="n", b=rules.ground, value=value)
    if tiles.wiring.drive == "uniform":
        value = rules.expression.format(value=f"drive*{_FREE.format('state')}")
        yield rules.current_source.format(name="i_drive", a=rules.ground, b="n", value=value)


def _switch(name: str, closed: str) -> str:
    return f"{name}_switch_on*({closed})+{name}_switch_off*(1-({closed}))"


def _internodal(tiles: _Tiles, axis: int) -> str:
    own, other = _BLOCKED.format("state"), _BLOCKED.format(_state_beside(tiles, axis))
    if tiles.wiring.is_driven:
        return _switch("internodal", f"(1-{own})*(1-{other})")
    if tiles.wiring.wall_resistance:
        return f"internodal_switch_on+{_wall(tiles, axis)}*({own}-{other})*({own}-{other})"
    return "internodal_switch_on"


def _state_beside(tiles: _Tiles, axis: int) -> str:
    """A tile's parameter for the state of the next tile; along a single axis, tiles have states of the plain names."""
    return f"state_{axis}" if len(tiles.shape) > 1 else "state_beside"


def _wall(tiles: _Tiles, axis: int) -> str:
    """The parameter of a wall: one for all, unless mismatch tells them apart."""
    return f"wall_resistance_{axis}" if len(np.unique(tiles.link_wall)) > 1 else "wall_resistance"


def _instances(
    rules: Dialect, tiles: _Tiles, link: NDArray[np.int64], kinds: NDArray[np.int64], labels: Sequence[str]
) -> Iterator[str]:
    usual: list[Mapping[str, tuple[list[float], float]]] = []
    for axis in range(len(tiles.shape)):
        own = {f"resistance_{axis}": (tiles.link_resistance.tolist(), _usual_resistance(tiles, axis))}
        if tiles.wiring.wall_resistance:
            own[_wall(tiles, axis)] = (tiles.link_wall.tolist(), tiles.wiring.wall_resistance)
        usual.append(own)
    watches = tiles.wiring.boundary in ("neumann", "wall")
    beyond = tiles.link_cells[:, 1].tolist()
    masters = {kind: _master(kind, len(tiles.shape)) for kind in np.unique(kinds).tolist()}
    for label, kind, row in zip(labels, kinds.tolist(), link.tolist(), strict=True):
        held = [(axis, number) for axis, number in enumerate(row) if number >= 0]
        values = {"state": rules.expression.format(value=f"state_{label}")}
        for axis, number in held:
            if watches:
                state = rules.expression.format(value=f"state_{labels[beyond[number]]}")
                values[_state_beside(tiles, axis)] = state
            values |= {name: repr(ohms[number]) for name, (ohms, most) in usual[axis].items() if ohms[number] != most}
        given = "".join(f" {name}={value}" for name, value in values.items())
        next_nodes = "".join(f" n_{labels[beyond[number]]}" for _, number in held)
        yield rules.instance.format(
            name=f"x_{label}",
            nodes=f"n_{label}{next_nodes} obstacle goal_0",
            master=masters[kind],
            values=f"{rules.instance_parameters}{given}",
        )


def _edge_names(tiles: _Tiles, labels: Sequence[str]) -> list[str]:
    """Resistors from the border cells to the obstacle rail, named by cell and face."""
    faces = zip(tiles.edge_cell.tolist(), tiles.edge_axis.tolist(), tiles.edge_upward.tolist(), strict=True)
    return [f"r_edge_{labels[cell]}_{axis}_{'upper' if up else 'lower'}" for cell, axis, up in faces]


def _edge_values(rules: Dialect, tiles: _Tiles, labels: Sequence[str]) -> list[str]:
    """Resistances to the obstacle rail beyond the edge; with walls these follow the state of the tile."""
    ohms = plain(tiles.edge_resistance)
    if not tiles.wiring.wall_resistance:
        return ohms
    return [
        rules.expression.format(value=f"{own}+{wall}*(1-{_BLOCKED.format(f'state_{labels[cell]}')})")
        for own, wall, cell in zip(ohms, plain(tiles.edge_wall), tiles.edge_cell.tolist(), strict=True)
    ]


def _simulated_resistors(tiles: _Tiles, labels: Sequence[str]) -> tuple[list[str], NDArray[np.float64]]:
    """Every resistor of the array as ngspice expands it, and its value in ohms."""
    links = list(zip((labels[cell] for cell in tiles.link_cells[:, 0].tolist()), tiles.link_axis.tolist(), strict=True))
    names = [f"r.x_{label}.r_link_{axis}" for label, axis in links]
    values = [tiles.link_resistance]
    if tiles.has_switched_links:
        names += [f"r.x_{label}.r_internodal_{axis}" for label, axis in links]
        values.append(tiles.link_switch)
    names += _edge_names(tiles, labels)
    values.append(tiles.edge_resistance + tiles.edge_switch)
    for rail, ohms in zip(_RAILS, _rail_switches(tiles), strict=True):
        names += [f"r.x_{label}.r_{rail}" for label in labels]
        values.append(ohms)
    return names, np.concatenate(values)
