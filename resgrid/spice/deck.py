"""From a netlist to the text of a flat deck."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import CircuitError, InputError
from resgrid.netlist import GROUND, Netlist
from resgrid.spice.dialects import Dialect, dialect_named
from resgrid.spice.names import legal_names
from resgrid.spice.rules import connected_parts, trapped_current_sources

_MAX_TITLE = 200
_INITIAL = {"resistor": "r", "voltage source": "v", "current source": "i", "capacitor": "c"}


@dataclass(frozen=True, eq=False)
class FlatDeck:
    """A deck's text, and what ties its names to the netlist.

    Attributes
    ----------
    netlist : Netlist
        What was written.
    text : str
        The deck, LF line ends.
    dialect : Dialect
        Whose rules it keeps.
    title : str
        Its title, one line of ASCII.
    nodes : ndarray of int64, shape (n,)
        Nodes of the netlist that the deck holds, ascending, without ground.
    node_names : list of str
        Their names in the deck.
    sources : ndarray of int64, shape (s,)
        Voltage sources of the netlist that the deck holds, in its order.
    source_names : list of str
        Their names in the deck.
    left_out : list of str
        Names (the netlist's) of the nodes that float and are left out.
    renamed_nodes, renamed_elements : mapping of str to str
        Name in the deck to name in the netlist, where they differ.
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


def flatten(netlist: Netlist, *, dialect: str = "ngspice", title: str | None = None) -> FlatDeck:
    """Write a netlist as a flat deck; as `format_deck`, with the names that were used.

    Parameters
    ----------
    netlist : Netlist
    dialect : str
    title : str, optional

    Returns
    -------
    FlatDeck

    Raises
    ------
    InputError, CircuitError
        As `format_deck`.
    """
    rules = dialect_named(dialect)
    held = _held_nodes(netlist)
    names, nodes = _node_names(netlist, rules, held)
    elements = _choose_elements(netlist, held)
    element_names = _element_names(netlist, elements, names)
    heading = _tidy_title(_default_title(netlist) if title is None else title)
    left_out = netlist.names_of(np.flatnonzero(~held))
    lines = [
        f"* {heading}",
        "* " + _census(rules, nodes, elements),
        *_left_out_line(netlist, elements, left_out),
        *_element_lines(netlist, rules, elements, element_names, names),
        rules.end,
    ]
    return FlatDeck(
        netlist=netlist,
        text="\n".join(lines) + "\n",
        dialect=rules,
        title=heading,
        nodes=nodes,
        node_names=[names[node] for node in nodes.tolist()],
        sources=elements["voltage source"],
        source_names=element_names["voltage source"],
        left_out=left_out,
        renamed_nodes=_renamed(names, netlist, nodes),
        renamed_elements=_renamed_elements(netlist, elements, element_names),
    )


def resistances(conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Resistances whose reciprocals are the given conductances, to the last bit where one exists.

    Of the candidates within one unit in the last place of ``1 / conductance``, and that value rounded to 12 digits
    (which gives 3300.0 back where 3300.0 was meant), the first whose reciprocal is exact is taken.

    Parameters
    ----------
    conductance : ndarray of float64, shape (m,)
        In siemens.

    Returns
    -------
    ndarray of float64, shape (m,)
        In ohms.
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


def _held_nodes(netlist: Netlist) -> NDArray[np.bool_]:
    part = connected_parts(netlist)
    trapped = trapped_current_sources(netlist, part)
    if trapped.size:
        where = netlist.names_of(netlist.current_nodes[trapped[0]])
        raise CircuitError(
            f"current source {trapped[0]} from node {where[0]} to node {where[1]} feeds a floating part that lets no "
            "current out: remove it, or join the part to ground"
        )
    held: NDArray[np.bool_] = part == part[GROUND]
    if held.sum() < 2:
        raise InputError("nothing is left to write: no node has a path of resistors or voltage sources to ground")
    return held


def _node_names(netlist: Netlist, rules: Dialect, held: NDArray[np.bool_]) -> tuple[list[str], NDArray[np.int64]]:
    nodes = np.flatnonzero(held)
    nodes = nodes[nodes != GROUND]
    legal = legal_names(netlist.names_of(nodes), "n", rules.reserved)
    names = [""] * netlist.node_count
    names[GROUND] = rules.ground
    for node, name in zip(nodes.tolist(), legal, strict=True):
        names[node] = name
    return names, nodes


def _choose_elements(netlist: Netlist, held: NDArray[np.bool_]) -> dict[str, NDArray[np.int64]]:
    """Numbers of the elements that the deck holds, per kind, in the order of their nodes and values."""
    from resgrid.nodal.sources import tie_sources

    with np.errstate(over="ignore"):
        if np.isinf(1 / netlist.conductance).any():
            raise InputError("a resistance is beyond the largest number; leave that resistor out: it is open")
    parents = tie_sources(netlist).parent_source
    keeps_source = np.zeros(len(netlist.source_volts), dtype=np.bool_)
    keeps_source[parents[parents >= 0]] = True
    return {
        "voltage source": _sorted(netlist.source_nodes, netlist.source_volts, held, keeps_source),
        "current source": _sorted(netlist.current_nodes, netlist.current_amps, held),
        "resistor": _sorted(netlist.resistor_nodes, -netlist.conductance, held),
        "capacitor": _sorted(netlist.capacitor_nodes, netlist.capacitance, held),
    }


def _sorted(
    ends: NDArray[np.int64],
    value: NDArray[np.float64],
    held: NDArray[np.bool_],
    keep: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    kept = held[ends].all(axis=1) if keep is None else held[ends].all(axis=1) & keep
    numbers = np.flatnonzero(kept)
    first, second = ends[numbers].T
    return numbers[np.lexsort((value[numbers], second, first))]


def _element_names(
    netlist: Netlist, elements: Mapping[str, NDArray[np.int64]], names: list[str]
) -> dict[str, list[str]]:
    """Names in the deck: the file's where there are any, otherwise from the place."""
    labels = [name.removeprefix("n_") for name in names]
    labels[GROUND] = ""
    given = netlist.element_names or {}
    result = {}
    for kind, numbers in elements.items():
        initial = _INITIAL[kind]
        if kind in given:
            read = [given[kind][number] for number in numbers.tolist()]
            wanted = [name if name[:1].lower() == initial else f"{initial}_{name}" for name in read]
        else:
            ends = _ends(netlist, kind)[numbers].tolist()
            wanted = _place_names(kind, initial, ends, labels)
        result[kind] = legal_names(wanted, initial)
    return result


def _place_names(kind: str, initial: str, ends: list[list[int]], labels: list[str]) -> list[str]:
    if kind == "resistor":
        return [f"r_{labels[a]}_{labels[b]}" if a and b else f"r_{labels[a or b]}" for a, b in ends]
    if kind == "current source":
        return [f"i_{labels[b or a]}" for a, b in ends]
    return [f"{initial}_{labels[a]}_{labels[b]}" if a and b else f"{initial}_{labels[a or b]}" for a, b in ends]


def _ends(netlist: Netlist, kind: str) -> NDArray[np.int64]:
    return {
        "resistor": netlist.resistor_nodes,
        "voltage source": netlist.source_nodes,
        "current source": netlist.current_nodes,
        "capacitor": netlist.capacitor_nodes,
    }[kind]


def _element_lines(
    netlist: Netlist,
    rules: Dialect,
    elements: Mapping[str, NDArray[np.int64]],
    element_names: Mapping[str, list[str]],
    names: list[str],
) -> list[str]:
    lines: list[str] = []
    for kind, template, values in (
        ("voltage source", rules.voltage_source, netlist.source_volts),
        ("current source", rules.current_source, netlist.current_amps),
        ("resistor", rules.resistor, resistances(netlist.conductance)),
        ("capacitor", rules.capacitor, netlist.capacitance),
    ):
        numbers = elements[kind]
        if not numbers.size:
            continue
        first, second = _ends(netlist, kind)[numbers].T.tolist()
        numbered = zip(element_names[kind], first, second, (values[numbers] + 0.0).tolist(), strict=True)
        block = [template % (name, names[a], names[b], value) for name, a, b, value in numbered]
        if kind == "resistor":
            block = _with_temperature(block, netlist, rules, numbers)
        lines += [f"* {kind}s", *block]
    return lines


def _with_temperature(block: list[str], netlist: Netlist, rules: Dialect, numbers: NDArray[np.int64]) -> list[str]:
    none = np.zeros(len(netlist.conductance))
    tc1 = none if netlist.tc1 is None else netlist.tc1
    tc2 = none if netlist.tc2 is None else netlist.tc2
    if not (tc1.any() or tc2.any()):
        return block
    pairs = zip(block, (tc1[numbers] + 0.0).tolist(), (tc2[numbers] + 0.0).tolist(), strict=True)
    return [line + rules.temperature_coefficients % (a, b) for line, a, b in pairs]


def _census(rules: Dialect, nodes: NDArray[np.int64], elements: Mapping[str, NDArray[np.int64]]) -> str:
    counts = [f"{len(numbers)} {kind}s" for kind, numbers in elements.items() if numbers.size]
    return f"{rules.name} dialect: " + ", ".join([f"{len(nodes)} nodes besides ground", *counts])


def _left_out_line(netlist: Netlist, elements: Mapping[str, NDArray[np.int64]], left_out: list[str]) -> list[str]:
    dropped = sum(len(_ends(netlist, kind)) - len(numbers) for kind, numbers in elements.items())
    if not left_out and not dropped:
        return []
    return [
        f"* left out: {len(left_out)} floating nodes (listed in the sidecar), "
        f"{dropped} elements that touch them or close a loop of voltage sources"
    ]


def _default_title(netlist: Netlist) -> str:
    if netlist.layout is None:
        return "resistor netlist"
    cells = " x ".join(str(cells) for cells in netlist.layout.space.shape)
    return f"resistor grid of {cells} cells, {netlist.layout.boundary} boundary"


def _tidy_title(title: str) -> str:
    # Decks are ASCII for the sake of old simulators; the scene keeps the title as it was written.
    tidy = " ".join(title.split()).encode("ascii", "replace").decode("ascii")
    printable = "".join(character if character.isprintable() else "?" for character in tidy)
    return printable[:_MAX_TITLE] or "resistor netlist"


def _renamed(names: list[str], netlist: Netlist, nodes: NDArray[np.int64]) -> dict[str, str]:
    originals = netlist.names_of(nodes)
    return {
        names[node]: original
        for node, original in zip(nodes.tolist(), originals, strict=True)
        if names[node] != original
    }


def _renamed_elements(
    netlist: Netlist, elements: Mapping[str, NDArray[np.int64]], element_names: Mapping[str, list[str]]
) -> dict[str, str]:
    given = netlist.element_names or {}
    return {
        name: given[kind][number]
        for kind in given
        for name, number in zip(element_names[kind], elements[kind].tolist(), strict=True)
        if name != given[kind][number]
    }
