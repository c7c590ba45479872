"""Writer of analyses: waveforms of sources, elements that change the circuit during a transient, and statements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.networkx_graphs import ELEMENTS
from resgrid.errors import InputError
from resgrid.spice.analyses import (
    Analysis,
    Measure,
    MismatchAnalysis,
    NoiseAnalysis,
    OperatingAnalysis,
    Probe,
    TemperatureAnalysis,
    TransientAnalysis,
    kind_of,
)
from resgrid.spice.dialects.record import GROUND_NAME, Dialect, Statements
from resgrid.spice.write.flat import Additions, FlatDeck

_KIND_WORDS: dict[type[Analysis], str] = {
    OperatingAnalysis: "dc",
    TransientAnalysis: "tran",
    NoiseAnalysis: "",
    TemperatureAnalysis: "dc",
    MismatchAnalysis: "dc",
}
"""Word for each kind of analysis in statements that save or print results (``tran``, ...).

The word of a noise analysis is empty, because it needs no such statement.
"""
_SAME_NODES, _SAME_VALUES = ("resistor", "voltage source"), ("capacitor", "nonlinear resistor")
"""Kinds of element of which a transient may change the values only, and kinds of which it may not change anything."""


def only_one(analyses: Sequence[Analysis], kind: type[Analysis]) -> Any:
    """Return the analysis of class `kind`, None if `analyses` has none; raise InputError if `analyses` has several."""
    own = [analysis for analysis in analyses if isinstance(analysis, kind)]
    if len(own) > 1:
        raise InputError(
            f"analyses holds {len(own)} of the kind {kind.__name__}, but a deck holds at most one of each kind; "
            "write a deck for each"
        )
    return own[0] if own else None


def additions(analyses: Sequence[Analysis], netlist: Netlist, rules: Dialect) -> Additions:
    """Return the changes of a deck's lines that analyses require: waveforms, AC sources and random resistors.

    `netlist`: the netlist of the deck; `rules`: the dialect of the deck.  Raises InputError if a transient analysis has
    a second circuit, `after`, that differs from the netlist in more than the values of resistors and sources.
    """
    suffix: dict[int, str] = {}
    transient: TransientAnalysis | None = only_one(analyses, TransientAnalysis)
    if transient is not None and transient.after is not None:
        _check_alike(netlist, transient.after)
        volts = dict(zip(_ends(transient.after, "voltage source"), transient.after.source_volts.tolist(), strict=True))
        before = zip(_ends(netlist, "voltage source"), netlist.source_volts.tolist(), strict=True)
        for source, (ends, low) in enumerate(before):
            if volts[ends] != low:
                points = f"0.0 {low!r} {transient.step!r} {volts[ends]!r}"
                suffix[source] = rules.piecewise.format(points=points)
    first = "" if only_one(analyses, NoiseAnalysis) is None else rules.small_signal
    mismatch: MismatchAnalysis | None = only_one(analyses, MismatchAnalysis)
    return Additions(suffix, first, 0.0 if mismatch is None else mismatch.sigma)


def _check_alike(before: Netlist, after: Netlist) -> None:
    """Raise InputError unless two netlists differ at most in the values of resistors, voltage and current sources.

    Resistors and voltage sources must lie between the same nodes; capacitors and nonlinear resistors must be equal.
    `before, after`: netlists before and after the change of a scene; their current sources are not compared.
    """
    for kind in (*_SAME_NODES, *_SAME_VALUES):
        for key in ELEMENTS[kind][1]:
            a, b = (_sums(netlist, kind, key) for netlist in (before, after))
            if a.keys() != b.keys() or (kind in _SAME_VALUES and a != b):
                raise InputError(
                    f"the scene after the change differs from the scene before in its {kind}s, not only in values: use "
                    "the same grid for both, and write them in tile form (form='cells')"
                )


def _ends(netlist: Netlist, kind: str) -> list[tuple[str, str]]:
    """Return the names of both nodes of every element of a kind, in the order of the elements."""
    first, second = getattr(netlist, ELEMENTS[kind][0]).T
    return list(zip(netlist.names_of(first), netlist.names_of(second), strict=True))


def _sums(netlist: Netlist, kind: str, key: str) -> dict[tuple[str, str], float]:
    """Return the sum of a value over parallel elements of a kind, by the names of their two nodes.

    `kind`: kind of element, such as ``"resistor"``; `key`: name of the value, such as ``"conductance"`` or ``"tc1"``.
    The key of an entry is a pair of node names.  The result is empty if the netlist does not have the value, such as
    temperature coefficients.
    """
    values = getattr(netlist, ELEMENTS[kind][1][key])
    total: dict[tuple[str, str], float] = {}
    if values is not None:
        for ends, value in zip(_ends(netlist, kind), values.tolist(), strict=True):
            total[ends] = total.get(ends, 0.0) + value
    return total


def format_commands(name: str, deck: FlatDeck, requested: Sequence[Analysis]) -> str:
    """Return the text of the file that includes a deck and requests analyses.

    `name`: file name of the deck; `requested`: the analyses, empty for the operating point.  Raises InputError for
    analyses that name nodes or sources that the deck does not have, and for several analyses if the dialect allows only
    one in a file.
    """
    analyses = requested or [OperatingAnalysis()]
    heading = "analyses" if requested else "operating point"
    rules, words = deck.dialect, deck.dialect.statements
    _check_names(deck, analyses)
    runs = [kind_of(item) for item in analyses if type(item) in _KIND_WORDS]
    if words.one_a_run and len(runs) > 1:
        raise InputError(f"{rules.name} runs one analysis per file, not {' and '.join(runs)}; write a deck for each")
    include = [rules.include.format(file=name)]
    statements = [line for analysis in analyses for line in _statement(words, name, deck, analysis)]
    if ".control" in statements and any(line.startswith(".o") for line in statements):
        statements += words.run  # a control block disables ngspice's other analyses, so a further block starts them
    lines = [
        f"{rules.comment}{heading} of {name}",
        *(line.format(deck=name, results=heading.replace(" ", "_")) for line in words.first),
        *(include if words.deck_first else []),
        *_change(deck, only_one(analyses, TransientAnalysis)),
        *_probes(words, analyses),
        *statements,
        *_measures(words, analyses),
        *([] if words.deck_first else include),
        *words.last,
    ]
    return "\n".join(lines) + "\n"


def _check_names(deck: FlatDeck, analyses: Sequence[Analysis]) -> None:
    """Raise InputError if analyses name nodes or sources that are not in the deck.

    A measurement without a transient analysis and a noise analysis without a voltage source raise InputError, too.
    """
    if only_one(analyses, TransientAnalysis) is None and any(isinstance(item, Measure) for item in analyses):
        raise InputError("measure: a measurement needs a transient; add a TransientAnalysis")
    if only_one(analyses, NoiseAnalysis) is not None and not deck.source_names:
        raise InputError("noise: the analysis needs a voltage source as its input, but the deck has none; add one")
    nodes, sources = set(deck.node_names), set(deck.source_names)
    for analysis in analyses:
        requested = analysis.nodes if isinstance(analysis, Probe) else ()
        if isinstance(analysis, NoiseAnalysis | Measure):
            requested = (analysis.node,)
        missing = [name for name in requested if name not in nodes]
        missing += [name for name in getattr(analysis, "sources", ()) if name not in sources]
        if missing:
            raise InputError(
                f"{kind_of(analysis)}: the deck has no node or voltage source {missing[0]!r}; "
                f"examples of its names: {', '.join([*deck.node_names[:3], *deck.source_names[:3]])}"
            )


def _statement(words: Statements, name: str, deck: FlatDeck, analysis: Analysis) -> list[str]:
    """Return the lines that request an analysis, an empty list for a `Probe` or a `Measure`, which only select results.

    `words`: statement templates of the dialect; `name`: file name of the deck; `deck`: the deck; `analysis`: the
    analysis.
    """
    if type(analysis) not in _KIND_WORDS:
        return []
    values: dict[str, Any] = {"deck": name, **_first_source(deck)}
    for key in fields(analysis):
        value = getattr(analysis, key.name)
        values[key.name] = (
            repr(float(value)) if key.type == "float" else value
        )  # integers, e.g. of points, are written without a decimal point
    if isinstance(analysis, TemperatureAnalysis):
        values["temperatures"] = " ".join(repr(float(value)) for value in analysis.celsius)
        values["count"] = len(analysis.celsius)
    if isinstance(analysis, MismatchAnalysis):
        values["numbers"] = " ".join(map(str, range(1, analysis.runs + 1)))
    templates: tuple[str, ...] = getattr(words, kind_of(analysis))
    return [template.format(**values) for template in templates]


def _first_source(deck: FlatDeck) -> dict[str, str]:
    """Return name and voltage of the voltage source with the lowest netlist index, for sweep and noise statements.

    The keys of the dict are ``source`` (name) and ``volts`` (as text); both values are empty texts if the deck has no
    voltage source.
    """
    if not deck.source_names:
        return {"source": "", "volts": ""}
    number = int(np.argmin(deck.sources))
    volts = float(deck.netlist.source_volts[deck.sources[number]])
    return {"source": deck.source_names[number], "volts": repr(volts)}


def _probes(words: Statements, analyses: Sequence[Analysis]) -> list[str]:
    """Return the statements that save the voltages and currents that the `Probe` entries of `analyses` name.

    Without a `Probe` entry, these are the statements that print all voltages.  `words`: statement templates of the
    dialect; `analyses`: the requested analyses.
    """
    kinds = list(dict.fromkeys(kind for item in analyses if (kind := _KIND_WORDS.get(type(item), ""))))
    saved: list[str] = []
    for probe in analyses:
        if isinstance(probe, Probe):
            saved += [words.probe_voltage.format(name=name) for name in probe.nodes]
            saved += [words.probe_current.format(name=name) for name in probe.sources]
    if not saved:
        return [words.print_all.format(kind=kind) for kind in kinds if words.print_all]
    return list(dict.fromkeys(words.probe.format(kind=kind, what=" ".join(saved)) for kind in kinds or ["dc"]))


def _measures(words: Statements, analyses: Sequence[Analysis]) -> list[str]:
    """Return the statements for every `Measure` in `analyses`; `words`: statement templates of the dialect."""
    lines = [
        getattr(words, item.what).format(name=item.name, node=item.node, at=None if item.at is None else float(item.at))
        for item in analyses
        if isinstance(item, Measure)
    ]
    return [*words.measure_first, *lines, *words.measure_last] if lines else []


def _change(deck: FlatDeck, transient: TransientAnalysis | None) -> Iterator[str]:
    """Yield the lines of the elements that change the circuit within the first step of a transient analysis.

    Every resistor that changes gets a parallel current source of ``(g_after - g_before) V`` times a ramp from 0 to 1,
    with the conductances ``g`` and the voltage ``V`` of the resistor; it carries current in the direction of ``V``.  A
    node whose injected current changes gets a current source of the difference times that ramp.  `deck`: the deck
    before the change; `transient`: the analysis, whose `after` is the circuit after the change; None, or an analysis
    without `after`, gives no lines.
    """
    if transient is None or transient.after is None:
        return
    rules, before, after = deck.dialect, deck.netlist, transient.after
    names = dict(zip(before.names_of(deck.nodes), deck.node_names, strict=True))
    names[before.node_name(GROUND)] = GROUND_NAME
    wave = rules.piecewise.format(points=f"0.0 0.0 {transient.step!r} 1.0")
    yield f"{rules.comment}the change of the scene"
    yield rules.voltage_source.format(name="v_scene_step", a="scene_step", b=GROUND_NAME, value="0.0") + wave
    step = f"v(scene_step,{GROUND_NAME})"
    siemens = _sums(after, "resistor", "conductance")
    for number, ((first, second), value) in enumerate(_sums(before, "resistor", "conductance").items()):
        difference = siemens[first, second] - value
        if difference and first in names and second in names:
            a, b = names[first], names[second]
            current = f"({difference!r})*v({a},{b})*{step}"
            yield rules.behavioural_current.format(name=f"b_scene_{number}", a=a, b=b, value=current)
    injected = _injected(after)
    for node, amps in _injected(before).items():
        difference = injected[node] - amps
        if difference and names.get(node, GROUND_NAME) != GROUND_NAME:
            name, current = f"b_drive_{names[node]}", f"({difference!r})*{step}"
            yield rules.behavioural_current.format(name=name, a=GROUND_NAME, b=names[node], value=current)


def _injected(netlist: Netlist) -> dict[str, float]:
    """Return the net current that current sources inject into every node, in amperes, by the name of the node."""
    count = netlist.node_count
    into, out = (np.bincount(netlist.current_nodes[:, end], netlist.current_amps, count) for end in (1, 0))
    return dict(zip(netlist.names_of(np.arange(count)), (into - out).tolist(), strict=True))
