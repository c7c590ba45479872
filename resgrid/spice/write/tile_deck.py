"""Writer of tile decks: a subcircuit per kind of tile, the array of instances, and the scene as parameters.

A tile is the circuit of one cell on a chip.  A tile deck consists of three files: the deck (title, supplies, includes),
the chip (tiles and array) and the pattern (one parameter per cell, its `State`).  Without cost maps and random effects
the chip is the same for all scenes of a grid.  Switch values are polynomials in the state `s`, exact for s = 0 to 3,
because arithmetic is the only part of expressions on which all simulators agree:

    blocked = s (2 - s) (3 - s) / 2,   goal = s (s - 1) (3 - s) / 2,   driven = s (s - 1) (s - 2) / 6
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import Netlist
from resgrid.scene.chip import Chip
from resgrid.spice.dialects.record import GROUND_NAME, Dialect
from resgrid.spice.write.flat import Additions, FlatDeck, fill, flatten, plain, spread_preamble
from resgrid.spice.write.tiles import ENDS, RAILS, Tiles, tiles_of

_BLOCKED = "{0}*(2-{0})*(3-{0})/2"
_GOAL = "{0}*({0}-1)*(3-{0})/2"
_DRIVEN = "{0}*({0}-1)*({0}-2)/6"
_FREE = "(1-{0})*(2-{0})*(3-{0})/6"
"""Templates of the formulas that are 1 for one state of a tile and 0 for the others.

The constants have the name of this state (free 0, blocked 1, goal 2, driven 3); ``{0}`` stands for the state.
"""


def write_tiles(
    netlist: Netlist, chip: Chip, name: str, *, dialect: str, title: str | None, additions: Additions
) -> FlatDeck:
    """Return the tile deck (one subcircuit per cell) of a netlist built from a chip.

    `FlatDeck.parts` of the result holds the chip file and the pattern file, which the main file includes. `netlist`:
    the circuit; `chip`: chip with the resistances of all switches of the tiles; `name`: file name of the deck;
    `dialect`: name of the simulator's dialect; `title`: first line, None for a description of the array; `additions`:
    changes of the lines that analyses require.
    """
    tiles = tiles_of(netlist, chip)
    size = " x ".join(map(str, tiles.shape))
    if title is None:
        title = f"array of {size} tiles, {tiles.wiring.boundary} boundary"
    flat = flatten(netlist, dialect=dialect, title=title)
    labels = [node.removeprefix("n_") for node in netlist.names_of(netlist.cells.node.ravel())]
    names, values = _simulated_resistors(tiles, labels)
    files = {
        "": _deck_lines(tiles, flat, name, additions),
        "chip": _chip_lines(tiles, flat.dialect, labels, additions.spread),
        "pattern": _pattern_lines(tiles, flat, labels),
    }
    texts = {part: "\n".join([*lines, ""]) for part, lines in files.items()}
    return dataclasses.replace(flat, text=texts.pop(""), parts=texts, resistors=names, resistor_value=values)


def _deck_lines(tiles: Tiles, flat: FlatDeck, name: str, additions: Additions) -> Iterator[str]:
    """Yield the lines of the main file: title, includes and voltage sources of the rails.

    `flat`: flat deck of the same netlist, for title and dialect; `name`: file name of the deck; `additions`: text to
    append to the lines of the voltage sources.
    """
    rules, netlist = flat.dialect, tiles.netlist
    yield f"{rules.comment}{flat.title}"
    yield f"{rules.comment}{rules.name} dialect: the pattern sets the switches of the chip's tiles"
    yield from rules.preamble
    yield from (rules.include.format(file=f"{name}.{part}") for part in ("pattern", "chip"))
    yield f"{rules.comment}supplies of the rails"
    supplies = zip(netlist.names_of(netlist.source_nodes[:, 0]), plain(netlist.source_volts), strict=True)
    suffixes = additions.of(range(len(netlist.source_volts)))
    for (node, volts), suffix in sorted(zip(supplies, suffixes, strict=True), reverse=True):
        yield rules.voltage_source.format(name=f"v_{node}", a=node, b=GROUND_NAME, value=volts) + suffix
    yield from [rules.end] if rules.end else []


def _pattern_lines(tiles: Tiles, flat: FlatDeck, labels: Sequence[str]) -> Iterator[str]:
    """Yield the lines of the pattern file: for every cell the definition of a parameter, whose value is its `State`.

    With a uniform drive, the parameter ``drive`` for the current into every free cell, in amperes, precedes them.
    `flat`: flat deck of the same netlist, for title and dialect; `labels` (cells,): indices of each cell as text in
    names, such as ``0_1``.
    """
    rules = flat.dialect
    yield f"{rules.comment}pattern: {flat.title}"
    yield f"{rules.comment}state of every tile: 0 free, 1 blocked, 2 goal, 3 driven"
    if tiles.wiring.drive == "uniform":
        yield rules.parameter.format(name="drive", value=repr(tiles.amps))
    states = {"name": [f"state_{label}" for label in labels], "value": map(str, tiles.state.tolist())}
    yield from fill(rules.parameter, states)


def _chip_lines(tiles: Tiles, rules: Dialect, labels: Sequence[str], spread: float) -> Iterator[str]:
    """Yield the lines of the chip file: subcircuits of tiles (cells), instances, and the resistors at the grid's edge.

    `rules`: dialect of the deck; `labels` (cells,): indices of each cell as text in names, such as ``0_1``;
    `spread`: relative standard deviation of the resistances, 0 for fixed values.
    """
    dimensions, links = len(tiles.shape), tiles.links
    link = np.full((len(tiles.state), dimensions), -1)
    link[tiles.cell[links], tiles.axis[links]] = links
    kinds = (link >= 0) @ (1 << np.arange(dimensions))
    whole = (1 << dimensions) - 1
    axes = {kind: [axis for axis in range(dimensions) if kind >> axis & 1] for kind in np.unique(kinds).tolist()}
    suffix = {kind: "_".join(map(str, own)) or "end" for kind, own in axes.items()}
    masters = {kind: "tile" if kind == whole else f"tile_{suffix[kind]}" for kind in axes}
    yield f"{rules.comment}chip: array of {' x '.join(map(str, tiles.shape))} tiles"
    yield from spread_preamble(rules, spread)
    for kind, master in masters.items():
        yield from _subcircuit(rules, tiles, master, axes[kind], spread)
    yield f"{rules.comment}the array"
    yield from _instances(rules, tiles, link, [masters[kind] for kind in kinds.tolist()], labels)
    yield from fill(rules.resistor, {
        "name": _edge_names(tiles, labels),
        "a": [f"n_{labels[cell]}" for cell in tiles.cell[tiles.edges].tolist()],
        "b": ["obstacle"] * len(tiles.edges),
        "value": _edge_values(rules, tiles, labels),
    })  # fmt: skip


def _parameters(tiles: Tiles, axis: int) -> dict[str, tuple[NDArray[np.float64], float]]:
    """Return the subcircuit parameters of a tile's resistor along an axis, by name, each as a pair of values in ohms.

    Names: ``resistance_<axis>``, and for walls with a resistance also ``wall_resistance`` (all walls are equal) or
    ``wall_resistance_<axis>``.  First value of a pair (n,): one value for each of the n resistors of the grid, along
    all axes and at the grid's edge, in the order of `Tiles.cell`.  Second value: default of the subcircuit, which is
    the most frequent resistance along this axis (0 without a resistor), or the nominal wall resistance.
    """
    own = tiles.resistance[tiles.links[tiles.axis[tiles.links] == axis]]
    values, count = np.unique(own, return_counts=True)
    parameters = {f"resistance_{axis}": (tiles.resistance, float(values[count.argmax()]) if values.size else 0.0)}
    if tiles.wiring.wall_resistance:
        parameters[_wall(tiles, axis)] = (tiles.wall, tiles.wiring.wall_resistance)
    return parameters


def _wall(tiles: Tiles, axis: int) -> str:
    """Return the name of the subcircuit parameter for the wall resistance along an axis.

    The name is ``wall_resistance`` for all axes if all walls between cells have the same resistance, else
    ``wall_resistance_<axis>``.
    """
    return f"wall_resistance_{axis}" if len(np.unique(tiles.wall[tiles.links])) > 1 else "wall_resistance"


def _neighbour_state(tiles: Tiles, axis: int) -> str:
    """Return the name of the subcircuit parameter for the state of the next tile along an axis.

    The name is ``state_<axis>``.  On a grid with one axis it is ``state_beside``, because there ``state_0`` is the name
    of the global parameter for the state of cell 0.
    """
    return f"state_{axis}" if len(tiles.shape) > 1 else "state_beside"


def _has_switched_links(tiles: Tiles) -> bool:
    """Return whether a switch is in series with every resistor between neighbouring cells."""
    return "internodal_switch_on" in tiles.ohms


def _depends_on_neighbours(tiles: Tiles) -> bool:
    """Return whether the resistance between two cells depends on the states of both cells (Neumann, wall boundary)."""
    return tiles.wiring.boundary in ("neumann", "wall")


def _subcircuit(rules: Dialect, tiles: Tiles, master: str, axes: Sequence[int], spread: float) -> Iterator[str]:
    """Yield the lines of the subcircuit for tiles (circuits of one cell) that have resistors along certain axes.

    `rules`: dialect of the deck; `master`: name of the subcircuit; `axes`: axes along which the tile has a resistor;
    `spread`: relative standard deviation of the resistances, 0 for fixed values.
    """
    defaults: dict[str, float | int] = {"state": 0}
    if _depends_on_neighbours(tiles):
        defaults |= {_neighbour_state(tiles, axis): 0 for axis in axes}
    usual = {name: ohms for axis in axes for name, (_, ohms) in _parameters(tiles, axis).items()}
    defaults |= {name: ohms for name, ohms in usual.items() if name.startswith("resistance")}
    for name in (*RAILS, *(["internodal"] if _has_switched_links(tiles) and axes else [])):
        defaults |= {f"{name}_switch_{end}": tiles.ohms[f"{name}_switch_{end}"] for end in ENDS}
    defaults |= usual
    if tiles.capacitance:
        defaults["capacitance"] = tiles.capacitance
    nodes = " ".join(["n", *(f"next_{axis}" for axis in axes), *RAILS])
    given = rules.parameters.format(values=" ".join(f"{name}={value!r}" for name, value in defaults.items()))
    yield rules.subcircuit.format(name=master, nodes=nodes, defaults="" if rules.parameters_in_body else given)
    if rules.parameters_in_body:
        yield given
    yield from _elements(rules, tiles, axes, spread)
    yield rules.end_subcircuit if rules.parameters_in_body else f"{rules.end_subcircuit} {master}"


def _elements(rules: Dialect, tiles: Tiles, axes: Sequence[int], spread: float) -> Iterator[str]:
    """Yield the element lines of the subcircuit of a tile: resistors along its axes, switches, capacitor and source.

    `rules`: dialect of the deck; `axes`: axes along which the tile has a resistor; `spread`: relative standard
    deviation of the resistances, 0 for fixed values.
    """

    def expression(value: str) -> str:
        return rules.expression.format(value=value)

    switched = _has_switched_links(tiles)
    for axis in axes:
        far = f"m_{axis}" if switched else f"next_{axis}"
        link = {"name": f"r_link_{axis}", "a": "n", "b": far}
        if spread:
            yield rules.spread_resistor.format(**link, value=f"resistance_{axis}", sigma=repr(spread))
        else:
            yield rules.resistor.format(**link, value=expression(f"resistance_{axis}"))
        if switched:
            series = expression(_internodal(tiles, axis))
            yield rules.resistor.format(name=f"r_internodal_{axis}", a=far, b=f"next_{axis}", value=series)
    tied = _DRIVEN if tiles.wiring.is_driven else _BLOCKED
    for rail, closed in zip(RAILS, (tied, _GOAL), strict=True):
        ohms = expression(_switch(rail, closed.format("state")))
        yield rules.resistor.format(name=f"r_{rail}", a="n", b=rail, value=ohms)
    if tiles.capacitance:
        yield rules.capacitor.format(name="c_node", a="n", b=GROUND_NAME, value=expression("capacitance"))
    if tiles.wiring.drive == "uniform":
        amps = expression(f"drive*{_FREE.format('state')}")
        yield rules.current_source.format(name="i_drive", a=GROUND_NAME, b="n", value=amps)


def _switch(name: str, closed: str) -> str:
    """Return the expression of a switch's resistance, in ohms, in the syntax of the deck.

    `name`: first part of the parameters of its on and off resistance, such as ``goal``; `closed`: an expression that is
    1 if the switch is closed and 0 if it is open.
    """
    return f"{name}_switch_on*({closed})+{name}_switch_off*(1-({closed}))"


def _internodal(tiles: Tiles, axis: int) -> str:
    """Return the expression of the resistance in series with the resistor to the next cell along an axis, in ohms.

    With open obstacles it is that of a switch, which is open if one of both cells is blocked.  With walls it is that of
    the closed switch, plus the wall resistance if exactly one of both cells is blocked.  With other boundaries it is
    that of the closed switch.
    """
    own, other = _BLOCKED.format("state"), _BLOCKED.format(_neighbour_state(tiles, axis))
    if tiles.wiring.is_driven:
        return _switch("internodal", f"(1-{own})*(1-{other})")
    if tiles.wiring.wall_resistance:
        return f"internodal_switch_on+{_wall(tiles, axis)}*({own}-{other})*({own}-{other})"
    return "internodal_switch_on"


def _instances(
    rules: Dialect, tiles: Tiles, link: NDArray[np.int64], masters: Sequence[str], labels: Sequence[str]
) -> Iterator[str]:
    """Yield one instance line per cell; a parameter whose value is the default of the subcircuit is left out.

    `rules`: dialect of the deck; `link` (cells, axes): index of the resistor from the cell to the next one along each
    axis, -1 for none; `masters` (cells,): names of the subcircuits; `labels` (cells,): indices of each cell as text in
    names, such as ``0_1``.
    """
    usual = [
        {name: (ohms.tolist(), most) for name, (ohms, most) in _parameters(tiles, axis).items()}
        for axis in range(len(tiles.shape))
    ]
    beyond = tiles.beyond.tolist()
    states = [rules.expression.format(value=f"state_{label}") for label in labels]
    for cell, (label, master, row) in enumerate(zip(labels, masters, link.tolist(), strict=True)):
        values, nodes = {"state": states[cell]}, [f"n_{label}"]
        for axis, number in enumerate(row):
            if number < 0:
                continue
            nodes.append(f"n_{labels[beyond[number]]}")
            if _depends_on_neighbours(tiles):
                values[_neighbour_state(tiles, axis)] = states[beyond[number]]
            values |= {name: repr(ohms[number]) for name, (ohms, most) in usual[axis].items() if ohms[number] != most}
        given = "".join(f" {name}={value}" for name, value in values.items())
        yield rules.instance.format(
            name=f"x_{label}",
            nodes=" ".join([*nodes, "obstacle", "goal_0"]),
            master=master,
            values=f"{rules.instance_parameters}{given}",
        )


def _edge_names(tiles: Tiles, labels: Sequence[str]) -> list[str]:
    """Return the names of the resistors at the grid's edge, such as ``r_edge_0_1_0_upper`` (cell, axis, side).

    `labels` (cells,): indices of each cell as text in names, such as ``0_1``.
    """
    columns = (column[tiles.edges].tolist() for column in (tiles.cell, tiles.axis, tiles.upward))
    return [
        f"r_edge_{labels[cell]}_{axis}_{'upper' if upward else 'lower'}"
        for cell, axis, upward in zip(*columns, strict=True)
    ]


def _edge_values(rules: Dialect, tiles: Tiles, labels: Sequence[str]) -> list[str]:
    """Return the resistances between edge cells and the obstacle rail as text, in ohms, one per resistor.

    With a wall boundary the texts are expressions of the cell's state instead of numbers.  `labels` (cells,):
    indices of each cell as text in names, such as ``0_1``.
    """
    ohms = plain(tiles.resistance[tiles.edges])
    if not tiles.wiring.wall_resistance:
        return ohms
    walls = zip(ohms, plain(tiles.wall[tiles.edges]), tiles.cell[tiles.edges].tolist(), strict=True)
    return [
        rules.expression.format(value=f"{own}+{wall}*(1-{_BLOCKED.format(f'state_{labels[cell]}')})")
        for own, wall, cell in walls
    ]


def _simulated_resistors(tiles: Tiles, labels: Sequence[str]) -> tuple[list[str], NDArray[np.float64]]:
    """Return ngspice's names of all resistors after the expansion of subcircuits, and their resistances (n,) in ohms.

    Switches are resistors, too.

    `labels` (cells,): indices of each cell as text in names, such as ``0_1``.
    """
    links, edges = tiles.links, tiles.edges
    places = [
        (labels[cell], axis) for cell, axis in zip(tiles.cell[links].tolist(), tiles.axis[links].tolist(), strict=True)
    ]
    names = [f"r.x_{label}.r_link_{axis}" for label, axis in places]
    values = [tiles.resistance[links]]
    if _has_switched_links(tiles):
        names += [f"r.x_{label}.r_internodal_{axis}" for label, axis in places]
        values.append(tiles.series[links])
    names += _edge_names(tiles, labels)
    values.append(tiles.resistance[edges] + tiles.series[edges])
    for rail, ohms in tiles.rail_switches.items():
        names += [f"r.x_{label}.r_{rail}" for label in labels]
        values.append(ohms)
    return names, np.concatenate(values)
