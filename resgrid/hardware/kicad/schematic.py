"""Types for placed symbols and sheets of a schematic, and the writer of KiCad's schematic files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from resgrid.hardware.kicad.pcb import title_block
from resgrid.hardware.kicad.sexpr import NO, YES, Node, Word, format_tree, identity, uuid_of
from resgrid.hardware.kicad.symbols import Symbol, effects, library_name, symbol_tree

FORMAT = 20250114
"""Version of the file format of schematics in KiCad 9."""

PROJECT = "grid"
"""Name of the KiCad project, with which the names of its files begin."""

Point = tuple[float, float]


@dataclass(frozen=True)
class TextPlace:
    """Place of a text of a symbol.

    `x`, `y`: anchor relative to the symbol's centre, in millimetres, y downwards; `size`: height of letters in
    millimetres; `align`: side of the text at the anchor: "left", "right", or "" for the centre.
    """

    x: float
    y: float
    size: float = 1.27
    align: str = ""


@dataclass(frozen=True)
class PlacedSymbol:
    """A symbol on a sheet.

    `symbol`: the symbol; `reference`, `value`: texts such as R7 and 10k; `x`, `y`: centre in millimetres from the upper
    left corner of the sheet, y downwards; `turn`: rotation in degrees, counterclockwise; `footprint`: name of its
    footprint with the library, such as ``resgrid:R_0603``, empty without one; `reference_at`, `value_at`: places of the
    texts, None if hidden; `simulation`: fields of the simulation model by name, empty without any, None if the
    simulation leaves the symbol out.
    """

    symbol: Symbol
    reference: str
    value: str
    x: float
    y: float
    turn: int = 0
    footprint: str = ""
    reference_at: TextPlace | None = None
    value_at: TextPlace | None = None
    simulation: Mapping[str, str] | None = field(default_factory=dict)


@dataclass
class Sheet:
    """A sheet of the schematic, extended while it is drawn.

    Places are (x, y) in millimetres from the upper left corner of the sheet, y downwards. `name`: its title, empty for
    the root; `paper`: name of its size; `symbols`: symbols; `wires`: ends of each wire; `junctions`: places at which
    wires are joined; `labels`: net, place and rotation in degrees; `notes`: text, place and height of letters;
    `areas`: two opposite corners and red, green, blue from 0 to 255; `children`: further sheets, with place of the
    upper left corner, and width and height, of their symbols.
    """

    name: str
    paper: str
    symbols: list[PlacedSymbol] = field(default_factory=list)
    wires: list[tuple[Point, Point]] = field(default_factory=list)
    junctions: list[Point] = field(default_factory=list)
    labels: list[tuple[str, Point, int]] = field(default_factory=list)
    notes: list[tuple[str, Point, float]] = field(default_factory=list)
    areas: list[tuple[Point, Point, tuple[int, int, int]]] = field(default_factory=list)
    children: list[tuple[Sheet, Point, Point]] = field(default_factory=list)

    @property
    def file(self) -> str:
        """Name of the sheet's file (``.kicad_sch``)."""
        return f"{PROJECT}{'_' + self.name.replace(' ', '_') if self.name else ''}.kicad_sch"

    @property
    def identity(self) -> str:
        """UUID by which paths of symbols refer to the sheet.

        It identifies the file for the root, else the sheet's symbol in the root.
        """
        return identity("sheet", self.name)


def symbol_path(sheet: Sheet, reference: str) -> str:
    """Return the path of UUIDs by which a footprint of the board refers to its symbol, such as ``/UUID/UUID``.

    `sheet`: sheet with the symbol; `reference`: reference of the part.
    """
    own = f"/{identity('symbol', reference)}"
    return f"/{sheet.identity}{own}" if sheet.name else own


def format_sheet(sheet: Sheet, root: Sheet, title: str, revision: str, comments: Iterable[str]) -> str:
    """Return the text of a sheet (``.kicad_sch``).

    `root`: first sheet of the schematic, which refers to the others; `title`, `revision`, `comments`: texts of the
    title block.
    """
    used = {placed.symbol.name: placed.symbol for placed in sheet.symbols}
    path = f"/{root.identity}" if sheet is root else f"/{root.identity}/{sheet.identity}"
    pages = [
        [root, "/", "1"],
        *([child, f"/{child.identity}", str(n)] for n, (child, _, _) in enumerate(root.children, 2)),
    ]
    tree: Node = [
        "kicad_sch",
        ["version", FORMAT],
        ["generator", "resgrid"],
        ["generator_version", "9.0"],
        ["uuid", sheet.identity if sheet is root else identity("file", sheet.name)],
        ["paper", sheet.paper],
        title_block(title, revision, comments),
        ["lib_symbols", *(symbol_tree(used[name], library_name(used[name])) for name in sorted(used))],
        *(_area(number, area, sheet.name) for number, area in enumerate(sheet.areas)),
        *(_note(number, note, sheet.name) for number, note in enumerate(sheet.notes)),
        *(
            ["junction", ["at", *place], ["diameter", 0], uuid_of("junction", sheet.name, *place)]
            for place in sheet.junctions
        ),
        *(_wire(start, stop, sheet.name) for start, stop in dict.fromkeys(sheet.wires)),
        *(_label(number, label, sheet.name) for number, label in enumerate(sheet.labels)),
        *(_symbol(placed, path) for placed in sheet.symbols),
        *(_child(child, at, size, path, page) for page, (child, at, size) in enumerate(sheet.children, start=2)),
        *(
            [["sheet_instances", *(["path", place, ["page", page]] for _, place, page in pages[:1])]]
            if sheet is root
            else []
        ),
        ["embedded_fonts", NO],
    ]
    return format_tree(tree)


def _symbol(placed: PlacedSymbol, path: str) -> Node:
    """Return the S-expression of a symbol on a sheet; `path`: path of UUIDs of the sheet."""
    symbol = placed.symbol
    simulated = placed.simulation is not None and symbol.simulated
    fields = [
        ("Reference", placed.reference, placed.reference_at),
        ("Value", placed.value, placed.value_at),
        ("Footprint", placed.footprint, None),
        ("Datasheet", "", None),
        ("Description", "", None),
        *((name, value, None) for name, value in (placed.simulation or {}).items()),
    ]
    return [
        "symbol",
        ["lib_id", library_name(symbol)],
        ["at", placed.x, placed.y, placed.turn],
        ["unit", 1],
        ["exclude_from_sim", NO if simulated else YES],
        ["in_bom", YES if symbol.in_bom else NO],
        ["on_board", YES if symbol.on_board else NO],
        ["dnp", NO],
        uuid_of("symbol", placed.reference),
        *(_field(placed, name, text, place) for name, text, place in fields),
        *(["pin", pin.number, uuid_of("pin", placed.reference, pin.number)] for pin in symbol.pins),
        ["instances", ["project", PROJECT, ["path", path, ["reference", placed.reference], ["unit", 1]]]],
    ]


def _field(placed: PlacedSymbol, name: str, text: str, place: TextPlace | None) -> Node:
    """Return the S-expression of a text field of a symbol; the text is always horizontal.

    `name`, `text`: name and value of the field; `place`: its place, None if it is hidden.
    """
    if place is None:
        return ["property", name, text, ["at", placed.x, placed.y, 0], effects(hidden=True)]
    turned = 90 if placed.turn % 180 else 0
    at: Node = ["at", placed.x + place.x, placed.y + place.y, turned]
    return ["property", name, text, at, effects(place.size, align=place.align)]


def _wire(start: Point, stop: Point, sheet: str) -> Node:
    """Return the S-expression of a wire.

    `start`, `stop`: ends (x, y) in millimetres from the upper left corner of the sheet, y downwards; `sheet`: name of
    the sheet.  The UUID is derived from all three.
    """
    return [
        "wire", ["pts", ["xy", *start], ["xy", *stop]], ["stroke", ["width", 0], ["type", Word("default")]],
        uuid_of("wire", sheet, *start, *stop),
    ]  # fmt: skip


def _label(number: int, label: tuple[str, Point, int], sheet: str) -> Node:
    """Return the S-expression of a global label, which names a net on all sheets.

    `label`: net, place (x, y) in millimetres from the upper left corner of the sheet, y downwards, and rotation in
    degrees; `number`: index of the label on the sheet; `sheet`: name of the sheet.  The UUID is derived from the last
    two.
    """
    text, place, turn = label
    align = "right" if turn in (180, 270) else "left"
    return [
        "global_label", text, ["shape", Word("passive")], ["at", *place, turn], ["fields_autoplaced", YES],
        effects(1.0, align=align), uuid_of("label", sheet, number),
        ["property", "Intersheetrefs", "${INTERSHEET_REFS}", ["at", *place, 0], effects(1.0, hidden=True)],
    ]  # fmt: skip


def _note(number: int, note: tuple[str, Point, float], sheet: str) -> Node:
    """Return the S-expression of a text on a sheet.

    `note`: text, place (x, y) from the upper left corner of the sheet, y downwards, and height of letters, in
    millimetres; `number`: index of the text on the sheet; `sheet`: name of the sheet.  The UUID is derived from the
    last two.
    """
    text, place, size = note
    return [
        "text", text, ["exclude_from_sim", YES], ["at", *place, 0], effects(size, align="left"),
        uuid_of("note", sheet, number),
    ]  # fmt: skip


def _area(number: int, area: tuple[Point, Point, tuple[int, int, int]], sheet: str) -> Node:
    """Return the S-expression of a coloured rectangle behind the drawing.

    `area`: two opposite corners (x, y) in millimetres from the upper left corner of the sheet, y downwards, and red,
    green, blue from 0 to 255; `number`: index of the rectangle on the sheet; `sheet`: name of the sheet.  The UUID is
    derived from the last two.
    """
    start, stop, colour = area
    return [
        "rectangle", ["start", *start], ["end", *stop],
        ["stroke", ["width", 0.1], ["type", Word("solid")], ["color", *colour, 1]],
        ["fill", ["type", Word("color")], ["color", *colour, 1]], uuid_of("area", sheet, number),
    ]  # fmt: skip


def _child(child: Sheet, at: Point, size: Point, path: str, page: int) -> Node:
    """Return the S-expression of the symbol of a further sheet on the root sheet.

    `child`: the further sheet; `at`: upper left corner of the symbol in mm; `size`: width and height of the symbol in
    mm; `path`: path of UUIDs of the root; `page`: page number of the further sheet.
    """
    return [
        "sheet", ["at", *at], ["size", *size], ["exclude_from_sim", NO], ["in_bom", YES], ["on_board", YES],
        ["dnp", NO], ["stroke", ["width", 0.1524], ["type", Word("solid")]], ["fill", ["color", 0, 0, 0, 0]],
        ["uuid", child.identity],
        ["property", "Sheetname", child.name, ["at", at[0], at[1] - 0.8, 0], effects(1.27, align="left")],
        ["property", "Sheetfile", child.file, ["at", at[0], at[1] + size[1] + 1.4, 0], effects(1.27, align="left")],
        ["instances", ["project", PROJECT, ["path", path, ["page", str(page)]]]],
    ]  # fmt: skip
