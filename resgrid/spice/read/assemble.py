"""From collected cards to arrays: title settled, subcircuits expanded, switches set, nodes numbered by first use."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import CircuitError
from resgrid.netlist import Netlist
from resgrid.spice.parsed import KINDS, NOMINAL_TEMPERATURE, LateNames, ParsedDeck, rebase
from resgrid.spice.read.collect import Collector
from resgrid.spice.read.diagnostics import CardError, Journal, Spot
from resgrid.spice.read.files import Source
from resgrid.spice.read.plain import Bulk
from resgrid.spice.read.rules import ReadingRules
from resgrid.spice.read.scopes import Scope
from resgrid.spice.read.subcircuits import Expander
from resgrid.spice.read.tables import WIDTHS, NodeTable, Part, Sheet, joined_parts

_BULK_KINDS = ("resistor", "voltage source", "current source", "capacitor")


def assemble_deck(collector: Collector, source: Source, limit: int | None) -> ParsedDeck:
    """Make the deck of everything that was collected."""
    rules, journal = _ground_rules(collector), collector.journal
    scope = Scope(collector.top, rules)
    table = NodeTable(rules)
    table.of("0", 0)
    sheet = Sheet(table)
    for origin, bulk in collector.bulks:
        _add_bulk(bulk, origin, sheet)
    expander = Expander(rules, journal, frozenset(collector.common))
    expander.check_size(collector.top, limit)
    journal.raise_errors()
    expander.fill(scope, sheet, collector.top.cards)
    journal.raise_errors()
    title = _settle_title(collector, scope, sheet, expander)
    temperatures = _temperatures(collector, scope)
    journal.raise_errors()
    parts = {kind: sheet.joined(kind) for kind in WIDTHS}
    files = tuple(source.name for source in collector.library.sources)
    parts["resistor"] = _with_switches(parts, len(table.names), files, journal)
    journal.raise_errors()
    _note_oddities(parts, table, files, rules, journal)
    return _deck(collector, source, title, parts, table, temperatures, tuple(sorted(expander.used)), files)


def _ground_rules(collector: Collector) -> ReadingRules:
    from dataclasses import replace

    if collector.options.values.get("replaceground") != "true":
        return collector.rules
    return replace(collector.rules, grounds=frozenset({"0", "gnd", "gnd!", "ground"}))


def _temperatures(collector: Collector, scope: Scope) -> tuple[float | None, float | None]:
    found: list[float | None] = []
    for key in ("temp", "tnom"):
        try:
            found.append(collector.options.temperature(key, scope))
        except CardError as error:
            collector.journal.error(error)
            found.append(None)
    return found[0], found[1]


def _add_bulk(bulk: Bulk, source: Source, sheet: Sheet) -> None:
    way = sheet.table.of_all(bulk.node_names, source.number << 40 | bulk.node_line, bulk.short)
    for code, kind in enumerate(_BULK_KINDS):
        chosen = bulk.kind == code
        if not chosen.any():
            continue
        line = bulk.line[chosen]
        place = np.empty((len(line), 2), dtype=np.int64)
        place[:, 0], place[:, 1] = source.number, line
        values = bulk.value[chosen][:, np.newaxis]
        sheet.parts[kind].append(Part(bulk.names(chosen), way[bulk.nodes[chosen]], values, place, None))


def _settle_title(collector: Collector, scope: Scope, sheet: Sheet, expander: Expander) -> str | None:
    """Decide whether a first line that may be an element is one: if it reads as one and is wired to the rest."""
    first = collector.first
    if first is None:
        return collector.title
    trial = Sheet(NodeTable(scope.rules), parts={kind: [] for kind in WIDTHS})
    doubts = Journal()
    Expander(scope.rules, doubts, expander.common).fill(scope, trial, [first])
    reads = not doubts.errors
    grounds = scope.rules.grounds
    wired = any(name in sheet.table.number for name in trial.table.number if name not in grounds)
    if reads and wired:
        expander.fill(scope, sheet, [first])
        collector.journal.note(
            "warning",
            first.spot(),
            "there is no title line: the first line is an element, and is kept; SPICE would take it for the title",
        )
        return collector.title
    if len(first.joins) > 1:
        collector.journal.error(first.error(None, "the first line, a title, is continued (+): a title line is missing"))
    if reads:
        collector.journal.note(
            "warning", first.spot(), "the first line reads like an element, but is wired to nothing: it is the title"
        )
    return first.text.strip()


def _with_switches(parts: dict[str, Part], node_count: int, files: tuple[str, ...], journal: Journal) -> Part:
    """Resistors, with every switch among them as the resistance of its state."""
    switches, resistors = parts["switch"], parts["resistor"]
    if not len(switches.names):
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
    open_question = ~tied | ~(is_on ^ is_off)
    for i in np.flatnonzero(open_question).tolist():
        file, line = switches.place[i].tolist()
        why = (
            f"is controlled by {control[i]:g} V, where it is neither on nor off"
            if tied[i]
            else "is controlled by nodes that no voltage source holds"
        )
        journal.error(CardError(Spot(files[file], line), f"the switch {switches.names.make()[i]} {why}"))
    if inside.any():
        file, line = switches.place[int(np.argmax(inside))].tolist()
        journal.note("warning", Spot(files[file], line), "a switch within its hysteresis is off unless ON is said")
    values = np.zeros((len(on), 6))
    values[:, 0] = np.where(is_on, on, off)
    values[:, 4:] = math.nan
    return joined_parts(
        "resistor",
        [resistors, Part(switches.names, switches.nodes[:, :2], values, switches.place, switches.order)],
    )


def _held_voltages(parts: dict[str, Part], node_count: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Voltage of every node above the root of its tree of voltage sources (and shorts), and that root."""
    from resgrid.nodal.sources import tie_sources

    source, resistor = parts["voltage source"], parts["resistor"]
    short = resistor.values[:, 0] == 0
    nodes = np.concatenate([source.nodes, resistor.nodes[short]])
    volts = np.concatenate([source.values[:, 0], np.zeros(int(short.sum()))])
    netlist = Netlist(node_count, np.empty((0, 2), np.int64), np.empty(0), source_nodes=nodes, source_volts=volts)
    try:
        forest = tie_sources(netlist)
    except CircuitError:
        return np.full(node_count, math.nan), np.arange(node_count)
    return forest.offset, forest.root


def _note_oddities(
    parts: dict[str, Part], table: NodeTable, files: tuple[str, ...], rules: ReadingRules, journal: Journal
) -> None:
    resistor = parts["resistor"]
    zero = np.flatnonzero(resistor.values[:, 0] == 0)
    if zero.size:
        file, line = resistor.place[zero[0]].tolist()
        journal.note(
            "warning",
            Spot(files[file], line),
            "0 ohm is a short (a 0 V source); ngspice takes 1 milliohm",
            len(zero),
        )
    if table.aliases:
        journal.note("info", Spot(files[0], 1), f"the node {', '.join(sorted(table.aliases))} is ground")
    foreign = frozenset({"gnd", "gnd!", "ground"}) - rules.grounds if rules.name == "xyce" else frozenset()
    strangers = sorted(name for name in foreign if name in table.number)
    if strangers:
        journal.note(
            "warning",
            Spot(files[0], 1),
            f"the node {', '.join(strangers)} is not ground in {rules.name}, but is elsewhere",
        )


def _deck(
    collector: Collector,
    source: Source,
    title: str | None,
    parts: dict[str, Part],
    table: NodeTable,
    temperatures: tuple[float | None, float | None],
    subcircuits: tuple[str, ...],
    files: tuple[str, ...],
) -> ParsedDeck:
    way, names = _by_first_use([parts[kind].nodes for kind in KINDS], table.names, bool(collector.bulks))
    resistor = parts["resistor"]
    temperature, nominal = temperatures
    usual = 25.0 if collector.rules.name == "hspice" else NOMINAL_TEMPERATURE
    ohms, tc1, tc2 = _at_nominal(resistor, usual if nominal is None else nominal)
    nodes = {kind: way[parts[kind].nodes] for kind in KINDS}
    return ParsedDeck(
        title=title,
        path=source.name,
        dialect=collector.rules.name,
        node_names=names,
        resistor_nodes=nodes["resistor"],
        resistance=ohms,
        source_nodes=nodes["voltage source"],
        source_volts=parts["voltage source"].values[:, 0].copy(),
        current_nodes=nodes["current source"],
        current_amps=parts["current source"].values[:, 0].copy(),
        capacitor_nodes=nodes["capacitor"],
        capacitance=parts["capacitor"].values[:, 0].copy(),
        element_names=LateNames({kind: parts[kind].names.make for kind in KINDS}),
        place={kind: parts[kind].place for kind in KINDS},
        files=files,
        notes=collector.journal.notes(),
        tc1=tc1,
        tc2=tc2,
        temperature=temperature,
        nominal_temperature=nominal,
        options=dict(collector.options.values),
        subcircuits=subcircuits,
    )


def _by_first_use(
    nodes: list[NDArray[np.int64]], names: list[str], compiled: bool
) -> tuple[NDArray[np.int32], tuple[str, ...]]:
    """Renumber nodes in the order of their first use, ground first; unused ones vanish."""
    used = np.concatenate([np.zeros(1, dtype=np.int64), *(pairs.ravel() for pairs in nodes)])
    if compiled:
        from resgrid.spice.read.kernels import first_uses

        way, order = first_uses(used, len(names))
        return way, tuple(map(names.__getitem__, order.tolist()))
    way = np.full(len(names), -1, dtype=np.int32)
    order = used[np.sort(np.unique(used, return_index=True)[1])]
    way[order] = np.arange(len(order))
    return way, tuple(map(names.__getitem__, order.tolist()))


def _at_nominal(
    part: Part, nominal: float
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Resistances and coefficients, counted from the deck's nominal temperature."""
    if part.values.shape[1] == 1:
        return part.values[:, 0], None, None
    ohms, tc1, tc2, rise, own, own_nominal = part.values.T
    if not (tc1.any() or tc2.any()):
        return ohms.copy(), None, None
    from_point = np.where(np.isnan(own_nominal), nominal, own_nominal)
    fixed = ~np.isnan(own)
    shift = np.where(fixed, own, rise + nominal) - from_point
    ohms, first, second = rebase(ohms.copy(), tc1.copy(), tc2.copy(), shift)
    assert first is not None and second is not None
    first, second = np.where(fixed, 0.0, first), np.where(fixed, 0.0, second)
    return np.ascontiguousarray(ohms), first, second if second.any() else None
