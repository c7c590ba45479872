"""Comparison of a circuit that an outside tool extracts with the intended one: nets, values and voltages.

Pads are compared by their reference and number.  The names of nets play no part, because tools shorten them, change
their case or have none (connected copper): two nets correspond if they have most of their pads in common.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from resgrid.hardware.record import HardwareRecord, Part, natural_order

Pad = tuple[str, int]
"""Reference of a part and number of a pad, counted from 1."""

Label = Hashable
"""Name or number of a net in the circuit that is compared with a record."""

SHOWN = 6
"""Maximum number of pads or nets that a message lists, and of nets that a comparison of voltages lists."""

MAX_VALUE_ERROR = 1e-9
"""Largest relative difference of resistances that count as equal.

Outside tools write values with a limited number of digits.
"""

_TWO_WAYS = ("resistor", "jumper")
"""Types of parts whose two pads are equivalent, so that they may be exchanged."""


def pads_of(record: HardwareRecord) -> dict[Pad, str]:
    """Return the net of every pad of a record, by reference of the part and number of the pad."""
    return {(part.reference, number): net for part in record.parts for number, net in enumerate(part.nets, 1)}


def compare_nets(record: HardwareRecord, found: Mapping[Pad, Label | None]) -> list[str]:
    """Return a message for every difference between the nets of a record and the nets of another circuit.

    `found`: net of every pad in the other circuit, None for a pad without a connection. Parts and pads that only one of
    both circuits contains are differences too. The two pads of a resistor or jumper may be exchanged.
    """
    expected = pads_of(record)
    owner = match_nets(expected, found)
    turned = set(_turned_parts(record, found, owner))
    groups = _groups({pad: net for pad, net in expected.items() if pad[0] not in turned}, found)
    messages = [*_absent(record, found), *_unknown(expected, found)]
    messages += [
        f"{_name(pad)} is connected to nothing instead of {net}"
        for pad, net in expected.items()
        if pad in found and found[pad] is None
    ]
    for net in sorted(groups, key=natural_order):
        messages += _differences(net, groups[net], owner)
    return list(dict.fromkeys(messages))


def match_nets(expected: Mapping[Pad, str], found: Mapping[Pad, Label | None]) -> dict[Label, str]:
    """Return the expected net that corresponds to each net of another circuit, by the label of the other net.

    A label is the name or number of a net in the other circuit. `expected`: expected net of every pad; `found`: net of
    every pad in the other circuit, None without a connection. An expected net corresponds to the found net that
    contains most of its pads. If several expected nets claim one found net, the expected net with most pads on it is
    chosen, and the others have no entry.
    """
    groups = _groups(expected, found)
    most = {net: max(map(len, labels.values())) for net, labels in groups.items()}
    candidates = [
        (net, label) for net, labels in groups.items() for label, pads in labels.items() if len(pads) == most[net]
    ]
    owner: dict[Label, str] = {}
    matched: set[str] = set()
    for net, label in sorted(candidates, key=lambda pair: (-most[pair[0]], natural_order(pair[0]))):
        if label not in owner and net not in matched:
            owner[label] = net
            matched.add(net)
    return owner


def _groups(
    expected: Mapping[Pad, str], found: Mapping[Pad, Label | None]
) -> dict[str, dict[Label, list[Pad]]]:  # fmt: skip
    """Return the pads of every expected net, grouped by their net in another circuit.

    The result has the expected net as key, and as value the pads of that net by the label of their net in the other
    circuit. `expected`: expected net of every pad; `found`: net of every pad in the other circuit. Pads without a net
    in the other circuit are left out.
    """
    groups: defaultdict[str, dict[Label, list[Pad]]] = defaultdict(dict)
    for pad, net in expected.items():
        label = found.get(pad)
        if label is not None:
            groups[net].setdefault(label, []).append(pad)
    return dict(groups)


def _turned_parts(
    record: HardwareRecord, found: Mapping[Pad, Label | None], owner: Mapping[Label, str]
) -> Iterator[str]:  # fmt: skip
    """Yield the reference of every resistor, and jumper of two pads, whose pads are exchanged in another circuit.

    `found`: net of every pad in the other circuit; `owner`: expected net that corresponds to each net of the other
    circuit.
    """
    for part in record.parts:
        if part.type in _TWO_WAYS and len(part.nets) == 2:
            here = [owner.get(found.get((part.reference, number))) for number in (1, 2)]
            if here == [part.nets[1], part.nets[0]]:
                yield part.reference


def _differences(net: str, groups: Mapping[Label, Sequence[Pad]], owner: Mapping[Label, str]) -> Iterator[str]:
    """Yield a message for every difference of one net of a record.

    `net`: name of the net in the record; `groups`: pads of this net, grouped by their net in the other circuit;
    `owner`: net of the record that corresponds to each net of the other circuit.
    """
    strangers = {label: pads for label, pads in groups.items() if owner.get(label, net) != net}
    own = [pads for label, pads in groups.items() if label not in strangers]
    if net not in owner.values() and strangers:
        largest = max(strangers, key=lambda label: len(strangers[label]))
        yield short_circuit(net, owner[largest])
        del strangers[largest]
    for label, pads in strangers.items():
        yield from (f"{_name(pad)} is on {owner[label]} instead of {net}" for pad in pads)
    if len(own) > 1:
        parts = " | ".join(_list(pads) for pads in sorted(own, key=len, reverse=True))
        yield f"{net} is split in {_number(len(own))}: pads {parts} (open track or missing via)"


def short_circuit(net: str, other: str) -> str:
    """Return the message for two nets that are connected."""
    first, second = sorted((net, other), key=natural_order)
    return f"{first} and {second} are connected (short circuit)"


def _absent(record: HardwareRecord, found: Mapping[Pad, Label | None]) -> Iterator[str]:
    """Yield a message for every part or pad of a record that is absent in `found`, the pads of another circuit."""
    for part in record.parts:
        numbers = [number for number in range(1, len(part.nets) + 1) if (part.reference, number) not in found]
        if numbers and len(numbers) == len(part.nets):
            yield f"{part.reference} is missing ({part.type.replace('_', ' ')}{_between(part)})"
        else:
            yield from (f"{part.reference}: pad {number} is missing" for number in numbers)


def _between(part: Part) -> str:
    """Return text about the nets of a part, such as " between n_1_2 and n_2_2"; empty for more than two nets."""
    nets = list(dict.fromkeys(part.nets))
    return f" on {nets[0]}" if len(nets) == 1 else f" between {nets[0]} and {nets[1]}" if len(nets) == 2 else ""


def _unknown(expected: Mapping[Pad, str], found: Iterable[Pad]) -> Iterator[str]:
    """Yield a message for every part or pad in `found`, the pads of another circuit, that is not in `expected`."""
    known = {reference for reference, _ in expected}
    extra = sorted(set(found) - set(expected), key=lambda pad: (natural_order(pad[0]), pad[1]))
    for pad in extra:
        yield f"{_name(pad)} is not in the record" if pad[0] in known else f"{pad[0]} is not in the record"


def compare_values(record: HardwareRecord, found: Mapping[str, float | None]) -> list[str]:
    """Return a message for every resistor whose resistance differs from the record by more than a limit.

    The limit is 1e-9 of the resistance in the record. `found`: resistance in ohms by reference; None stands for a text
    that is not a number, and gives a message. Resistors without an entry give no message.
    """
    messages = []
    for part in record.parts:
        if part.type == "resistor" and part.value is not None and part.reference in found:
            value = found[part.reference]
            if value is None or abs(value - part.value) > MAX_VALUE_ERROR * part.value:
                shown = "a value that is not a number" if value is None else f"{value:.10g} ohm"
                messages.append(f"{part.reference}: {shown} instead of {part.value:.10g}")
    return messages


@dataclass(frozen=True)
class VoltageComparison:
    """Differences between the voltages of a record and those of another circuit.

    `max_abs_error`: largest absolute difference in volts, None if no net was compared; `max_relative_error`: this
    difference as a fraction of the supply; `nodes`: number of nets compared; `worst`: net, expected and found voltage
    in volts, for the at most six nets with the largest differences, the largest first; `findings`: messages about
    differences above the tolerance and about nets without a found voltage.
    """

    max_abs_error: float | None = None
    max_relative_error: float | None = None
    nodes: int = 0
    worst: tuple[tuple[str, float, float], ...] = ()
    findings: tuple[str, ...] = ()


def compare_voltages(
    record: HardwareRecord, found: Mapping[str, float], tolerance: float, tool: str
) -> VoltageComparison:  # fmt: skip
    """Return the comparison of a record's voltages with those of another circuit.

    `found`: voltage by net of the record, in volts; nets without an entry give a finding; `tolerance`: largest accepted
    absolute difference as a fraction of the supply, which is the largest voltage difference between nets of the record;
    `tool`: name of the tool that computed `found`, for messages.
    """
    supply = supply_of(record)
    error = {net: abs(found[net] - volts) for net, volts in record.voltages.items() if net in found}
    order = sorted(error, key=lambda net: (-error[net], natural_order(net)))
    worst = tuple((net, record.voltages[net], found[net]) for net in order[:SHOWN] if error[net] > 0)
    findings = [
        f"{net}: {tool} finds {found[net]!r} V, expected {record.voltages[net]!r} V"
        for net in order[:SHOWN]
        if not error[net] <= tolerance * supply
    ]
    absent = sorted((net for net in record.voltages if net not in found), key=natural_order)
    if absent:
        findings.append(f"{tool} has no voltage of {_list(absent)}")
    largest = max(error.values(), default=None)
    relative = None if largest is None else largest / supply
    return VoltageComparison(largest, relative, len(error), worst, tuple(findings))


def supply_of(record: HardwareRecord) -> float:
    """Return the largest voltage difference between the nets of a record, in volts; 1 if all voltages are equal."""
    volts = record.voltages.values()
    return (max(volts, default=0.0) - min(volts, default=0.0)) or 1.0


def _name(pad: Pad) -> str:
    """Return the text for a pad: ``R17: pad 2``."""
    return f"{pad[0]}: pad {pad[1]}"


def _list(names: Sequence[Pad] | Sequence[str]) -> str:
    """Return a list of pads or nets as text: the first six of them, and the number of the others."""
    words = [name if isinstance(name, str) else f"{name[0]}.{name[1]}" for name in names]
    rest = len(words) - SHOWN
    return ", ".join(words[:SHOWN]) + (f" and {rest} more" if rest > 0 else "")


def _number(count: int) -> str:
    """Return a count from 2 as text: ``two``, ``three``, then digits."""
    return {2: "two", 3: "three"}.get(count, str(count))
