"""Reader of Gerber X2 copper layers (Ucamco, revision 2024.05): polygons with the nets that the file states for them.

Only the commands that board editors write for copper are accepted.  Another command raises InputError, because a
misread layer would make a wrong board look right.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from resgrid._internal.files import read_text
from resgrid.errors import InputError
from resgrid.hardware.gerber_apertures import ARC_STEPS, Aperture, aperture, parse_macro

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_WORD = re.compile(r"%(?P<extended>[^%]*)%|(?P<word>[^%*]*)\*", re.DOTALL)
_OPERATION = re.compile(
    r"(?:X(?P<x>[+-]?\d+))?(?:Y(?P<y>[+-]?\d+))?(?:I(?P<i>[+-]?\d+))?(?:J(?P<j>[+-]?\d+))?D0?(?P<d>[123])"
)
_FORMAT = re.compile(r"FSLAX(\d)(\d)Y\1\2")
_IGNORED = re.compile(r"TF|TA|AMHOLE|G04|LN|IN|IP(?:POS)|OFA0B0|G74|G75|G90|G71|G70|M0?[02]|G54|^$")
_FUNCTIONS = {"G01": 1, "G1": 1, "G02": 2, "G2": 2, "G03": 3, "G3": 3}


@dataclass(frozen=True)
class CopperShape:
    """A connected piece of copper.

    `geometry`: polygon of shapely in millimetres, y upwards; `net`: name of the net that the file states, empty without
    one.
    """

    geometry: Any
    net: str


@dataclass
class _State:
    """State of the plotter of a Gerber file.

    `place`: name of the file, for messages; `unit`: millimetres per unit of the file (1 or 25.4); `scale`: units of the
    file per integer coordinate; `point`: current point in millimetres; `mode`: 1 for lines, 2 and 3 for clockwise and
    counterclockwise arcs; `current`: selected aperture, None before the first selection; `contour`: points of the
    current contour in millimetres, None outside regions; `dark`: whether objects add copper (they remove it otherwise);
    `net`: net of the next objects (attribute ``.N``), empty without one; `apertures`: apertures by number; `macros`:
    primitives by macro name; `shapes`: finished objects.
    """

    place: str
    unit: float = 1.0
    scale: float = 1e-6
    point: tuple[float, float] = (0.0, 0.0)
    mode: int = 1
    current: Aperture | None = None
    contour: list[tuple[float, float]] | None = None
    dark: bool = True
    net: str = ""
    apertures: dict[int, Aperture] = field(default_factory=dict)
    macros: dict[str, list[list[str]]] = field(default_factory=dict)
    shapes: list[CopperShape] = field(default_factory=list)


def read_gerber(path: Path) -> list[CopperShape]:
    """Return the copper shapes of a Gerber layer; raise InputError for a damaged file or an unsupported command."""
    return parse_gerber(read_text(path), str(path))


def parse_gerber(text: str, name: str = "<text>") -> list[CopperShape]:
    """Return the copper shapes of a layer in Gerber format: connected polygons in millimetres, y upwards.

    `text`: content of the file; `name`: name of the file in messages. Raises InputError for damaged text and for
    commands that are not supported.
    """
    state = _State(name)
    end = 0
    for match in _WORD.finditer(text):
        if text[end : match.start()].strip():
            raise _unknown(state, text[end : match.start()])
        end = match.end()
        extended = match["extended"]
        if extended is None:
            _do_word(state, "".join(match["word"].split()))
        else:
            _do_extended(state, extended)
        if match["word"] is not None and match["word"].strip() in ("M02", "M00"):
            return pieces(state.shapes)
    raise InputError(f"{name}: the command M02 at the end is missing; is the file complete?")


def _unknown(state: _State, command: str) -> InputError:
    """Return the InputError for a command that this reader does not support; `state`: state of the plotter."""
    return InputError(
        f"{state.place}: Gerber command {command.strip()[:40]!r} is not supported; use KiCad's Gerber files"
    )


def _do_extended(state: _State, text: str) -> None:
    """Execute an extended command, and change `state`; `text`: the text between the percent signs."""
    if text.startswith("AM"):
        name, primitives = parse_macro(text, state.place)
        state.macros[name] = primitives
        return
    for command in filter(None, ("".join(part.split("\n")) for part in text.split("*"))):
        if match := _FORMAT.fullmatch(command):
            state.scale = 10.0 ** -int(match[2])
        elif command in ("MOMM", "MOIN"):
            state.unit = 1.0 if command == "MOMM" else 25.4
        elif command in ("LPD", "LPC"):
            state.dark = command == "LPD"
        elif command.startswith("AD"):
            number, shape = aperture(command, state.macros, state.unit, state.place)
            state.apertures[number] = shape
        elif command.startswith("TO.N,"):
            state.net = _unescaped(command.removeprefix("TO.N,"))
        elif command in {"TD", "TD.N"}:
            state.net = ""
        elif not command.startswith(("TD", "TO")) and not _IGNORED.match(command):
            raise _unknown(state, command)


def _unescaped(text: str) -> str:
    """Return the value of a Gerber attribute with escapes of four hexadecimal digits replaced by characters."""
    return re.sub(r"\\u([0-9a-fA-F]{4})", lambda match: chr(int(match[1], 16)), text)


def _do_word(state: _State, word: str) -> None:
    """Execute a command `word`, which sets a mode, selects an aperture or draws, and change `state`."""
    if word.startswith("G04"):
        return
    for code, mode in _FUNCTIONS.items():
        if word.startswith(code) and not word[len(code) : len(code) + 1].isdigit():
            state.mode, word = mode, word[len(code) :]
            break
    if word == "G36":
        state.contour = []
    elif word == "G37":
        _close_contour(state)
        state.contour = None
    elif match := re.fullmatch(r"(?:G54)?D([1-9]\d+)", word):
        if int(match[1]) not in state.apertures:
            raise InputError(f"{state.place}: aperture D{match[1]} is used, but not defined; is the file complete?")
        state.current = state.apertures[int(match[1])]
    elif match := _OPERATION.fullmatch(word):
        _operate(state, match)
    elif not _IGNORED.fullmatch(word):
        raise _unknown(state, word)


def _operate(state: _State, match: re.Match[str]) -> None:
    """Draw a line or arc, move, or flash the aperture, and change `state`.

    `match`: match of a command such as ``X100Y200D01`` with `_OPERATION`; D01 draws, D02 moves, D03 flashes.
    """
    size = state.scale * state.unit
    end = tuple(int(match[axis]) * size if match[axis] else old for axis, old in zip("xy", state.point, strict=True))
    target = (end[0], end[1])
    if match["d"] == "2":
        if state.contour is not None:
            _close_contour(state)
            state.contour = [target]
    elif match["d"] == "1":
        centre = (int(match["i"] or 0) * size, int(match["j"] or 0) * size)
        points = [target] if state.mode == 1 else list(_arc(state.point, target, centre, state.mode == 2))
        if state.contour is None:
            _add(state, _drawn(state, [state.point, *points]))
        else:
            state.contour += points
    else:
        _add(state, _selected(state).flash(target))
    state.point = target


def _selected(state: _State) -> Aperture:
    """Return the selected aperture; raise InputError if no aperture was selected before."""
    if state.current is None:
        raise InputError(f"{state.place}: an object has no aperture; is the file complete?")
    return state.current


def _drawn(state: _State, points: list[tuple[float, float]]) -> Any:
    """Return the polygon that the selected circular aperture draws along a line.

    `points`: ends of the line, or points along an arc, in millimetres. Raises InputError for other apertures.
    """
    from shapely import LineString, Point

    width = _selected(state).diameter
    if width is None:
        raise InputError(
            f"{state.place}: a line is drawn with an aperture that is not a circle; use KiCad's Gerber files"
        )
    line = Point(points[0]) if len(set(points)) == 1 else LineString(points)
    return line.buffer(width / 2, quad_segs=ARC_STEPS)


def _arc(
    start: tuple[float, float], end: tuple[float, float], offset: tuple[float, float], clockwise: bool
) -> Iterator[tuple[float, float]]:
    """Yield the points of an arc after its start, in millimetres.

    `offset`: centre of the arc relative to `start`; all points in millimetres. Equal ends give a full circle.
    """
    centre = (start[0] + offset[0], start[1] + offset[1])
    first = math.atan2(-offset[1], -offset[0])
    turn = math.atan2(end[1] - centre[1], end[0] - centre[0]) - first
    turn = turn % (2 * math.pi) or 2 * math.pi
    turn = turn if not clockwise else turn - 2 * math.pi or -2 * math.pi
    steps = max(2, math.ceil(abs(turn) / (math.pi / 2) * ARC_STEPS))
    radius = math.hypot(*offset)
    for step in range(1, steps):
        angle = first + turn * step / steps
        yield centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle)
    yield end


def _close_contour(state: _State) -> None:
    """Add the region inside the current contour to the objects of `state`, if it has an area, and empty the contour."""
    from shapely import Polygon, make_valid

    if state.contour and len(state.contour) > 3:
        _add(state, make_valid(Polygon(state.contour)))
    if state.contour is not None:
        state.contour = []


def _add(state: _State, geometry: Any) -> None:
    """Add an object to the shapes of `state`; with clear polarity, subtract it from the shapes instead.

    `geometry`: polygon in millimetres.
    """
    if state.dark:
        state.shapes.append(CopperShape(geometry, state.net))
    else:
        state.shapes = subtract(state.shapes, geometry)


def subtract(shapes: list[CopperShape], geometry: Any) -> list[CopperShape]:
    """Return copies of shapes without the area of a geometry; their nets remain.

    A shape may become empty or consist of several polygons. `geometry`: polygon of shapely in millimetres.
    """
    return [
        CopperShape(shape.geometry.difference(geometry), shape.net) if shape.geometry.intersects(geometry) else shape
        for shape in shapes
    ]


def pieces(shapes: list[CopperShape]) -> list[CopperShape]:
    """Return one shape for each connected polygon of the given shapes, with the net of its shape.

    Polygons of zero area are left out.
    """
    import shapely

    geometries: NDArray[Any] = np.array([shape.geometry for shape in shapes], dtype=object)
    parts, index = shapely.get_parts(geometries, return_index=True)
    area = shapely.area(parts) > 0
    return [CopperShape(part, shapes[i].net) for part, i in zip(parts[area], index[area].tolist(), strict=True)]
