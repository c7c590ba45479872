"""From a netlist to a flat deck: one line an element, in the order of their nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from string import Formatter

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import Netlist
from resgrid.core.networkx_graphs import ELEMENTS
from resgrid.errors import CircuitError, InputError
from resgrid.spice.circuit import Circuit
from resgrid.spice.dialects import dialect_named
from resgrid.spice.dialects.record import Dialect
from resgrid.spice.write.names import INITIALS, name_elements, name_nodes

_MAX_TITLE = 200


@dataclass(frozen=True, eq=False)
class FlatDeck:
    """A deck's text, and what ties its names to the netlist.

    `netlist`: what was written; `text`: the deck, LF line ends; `dialect`: whose rules it keeps; `title`: its title,
    one line of ASCII; `nodes` (n,): nodes of the netlist that the deck holds, ascending, without ground;
    `node_names`: their names in the deck; `sources` (s,): voltage sources of the netlist that the deck holds, in its
    order; `source_names`: their names in the deck; `left_out`: names (the netlist's) of the nodes that float and are
    left out; `renamed_nodes, renamed_elements`: name in the deck to name in the netlist, where they differ;
    `resistors`: names of the resistors as the simulator has them; `resistor_value` in ohms goes with them; `parts`:
    the files that the deck includes, by the end of their names; `dropped`: how many elements of the netlist are left
    out, by kind: they touch a node that floats, or close a loop of voltage sources.
    """

    netlist: Netlist
    text: str
    dialect: Dialect
    title: str
    nodes: NDArray[np.int64]
    node_names: list[str]
    sources: NDArray[np.int64]
    source_names: list[str]
    left_out: list[str]
    renamed_nodes: Mapping[str, str]
    renamed_elements: Mapping[str, str]
    resistors: list[str]
    resistor_value: NDArray[np.float64]
    parts: Mapping[str, str] = field(default_factory=dict)
    dropped: Mapping[str, int] = field(default_factory=dict)

    @property
    def missing(self) -> dict[str, int]:
        """How many nodes and elements of the netlist it does not hold, by kind."""
        return {**({"floating node": len(self.left_out)} if self.left_out else {}), **self.dropped}


@dataclass(frozen=True, eq=False)
class Additions:
    """What analyses ask of the lines of a deck.

    `suffix`: what is added to the line of which of the netlist's voltage sources (a waveform); `first`: what is added
    to that of the first one that the deck holds; `spread`: standard deviation of the resistances, relative, to be drawn
    by the simulator; 0 for none.
    """

    suffix: Mapping[int, str] = field(default_factory=dict)
    first: str = ""
    spread: float = 0.0

    def of(self, sources: Iterable[int]) -> list[str]:
        """What is added to the lines of the voltage sources of a deck, numbered as in the netlist."""
        numbers = list(sources)
        least = min(numbers, default=0)
        return [self.suffix.get(number, "") + self.first * (number == least) for number in numbers]


_NOTHING = Additions()


def flatten(
    netlist: Netlist, *, dialect: str = "ngspice", title: str | None = None, additions: Additions = _NOTHING
) -> FlatDeck:
    """Write a netlist as a flat deck; the same netlist gives the same text, whatever the order of its elements.

    Floating nodes and the elements that touch them are left out, as are sources that close a (consistent) loop.
    """
    rules = dialect_named(dialect)
    held = _held_nodes(netlist)
    names = name_nodes(netlist, rules, held)
    elements = _choose_elements(netlist, held)
    element_names = {kind: name_elements(netlist, kind, chosen, names) for kind, chosen in elements.items()}
    ohms = resistances(netlist.conductance[elements["resistor"]])
    heading = _heading(netlist, title)
    nodes = np.flatnonzero(held)[1:]  # without ground
    node_names = [names[node] for node in nodes.tolist()]
    left_out = netlist.names_of(np.flatnonzero(~held))
    dropped = {kind: len(getattr(netlist, ELEMENTS[kind][0])) - len(kept) for kind, kept in elements.items()}
    counts = [f"{len(chosen)} {kind}s" for kind, chosen in elements.items() if chosen.size]
    remarks = [heading, f"{rules.name} dialect: " + ", ".join([f"{len(nodes)} nodes besides ground", *counts])]
    if left_out or any(dropped.values()):
        remarks.append(
            f"left out: {len(left_out)} floating nodes (listed in the sidecar), "
            f"{sum(dropped.values())} elements that touch them or close a loop of voltage sources"
        )
    lines = [*(f"{rules.comment}{remark}" for remark in remarks), *_preamble(netlist, rules, additions)]
    for kind, chosen in elements.items():
        if chosen.size:
            columns = {"name": element_names[kind], **({"value": plain(ohms)} if kind == "resistor" else {})}
            lines += [f"{rules.comment}{kind}s", *_lines_of(netlist, rules, kind, chosen, names, columns, additions)]
    return FlatDeck(
        netlist=netlist,
        text="\n".join([*lines, *([rules.end] if rules.end else []), ""]),
        dialect=rules,
        title=heading,
        nodes=nodes,
        node_names=node_names,
        sources=elements["voltage source"],
        source_names=element_names["voltage source"],
        left_out=left_out,
        renamed_nodes=_renamed(node_names, netlist.node_names, nodes),
        renamed_elements={
            name: original
            for kind, given in (netlist.element_names or {}).items()
            for name, original in _renamed(element_names[kind], given, elements[kind]).items()
        },
        resistors=element_names["resistor"],
        resistor_value=ohms,
        dropped={kind: count for kind, count in dropped.items() if count},
    )


def fill(template: str, columns: Mapping[str, Iterable[str]]) -> list[str]:
    r"""Fill a `str.format` template once a row of its columns.

    Examples
    --------
    >>> fill("r{name} {{{value}}}", {"name": ["a", "b"], "value": ["1.0", "2.0"], "unused": []})
    ['ra {1.0}', 'rb {2.0}']
    """
    parts = [(literal.replace("{", "{{").replace("}", "}}"), name) for literal, name, *_ in Formatter().parse(template)]
    by_position = "".join(literal + ("" if name is None else "{}") for literal, name in parts)
    return list(map(by_position.format, *(columns[name] for _, name in parts if name is not None)))


def plain(values: NDArray[np.float64]) -> list[str]:
    """Numbers as ``repr`` writes them, without a minus in front of zero; shape (n,)."""
    return list(map(repr, (values + 0.0).tolist()))


def resistances(conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Resistances whose reciprocals are the given conductances, to the last bit where one exists.

    Of the candidates within one unit in the last place of ``1 / conductance``, and that value rounded to 12 digits
    (which gives 3300.0 back where 3300.0 was meant), the first whose reciprocal is exact is taken.

    Shapes: `conductance` (m,); returns (m,).
    """
    nearest = 1 / conductance
    best = nearest.copy()
    done = np.zeros(best.shape, dtype=np.bool_)
    for candidate in (rounded(nearest), nearest, np.nextafter(nearest, 0), np.nextafter(nearest, np.inf)):
        with np.errstate(all="ignore"):
            exact = ~done & (1 / candidate == conductance)
        best[exact] = candidate[exact]
        done |= exact
    return best


def rounded(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positive numbers rounded to 12 digits."""
    with np.errstate(all="ignore"):
        scale = 10.0 ** (11 - np.floor(np.log10(values)))
        return np.asarray(np.rint(values * scale) / scale)


def _held_nodes(netlist: Netlist) -> NDArray[np.bool_]:
    """Which nodes a deck can hold: those that resistors and voltage sources join to ground; shape (node_count,)."""
    circuit = Circuit.of(netlist)
    for source in circuit.trapped_sources.tolist():
        where = netlist.names_of(netlist.current_nodes[source])
        raise CircuitError(
            f"current source {source} from node {where[0]} to node {where[1]} feeds a floating part that lets no "
            "current out: remove it, or join the part to ground"
        )
    held = ~circuit.is_floating
    if held.sum() < 2:
        raise InputError("nothing is left to write: no node has a path of resistors or voltage sources to ground")
    return held


def _choose_elements(netlist: Netlist, held: NDArray[np.bool_]) -> dict[str, NDArray[np.int64]]:
    """Numbers of the elements that the deck holds, per kind, in the order of their nodes and values."""
    from resgrid.circuit.sources import tie_sources

    with np.errstate(over="ignore"):
        if np.isinf(1 / netlist.conductance).any():
            raise InputError("a resistance is beyond the largest number; leave that resistor out: it is open")
    in_tree = np.zeros(len(netlist.source_volts), dtype=np.bool_)
    parents = tie_sources(netlist).source
    in_tree[parents[parents >= 0]] = True
    chosen = {}
    for kind in INITIALS:
        nodes, columns = ELEMENTS[kind]
        ends, value = getattr(netlist, nodes), getattr(netlist, next(iter(columns.values())))
        kept = held[ends].all(axis=1)
        numbers = np.flatnonzero(kept & in_tree if kind == "voltage source" else kept)
        rank = -value if kind == "resistor" else value
        chosen[kind] = numbers[np.lexsort((rank[numbers], ends[numbers, 1], ends[numbers, 0]))]
    return chosen


def _lines_of(
    netlist: Netlist,
    rules: Dialect,
    kind: str,
    chosen: NDArray[np.int64],
    names: Sequence[str],
    columns: Mapping[str, list[str]],
    additions: Additions,
) -> list[str]:
    """Lines of elements of a kind; ``columns`` holds their names, and the values of resistors."""
    template: str = getattr(rules, kind.replace(" ", "_"))
    first, second = getattr(netlist, ELEMENTS[kind][0])[chosen].T.tolist()
    columns = {**columns, "a": [names[node] for node in first], "b": [names[node] for node in second]}
    if kind == "resistor":
        if additions.spread:
            template = rules.spread_resistor.replace("{sigma}", repr(additions.spread))
        if _has_coefficients(netlist):
            template += rules.temperature_coefficients
    elif kind == "voltage source":
        template += "{suffix}"
        columns["suffix"] = additions.of(chosen.tolist())
    for key, column in ELEMENTS[kind][1].items():
        field_name = "value" if key in ("volts", "amps", "capacitance") else key
        if f"{{{field_name}}}" in template:
            values = getattr(netlist, column)
            columns[field_name] = plain(np.zeros(len(chosen)) if values is None else values[chosen])
    return fill(template, columns)


def _has_coefficients(netlist: Netlist) -> bool:
    return any(tc is not None and tc.any() for tc in (netlist.tc1, netlist.tc2))


def _preamble(netlist: Netlist, rules: Dialect, additions: Additions) -> list[str]:
    precise = [rules.precise] if netlist.nonlinear_nodes.size else []
    spread = spread_preamble(rules, additions.spread, temperature=_has_coefficients(netlist))
    return [*rules.preamble, *precise, *spread]


def spread_preamble(rules: Dialect, sigma: float, *, temperature: bool = False) -> list[str]:
    """Lines that resistors of random value need in front of them; ``temperature``: whether they have coefficients."""
    if not sigma:
        return []
    defaults, passed = (" tc1=0 tc2=0", " tc1=tc1 tc2=tc2") if temperature else ("", "")
    return [line.format(sigma=repr(sigma), defaults=defaults, passed=passed) for line in rules.spread_preamble]


def _renamed(names: Sequence[str], given: Sequence[str] | None, numbers: NDArray[np.int64]) -> dict[str, str]:
    """Name in the deck to name in the netlist, where they differ; ``names`` has one entry a number."""
    if given is None:
        return {}
    pairs = zip(names, (given[number] for number in numbers.tolist()), strict=True)
    return {name: original for name, original in pairs if name != original}


def _heading(netlist: Netlist, title: str | None) -> str:
    """A title as one line of printable ASCII, for old simulators."""
    if title is None and netlist.cell_map is not None:
        cells = " x ".join(str(cells) for cells in netlist.cell_map.space.shape)
        title = f"resistor grid of {cells} cells, {netlist.cell_map.wiring.boundary} boundary"
    words = " ".join((title or "").split())
    return "".join(letter if " " <= letter <= "~" else "?" for letter in words)[:_MAX_TITLE] or "resistor netlist"
