"""From a netlist to the text of a flat deck."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import Netlist
from resgrid.spice.dialects import dialect_named
from resgrid.spice.dialects.record import Dialect
from resgrid.spice.text.texts import Chosen, Texts, fill, names, numbers, weave
from resgrid.spice.write.elements import (
    ENDS,
    NodeNames,
    choose_elements,
    held_nodes,
    name_elements,
    name_nodes,
    renamed,
    renamed_elements,
)

_MAX_TITLE = 200


@dataclass(frozen=True, eq=False)
class FlatDeck:
    """A deck's text, and what ties its names to the netlist.

    `netlist`: what was written; `text`: the deck, LF line ends; `dialect`: whose rules it keeps; `title`: its title,
    one line of ASCII; `nodes` (n,): nodes of the netlist that the deck holds, ascending, without ground;
    `node_texts`: their names in the deck; `node_names` as strings; `sources` (s,): voltage sources of the netlist
    that the deck holds, in its order; `source_texts`: their names in the deck; `source_names` as strings; `left_out`:
    names (the netlist's) of the nodes that float and are left out; `renamed_nodes, renamed_elements`: name in the
    deck to name in the netlist, where they differ; `resistors`: names of the resistors in the deck, in its order;
    `resistor_value` in ohms goes with them.
    """

    netlist: Netlist
    text: str
    dialect: Dialect
    title: str
    nodes: NDArray[np.int64]
    node_texts: Texts
    sources: NDArray[np.int64]
    source_texts: Texts
    left_out: list[str]
    renamed_nodes: Mapping[str, str]
    renamed_elements: Mapping[str, str]
    resistors: Texts
    resistor_value: NDArray[np.float64]

    @cached_property
    def node_names(self) -> list[str]:
        """Names of the nodes in the deck."""
        return self.node_texts.strings()

    @cached_property
    def source_names(self) -> list[str]:
        """Names of the voltage sources in the deck."""
        return self.source_texts.strings()


@dataclass(frozen=True, eq=False)
class Additions:
    """What analyses ask of the lines of a deck.

    `suffix`: per kind of source, what is added to the line of which of the netlist's elements (a waveform); `spread`:
    standard deviation of the resistances, relative, to be drawn by the simulator; 0 for none.
    """

    suffix: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    spread: float = 0.0


_NOTHING = Additions()


def format_deck(netlist: Netlist, *, dialect: str = "ngspice", title: str | None = None) -> str:
    """Write a netlist as the text of a flat deck.

    Floating nodes and the elements that touch them are left out, as are sources that close a (consistent) loop.

    Parameters
    ----------
    netlist : Netlist
    dialect : str
        Whose rules to keep, one of `resgrid.spice.dialects.DIALECTS`.
    title : str, optional
        The first line; by default it tells the grid.

    Returns
    -------
    str
        The same netlist gives the same text, whatever the order of its elements.

    Raises
    ------
    InputError
        If the dialect is unknown, or nothing is left to write.
    CircuitError
        If sources contradict each other, or a current source feeds a floating part.
    """
    return flatten(netlist, dialect=dialect, title=title).text


def flatten(
    netlist: Netlist, *, dialect: str = "ngspice", title: str | None = None, additions: Additions = _NOTHING
) -> FlatDeck:
    """Write a netlist as a flat deck; as `format_deck`, with the names that were used."""
    rules = dialect_named(dialect)
    held = held_nodes(netlist)
    nodes = name_nodes(netlist, rules, held)
    elements = choose_elements(netlist, held)
    element_names = {kind: name_elements(netlist, kind, chosen, nodes) for kind, chosen in elements.items()}
    ohms = resistances(netlist.conductance[elements["resistor"]])
    values = _values(netlist, elements, ohms)
    heading = tidy_title(_default_title(netlist) if title is None else title)
    left_out = netlist.names_of(np.flatnonzero(~held))
    head = [heading, _census(rules, nodes, elements), *_left_out_line(netlist, elements, left_out)]
    blocks = [
        fill(_template(netlist, rules, kind, additions), len(chosen), {
            "name": element_names[kind],
            "a": nodes.texts.take(getattr(netlist, ENDS[kind])[chosen, 0]),
            "b": nodes.texts.take(getattr(netlist, ENDS[kind])[chosen, 1]),
            "suffix": _suffixes(chosen, additions.suffix.get(kind, {})),
            **values[kind],
        })
        for kind, chosen in elements.items()
    ]  # fmt: skip
    head_lines = [f"{rules.comment}{line}\n" for line in head]
    head_lines += [f"{line}\n" for line in _preamble(netlist, rules, elements, additions)]
    body = [part for kind, block in zip(elements, blocks, strict=True) if len(block)
            for part in (f"{rules.comment}{kind}s\n".encode(), block.data.data)]  # fmt: skip
    end = f"{rules.end}\n" if rules.end else ""
    text = b"".join(["".join(head_lines).encode(), *body, end.encode()]).decode("ascii")
    return FlatDeck(
        netlist=netlist,
        text=text,
        dialect=rules,
        title=heading,
        nodes=nodes.nodes,
        node_texts=weave(len(nodes.nodes), nodes.texts.take(nodes.nodes)),
        sources=elements["voltage source"],
        source_texts=element_names["voltage source"],
        left_out=left_out,
        renamed_nodes=renamed(netlist, nodes),
        renamed_elements=renamed_elements(netlist, elements, element_names),
        resistors=element_names["resistor"],
        resistor_value=ohms,
    )


def resistances(conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Resistances whose reciprocals are the given conductances, to the last bit where one exists.

    Of the candidates within one unit in the last place of ``1 / conductance``, and that value rounded to 12 digits
    (which gives 3300.0 back where 3300.0 was meant), the first whose reciprocal is exact is taken.

    Shapes: `conductance` (m,); returns (m,).
    """
    nearest = 1 / conductance
    with np.errstate(all="ignore"):
        scale = 10.0 ** (11 - np.floor(np.log10(nearest)))
        short = np.rint(nearest * scale) / scale
    best = nearest.copy()
    found = np.zeros(best.shape, dtype=np.bool_)
    for candidate in (short, nearest, np.nextafter(nearest, 0), np.nextafter(nearest, np.inf)):
        with np.errstate(all="ignore"):
            exact = ~found & (1 / candidate == conductance)
        best[exact] = candidate[exact]
        found |= exact
    return best


def _values(
    netlist: Netlist, elements: Mapping[str, NDArray[np.int64]], ohms: NDArray[np.float64]
) -> dict[str, dict[str, Texts]]:
    """Columns of numbers, per kind, by the names that the dialects' templates have for them."""
    chosen = elements["resistor"]
    none = np.zeros(len(netlist.conductance))
    return {
        "voltage source": {"value": _plain(netlist.source_volts, elements["voltage source"])},
        "current source": {"value": _plain(netlist.current_amps, elements["current source"])},
        "resistor": {
            "value": numbers(ohms),
            "tc1": _plain(none if netlist.tc1 is None else netlist.tc1, chosen),
            "tc2": _plain(none if netlist.tc2 is None else netlist.tc2, chosen),
        },
        "nonlinear resistor": {
            "current": _plain(netlist.nonlinear_current, elements["nonlinear resistor"]),
            "voltage": _plain(netlist.nonlinear_voltage, elements["nonlinear resistor"]),
        },
        "capacitor": {"value": _plain(netlist.capacitance, elements["capacitor"])},
    }


def _plain(values: NDArray[np.float64], chosen: NDArray[np.int64]) -> Texts:
    return numbers(values[chosen] + 0.0)  # no minus in front of zero


def _template(netlist: Netlist, rules: Dialect, kind: str, additions: Additions) -> str:
    template: str = getattr(rules, kind.replace(" ", "_"))
    if kind == "resistor":
        if additions.spread:
            template = rules.spread_resistor.replace("{sigma}", repr(additions.spread))
        if any(tc is not None and tc.any() for tc in (netlist.tc1, netlist.tc2)):
            template += rules.temperature_coefficients
    return template + ("{suffix}\n" if additions.suffix.get(kind) else "\n")


def _suffixes(chosen: NDArray[np.int64], suffix: Mapping[int, str]) -> Chosen | bytes:
    if not suffix:
        return b""
    which = {number: i for i, number in enumerate(suffix, start=1)}
    return names(["", *suffix.values()]).take(np.array([which.get(number, 0) for number in chosen.tolist()], np.int64))


def _preamble(
    netlist: Netlist, rules: Dialect, elements: Mapping[str, NDArray[np.int64]], additions: Additions
) -> list[str]:
    lines = list(rules.preamble)
    if elements["nonlinear resistor"].size:
        lines.append(rules.precise)
    if additions.spread:
        coefficients = any(tc is not None and tc.any() for tc in (netlist.tc1, netlist.tc2))
        lines += spread_preamble(rules, additions.spread, temperature=coefficients)
    return lines


def spread_preamble(rules: Dialect, sigma: float, *, temperature: bool = False) -> list[str]:
    """Lines that resistors of random value need in front of them; ``temperature``: whether they have coefficients."""
    defaults, passed = (" tc1=0 tc2=0", " tc1=tc1 tc2=tc2") if temperature else ("", "")
    return [line.format(sigma=repr(sigma), defaults=defaults, passed=passed) for line in rules.spread_preamble]


def _census(rules: Dialect, nodes: NodeNames, elements: Mapping[str, NDArray[np.int64]]) -> str:
    counts = [f"{len(numbers)} {kind}s" for kind, numbers in elements.items() if numbers.size]
    return f"{rules.name} dialect: " + ", ".join([f"{len(nodes.nodes)} nodes besides ground", *counts])


def _left_out_line(netlist: Netlist, elements: Mapping[str, NDArray[np.int64]], left_out: list[str]) -> list[str]:
    dropped = sum(len(getattr(netlist, ENDS[kind])) - len(numbers) for kind, numbers in elements.items())
    if not left_out and not dropped:
        return []
    return [
        f"left out: {len(left_out)} floating nodes (listed in the sidecar), "
        f"{dropped} elements that touch them or close a loop of voltage sources"
    ]


def _default_title(netlist: Netlist) -> str:
    if netlist.cell_map is None:
        return "resistor netlist"
    cells = " x ".join(str(cells) for cells in netlist.cells.space.shape)
    return f"resistor grid of {cells} cells, {netlist.cells.wiring.boundary} boundary"


def tidy_title(title: str) -> str:
    """Make one line of printable ASCII."""
    # Decks are ASCII for the sake of old simulators; the scene keeps the title as it was written.
    tidy = " ".join(title.split()).encode("ascii", "replace").decode("ascii")
    printable = "".join(character if character.isprintable() else "?" for character in tidy)
    return printable[:_MAX_TITLE] or "resistor netlist"
