"""Writer of flat decks: one line per element of a netlist, sorted by nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from string import Formatter

import numpy as np
from numpy.typing import NDArray

from resgrid.core.lattice import SQUARE
from resgrid.core.netlist import Netlist
from resgrid.core.networkx_graphs import ELEMENTS
from resgrid.errors import CircuitError, InputError
from resgrid.spice.circuit import Circuit
from resgrid.spice.dialects import dialect_named
from resgrid.spice.dialects.record import Dialect
from resgrid.spice.write.names import INITIALS, name_elements, name_nodes

_MAX_TITLE = 200
"""Maximum length of a deck's title, in characters; longer titles are cut."""


@dataclass(frozen=True, eq=False)
class FlatDeck:
    """Text of a deck, and the correspondence between names in the deck and the netlist.

    `netlist`: the netlist that was written; `text`: main file of the deck, with LF line ends; `dialect`: dialect of the
    deck; `title`: one line of ASCII; `nodes` (n,): netlist numbers of the nodes in the deck, ascending, without ground;
    `node_names` (n,): names of `nodes` in the deck; `sources` (s,): netlist indices of the voltage sources in the deck,
    in the order of the deck; `source_names` (s,): names of `sources` in the deck; `left_out`: netlist names of the
    floating nodes, which the deck omits; `renamed_nodes, renamed_elements`: netlist name by deck name, where they
    differ; `resistors` (m,): the simulator's names of the resistors; `resistor_value` (m,): resistances in ohms;
    `parts`: content of the files that the main file includes, by file name suffix; empty for a flat deck; `dropped`:
    number of omitted elements of each kind (an omitted element touches a floating node, or closes a loop of voltage
    sources); a kind without omitted elements is absent.
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
        """Numbers of floating nodes and of elements that the deck omits, by kind, without zeros.

        Kinds: ``"floating node"``, ``"resistor"``, ``"voltage source"`` and so on.
        """
        return {**({"floating node": len(self.left_out)} if self.left_out else {}), **self.dropped}


@dataclass(frozen=True, eq=False)
class Additions:
    """Text that analyses require in a deck: at the end of the lines of voltage sources, and in those of resistors.

    `suffix`: text appended to the line of a voltage source (a waveform), by the netlist index of the source; `first`:
    text appended to the line of the voltage source with the lowest netlist index (the input of a noise analysis), empty
    for none; `spread`: relative standard deviation of the resistances, which the simulator draws; 0 for fixed values.
    """

    suffix: Mapping[int, str] = field(default_factory=dict)
    first: str = ""
    spread: float = 0.0

    def of(self, sources: Iterable[int]) -> list[str]:
        """Return the text appended to the line of each voltage source in the deck; `sources`: their netlist indices."""
        numbers = list(sources)
        least = min(numbers, default=0)
        return [self.suffix.get(number, "") + self.first * (number == least) for number in numbers]


_NOTHING = Additions()


def flatten(
    netlist: Netlist, *, dialect: str = "ngspice", title: str | None = None, additions: Additions = _NOTHING
) -> FlatDeck:
    """Return the flat deck of a netlist.  The text does not depend on the order of the netlist's elements.

    `dialect`: name of the dialect; `title`: first line, None for a description of the netlist; `additions`: changes
    that analyses require.  Floating nodes, the elements that touch floating nodes, and voltage sources that close a
    loop (whose voltages must sum to zero) are omitted.  Raises InputError for an unknown dialect, an overflowing
    resistance or a netlist without grounded nodes, and CircuitError for a current source that drives a floating node.
    """
    rules = dialect_named(dialect)
    held = grounded_nodes(netlist)
    names = name_nodes(netlist, rules, held)
    elements = choose_elements(netlist, held)
    element_names = {kind: name_elements(netlist, kind, chosen, names) for kind, chosen in elements.items()}
    ohms = resistances(netlist.conductance[elements["resistor"]])
    heading = one_line_title(netlist, title)
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
            lines += [f"{rules.comment}{kind}s", *lines_of(netlist, rules, kind, chosen, names, columns, additions)]
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
    """Return the lines that result from a `str.format` template, one for each row of a table of texts.

    `columns`: column of the table for each field of the template, by name; all these columns have the same length.

    Examples
    --------
    >>> fill("r{name} {{{value}}}", {"name": ["a", "b"], "value": ["1.0", "2.0"], "unused": []})
    ['ra {1.0}', 'rb {2.0}']
    """
    parts = [(literal.replace("{", "{{").replace("}", "}}"), name) for literal, name, *_ in Formatter().parse(template)]
    by_position = "".join(literal + ("" if name is None else "{}") for literal, name in parts)
    return list(map(by_position.format, *(columns[name] for _, name in parts if name is not None)))


def plain(values: NDArray[np.float64]) -> list[str]:
    """Return the shortest decimal text that reads back as each number, ``0.0`` for negative zero; `values` (n,)."""
    return list(map(repr, (values + 0.0).tolist()))


def resistances(conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return resistances (m,), in ohms, whose floating-point reciprocals equal the given conductances if possible.

    The candidates are the quotient ``1 / conductance`` rounded to 12 digits (which restores 3300.0 from 1 / 3300.0),
    the quotient itself, and the two doubles next to it.  The first one whose reciprocal is exactly the conductance is
    used; without such a candidate, the quotient.  `conductance` (m,): in siemens.
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
    """Return positive numbers rounded to 12 significant digits, shape (n,); `values` (n,)."""
    with np.errstate(all="ignore"):
        scale = 10.0 ** (11 - np.floor(np.log10(values)))
        return np.asarray(np.rint(values * scale) / scale)


def grounded_nodes(netlist: Netlist) -> NDArray[np.bool_]:
    """Return the mask (node_count,) of ground and the nodes that conducting elements connect to ground.

    Resistors, nonlinear resistors and voltage sources conduct; capacitors and current sources do not.

    Raises InputError if only ground is in the mask, and CircuitError for a current source that drives a floating node.
    """
    circuit = Circuit.of(netlist)
    for source in circuit.trapped_sources.tolist():
        where = netlist.names_of(netlist.current_nodes[source])
        raise CircuitError(
            f"current source {source} from node {where[0]} to node {where[1]} drives a floating part, which has no "
            "return path: remove it, or join the part to ground by a resistor"
        )
    held = ~circuit.is_floating
    if held.sum() < 2:
        raise InputError(
            "the netlist cannot be written as a deck: no node has a path of resistors or voltage sources to ground; "
            "connect it to node 0"
        )
    return held


def choose_elements(netlist: Netlist, held: NDArray[np.bool_]) -> dict[str, NDArray[np.int64]]:
    """Return the netlist indices of the elements in the deck, by kind, sorted by nodes and then by values.

    Kinds are ``"resistor"``, ``"voltage source"`` and so on.  Elements at nodes outside the deck, and voltage sources
    that close a loop of voltage sources, are left out.  Resistors at the same nodes are sorted by ascending resistance.
    `held` (node_count,): mask of the nodes in the deck.
    """
    from resgrid.circuit.sources import tie_sources

    with np.errstate(over="ignore"):
        if np.isinf(1 / netlist.conductance).any():
            raise InputError("a resistance exceeds the largest double; remove that resistor: it is open")
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


def lines_of(
    netlist: Netlist,
    rules: Dialect,
    kind: str,
    chosen: NDArray[np.int64],
    names: Sequence[str],
    columns: Mapping[str, list[str]],
    additions: Additions,
) -> list[str]:
    """Return the lines of the elements of one kind.

    `netlist, rules`: the circuit, and the dialect of the deck; `kind`: kind, such as ``"resistor"``; `chosen` (m,):
    netlist indices of the elements; `names` (node_count,): deck names of all nodes; `columns`: m texts for each of the
    fields ``name`` and, for resistors, ``value`` of the template of the line, by field; `additions`: changes that
    analyses require.
    """
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
    """Return whether any resistor of the netlist has a nonzero temperature coefficient."""
    return any(tc is not None and tc.any() for tc in (netlist.tc1, netlist.tc2))


def _preamble(netlist: Netlist, rules: Dialect, additions: Additions) -> list[str]:
    """Return the lines between the title and the elements: dialect statements, tolerances, random resistors.

    `rules`: dialect of the deck; `additions`: changes of the deck that analyses require.
    """
    precise = [rules.precise] if netlist.nonlinear_nodes.size else []
    spread = spread_preamble(rules, additions.spread, temperature=_has_coefficients(netlist))
    return [*rules.preamble, *precise, *spread]


def spread_preamble(rules: Dialect, sigma: float, *, temperature: bool = False) -> list[str]:
    """Return the lines that define resistors of random value in a dialect, an empty list for fixed values.

    `sigma`: relative standard deviation of the resistances, 0 for fixed values; `temperature`: whether resistors have
    temperature coefficients.
    """
    if not sigma:
        return []
    defaults, passed = (" tc1=0 tc2=0", " tc1=tc1 tc2=tc2") if temperature else ("", "")
    return [line.format(sigma=repr(sigma), defaults=defaults, passed=passed) for line in rules.spread_preamble]


def _renamed(names: Sequence[str], given: Sequence[str] | None, numbers: NDArray[np.int64]) -> dict[str, str]:
    """Return the netlist name by deck name, where the two names differ.

    `names` (n,): deck names; `given`: all names in the netlist, None without names (then the result is empty);
    `numbers` (n,): index in `given` of each deck name.
    """
    if given is None:
        return {}
    pairs = zip(names, (given[number] for number in numbers.tolist()), strict=True)
    return {name: original for name, original in pairs if name != original}


def one_line_title(netlist: Netlist, title: str | None) -> str:
    """Return the title of a deck as one line of at most 200 printable ASCII characters; other characters become ``?``.

    `title`: text of the title; None for a description of the netlist.
    """
    found = netlist.space_map
    if title is None and found is not None:
        cells, lattice = " x ".join(str(cells) for cells in found.space.shape), found.wiring.lattice
        kind = "resistor grid of" if lattice == SQUARE else f"{lattice} lattice over"
        title = f"{kind} {cells} cells, {found.wiring.boundary} boundary"
        title += f", leak {found.wiring.leak:g}" if found.wiring.leak else ""
    words = " ".join((title or "").split())
    return "".join(letter if " " <= letter <= "~" else "?" for letter in words)[:_MAX_TITLE] or "resistor netlist"
