"""Symbols of a schematic as data (resistor, test pad, solder jumper, connectors, sources), and their text for KiCad."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from resgrid.hardware.kicad.footprints import LIBRARY
from resgrid.hardware.kicad.sexpr import NO, YES, Node, Word, format_tree

FORMAT = 20241209
"""Version of the file format of symbols in KiCad 9."""

Line = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Pin:
    """A pin of a symbol.

    `number`: text such as "1"; `x`, `y`: its outer end in millimetres from the symbol's origin, y upwards; `turn`:
    direction from this end to the symbol in degrees, counterclockwise from the right; `length`: in millimetres;
    `kind`: KiCad's electrical type.
    """

    number: str
    x: float
    y: float
    turn: int
    length: float
    kind: str = "passive"


@dataclass(frozen=True)
class Symbol:
    """A symbol in the library of a board's folder; lengths are in millimetres from the symbol's origin, y upwards.

    `name`: its name; `prefix`: beginning of references, such as R; `pins`: its pins; `lines`: corners of drawn lines;
    `circles`: centre x, y and radius; `power`: whether it gives a net its name; `simulated`: whether it is part of the
    SPICE netlist; `on_board`: whether it has a footprint; `in_bom`: whether the bill of materials lists it.
    """

    name: str
    prefix: str
    pins: tuple[Pin, ...]
    lines: tuple[Line, ...] = ()
    circles: tuple[tuple[float, float, float], ...] = ()
    power: bool = False
    simulated: bool = True
    on_board: bool = True
    in_bom: bool = True


def _box(x0: float, y0: float, x1: float, y1: float) -> Line:
    """Return the corners of a closed rectangle, in millimetres."""
    return (x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)


RESISTOR = Symbol(
    "R", "R", (Pin("1", 0.0, 3.81, 270, 1.27), Pin("2", 0.0, -3.81, 90, 1.27)), (_box(-1.016, -2.54, 1.016, 2.54),)
)
TEST_PAD = Symbol(
    "TestPad", "TP", (Pin("1", 0.0, 0.0, 90, 1.27),), circles=((0.0, 1.905, 0.635),), simulated=False, in_bom=False
)
SOLDER_JUMPER = Symbol(
    "SolderJumper_3", "JP",
    (Pin("1", -5.08, 0.0, 0, 2.54), Pin("2", 0.0, -3.81, 90, 2.54), Pin("3", 5.08, 0.0, 180, 2.54)),
    (
        _box(-2.54, -1.016, -1.27, 1.016), _box(-0.635, -1.016, 0.635, 1.016), _box(1.27, -1.016, 2.54, 1.016),
        ((0.0, -1.016), (0.0, -1.27)),
    ),
    in_bom=False,
)  # fmt: skip
HOLE = Symbol("MountingHole", "H", (), circles=((0.0, 0.0, 1.27), (0.0, 0.0, 0.762)), simulated=False, in_bom=False)
SOURCE = Symbol(
    "VDC", "V", (Pin("1", 0.0, 5.08, 270, 2.54), Pin("2", 0.0, -5.08, 90, 2.54)),
    (((-0.635, 1.27), (0.635, 1.27)), ((0.0, 0.635), (0.0, 1.905)), ((-0.635, -1.27), (0.635, -1.27))),
    circles=((0.0, 0.0, 2.54),), on_board=False, in_bom=False,
)  # fmt: skip
GROUND = Symbol(
    "GND", "#PWR", (Pin("1", 0.0, 0.0, 270, 0.0, "power_in"),),
    (((0.0, 0.0), (0.0, -1.27)), ((-1.27, -1.27), (1.27, -1.27), (0.0, -2.54), (-1.27, -1.27))),
    power=True, simulated=False, in_bom=False,
)  # fmt: skip
RAIL = Symbol(
    "RAIL", "#PWR", (Pin("1", 0.0, 0.0, 90, 0.0, "power_in"),),
    (((0.0, 0.0), (0.0, 1.27)), ((-1.27, 1.27), (1.27, 1.27))), power=True, simulated=False, in_bom=False,
)  # fmt: skip
FLAG = Symbol(
    "PWR_FLAG", "#FLG", (Pin("1", 0.0, 0.0, 90, 0.0, "power_out"),),
    (((0.0, 0.0), (0.0, 1.27)), ((0.0, 1.27), (-1.016, 1.905), (0.0, 2.54), (1.016, 1.905), (0.0, 1.27))),
    power=True, simulated=False, in_bom=False,
)  # fmt: skip


def connector(pins: int) -> Symbol:
    """Return the symbol of a connector with `pins` pins in one column; pin 1 is at the top, at y = 0."""
    end = -2.54 * (pins - 1)
    marks = tuple(_box(-1.27, -2.54 * k - 0.254, 0.254, -2.54 * k + 0.254) for k in range(pins))
    return Symbol(
        f"Conn_1x{pins:02d}",
        "J",
        tuple(Pin(str(k + 1), -5.08, -2.54 * k, 0, 3.81) for k in range(pins)),
        (_box(-1.27, end - 1.27, 1.27, 1.27), *marks),
        simulated=False,
    )


def format_symbols(symbols: Sequence[Symbol]) -> str:
    """Return the text of a library of symbols (``.kicad_sym``)."""
    tree: Node = [
        "kicad_symbol_lib", ["version", FORMAT], ["generator", "resgrid"], ["generator_version", "9.0"],
        *(symbol_tree(symbol, symbol.name) for symbol in symbols),
    ]  # fmt: skip
    return format_tree(tree)


def symbol_tree(symbol: Symbol, name: str) -> Node:
    """Return the S-expression of a symbol.

    `name`: name of the symbol, with the library's name in front in schematics.
    """
    hidden = ["hide", YES]
    texts = (
        ("Reference", symbol.prefix),
        ("Value", symbol.name),
        ("Footprint", ""),
        ("Datasheet", ""),
        ("Description", ""),
    )
    stroke: Node = ["stroke", ["width", 0.2], ["type", Word("default")]]
    empty: Node = ["fill", ["type", Word("none")]]
    drawn: list[Node] = [
        *(["polyline", ["pts", *(["xy", *corner] for corner in line)], stroke, empty] for line in symbol.lines),
        *(["circle", ["center", x, y], ["radius", radius], stroke, empty] for x, y, radius in symbol.circles),
    ]
    return [
        "symbol",
        name,
        *([["power"]] if symbol.power else []),
        ["pin_numbers", hidden],
        ["pin_names", ["offset", 0], hidden],
        ["exclude_from_sim", NO if symbol.simulated else YES],
        ["in_bom", YES if symbol.in_bom else NO],
        ["on_board", YES if symbol.on_board else NO],
        *(["property", key, text, ["at", 0, 0, 0], effects(hidden=key != "Reference")] for key, text in texts),
        ["symbol", f"{symbol.name}_0_1", *drawn],
        ["symbol", f"{symbol.name}_1_1", *map(_pin, symbol.pins)],
        ["embedded_fonts", NO],
    ]


def effects(size: float = 1.27, *, hidden: bool = False, align: str = "") -> Node:
    """Return the S-expression of a font.

    `size`: height of letters in millimetres; `hidden`: whether the text is not shown; `align`: side of the text at its
    anchor: "left", "right", or "" for the centre.
    """
    return [
        "effects", ["font", ["size", size, size]], *([["justify", Word(align)]] if align else []),
        *([["hide", YES]] if hidden else []),
    ]  # fmt: skip


def _pin(pin: Pin) -> Node:
    """Return the S-expression of a pin."""
    return [
        "pin", Word(pin.kind), Word("line"), ["at", pin.x, pin.y, pin.turn], ["length", pin.length],
        ["name", "~" if pin.kind == "passive" else pin.number, effects()], ["number", pin.number, effects()],
    ]  # fmt: skip


def library_name(symbol: Symbol) -> str:
    """Return the name of a symbol with its library in front, such as ``resgrid:R``."""
    return f"{LIBRARY}:{symbol.name}"
