"""Footprints of a board: pads, outlines and courtyards as data, and their text in a library or on a board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from resgrid.hardware.kicad.sexpr import NO, YES, Node, Word, format_tree, uuid_of

LIBRARY = "resgrid"
"""Name of the KiCad libraries of symbols and footprints in a board's folder."""

FORMAT = 20241229
"""Version of the file format of boards and footprints in KiCad 9."""

PIN_SPACING = 2.54
"""Distance of the centres of neighbouring pins of a pin header, in millimetres."""


@dataclass(frozen=True)
class FootprintPad:
    """A pad of a footprint.

    `number`: text such as "1", empty for a hole without copper; `x`, `y`: centre relative to the footprint's origin, in
    millimetres, y downwards; `width`, `height`: in millimetres; `shape`: "circle", "rect" or "roundrect"; `drill`:
    diameter of the hole in millimetres, 0 for a pad on the front without a hole.
    """

    number: str
    x: float
    y: float
    width: float
    height: float
    shape: str = "roundrect"
    drill: float = 0.0


@dataclass(frozen=True)
class Footprint:
    """A footprint in the library of a board's folder; lengths are in mm from the footprint's origin, y downwards.

    `name`: its name; `about`: description; `pads`: the pads; `silk`: lines (x0, y0, x1, y1) on the front silkscreen;
    `courtyard`: rectangle (x0, y0, x1, y1) that other parts must leave free, None without one; `attributes`: KiCad's
    words for its kind, such as ``smd``.
    """

    name: str
    about: str
    pads: tuple[FootprintPad, ...]
    silk: tuple[tuple[float, float, float, float], ...] = ()
    courtyard: tuple[float, float, float, float] | None = None
    attributes: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlacedFootprint:
    """A footprint on the board.

    Places are in millimetres from the upper left corner of the sheet, y downwards. `footprint`: the footprint;
    `reference`, `value`: texts such as R7 and 10k; `x`, `y`: place of the footprint's origin, which is its centre, or
    pin 1 of a pin header; `turn`: rotation in degrees, counterclockwise: 0, 90, 180 or 270; `nets`: nets of the pads of
    `footprint`, in their order; `label`: place (x, y) of the reference on the silkscreen, None if only the fabrication
    layer shows it; `label_turn`: rotation of the reference in degrees; `label_size`: width and height of its letters in
    mm; `path`: UUIDs that lead to the part's symbol in the schematic, empty without one.
    """

    footprint: Footprint
    reference: str
    value: str
    x: float
    y: float
    nets: tuple[str, ...] = ()
    turn: int = 0
    label: tuple[float, float] | None = None
    label_turn: int = 0
    label_size: tuple[float, float] = (0.8, 0.8)
    path: str = ""

    def place_of(self, pad: FootprintPad) -> tuple[float, float]:
        """Return the centre (x, y) of a pad on the board, in millimetres, y downwards."""
        x, y = {0: (pad.x, pad.y), 90: (pad.y, -pad.x), 180: (-pad.x, -pad.y), 270: (-pad.y, pad.x)}[self.turn]
        return self.x + x, self.y + y

    def size_of(self, pad: FootprintPad) -> tuple[float, float]:
        """Return width and height of a pad on the board, after the rotation of the footprint, in millimetres."""
        return (pad.width, pad.height) if self.turn % 180 == 0 else (pad.height, pad.width)


RESISTOR = Footprint(
    "R_0603_1608Metric_HandSolder",
    "Resistor 0603 (1608 metric) with long pads for soldering by hand",
    (FootprintPad("1", -0.9125, 0.0, 0.975, 0.95), FootprintPad("2", 0.9125, 0.0, 0.975, 0.95)),
    courtyard=(-1.65, -0.73, 1.65, 0.73),
    attributes=("smd",),
)
TEST_PAD = Footprint(
    "TestPad_D1.5mm_Drill0.8mm",
    "Plated hole for a probe tip or a wire",
    (FootprintPad("1", 0.0, 0.0, 1.5, 1.5, "circle", 0.8),),
    attributes=("exclude_from_pos_files", "exclude_from_bom"),
)
SOLDER_JUMPER = Footprint(
    "SolderJumper_3_Open",
    "Three pads for a solder bridge from the middle pad to either of the others",
    tuple(FootprintPad(str(number), x, 0.0, 0.85, 1.5, "rect") for number, x in ((1, -1.1), (2, 0.0), (3, 1.1))),
    courtyard=(-1.6, -0.85, 1.6, 0.85),
    attributes=("exclude_from_pos_files", "exclude_from_bom"),
)
TERMINAL = Footprint(
    "TerminalBlock_1x02_P5.08mm",
    "Screw terminal with two poles, 5.08 mm apart; the wires enter at the lower side",
    (FootprintPad("1", -2.54, 0.0, 2.6, 2.6, "rect", 1.3), FootprintPad("2", 2.54, 0.0, 2.6, 2.6, "circle", 1.3)),
    silk=((-5.2, -4.0, 5.2, -4.0), (5.2, -4.0, 5.2, 4.2), (5.2, 4.2, -5.2, 4.2), (-5.2, 4.2, -5.2, -4.0)),
    courtyard=(-5.4, -4.2, 5.4, 4.4),
    attributes=("through_hole",),
)
HOLE = Footprint(
    "MountingHole_3.2mm_M3",
    "Hole for a screw M3",
    (FootprintPad("", 0.0, 0.0, 3.2, 3.2, "circle", 3.2),),
    courtyard=(-3.2, -3.2, 3.2, 3.2),
    attributes=("exclude_from_pos_files", "exclude_from_bom"),
)


def pin_header(pins: int) -> Footprint:
    """Return the footprint of a vertical pin header with pins in one column; pin 1, at the origin, is square."""
    end = (pins - 1) * PIN_SPACING
    corners = ((-1.3, -1.15), (1.3, -1.15), (1.3, end + 1.15), (-1.3, end + 1.15))
    sides = zip(corners, (*corners[1:], corners[0]), strict=True)
    return Footprint(
        f"PinHeader_1x{pins:02d}_P2.54mm",
        f"Pin header, {pins} pins, 2.54 mm apart",
        tuple(
            FootprintPad(str(pin + 1), 0.0, pin * PIN_SPACING, 1.7, 1.7, "circle" if pin else "rect", 1.0)
            for pin in range(pins)
        ),
        silk=tuple((*start, *stop) for start, stop in sides),
        courtyard=(-1.5, -1.27, 1.5, end + 1.27),
        attributes=("through_hole",),
    )


def format_footprint(footprint: Footprint) -> str:
    """Return the text of a library file (``.kicad_mod``) of a footprint."""
    tree = [
        Word("footprint"),
        footprint.name,
        ["version", FORMAT],
        ["generator", "resgrid"],
        ["generator_version", "9.0"],
        ["layer", "F.Cu"],
        ["descr", footprint.about],
        *_properties("REF**", footprint.name, footprint.name),
        *_contents(footprint, footprint.name, {}),
    ]
    return format_tree(tree)


def placed_tree(placed: PlacedFootprint, nets: Mapping[str, int]) -> Node:
    """Return the S-expression of a footprint on a board; `nets`: number of every net by name."""
    footprint = placed.footprint
    tree: Node = [
        "footprint",
        f"{LIBRARY}:{footprint.name}",
        ["layer", "F.Cu"],
        uuid_of("board", placed.reference),
        ["at", placed.x, placed.y, *([placed.turn] if placed.turn else [])],
        ["descr", footprint.about],
        *_properties(placed.reference, placed.value, placed.reference, placed),
        *([["path", placed.path]] if placed.path else []),
    ]
    own = {pad.number: (nets[net], net) for pad, net in zip(footprint.pads, placed.nets, strict=False)}
    return tree + _contents(footprint, placed.reference, own, placed.turn)


def _properties(reference: str, value: str, key: str, placed: PlacedFootprint | None = None) -> list[Node]:
    """Return the S-expressions of the texts of a footprint: reference, value, and two empty texts that KiCad requires.

    `reference`, `value`: texts; `key`: name from which the UUIDs are derived; `placed`: the footprint on a board, which
    gives the place of the reference; None in a library.
    """
    where, layer, turn, size = (0.0, 0.0), "F.Fab", 0, (0.8, 0.8)
    if placed is not None and placed.label is not None:
        layer, turn, size = "F.SilkS", placed.label_turn, placed.label_size
        dx, dy = placed.label[0] - placed.x, placed.label[1] - placed.y
        where = {0: (dx, dy), 90: (-dy, dx), 180: (-dx, -dy), 270: (dy, -dx)}[placed.turn]
    properties = (
        ("Reference", reference, where, layer, turn, False),
        ("Value", value, (0.0, 1.5), "F.Fab", 0, True),
        ("Datasheet", "", (0.0, 0.0), "F.Fab", 0, True),
        ("Description", "", (0.0, 0.0), "F.Fab", 0, True),
    )
    return [
        [
            "property", name, text, ["at", *place, angle], ["layer", on], *([["hide", YES]] if hidden else []),
            uuid_of("text", key, name), _effects(size),
        ]
        for name, text, place, on, angle, hidden in properties
    ]  # fmt: skip


def _effects(size: Sequence[float]) -> Node:
    """Return the S-expression of a font; `size`: width and height of letters, in millimetres."""
    return ["effects", ["font", ["size", size[1], size[0]], ["thickness", 0.12]]]


def _contents(footprint: Footprint, key: str, nets: Mapping[str, tuple[int, str]], turn: int = 0) -> list[Node]:
    """Return the S-expressions of attributes, lines, courtyard and pads of a footprint.

    `key`: name from which the UUIDs are derived; `nets`: number and name of the net of each pad, by the pad's number;
    `turn`: rotation of the footprint in degrees.
    """
    parts: list[Node] = [["attr", *map(Word, footprint.attributes)]] if footprint.attributes else []
    parts += [_line(line, key, number) for number, line in enumerate(footprint.silk)]
    if footprint.courtyard is not None:
        x0, y0, x1, y1 = footprint.courtyard
        stroke: Node = ["stroke", ["width", 0.05], ["type", Word("solid")]]
        parts.append(
            ["fp_rect", ["start", x0, y0], ["end", x1, y1], stroke, ["fill", NO], ["layer", "F.CrtYd"],
             uuid_of("courtyard", key)]
        )  # fmt: skip
    return parts + [_pad(pad, key, nets.get(pad.number), turn) for pad in footprint.pads]


def _line(line: tuple[float, float, float, float], key: str, number: int) -> Node:
    """Return the S-expression of a line (x0, y0, x1, y1) of a footprint on the silkscreen, in millimetres.

    `key`, `number`: name of the footprint and index of the line, from which the identifier is derived.
    """
    x0, y0, x1, y1 = line
    return [
        "fp_line", ["start", x0, y0], ["end", x1, y1], ["stroke", ["width", 0.12], ["type", Word("solid")]],
        ["layer", "F.SilkS"], uuid_of("silk", key, number),
    ]  # fmt: skip


def _pad(pad: FootprintPad, key: str, net: tuple[int, str] | None, turn: int) -> Node:
    """Return the S-expression of a pad.

    `key`: name of its footprint, from which the identifier is derived; `net`: number and name of its net, None without
    one; `turn`: rotation of the footprint in degrees.
    """
    kind = "smd" if not pad.drill else "thru_hole" if pad.number else "np_thru_hole"
    layers = ("*.Cu", "*.Mask") if pad.drill else ("F.Cu", "F.Mask", "F.Paste")
    tree: Node = [
        "pad", pad.number, Word(kind), Word(pad.shape), ["at", pad.x, pad.y, *([turn] if turn else [])],
        ["size", pad.width, pad.height], *([["drill", pad.drill]] if pad.drill else []), ["layers", *layers],
    ]  # fmt: skip
    if kind == "thru_hole":
        tree.append(["remove_unused_layers", NO])
    if pad.shape == "roundrect":
        tree.append(["roundrect_rratio", 0.25])
    if net is not None:
        tree.append(["net", *net])
    return [*tree, uuid_of("pad", key, pad.number)]


@dataclass(frozen=True)
class Graphics:
    """Lines and texts of a board that belong to no part.

    `lines`: (x0, y0, x1, y1, width, layer), the ends and the width in millimetres from the upper left corner of the
    sheet, y downwards, and the name of the layer; `texts`: the texts.
    """

    lines: list[tuple[float, float, float, float, float, str]] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)


@dataclass(frozen=True)
class Text:
    """A text on the silkscreen.

    `text`: its words; `x`, `y`: anchor in millimetres from the upper left corner of the sheet, y downwards; `size`:
    width and height of letters in millimetres; `turn`: rotation in degrees, counterclockwise; `layer`: name of the
    layer; `align`: side of the text at the anchor: "left", "right", or "" for the centre; `thickness`: width of its
    lines in millimetres.
    """

    text: str
    x: float
    y: float
    size: tuple[float, float] = (0.8, 0.8)
    turn: int = 0
    layer: str = "F.SilkS"
    align: str = ""
    thickness: float = 0.12

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Rectangle (x0, y0, x1, y1) that encloses the text, in millimetres, y downwards."""
        width, height = self.size[0] * 0.95 * len(self.text) + 0.1, self.size[1] + 0.2
        start = {"left": 0.0, "right": -width}.get(self.align, -width / 2)
        if self.turn % 180:
            return self.x - height / 2, self.y - start - width, self.x + height / 2, self.y - start
        return self.x + start, self.y - height / 2, self.x + start + width, self.y + height / 2
