"""Reader of KiCad's SPICE netlist, and net voltages of extracted circuits, solved by resgrid or by ngspice."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.hardware.comparison import Label, Pad, match_nets, pads_of
from resgrid.hardware.record import GROUND, HardwareRecord
from resgrid.spice.read.deck import read_spice
from resgrid.spice.run.ngspice import SimulatorRun, simulate


@dataclass(frozen=True)
class SpiceNetlist:
    """Content of KiCad's SPICE netlist of a schematic.

    `text`: the netlist; `nets`: name of the node of every pad of its resistors, by reference and pad number from 1;
    `values`: resistance in ohms by reference; `sources`: names of the plus and the minus node, and volts, of every
    voltage source.
    """

    text: str
    nets: Mapping[Pad, str]
    values: Mapping[str, float]
    sources: tuple[tuple[str, str, float], ...]


def read_kicad_spice(text: str) -> SpiceNetlist:
    """Return the resistors and sources of KiCad's SPICE netlist; raise InputError for a text that is not a deck."""
    circuit = read_spice(io.StringIO(text), dialect="ngspice").netlist()
    nodes: Sequence[str] = circuit.names_of(np.arange(circuit.node_count))
    names: Sequence[str] = (circuit.element_names or {}).get("resistor", ())
    nets: dict[Pad, str] = {}
    values: dict[str, float] = {}
    for name, ends, conductance in zip(
        names, circuit.resistor_nodes.tolist(), circuit.conductance.tolist(), strict=True
    ):
        reference = name.upper()
        values[reference] = 1.0 / conductance
        nets |= {(reference, number): nodes[node] for number, node in enumerate(ends, 1)}
    sources = tuple(
        (nodes[plus], nodes[minus], volts)
        for (plus, minus), volts in zip(circuit.source_nodes.tolist(), circuit.source_volts.tolist(), strict=True)
    )
    return SpiceNetlist(text, nets, values, sources)


def simulate_kicad_spice(
    record: HardwareRecord, netlist: SpiceNetlist, timeout: float
) -> tuple[dict[str, float], SimulatorRun]:
    """Return the voltages in volts that ngspice computes for KiCad's SPICE netlist, by net of the record, and the run.

    The record's sources, and its closed jumpers as sources of 0 V, are added to the netlist, unless the netlist has a
    source between the same nodes. `timeout`: longest run of ngspice, in seconds.
    """
    owner = match_nets(pads_of(record), netlist.nets)
    node = {net: net for net in record.voltages} | {net: str(label) for label, net in owner.items()} | {GROUND: GROUND}
    present = {frozenset((plus, minus)) for plus, minus, _ in netlist.sources}
    pairs = [(node.get(plus, plus), node.get(minus, minus), volts) for plus, minus, volts in _sources(record)]
    lines = [
        f"v_record_{number} {plus} {minus} {volts!r}"
        for number, (plus, minus, volts) in enumerate(pairs, 1)
        if frozenset((plus, minus)) not in present and plus != minus
    ]
    body = [line for line in netlist.text.splitlines() if line.strip().lower() != ".end"]
    run = simulate(
        "\n".join([*body, *lines, ".end", ""]).encode("utf-8"), source="KiCad's SPICE netlist", timeout=timeout
    )
    volts = {net: run.voltage[label] for net, label in node.items() if label in run.voltage}
    return volts | {GROUND: 0.0}, run


def _sources(record: HardwareRecord) -> Iterator[tuple[str, str, float]]:
    """Yield plus net, minus net and volts of every source of a record, and of the bridges of closed jumpers (0 V).

    A jumper gives one source of 0 V for each two consecutive pads that solder joins.
    """
    for source in record.sources:
        yield source.positive, source.negative, source.volts
    for part in record.parts:
        nets = [part.nets[pad - 1] for pad in part.closed]
        for first, second in pairwise(nets):
            yield first, second, 0.0


def solve_extracted(
    record: HardwareRecord, found: Mapping[Pad, Label | None], values: Mapping[str, float | None]
) -> dict[str, float]:
    """Return the voltages of an extracted circuit in volts, by net of the record.

    An extracted net corresponds to the net of the record with which it shares most pads (`match_nets`). Nets that
    float, and nets without a corresponding extracted net, have no entry. `record`: gives the resistors, sources and
    closed jumpers; `found`: net of every pad in the extracted circuit, None for a pad without a connection; `values`:
    resistance in ohms by reference. A resistor with an unconnected pad, or with both pads on one net, carries no
    current and is left out. Raises InputError if another resistor has no value.
    """
    owner = match_nets(pads_of(record), found)
    label_of: dict[str, Label] = {net: label for label, net in owner.items()}
    label_of.setdefault(GROUND, GROUND)
    number: dict[Label, int] = {label_of[GROUND]: 0}
    resistors: list[tuple[int, int]] = []
    conductance: list[float] = []
    for part in record.parts:
        ends = [found.get((part.reference, pad)) for pad in (1, 2)]
        if part.type == "resistor" and None not in ends and ends[0] != ends[1]:
            resistors.append((number.setdefault(ends[0], len(number)), number.setdefault(ends[1], len(number))))
            conductance.append(1.0 / _value(part.reference, values))
    ties = [
        (number.setdefault(plus, len(number)), number.setdefault(minus, len(number)), volts)
        for first, second, volts in _sources(record)
        if (plus := label_of.get(first)) is not None and (minus := label_of.get(second)) is not None and plus != minus
    ]
    names = {number[label]: net for net, label in label_of.items() if label in number}
    volts = solve(
        Netlist(
            len(number),
            np.array(resistors, dtype=np.int32).reshape(-1, 2),
            np.array(conductance),
            source_nodes=np.array([tie[:2] for tie in ties], dtype=np.int32).reshape(-1, 2),
            source_volts=np.array([tie[2] for tie in ties]),
        )
    ).voltage.tolist()
    return {net: volts[node] for node, net in names.items() if not math.isnan(volts[node])}


def _value(reference: str, values: Mapping[str, float | None]) -> float:
    """Return the resistance of a part in ohms; raise InputError if it is unknown, not positive or infinite.

    `reference`: name of the part; `values`: resistances in ohms by reference, None for an unknown one.
    """
    value = values.get(reference)
    if value is None or not 0 < value < math.inf:
        raise InputError(f"{reference} has no resistance; give it a value such as 10k")
    return value
