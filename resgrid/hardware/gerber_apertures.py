"""Apertures of Gerber files: circles, rectangles, obrounds, polygons and macros, as polygons in millimetres."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from resgrid.errors import InputError

ARC_STEPS = 16
"""Number of chords that replace a quarter circle; at a diameter of 2 mm they are within 1.2 micrometres of the arc."""

_DEFINITION = re.compile(r"ADD(\d+)([A-Za-z_.$][\w.$-]*)(?:,(.*))?")
_OPERATORS: dict[type, Callable[[float, float], float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip


@dataclass(frozen=True)
class Aperture:
    """A shape with which a plotter draws lines or which it flashes.

    `geometry`: polygon of shapely around the origin, in millimetres; `diameter`: diameter of a circle in millimetres,
    None for other shapes.
    """

    geometry: Any
    diameter: float | None = None

    def flash(self, point: tuple[float, float]) -> Any:
        """Return the polygon of this aperture, moved to a point; lengths in millimetres."""
        from shapely.affinity import translate

        return translate(self.geometry, *point)


def parse_macro(text: str, place: str) -> tuple[str, list[list[str]]]:
    """Return the name of an aperture macro and its primitives, each as a list of arithmetic expressions.

    The first expression of a primitive is its code in the Gerber specification, the others are its parameters. `text`:
    the command between percent signs; `place`: name of the file, for messages. Raises InputError for a macro that
    defines a variable.
    """
    blocks = [block.replace("\n", "").replace("\r", "").strip() for block in text.split("*")]
    primitives = []
    for block in filter(None, blocks[1:]):
        if "=" in block:
            raise InputError(f"{place}: aperture macro {blocks[0][2:]} defines a variable, which is not supported")
        if not re.match(r"0(\s|$)", block):  # a comment
            primitives.append(block.split(","))
    return blocks[0][2:], primitives


def aperture(command: str, macros: dict[str, list[list[str]]], unit: float, place: str) -> tuple[int, Aperture]:
    """Return the number and the shape of an aperture.

    `command`: definition such as ``ADD10C,0.5``; `macros`: primitives by macro name, each as a list of arithmetic
    expressions; `unit`: millimetres per unit of the file; `place`: name of the file, for messages.  Raises InputError
    for damaged definitions.
    """
    match = _DEFINITION.fullmatch(command)
    if match is None:
        raise InputError(f"{place}: {command[:40]!r} is not the definition of an aperture; is the file damaged?")
    number, name = int(match[1]), match[2]
    try:
        values = [float(value) for value in (match[3] or "").split("X") if value]
        if name in macros:
            return number, Aperture(_scaled(_macro(macros[name], values, place), unit))
        return number, _standard(name, [value * unit for value in values], values, place)
    except (ValueError, IndexError, ZeroDivisionError, SyntaxError) as error:
        raise InputError(f"{place}: aperture D{number} is damaged ({error}); write the file again") from error


def _scaled(geometry: Any, unit: float) -> Any:
    """Return a geometry in millimetres; `unit`: length of one unit of its coordinates, in millimetres."""
    from shapely.affinity import scale

    return geometry if unit == 1 else scale(geometry, unit, unit, origin=(0, 0))


def _standard(name: str, size: list[float], values: list[float], place: str) -> Aperture:
    """Return the aperture of a circle, rectangle, obround or regular polygon.

    `name`: C, R, O or P; `size`: parameters as lengths in millimetres; `values`: parameters as written, for numbers of
    corners and angles in degrees; `place`: name of the file, for messages.
    """
    from shapely import LineString, Point, Polygon, box

    if name == "C":
        return Aperture(_ring(Point(0, 0).buffer(size[0] / 2, quad_segs=ARC_STEPS), size[1:]), size[0])
    if name == "R":
        return Aperture(_ring(box(-size[0] / 2, -size[1] / 2, size[0] / 2, size[1] / 2), size[2:]))
    if name == "O":
        half, width = (max(size[:2]) - min(size[:2])) / 2, min(size[:2])
        ends = [(-half, 0), (half, 0)] if size[0] > size[1] else [(0, -half), (0, half)]
        body = LineString(ends).buffer(width / 2, quad_segs=ARC_STEPS)
        return Aperture(_ring(body, size[2:]))
    if name == "P":
        turn = math.radians(values[2]) if len(values) > 2 else 0.0
        angles = [turn + 2 * math.pi * k / values[1] for k in range(int(values[1]))]
        body = Polygon([(size[0] / 2 * math.cos(a), size[0] / 2 * math.sin(a)) for a in angles])
        return Aperture(_ring(body, size[3:]))
    raise InputError(f"{place}: aperture {name!r} is neither standard nor a macro of the file; is the file damaged?")


def _ring(body: Any, hole: list[float]) -> Any:
    """Return a polygon without a round hole at the origin; `hole`: empty, or one entry, the hole's diameter in mm."""
    from shapely import Point

    return body.difference(Point(0, 0).buffer(hole[0] / 2, quad_segs=ARC_STEPS)) if hole else body


def _macro(primitives: list[list[str]], values: list[float], place: str) -> Any:
    """Return the polygon of an aperture macro, in units of the file.

    `primitives`: the expressions of each primitive; `values`: parameters of the aperture; `place`: name of the file,
    for messages.
    """
    from shapely import Polygon

    body: Any = Polygon()
    for primitive in primitives:
        code, *numbers = (_evaluate(expression, values) for expression in primitive)
        shape, dark = _primitive(int(code), numbers, place)
        body = body.union(shape) if dark else body.difference(shape)
    return body


def _primitive(code: int, n: list[float], place: str) -> tuple[Any, bool]:
    """Return the polygon of a macro primitive, and whether it adds copper (it removes copper otherwise).

    `code`: number of the primitive in the Gerber specification; `n`: its parameters, in units of the file and degrees;
    `place`: name of the file, for messages.  Raises InputError for other codes than 1, 4, 5, 20 and 21.
    """
    from shapely import LineString, Point, Polygon, box
    from shapely.affinity import rotate

    if code == 1:  # circle: exposure, diameter, centre, rotation
        shape, turn = Point(n[2], n[3]).buffer(n[1] / 2, quad_segs=ARC_STEPS), n[4] if len(n) > 4 else 0.0
    elif code == 20:  # line with flat ends: exposure, width, start, end, rotation
        shape, turn = LineString([n[2:4], n[4:6]]).buffer(n[1] / 2, cap_style="flat"), n[6]
    elif code == 21:  # rectangle: exposure, width, height, centre, rotation
        x, y, a, b = n[3], n[4], n[1] / 2, n[2] / 2
        shape, turn = box(x - a, y - b, x + a, y + b), n[5]
    elif code == 4:  # outline: exposure, number of edges, corners, rotation
        count = int(n[1]) + 1
        corners = [(n[2 + 2 * k], n[3 + 2 * k]) for k in range(count)]
        shape, turn = Polygon(corners).buffer(0), n[2 + 2 * count]
    elif code == 5:  # regular polygon: exposure, corners, centre, diameter, rotation
        angles = [2 * math.pi * k / n[1] for k in range(int(n[1]))]
        shape = Polygon([(n[2] + n[4] / 2 * math.cos(a), n[3] + n[4] / 2 * math.sin(a)) for a in angles])
        turn = n[5]
    else:
        raise InputError(f"{place}: aperture macro primitive {code} is not supported; use KiCad's Gerber files")
    return rotate(shape, turn, origin=(0, 0)), n[0] != 0


def _evaluate(expression: str, values: list[float]) -> float:
    """Return the value of an expression of a macro, such as ``$1x2+$3``; `values`: parameters of the aperture."""
    text = re.sub(r"\$(\d+)", lambda match: f"({values[int(match[1]) - 1]!r})", expression.strip())
    return _value(ast.parse(re.sub("[xX]", "*", text), mode="eval").body)


def _value(node: ast.expr) -> float:
    """Return the value of a parsed arithmetic expression; raise ValueError for other expressions."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return float(node.value)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        return _value(node.operand) * (-1 if isinstance(node.op, ast.USub) else 1)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(node.left), _value(node.right))
    raise ValueError("an expression is not arithmetic")
