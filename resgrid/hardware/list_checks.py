"""Comparison of the bill of materials and the expected voltages of a board with the record of the board."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from resgrid._internal.files import read_text
from resgrid.errors import InputError
from resgrid.hardware.bill import BILL, VOLTAGE_DIGITS, VOLTAGES
from resgrid.hardware.comparison import compare_values
from resgrid.hardware.record import HardwareRecord
from resgrid.scene.quantities import parse_quantity

_RANGE = re.compile(r"([A-Z]+)(\d+)(?:-\1(\d+))?")
"""A reference, or a range of references: ``R7``, ``R1-R3``."""


def check_lists(record: HardwareRecord, folder: Path) -> list[str]:
    """Return a message for every entry of a board's two lists that contradicts the record of the board.

    The lists are the bill of materials and the expected voltages. `folder`: folder of the board; a list that is absent
    is not compared.
    """
    messages = []
    for name, differences in ((VOLTAGES, _voltage_differences), (BILL, _bill_differences)):
        if not (folder / name).exists():
            continue
        try:
            rows = list(csv.DictReader(read_text(folder / name).splitlines(), strict=True))
            messages += [f"{name}: {difference}" for difference in differences(record, rows)]
        except InputError as error:
            messages.append(str(error))
        except (KeyError, ValueError, TypeError, AttributeError, csv.Error) as error:
            messages.append(f"{name} cannot be read: {type(error).__name__} {error}; write the board again")
    return messages


def _voltage_differences(record: HardwareRecord, rows: list[dict[str, str]]) -> Iterator[str]:
    """Yield a message for every difference between a list of expected voltages and the record.

    Voltages may differ by the rounding to the digits of the list. `rows`: lines of the list, each as texts by column
    name.
    """
    pads = {part.reference: part.nets[0] for part in record.parts if part.type == "test_pad"}
    listed = {row["pad"]: row for row in rows}
    yield from (f"{pad} is missing" for pad in pads if pad not in listed)
    for pad, row in listed.items():
        if pad not in pads:
            yield f"{pad} is not in the record"
            continue
        net, volts = pads[pad], float(row["volts"])
        if row["net"] != net:
            yield f"{pad} is on {row['net']} instead of {net}"
        expected = record.voltages.get(net)
        if expected is not None and not abs(volts - expected) <= 0.51 * 10**-VOLTAGE_DIGITS:
            yield f"{pad}: {row['volts']} V instead of {expected:.{VOLTAGE_DIGITS}f} V"


def _bill_differences(record: HardwareRecord, rows: list[dict[str, str]]) -> Iterator[str]:
    """Yield a message for every difference between the resistors of a bill of materials and those of the record.

    `rows`: lines of the bill, each as texts by column name; lines of other parts are not compared.
    """
    found: dict[str, float | None] = {}
    for row in rows:
        if row["description"].startswith("resistor"):
            references = list(_expanded(row["references"]))
            if int(row["quantity"]) != len(references):
                yield f"{row['references']} are {len(references)} parts, but the quantity is {row['quantity']}"
            found |= dict.fromkeys(references, parse_quantity(row["value"].removesuffix(" ohm")))
    yield from _absent_resistors(record, found)
    yield from compare_values(record, found)


def _absent_resistors(record: HardwareRecord, found: Mapping[str, float | None]) -> Iterator[str]:
    """Yield a message for every resistor that only the record or only the bill of materials contains.

    `found`: resistances in ohms by reference, from the bill of materials.
    """
    resistors = [part.reference for part in record.parts if part.type == "resistor"]
    yield from (f"{reference} is missing" for reference in resistors if reference not in found)
    yield from (f"{reference} is not in the record" for reference in sorted(found.keys() - set(resistors)))


def _expanded(references: str) -> Iterator[str]:
    """Yield every reference of a text with ranges such as ``R1-R3 R7``; raise ValueError for other text."""
    for word in references.split():
        match = _RANGE.fullmatch(word)
        if match is None:
            raise ValueError(f"{word!r} is not a reference")
        kind, first, last = match.groups()
        yield from (f"{kind}{number}" for number in range(int(first), int(last or first) + 1))
