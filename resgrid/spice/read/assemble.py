"""Assembly of a `Circuit` from collected cards (statements): title, subcircuits, switch states, node numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import Netlist
from resgrid.core.networkx_graphs import ELEMENTS
from resgrid.errors import CircuitError
from resgrid.spice.circuit import KINDS, Circuit
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.read.collector import Collector
from resgrid.spice.read.commands import Contents
from resgrid.spice.read.diagnostics import CardError, Diagnostics, Spot
from resgrid.spice.read.element_tables import WIDTHS, ElementArrays, Elements, LazyNames, NodeTable, joined_parts
from resgrid.spice.read.files import SourceFile
from resgrid.spice.read.scopes import Scope
from resgrid.spice.read.subcircuits import Expander


def assemble_deck(collector: Collector, source: SourceFile, limit: int | None) -> Circuit:
    """Return the circuit of the collected cards.

    `collector`: the cards (statements of the deck); `source`: file of the deck; `limit`: maximum number of elements
    after the expansion of subcircuits, None for a limit that grows with the number of cards.  Raises DeckError with all
    errors of the deck, and BudgetError if the circuit has more elements than the limit.
    """
    contents, diagnostics = collector.contents, collector.contents.diagnostics
    scope = Scope(contents.top, diagnostics, built_ins=contents.built_ins())
    temperature, nominal = (contents.temperature(key, scope) for key in ("temp", "tnom"))
    usual = DIALECTS[contents.rules.name].nominal_temperature
    reference = usual if nominal is None else nominal
    expander = Expander(contents, reference, (usual if temperature is None else temperature) - reference)
    elements = expander.elements()
    elements.nodes.number_of("0", 0)
    for plain in collector.plain:
        plain.add_to(elements)
    expander.check_size(limit)
    diagnostics.raise_errors()
    expander.fill(scope, elements, contents.top.cards)
    diagnostics.raise_errors()
    _resolve_title(contents, scope, elements, expander)
    diagnostics.raise_errors()
    parts = {kind: elements.joined(kind) for kind in WIDTHS}
    files = tuple(source.name for source in collector.library.sources)
    parts["resistor"] = _with_switches(parts, len(elements.nodes.names), files, diagnostics)
    diagnostics.raise_errors()
    _note_zero_ohms_and_grounds(parts, elements.nodes, files, contents)
    numbers, names = _by_first_use([parts[kind].nodes for kind in KINDS], elements.nodes.names)
    ohms, *coefficients = np.hsplit(parts["resistor"].values, (1, 2))
    tc1, tc2 = (column[:, 0].copy() if column.any() else None for column in coefficients)
    columns: dict[str, Any] = {"resistance": ohms[:, 0].copy(), "tc1": tc1, "tc2": tc2}
    columns["is_inductor"] = parts["voltage source"].values[:, 1:].any(axis=1)
    for kind, (ends, values) in ELEMENTS.items():
        columns[ends] = numbers[parts[kind].nodes]
        if kind != "resistor":
            columns |= {name: parts[kind].values[:, i].copy() for i, name in enumerate(values.values())}
    return Circuit(
        title=contents.title,
        path=source.name,
        dialect=contents.rules.name,
        node_names=names,
        element_names=LazyNames({kind: parts[kind].names for kind in KINDS}),
        place={kind: parts[kind].place for kind in KINDS},
        files=files,
        notes=diagnostics.notes(),
        temperature=temperature,
        nominal_temperature=nominal,
        options=dict(contents.options),
        subcircuits=tuple(sorted(expander.used)),
        **columns,
    )


def _resolve_title(contents: Contents, scope: Scope, elements: Elements, expander: Expander) -> None:
    """Add the first line of the deck as an element to `elements`, or set it as the title of the deck.

    The first line is an element if it can be read as one and shares a node other than ground with the other elements.
    Nothing is done unless the collected content holds a first line that may be an element.  `contents`: content of the
    deck; `scope`: parameter values of the deck; `elements`: all elements of the other lines; `expander`: expander of
    the subcircuits of the deck.
    """
    first, diagnostics = contents.first, contents.diagnostics
    if first is None:
        return
    trial_diagnostics = Diagnostics()
    trial = expander.elements()
    alone = Scope(contents.top, trial_diagnostics, built_ins=contents.built_ins())
    Expander(contents, expander.nominal, expander.heating).fill(alone, trial, [first])
    reads = not trial_diagnostics.errors
    wired = any(name in elements.nodes.number for name in trial.nodes.number if name not in contents.grounds)
    if reads and wired:
        expander.fill(scope, elements, [first])
        diagnostics.warn(
            first.spot(),
            "there is no title line: the first line is read as an element; SPICE would take it for the title",
        )
        return
    if len(first.joins) > 1:
        diagnostics.error(first.error(None, "the first line, a title, is continued (+): a title line is missing"))
    if reads:
        diagnostics.warn(
            first.spot(),
            "the first line looks like an element, but shares no node with the rest: it is read as the title",
        )
    contents.title = first.text.strip()


def _with_switches(
    parts: dict[str, ElementArrays], node_count: int, files: tuple[str, ...], diagnostics: Diagnostics
) -> ElementArrays:
    """Return the resistors and the switches as one array of resistors; a switch has its on or its off resistance.

    The state of a switch follows from the voltage between its control nodes, which voltage sources must fix.  `parts`:
    elements by kind, such as ``"resistor"`` or ``"switch"``; `node_count`: number of nodes; `files`: names of the
    files, for messages; `diagnostics`: receives an error for every switch whose state is not determined.
    """
    switches, resistors = parts["switch"], parts["resistor"]
    if not len(switches):
        return resistors
    volts = _held_voltages(parts, node_count)
    control = volts[0][switches.nodes[:, 2]] - volts[0][switches.nodes[:, 3]]
    tied = volts[1][switches.nodes[:, 2]] == volts[1][switches.nodes[:, 3]]
    on, off, upper, lower, between = switches.values.T
    is_on = np.where(upper >= lower, control > upper, control < upper)
    is_off = np.where(upper >= lower, control < lower, control > lower)
    rising = upper > lower
    inside = rising & (control > lower) & (control < upper) & ~np.isnan(between)
    is_on |= inside & (between == 1)
    is_off |= inside & (between == 0)
    undecided = ~tied | ~(is_on ^ is_off)
    for i in np.flatnonzero(undecided).tolist():
        file, line = switches.place[i].tolist()
        why = (
            f"is controlled by {control[i]:g} V, where it is neither on nor off"
            if tied[i]
            else "is controlled by nodes that no voltage source holds"
        )
        diagnostics.error(CardError(Spot(files[file], line), f"the switch {switches.names()[i]} {why}"))
    if inside.any():
        file, line = switches.place[int(np.argmax(inside))].tolist()
        diagnostics.warn(Spot(files[file], line), "a switch within its hysteresis is off unless its card has ON")
    values = np.where(is_on, on, off)[:, np.newaxis]
    settled = ElementArrays(switches.names, switches.nodes[:, :2], values, switches.place, switches.order)
    return joined_parts("resistor", [resistors, settled])


def _held_voltages(parts: dict[str, ElementArrays], node_count: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the voltage of every node relative to a root node, in volts, and the number of that root; shapes (nodes,).

    Voltage sources and resistors of 0 ohm connect nodes to trees, and each tree has one root.  `parts`: elements by
    kind, such as ``"voltage source"``; `node_count`: number of nodes.  If the sources contradict each other, all
    voltages are NaN.
    """
    from resgrid.circuit.sources import tie_sources

    source, resistor = parts["voltage source"], parts["resistor"]
    short = resistor.values[:, 0] == 0
    nodes = np.concatenate([source.nodes, resistor.nodes[short]])
    volts = np.concatenate([source.values[:, 0], np.zeros(int(short.sum()))])
    netlist = Netlist(node_count, np.empty((0, 2), np.int64), np.empty(0), source_nodes=nodes, source_volts=volts)
    try:
        forest = tie_sources(netlist)
    except CircuitError:
        return np.full(node_count, np.nan), np.arange(node_count)
    return forest.offsets[0], forest.root


def _note_zero_ohms_and_grounds(
    parts: dict[str, ElementArrays], nodes: NodeTable, files: tuple[str, ...], contents: Contents
) -> None:
    """Add warnings about resistors of 0 ohm, and notes about node names that are, or look like, names of ground.

    `parts`: elements by kind, such as ``"resistor"``; `nodes`: table of the nodes; `files`: names of the files, for
    messages; `contents`: content of the deck, which receives the notes.
    """
    resistor, diagnostics, top = parts["resistor"], contents.diagnostics, Spot(files[0], 1)
    zero = np.flatnonzero(resistor.values[:, 0] == 0)
    if zero.size:
        file, line = resistor.place[zero[0]].tolist()
        diagnostics.warn(
            Spot(files[file], line), "0 ohm is a short (a 0 V source); ngspice takes 1 milliohm", len(zero)
        )
    if nodes.aliases:
        diagnostics.inform(top, f"the node {', '.join(sorted(nodes.aliases))} is ground")
    lookalikes = sorted(name for name in contents.rules.no_grounds - contents.grounds if name in nodes.number)
    if lookalikes:
        diagnostics.warn(
            top, f"the node {', '.join(lookalikes)} is not ground in {contents.rules.name}, but is elsewhere"
        )


def _by_first_use(nodes: list[NDArray[np.int64]], names: list[str]) -> tuple[NDArray[np.int32], tuple[str, ...]]:
    """Return the new number of every node in the order of first use, -1 if unused, and the node names in the new order.

    `nodes`: old node numbers of the elements, one array (elements, nodes per element) per kind; node 0 (ground) stays
    first; `names`: names by old number.  The new numbers have the shape (old nodes,).
    """
    used = np.concatenate([np.zeros(1, dtype=np.int64), *(ends.ravel() for ends in nodes)])
    first = np.full(len(names), -1, dtype=np.int64)
    first[used[::-1]] = np.arange(len(used))[::-1]  # the last assignment to an entry counts
    is_first = np.zeros(len(used), dtype=np.bool_)
    is_first[first[first >= 0]] = True
    order = used[is_first]
    number = np.full(len(names), -1, dtype=np.int32)
    number[order] = np.arange(len(order))
    return number, tuple(map(names.__getitem__, order.tolist()))
