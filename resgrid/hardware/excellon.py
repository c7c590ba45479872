"""Reader of Excellon drill files: places and diameters of holes and slots, in millimetres."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from resgrid._internal.files import read_text
from resgrid.errors import InputError

_TOOL = re.compile(r"T(\d+)(?:[FS]\d+)*C([\d.]+)")
_HIT = re.compile(r"(?:X([+-]?[\d.]+))?(?:Y([+-]?[\d.]+))?(?:G85(?:X([+-]?[\d.]+))?(?:Y([+-]?[\d.]+))?)?")
_IGNORED = re.compile(r"M48|FMAT,2|G90|G05|%|M95|T0+|ICI,OFF|M71|M72|")


@dataclass(frozen=True)
class Hole:
    """A drilled hole or slot; lengths are in millimetres, y upwards.

    `start`, `end`: centres (x, y) of its two ends, equal for a round hole; `diameter`: diameter of the drill.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    diameter: float


def read_excellon(path: Path) -> list[Hole]:
    """Return the holes of a drill file; raise InputError, which names the line, for damaged or unsupported files."""
    return parse_excellon(read_text(path), str(path))


def parse_excellon(text: str, name: str = "<text>") -> list[Hole]:
    """Return the holes of a text in Excellon format with decimal points; `name`: name of the file in messages."""
    unit, diameter, tools = 1.0, None, {}
    point = (0.0, 0.0)
    holes: list[Hole] = []
    for number, line in enumerate(text.split("\n"), 1):
        word = line.split(";")[0].strip()
        if word in ("M30", "M00"):
            return holes
        if word.startswith(("METRIC", "INCH")):
            unit = 1.0 if word.startswith("METRIC") else 25.4
        elif match := _TOOL.fullmatch(word):
            tools[int(match[1])] = float(match[2]) * unit
        elif (match := re.fullmatch(r"T(\d+)", word)) and int(match[1]) in tools:
            diameter = tools[int(match[1])]
        elif word and (match := _HIT.fullmatch(word)) and diameter is not None:
            first = _moved(point, match[1], match[2], unit)
            point = _moved(first, match[3], match[4], unit)
            holes.append(Hole(first, point, diameter))
        elif not _IGNORED.fullmatch(word):
            raise InputError(
                f"{name}, line {number}: drill command {word[:40]!r} is not supported; use KiCad's drill files"
            )
    raise InputError(f"{name}: the command M30 at the end is missing; is the file complete?")


def _moved(point: tuple[float, float], x: str | None, y: str | None, unit: float) -> tuple[float, float]:
    """Return a point (x, y) in millimetres with the coordinates that a command states.

    `point`: previous point in millimetres; `x`, `y`: coordinates as text, None to retain the coordinate of `point`;
    `unit`: millimetres per unit of the file.
    """
    return (point[0] if x is None else float(x) * unit, point[1] if y is None else float(y) * unit)
