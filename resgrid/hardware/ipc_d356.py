"""Reader of IPC-D-356 and IPC-D-356A files: the net, place and access of every pad, for the electrical test of boards.

A record is a line of 80 columns (IPC-D-356A, "Bare Substrate Electrical Test Data Format", section 4): columns 1-3 hold
the operation code, 4-17 the net, 21-26 the reference, 28-31 the pin, 33-38 hole and plating, 39-41 the access, 42-57
the coordinates.  KiCad writes nets in upper case and no table of long names, so only their last 14 characters remain.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from resgrid._internal.files import read_text
from resgrid.errors import InputError

NO_NET = "N/C"
"""Name that an IPC-D-356 file gives to the net of pads that are not connected."""

_UNITS = {"CUST 0": 2.54e-3, "CUST": 2.54e-3, "CUST 1": 1e-3, "SI": 1e-3, "CUST 2": 2.54e-3}
"""Length of one unit of coordinates in millimetres, by the parameter UNITS: 0.0001 inch or 0.001 mm."""

_THROUGH, _SURFACE, _HOLE, _COMBINED = "17", "27", "37", "07"
_TESTS = frozenset({_THROUGH, _SURFACE, _HOLE, _COMBINED})
"""Second and third digit of the operation codes of test points; the first digit is 3, or 0 in a continuation record."""
_COORDINATE = re.compile(r"[+-]?\d+")


@dataclass(frozen=True)
class TestPoint:
    """A pad or via.

    `net`: name of its net; `reference`: name of its part, ``"VIA"`` for a via; `pin`: number of the pad, empty for a
    via; `position`: x and y in millimetres from the origin of the file, y upwards; `access`: 0 for both sides,
    otherwise the number of the layer, from 1 for the front; `hole`: diameter of its hole in millimetres, None for a
    surface pad; `plated`: whether the hole is plated, False without a hole.
    """

    __test__ = False
    net: str
    reference: str
    pin: str
    position: tuple[float, float]
    access: int
    hole: float | None
    plated: bool


def read_ipc_d356(file: str | Path) -> tuple[TestPoint, ...]:
    """Return the test points of an IPC-D-356 file; raise InputError, which names the line, for a damaged file."""
    path = Path(file)
    return parse_ipc_d356(read_text(path), str(path))


def parse_ipc_d356(text: str, name: str = "<text>") -> tuple[TestPoint, ...]:
    """Return the test points of a text in the format IPC-D-356; raise InputError, which names the line, for damage.

    `name`: name of the file in messages.
    """
    unit, long_names = _UNITS["CUST 0"], {}
    points: list[TestPoint] = []
    lines = text.split("\n")
    for number, line in enumerate(lines, 1):
        code = line[:3]
        if code == "999":
            return tuple(points)
        if code.startswith("P"):
            words = line[1:].strip()
            if words.startswith("UNITS"):
                unit = _unit(words.removeprefix("UNITS").strip(), f"{name}, line {number}")
            elif match := re.match(r"(NNAME\d+)\s+(\S+)", words):
                long_names[match[1]] = match[2]
        elif code[:1] in ("3", "0") and code[1:] in _TESTS:
            previous = points[-1] if code.startswith("0") and points else None
            points.append(_point(line, unit, long_names, previous, f"{name}, line {number}"))
    raise InputError(f"{name}: the record 999 at the end is missing; is the file complete?")


def _unit(words: str, place: str) -> float:
    """Return the length of one unit of coordinates in millimetres.

    `words`: value of the parameter UNITS; `place`: name of the file and line, for messages.
    """
    if words not in _UNITS:
        raise InputError(f"{place}: units {words!r} are unknown; write the file again with units CUST 0, CUST 1 or SI")
    return _UNITS[words]


def _point(line: str, unit: float, long_names: dict[str, str], previous: TestPoint | None, place: str) -> TestPoint:
    """Return the test point that a line of the file describes.

    `line`: a record of 80 columns; `unit`: length of one unit of coordinates in millimetres; `long_names`: names of
    nets by their alias, such as ``NNAME1``; `previous`: test point that this line continues, from which it takes blank
    columns, else None; `place`: name of the file and line, for messages.
    """
    net = line[3:17].strip() or (previous.net if previous else "")
    hole = _number(line[33:37], place) * unit if line[32:33] == "D" else None
    return TestPoint(
        net=long_names.get(net, net),
        reference=line[20:26].strip() or (previous.reference if previous else ""),
        pin=line[27:31].strip(),
        position=(_coordinate(line, 41, "X", place) * unit, _coordinate(line, 49, "Y", place) * unit),
        access=int(_number(line[39:41], place)) if line[38:39] == "A" else 0,
        hole=hole,
        plated=hole is not None and line[37:38] == "P",
    )


def _coordinate(line: str, column: int, letter: str, place: str) -> int:
    """Return the coordinate in a line, in units of the file; raise InputError if its letter is missing.

    `column`: index of the letter in the line; `letter`: "X" or "Y"; `place`: name of the file and line, for messages.
    """
    if line[column : column + 1] != letter:
        raise InputError(f"{place}: column {column + 1} holds {line[column : column + 1]!r} instead of {letter}")
    return int(_number(line[column + 1 : column + 8], place))


def _number(digits: str, place: str) -> int:
    """Return the whole number in some columns of a line; raise InputError for other text.

    `digits`: text of the columns; `place`: name of the file and line, for messages.
    """
    if not _COORDINATE.fullmatch(digits.strip()):
        raise InputError(f"{place}: {digits!r} is not a number; write the file again")
    return int(digits)
