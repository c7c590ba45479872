"""Writer of decks with memristors.

A memristor is two behavioural current sources and a capacitor of 1 F.  The voltage of the capacitor is the state ``x``.
One source carries the current ``i = v / max(R_off - (R_off - R_on) x, R_on)`` between the nodes of the memristor, the
other one charges the capacitor with the drift ``k i f(x) = dx/dt``, with the rate ``k`` in 1/C (negative for reversed
polarity) and the window ``f`` from 0 to 1.  The maximum keeps Newton's method from a division by zero.
With the rectangular window the drift is ``max(min(k i, K (1 - x)), -K x)``, which has no jump: it stops at a limit
within about ``1 / K`` seconds, and leaves the limit as soon as the current reverses.  The gain ``K`` is 1e5 times the
largest possible drift.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Positive
from resgrid.circuit.transients.memristive import memristive_transient
from resgrid.circuit.transients.memristors import MemristiveCircuit, Memristor
from resgrid.circuit.transients.waveforms import drive_at, waveform_corners
from resgrid.errors import InputError
from resgrid.spice.dialects import dialect_named
from resgrid.spice.dialects.record import GROUND_NAME, Dialect
from resgrid.spice.write.files import WrittenDeck, checked_target, write_set
from resgrid.spice.write.flat import (
    Additions,
    choose_elements,
    fill,
    grounded_nodes,
    lines_of,
    one_line_title,
    plain,
    resistances,
)
from resgrid.spice.write.memristive_sidecar import MemristorNames, format_memristive_sidecar
from resgrid.spice.write.names import legal_names, name_elements, name_nodes
from resgrid.spice.write.sidecar import digest

_GAIN = 1e5
"""Ratio of the gain ``K`` of the rectangular window to the largest possible drift of a state, both in 1/s.

In the drift ``dx/dt = max(min(k i, K (1 - x)), -K x)`` the gain stops the state ``x`` at its limits 0 and 1.
"""

_OUTPUTS = 10
"""Number of times, equally spaced from ``stop / 10`` to ``stop``, at which the sidecar holds expected values."""

_STEPS = 1000
"""Number by which the end of the transient is divided for the default of the simulator's longest time step."""


@dataclass(frozen=True, eq=False)
class MemristiveDeck:
    """Text of a deck with memristors, and its names.

    `text`: the deck; `rules`: its dialect; `nodes` (n,): netlist numbers of its nodes without ground; `node_names`
    (n,): their names in the deck; `memristors`: names of the memristors in the deck; `left_out`: numbers of the
    floating nodes and of the memristors that the deck omits, by the keys ``"floating node"`` and ``"memristor"``,
    without zeros.
    """

    text: str
    rules: Dialect
    nodes: NDArray[np.int64]
    node_names: list[str]
    memristors: MemristorNames
    left_out: dict[str, int]


def write_memristive(
    circuit: MemristiveCircuit,
    file: str | os.PathLike[str],
    *,
    stop: Positive,
    dialect: str = "ngspice",
    step: Positive | None = None,
    waveform: ArrayLike | None = None,
    reltol: Positive = 1e-7,
    title: str | None = None,
) -> WrittenDeck:
    r"""Write a deck with memristors, the simulator's commands for its transient, and a sidecar.

    The deck is portable and holds no commands.  ``check_deck(file)`` runs it in ngspice and compares voltages and
    states with those in the sidecar.

    Parameters
    ----------
    circuit : MemristiveCircuit
        The circuit; its capacitors are discharged at time 0.
    file : path-like
        The deck.  ``FILE.json`` and ``FILE.ngspice`` (the dialect's name) are written to the same folder.
    stop : float
        End of the transient, in seconds.
    dialect : {"ngspice", "ltspice", "xyce", "hspice", "spectre"}
        Simulator that will read the deck.
    step : float, optional
        Longest step of the simulator, in seconds; by default ``stop / 1000``.
    waveform : array_like of float, shape (n, 2), optional
        Times in seconds, ascending, and the factors by which all sources are multiplied at these times; linear between
        the times, constant before and after them; written as PWL sources.  By default the factor is 1.
    reltol : float
        Relative tolerance of the simulator, below 1.
    title : str, optional
        First line of the deck, cut at 200 characters; by default a description of the circuit.

    Returns
    -------
    WrittenDeck
        Paths of the files, and the hash of the deck.

    Raises
    ------
    InputError
        If the dialect is unknown, a file cannot be written, or a number is not admissible.
    CircuitError
        If a current source drives a floating part, or voltage sources contradict each other.

    Examples
    --------
    >>> law = rg.circuit.Memristor(on_resistance=100.0, off_resistance=16e3, rate=1e4)
    >>> loop = rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    >>> written = rg.spice.write_memristive(rg.circuit.MemristiveCircuit(loop, law), "one.cir", stop=0.5)
    >>> print(*written.path.read_text().splitlines()[3:6], sep="\n")
    v_node_1 node_1 0 1.0
    * memristors: current, drift of the state, state
    b_node_1 node_1 0 i=v(node_1,0)/max(16000.0-15900.0*v(x_node_1,0),100.0)
    >>> rg.check_deck("one.cir").agrees
    True
    """
    target = checked_target(Path(file))
    longest = stop / _STEPS if step is None else step
    if not longest <= stop:
        raise InputError(f"step = {longest:g} s must be at most stop = {stop:g} s")
    if not reltol < 1:
        raise InputError(f"reltol = {reltol:g} must be below 1; the default is 1e-7")
    deck = format_memristive(circuit, dialect=dialect, title=title, corners=waveform_corners(waveform))
    times = np.linspace(0.0, stop, _OUTPUTS + 1)[1:]
    run = memristive_transient(circuit, times, waveform=waveform, tolerance=1e-7)
    commands = _commands(target.name, deck.rules, stop, longest, reltol)
    suffix = deck.rules.name
    sidecar = format_memristive_sidecar(
        target.name,
        deck.text,
        (suffix, commands),
        run,
        dict(zip(deck.node_names, deck.nodes.tolist(), strict=True)),
        deck.memristors,
    )
    files = write_set(target, deck.text, {suffix: commands, "json": sidecar})
    return WrittenDeck(target, files[suffix], files["json"], digest(deck.text.encode()), left_out=deck.left_out)


def format_memristive(
    circuit: MemristiveCircuit, *, dialect: str, title: str | None, corners: NDArray[np.float64]
) -> MemristiveDeck:
    """Return the deck of a circuit with memristors.

    `dialect`: name of the dialect; `title`: first line, None for a description of the netlist; `corners` (n, 2): times
    in seconds and factors of all sources; the factor is linear between these times and constant before and after them.
    Raise InputError for an unknown dialect or a netlist without grounded nodes.
    """
    rules, netlist = dialect_named(dialect), circuit.netlist
    held = grounded_nodes(netlist)
    names = name_nodes(netlist, rules, held)
    chosen = choose_elements(netlist, held)
    place = np.full(len(netlist.conductance), -1)
    place[circuit.memristors] = np.arange(len(circuit.memristors))
    own = place[chosen["resistor"]]
    chosen["resistor"] = chosen["resistor"][own < 0]
    own = own[own >= 0]
    labels = name_elements(netlist, "resistor", circuit.memristors[own], names)
    states = legal_names([f"x{label[1:]}" for label in labels], "x", {*names, *rules.reserved})
    counts = [f"{len(kept)} {kind}s" for kind, kept in chosen.items() if kept.size] + [f"{len(own)} memristors"]
    nodes = np.flatnonzero(held)[1:]
    lines = [
        f"{rules.comment}{one_line_title(netlist, title)}",
        f"{rules.comment}{rules.name} dialect: " + ", ".join([f"{len(nodes)} nodes besides ground", *counts]),
        *rules.preamble,
    ]
    for kind, kept in chosen.items():
        if not kept.size:
            continue
        columns = {"name": name_elements(netlist, kind, kept, names)}
        if kind == "resistor":
            columns["value"] = plain(resistances(netlist.conductance[kept]))
        written = lines_of(netlist, rules, kind, kept, names, columns, Additions())
        if kind in ("voltage source", "current source"):
            values = netlist.source_volts if kind == "voltage source" else netlist.current_amps
            waves = [_wave(rules, value, corners) for value in values[kept].tolist()]
            written = [line + wave for line, wave in zip(written, waves, strict=True)]
        if kind == "capacitor":
            written = [line + rules.initial_voltage.format(value="0.0") for line in written]
        lines += [f"{rules.comment}{kind}s", *written]
    ends = [[names[node] for node in pair] for pair in netlist.resistor_nodes[circuit.memristors[own]].tolist()]
    memristors = MemristorNames(own, states, ends)
    lines.append(f"{rules.comment}memristors: current, drift of the state, state")
    lines += _memristor_lines(circuit, rules, memristors, [label[1:] for label in labels], _gain(circuit, corners))
    left_out = {"floating node": int(np.count_nonzero(~held)), "memristor": len(circuit.memristors) - len(own)}
    return MemristiveDeck(
        text="\n".join([*lines, *([rules.end] if rules.end else []), ""]),
        rules=rules,
        nodes=nodes,
        node_names=[names[node] for node in nodes.tolist()],
        memristors=memristors,
        left_out={kind: count for kind, count in left_out.items() if count},
    )


def _memristor_lines(
    circuit: MemristiveCircuit, rules: Dialect, memristors: MemristorNames, labels: list[str], gain: float
) -> list[str]:
    """Return the lines of all memristors, three each: current, drift of the state, and capacitor of the state.

    `rules`: dialect; `memristors`: names in the deck; `labels`: for every memristor the text after the first letters in
    the names of its three elements; `gain`: gain ``K`` in 1/s of the terms that stop the drift at the limits 0 and 1 of
    the state ``x``: ``dx/dt = max(min(k i, K (1 - x)), -K x)``.
    """
    law, lines = circuit.law, []
    for number, state, (a, b), label in zip(*memristors, labels, strict=True):
        x = f"v({state},{GROUND_NAME})"
        ohms = f"{law.off_resistance!r}-{law.off_resistance - law.on_resistance!r}*{x}"
        current = f"v({a},{b})/max({ohms},{law.on_resistance!r})"
        drift = _drift(law, f"{float(circuit.polarity[number]) * law.rate!r}*{current}", x, gain)
        start = repr(float(circuit.state[number]))
        columns = {"name": [f"b{label}"], "a": [a], "b": [b], "value": [current]}
        lines += fill(rules.behavioural_current, columns)
        columns = {"name": [f"bx{label}"], "a": [GROUND_NAME], "b": [state], "value": [drift]}
        lines += fill(rules.behavioural_current, columns)
        columns = {"name": [f"cx{label}"], "a": [state], "b": [GROUND_NAME], "value": ["1.0"]}
        lines += [fill(rules.capacitor, columns)[0] + rules.initial_voltage.format(value=start)]
    return lines


def _drift(law: Memristor, speed: str, x: str, gain: float) -> str:
    """Return the expression of the drift of a state, in 1/s.

    `law`: law of the memristor, whose window limits the drift; `speed`: expression of the drift without a window, in
    1/s; `x`: expression of the state; `gain`: gain ``K``, in 1/s.  With a rectangular window, the drift is limited to
    ``K (1 - x)`` upwards and ``K x`` downwards, which stops the state at 1 and 0; other windows do not use the gain.
    """
    if law.window == "rectangular":
        return f"max(min({speed},{gain!r}*(1-{x})),-{gain!r}*{x})"
    away = f"(2*{x}-1)*(2*{x}-1)"
    return f"{speed}*(1-{'*'.join([away] * law.exponent)})"


def _gain(circuit: MemristiveCircuit, corners: NDArray[np.float64]) -> float:
    """Return the gain ``K`` of the drift at the limits of a state, in 1/s: 1e5 times the largest possible drift.

    In the drift ``dx/dt = max(min(k i, K (1 - x)), -K x)`` the gain stops the state ``x`` at its limits 0 and 1.
    `corners` (n, 2): times in seconds and factors of all sources.
    """
    netlist, factor = circuit.netlist, float(np.abs(corners[:, 1]).max()) or 1.0
    amps = np.abs(netlist.source_volts).sum() / circuit.law.on_resistance + np.abs(netlist.current_amps).sum()
    return float(_GAIN * circuit.law.rate * factor * amps) or 1.0


def _wave(rules: Dialect, value: float, corners: NDArray[np.float64]) -> str:
    """Return the text of a waveform at the end of a source's line; empty for a constant source with the factor 1.

    `rules`: dialect; `value`: value of the source for the factor 1, in volts or amperes; `corners` (n, 2): times in
    seconds and factors, linear between these times and constant before and after them.
    """
    if len(corners) == 1 and corners[0, 1] == 1.0:
        return ""
    points = corners if corners[0, 0] == 0.0 else np.vstack([[0.0, drive_at(corners, 0.0).value], corners])
    return rules.piecewise.format(points=" ".join(f"{t!r} {value * w!r}" for t, w in points.tolist()))


def _commands(name: str, rules: Dialect, stop: float, step: float, reltol: float) -> str:
    """Return the text of the file that includes a deck and requests its transient.

    `name`: file name of the deck; `rules`: dialect; `stop`, `step`: end and longest step, in seconds; `reltol`:
    relative tolerance.
    """
    words = rules.statements
    values = {"stop": stop, "step": step, "reltol": reltol}
    values |= {"vntol": 1e-3 * reltol, "abstol": 1e-6 * reltol, "chgtol": 1e-10 * reltol}
    texts = {key: repr(float(value)) for key, value in values.items()}
    include = [rules.include.format(file=name)]
    lines = [
        f"{rules.comment}transient of {name}",
        *(line.format(deck=name, results="transient") for line in words.first),
        *(include if words.deck_first else []),
        *(line.format(**texts) for line in words.charged),
        *([words.print_all.format(kind="tran")] if words.print_all else []),
        *([] if words.deck_first else include),
        *words.last,
    ]
    return "\n".join(lines) + "\n"
