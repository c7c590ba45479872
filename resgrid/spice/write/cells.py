"""The tile form of a deck: a subcircuit per kind of tile, the array of them, and the scene as a pattern of parameters.

Three files: the deck (title, supplies, and what it includes), the chip (tiles and array, the same for every scene of
its grid) and the pattern (one parameter a cell, its `State`).  The expressions are polynomials in the state, exact for
the states there are, because simulators agree on nothing but arithmetic:

    blocked = s (2 - s) (3 - s) / 2,   goal = s (s - 1) (3 - s) / 2,   driven = s (s - 1) (s - 2) / 6
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import Netlist
from resgrid.spice.analyses import MismatchAnalysis
from resgrid.spice.dialects import dialect_named
from resgrid.spice.dialects.record import Dialect
from resgrid.spice.text.texts import Chosen, Texts, fill, names, numbers, weave
from resgrid.spice.write.flat import FlatDeck, flatten, resistances, spread_preamble, tidy_title
from resgrid.spice.write.tiles import Tile, TileArray, expanded_netlist, pattern_of, tile_array

_BLOCKED = "{0}*(2-{0})*(3-{0})/2"
_GOAL = "{0}*({0}-1)*(3-{0})/2"
_DRIVEN = "{0}*({0}-1)*({0}-2)/6"
_USUAL = Tile()
_FREE = "(1-{0})*(2-{0})*(3-{0})/6"


@dataclass(frozen=True, eq=False)
class CellDeck:
    """A deck of tiles.

    `flat`: the flat deck of the expanded netlist, whose node names the tiles share; `text`: the deck; it includes the
    two other files; `chip, pattern`: their content; `resistors`: names of all resistors as ngspice expands them,
    ``r.x_3_4.r_link_0``; `resistor_value` (resistors,): what they should come to, in ohms.
    """

    flat: FlatDeck
    text: str
    chip: str
    pattern: str
    resistors: Texts
    resistor_value: NDArray[np.float64]


def tile_deck(
    netlist: Netlist,
    tile: Tile = _USUAL,
    *,
    dialect: str = "ngspice",
    title: str | None = None,
    chip_file: str = "chip",
    pattern_file: str = "pattern",
    mismatch: MismatchAnalysis | None = None,
    suffix: Mapping[int, str] | None = None,
) -> CellDeck:
    """Write a compiled netlist in tile form."""
    rules = dialect_named(dialect)
    array, pattern = tile_array(netlist, tile, mismatch), pattern_of(netlist)
    spread = mismatch.sigma if mismatch is not None and mismatch.runs else 0.0
    flat = flatten(expanded_netlist(netlist, tile, mismatch), dialect=dialect, title=_title(netlist, title))
    labels = weave(len(pattern.state), names([name.removeprefix("n_") for name in flat.node_names[2:]]))
    resistors, values = _expanded_resistors(array, flat.netlist, labels)
    return CellDeck(
        flat=flat,
        text=_deck(rules, array, flat, chip_file, pattern_file, suffix or {}),
        chip=_chip(rules, array, labels, spread),
        pattern=_pattern(rules, array, pattern.amps, pattern.state, labels, flat.title),
        resistors=resistors,
        resistor_value=values,
    )


def _title(netlist: Netlist, title: str | None) -> str:
    if title is not None or netlist.cell_map is None:
        return tidy_title(title or "")
    size = " x ".join(map(str, netlist.cells.space.shape))
    return f"array of {size} tiles, {netlist.cells.wiring.boundary} boundary"


def _deck(
    rules: Dialect, array: TileArray, flat: FlatDeck, chip_file: str, pattern_file: str, suffix: Mapping[int, str]
) -> str:
    supplies = [
        rules.voltage_source.format(name=f"v_{node}", a=node, b=rules.ground, value=repr(volts)) + suffix.get(i, "")
        for i, (node, volts) in enumerate((("obstacle", array.high), ("goal_0", array.low)))
    ]
    lines = [
        f"{rules.comment}{flat.title}",
        f"{rules.comment}{rules.name} dialect: the pattern sets the switches of the chip's tiles",
        *rules.preamble,
        rules.include.format(file=pattern_file),
        rules.include.format(file=chip_file),
        f"{rules.comment}supplies of the rails",
        *supplies,
        *([rules.end] if rules.end else []),
    ]
    return "\n".join(lines) + "\n"


def _pattern(rules: Dialect, array: TileArray, amps: float, state: NDArray[np.uint8], labels: Texts, title: str) -> str:
    lines = [
        f"{rules.comment}pattern: {title}",
        f"{rules.comment}state of every tile: 0 free, 1 blocked, 2 goal, 3 driven",
    ]
    if array.drive == "uniform":
        lines.append(rules.parameter.format(name="drive", value=repr(amps)))
    digit = names(["0", "1", "2", "3"]).take(state.astype(np.int64))
    name = weave(len(state), b"state_", labels)
    return "\n".join(lines) + "\n" + fill(rules.parameter + "\n", len(state), {"name": name, "value": digit}).decode()


def _chip(rules: Dialect, array: TileArray, labels: Texts, spread: float) -> str:
    link = _links(array)
    kinds = (link >= 0) @ (1 << np.arange(len(array.shape)))
    size = " x ".join(map(str, array.shape))
    head = [f"{rules.comment}chip: array of {size} tiles", *(spread_preamble(rules, spread) if spread else [])]
    tiles = [line for kind in np.unique(kinds).tolist() for line in _subcircuit(rules, array, kind, spread)]
    blocks = [_instances(rules, array, link, kinds, labels), _edges(rules, array, labels)]
    return "\n".join([*head, *tiles, f"{rules.comment}the array"]) + "\n" + "".join(block.decode() for block in blocks)


def _links(array: TileArray) -> NDArray[np.int64]:
    """Number of the link that each tile holds along each axis, -1 for none; shape (cells, axes)."""
    table = np.full((int(np.prod(array.shape)), len(array.shape)), -1)
    table[array.link_cells[:, 0], array.link_axis] = np.arange(len(array.link_axis))
    return table


def _axes(array: TileArray, kind: int) -> list[int]:
    return [axis for axis in range(len(array.shape)) if kind >> axis & 1]


def _master(kind: int, dimensions: int) -> str:
    """Name of a tile: ``tile`` has a link along every axis, ``tile_0_2`` along the axes 0 and 2."""
    if kind == (1 << dimensions) - 1:
        return "tile"
    return "tile_" + ("_".join(str(axis) for axis in range(dimensions) if kind >> axis & 1) or "end")


def _usual_resistance(array: TileArray, axis: int) -> float:
    values, count = np.unique(array.link_resistance[array.link_axis == axis], return_counts=True)
    return float(values[count.argmax()])


def _watches_neighbours(array: TileArray) -> bool:
    return array.boundary in ("neumann", "wall")


def _subcircuit(rules: Dialect, array: TileArray, kind: int, spread: float) -> list[str]:
    axes = _axes(array, kind)
    tile = array.tile
    defaults: dict[str, float | int] = {"state": 0}
    if _watches_neighbours(array):
        defaults |= {_state_beside(array, axis): 0 for axis in axes}
    defaults |= {f"resistance_{axis}": _usual_resistance(array, axis) for axis in axes}
    for name in ("obstacle", "goal", *(["internodal"] if array.internodal and axes else [])):
        defaults |= {f"{name}_switch_{end}": getattr(tile, f"{name}_switch_{end}") for end in ("on", "off")}
    if array.wall_resistance and axes:
        defaults |= dict.fromkeys((_wall(array, axis) for axis in axes), array.wall_resistance)
    if tile.capacitance:
        defaults["capacitance"] = tile.capacitance
    nodes = " ".join(["n", *(f"next_{axis}" for axis in axes), "obstacle", "goal"])
    given = rules.parameters.format(values=" ".join(f"{name}={value!r}" for name, value in defaults.items()))
    master = _master(kind, len(array.shape))
    return [
        rules.subcircuit.format(name=master, nodes=nodes, defaults="" if rules.parameters_in_body else given),
        *([given] if rules.parameters_in_body else []),
        *_elements(rules, array, axes, spread),
        rules.end_subcircuit if rules.parameters_in_body else f"{rules.end_subcircuit} {master}",
    ]


def _elements(rules: Dialect, array: TileArray, axes: Sequence[int], spread: float) -> list[str]:
    def resistor(name: str, a: str, b: str, value: str) -> str:
        return rules.resistor.format(name=name, a=a, b=b, value=rules.expression.format(value=value))

    tied = _DRIVEN if array.boundary == "neumann" else _BLOCKED
    lines = []
    for axis in axes:
        far = f"m_{axis}" if array.internodal else f"next_{axis}"
        link = resistor(f"r_link_{axis}", "n", far, f"resistance_{axis}")
        if spread:
            template = rules.spread_resistor.replace("{sigma}", repr(spread))
            link = template.format(name=f"r_link_{axis}", a="n", b=far, value=f"resistance_{axis}")
        lines.append(link)
        if array.internodal:
            lines.append(resistor(f"r_internodal_{axis}", far, f"next_{axis}", _internodal(array, axis)))
    lines += [
        resistor("r_obstacle", "n", "obstacle", _switch("obstacle", tied.format("state"))),
        resistor("r_goal", "n", "goal", _switch("goal", _GOAL.format("state"))),
    ]
    if array.tile.capacitance:
        value = rules.expression.format(value="capacitance")
        lines.append(rules.capacitor.format(name="c_node", a="n", b=rules.ground, value=value))
    if array.drive == "uniform":
        value = rules.expression.format(value=f"drive*{_FREE.format('state')}")
        lines.append(rules.current_source.format(name="i_drive", a=rules.ground, b="n", value=value))
    return lines


def _switch(name: str, closed: str) -> str:
    return f"{name}_switch_on*({closed})+{name}_switch_off*(1-({closed}))"


def _internodal(array: TileArray, axis: int) -> str:
    own, other = _BLOCKED.format("state"), _BLOCKED.format(_state_beside(array, axis))
    if array.boundary == "neumann":
        return _switch("internodal", f"(1-{own})*(1-{other})")
    if array.wall_resistance:
        return f"internodal_switch_on+{_wall(array, axis)}*({own}-{other})*({own}-{other})"
    return "internodal_switch_on"


def _wall(array: TileArray, axis: int) -> str:
    """The parameter of a wall: one for all, unless mismatch tells them apart."""
    return f"wall_resistance_{axis}" if len(np.unique(array.link_wall)) > 1 else "wall_resistance"


def _instances(
    rules: Dialect, array: TileArray, link: NDArray[np.int64], kinds: NDArray[np.int64], labels: Texts
) -> Texts:
    cells, dimensions = link.shape
    node = weave(cells + 1, *_or_nothing(b" n_", labels))
    state = weave(cells, rules.expression.format(value="@").split("@")[0].encode(), b"state_", labels,
                  rules.expression.format(value="@").split("@")[1].encode())  # fmt: skip
    beyond = np.where(link >= 0, array.link_cells[link, 1], cells)
    nodes: list[bytes | Texts | Chosen] = [b"n_", labels, *(node.take(beyond[:, axis]) for axis in range(dimensions))]
    values: list[bytes | Texts | Chosen] = [b" state=", state]
    for axis in range(dimensions):
        if _watches_neighbours(array):
            values.append(
                weave(cells + 1, *_or_nothing(f" {_state_beside(array, axis)}=".encode(), state)).take(beyond[:, axis])
            )
        given = [(f"resistance_{axis}", array.link_resistance, _usual_resistance_or_none(array, axis))]
        if array.wall_resistance:
            given.append((_wall(array, axis), array.link_wall, array.wall_resistance))
        for name, ohms, usual in given:
            changed = (link[:, axis] >= 0) & (ohms[link[:, axis]] != usual)
            if changed.any():
                text = weave(len(ohms) + 1, *_or_nothing(f" {name}=".encode(), numbers(ohms)))
                values.append(text.take(np.where(changed, link[:, axis], len(ohms))))
    masters = names([_master(kind, dimensions) for kind in range(1 << dimensions)])
    columns: dict[str, bytes | Texts | Chosen] = {
        "name": weave(cells, b"x_", labels),
        "nodes": weave(cells, *nodes, b" obstacle goal_0"),
        "master": masters.take(kinds),
        "values": weave(cells, b" params:" if "params:" in rules.parameters else b"", *values),
    }
    return fill(rules.instance + "\n", cells, columns)


def _state_beside(array: TileArray, axis: int) -> str:
    """A tile's parameter for the state of the next tile; along a single axis, tiles have states of the plain names."""
    return f"state_{axis}" if len(array.shape) > 1 else "state_beside"


def _usual_resistance_or_none(array: TileArray, axis: int) -> float:
    return _usual_resistance(array, axis) if np.any(array.link_axis == axis) else 0.0


def _or_nothing(prefix: bytes, texts: Texts) -> tuple[Chosen, Chosen]:
    """The prefix and each of the texts, and one row more with nothing."""
    count = len(texts)
    first = names(["", prefix.decode("ascii")]).take(np.append(np.ones(count, np.int64), 0))
    return first, Texts(texts.data, np.append(texts.offset, texts.offset[-1])).take(np.arange(count + 1))


def _edges(rules: Dialect, array: TileArray, labels: Texts) -> Texts:
    """Resistors from the border cells to the obstacle rail, named by cell and face."""
    rows = len(array.edge_cell)
    place = labels.take(array.edge_cell)
    columns: dict[str, bytes | Texts | Chosen] = {
        "name": weave(rows, b"r_edge_", place, *_face(array)),
        "a": weave(rows, b"n_", place),
        "b": names(["obstacle"]).take(np.zeros(rows, np.int64)),
        "value": _edge_values(rules, array, place),
    }
    return fill(rules.resistor + "\n", rows, columns)


def _edge_values(rules: Dialect, array: TileArray, place: Chosen) -> Texts:
    """Resistances to the obstacle rail beyond the edge; with walls these follow the state of the tile."""
    rows, ohms = len(array.edge_resistance), numbers(array.edge_resistance)
    if not array.wall_resistance:
        return ohms
    template = f"{{ohms}}+{{wall}}*(1-{_BLOCKED.format('{state}')})"
    columns = {"ohms": ohms, "wall": numbers(array.edge_wall), "state": weave(rows, b"state_", place)}
    return fill(rules.expression, rows, {"value": fill(template, rows, columns)})


def _face(array: TileArray) -> tuple[Chosen, Chosen]:
    faces = [int(np.prod(array.shape)) // n * (n + 1) for n in array.shape]
    axis = np.searchsorted(np.cumsum(faces), array.edge_face, side="right")
    which = names([f"_{number}" for number in range(len(array.shape))]).take(axis)
    return which, names(["_lower", "_upper"]).take(array.edge_upward.astype(np.int64))


def _expanded_resistors(array: TileArray, netlist: Netlist, labels: Texts) -> tuple[Texts, NDArray[np.float64]]:
    """Every resistor of the array as ngspice names it, and its value."""
    links, edges, cells = len(array.link_axis), len(array.edge_cell), len(labels)
    total = resistances(netlist.conductance)
    axis = names([f"_{number}" for number in range(len(array.shape))]).take(array.link_axis)
    home = labels.take(array.link_cells[:, 0])
    parts = [weave(links, b"r.x_", home, b".r_link", axis)]
    values = [array.link_resistance]
    if array.internodal:
        parts.append(weave(links, b"r.x_", home, b".r_internodal", axis))
        values.append(total[:links] - array.link_resistance)
    parts.append(weave(edges, b"r_edge_", labels.take(array.edge_cell), *_face(array)))
    parts += [weave(cells, b"r.x_", labels, text) for text in (b".r_obstacle", b".r_goal")]
    values.append(total[links:])
    data = np.concatenate([part.data for part in parts])
    lengths = np.concatenate([np.diff(part.offset) for part in parts])
    return Texts(data, np.concatenate([[0], np.cumsum(lengths)])), np.concatenate(values)
