"""Types for tracks, vias, the copper plane and the contents of a board, and the writer of KiCad's board file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from resgrid.hardware.kicad.footprints import FORMAT, Graphics, PlacedFootprint, Text, placed_tree
from resgrid.hardware.kicad.sexpr import NO, YES, Node, Word, format_tree, uuid_of

Point = tuple[float, float]

_LAYERS: tuple[tuple[int, str, str, str], ...] = (
    (0, "F.Cu", "signal", ""),
    (2, "B.Cu", "signal", ""),
    (13, "F.Paste", "user", ""),
    (15, "B.Paste", "user", ""),
    (5, "F.SilkS", "user", "F.Silkscreen"),
    (7, "B.SilkS", "user", "B.Silkscreen"),
    (1, "F.Mask", "user", ""),
    (3, "B.Mask", "user", ""),
    (25, "Edge.Cuts", "user", ""),
    (27, "Margin", "user", ""),
    (31, "F.CrtYd", "user", "F.Courtyard"),
    (29, "B.CrtYd", "user", "B.Courtyard"),
    (35, "F.Fab", "user", ""),
    (33, "B.Fab", "user", ""),
)
"""Number, name, type and displayed name ("" for the name itself) of the layers of a board with two copper layers."""


@dataclass(frozen=True)
class Track:
    """A straight piece of copper.

    `start`, `stop`: ends (x, y) in mm from the upper left corner of the sheet, y downwards; `net`: its net; `layer`:
    name of the copper layer; `width`: in mm.
    """

    start: Point
    stop: Point
    net: str
    layer: str = "F.Cu"
    width: float = 0.25


@dataclass(frozen=True)
class Via:
    """A plated hole that joins both copper layers.

    `x`, `y`: centre, from the upper left corner of the sheet, y downwards; `net`: its net; `size`, `drill`: diameters
    of the copper and of the hole; lengths are in mm.
    """

    x: float
    y: float
    net: str
    size: float = 0.8
    drill: float = 0.4


@dataclass(frozen=True)
class Plane:
    """A filled area of copper.

    Lengths are in millimetres, from the upper left corner of the sheet, y downwards. `net`: its net; `layer`: name of
    the copper layer; `outline`: corners of the zone that may be filled; `filled`: corners of each polygon of copper;
    `clearance`: distance from copper of other nets, as stated in the board file.
    """

    net: str
    layer: str
    outline: tuple[Point, ...]
    filled: tuple[tuple[Point, ...], ...]
    clearance: float = 0.25


@dataclass(frozen=True)
class BoardDrawing:
    """Contents of a board file.

    `title`, `revision`, `comments`: texts of the title block; `size`: width and height of the board; `origin`: upper
    left corner (x, y) of the board, from that of the sheet, y downwards; `radius`: radius of the board's rounded
    corners; lengths are in millimetres; `paper`: name of the sheet's size; `footprints`: placed parts; `tracks`,
    `vias`, `plane`: copper; `graphics`: printed lines and texts.
    """

    title: str
    revision: str
    comments: tuple[str, ...]
    size: Point
    origin: Point
    radius: float
    paper: str
    footprints: Sequence[PlacedFootprint]
    tracks: Sequence[Track]
    vias: Sequence[Via]
    plane: Plane
    graphics: Graphics


def format_board(board: BoardDrawing) -> str:
    """Return the text of a board file (``.kicad_pcb``)."""
    names = {net for placed in board.footprints for net in placed.nets} | {board.plane.net}
    names |= {track.net for track in board.tracks} | {via.net for via in board.vias}
    numbers = {name: number for number, name in enumerate(sorted(names), start=1)}
    tree: Node = [
        "kicad_pcb",
        ["version", FORMAT],
        ["generator", "resgrid"],
        ["generator_version", "9.0"],
        ["general", ["thickness", 1.6], ["legacy_teardrops", NO]],
        ["paper", board.paper],
        title_block(board.title, board.revision, board.comments),
        [
            "layers",
            *([Word(number), name, Word(kind), *([user] if user else [])] for number, name, kind, user in _LAYERS),
        ],
        _setup(),
        ["net", 0, ""],
        *(["net", number, name] for name, number in numbers.items()),
        *(placed_tree(placed, numbers) for placed in board.footprints),
        *_outline(board),
        *(_line(number, *line) for number, line in enumerate(board.graphics.lines)),
        *(_text(number, text) for number, text in enumerate(board.graphics.texts)),
        *(_track(track, numbers[track.net]) for track in board.tracks),
        *(_via(via, numbers[via.net]) for via in board.vias),
        _zone(board.plane, numbers[board.plane.net]),
        ["embedded_fonts", NO],
    ]
    return format_tree(tree)


def title_block(title: str, revision: str, comments: Iterable[str]) -> Node:
    """Return the S-expression of the title block of a schematic or board.

    It states no date, so that the same scene gives the same bytes.
    """
    numbered = (["comment", number, text] for number, text in enumerate(comments, start=1))
    return ["title_block", ["title", title], ["rev", revision], ["company", "resgrid"], *numbered]


def _setup() -> Node:
    """Return the S-expression of the settings of a board: the solder mask covers the vias."""
    return [
        "setup",
        ["pad_to_mask_clearance", 0],
        ["allow_soldermask_bridges_in_footprints", NO],
        ["tenting", Word("front"), Word("back")],
    ]


def _outline(board: BoardDrawing) -> list[Node]:
    """Return the S-expressions of the outline of a board, a rectangle with rounded corners."""
    (x0, y0), (width, height), r = board.origin, board.size, board.radius
    x1, y1 = x0 + width, y0 + height
    half = r * (1 - 0.5**0.5)
    sides = (
        ((x0 + r, y0), (x1 - r, y0)),
        ((x1, y0 + r), (x1, y1 - r)),
        ((x1 - r, y1), (x0 + r, y1)),
        ((x0, y1 - r), (x0, y0 + r)),
    )
    arcs = (
        ((x1 - r, y0), (x1 - half, y0 + half), (x1, y0 + r)),
        ((x1, y1 - r), (x1 - half, y1 - half), (x1 - r, y1)),
        ((x0 + r, y1), (x0 + half, y1 - half), (x0, y1 - r)),
        ((x0, y0 + r), (x0 + half, y0 + half), (x0 + r, y0)),
    )
    stroke: Node = ["stroke", ["width", 0.1], ["type", Word("solid")]]
    layer: Node = ["layer", "Edge.Cuts"]
    return [
        *(["gr_line", ["start", *a], ["end", *b], stroke, layer, uuid_of("side", n)] for n, (a, b) in enumerate(sides)),
        *(
            ["gr_arc", ["start", *a], ["mid", *b], ["end", *c], stroke, layer, uuid_of("corner", n)]
            for n, (a, b, c) in enumerate(arcs)
        ),
    ]


def _line(number: int, x0: float, y0: float, x1: float, y1: float, width: float, layer: str) -> Node:
    """Return the S-expression of a printed line.

    `number`: index of the line, for its UUID; `x0`, `y0`, `x1`, `y1`: ends in mm from the upper left corner of the
    sheet, y downwards; `width`: in mm; `layer`: name of the layer.
    """
    return [
        "gr_line", ["start", x0, y0], ["end", x1, y1], ["stroke", ["width", width], ["type", Word("solid")]],
        ["layer", layer], uuid_of("line", number),
    ]  # fmt: skip


def _text(number: int, text: Text) -> Node:
    """Return the S-expression of a printed text, mirrored on the back; `number`: index of the text, for its UUID."""
    justify = [*([Word(text.align)] if text.align else []), *([Word("mirror")] if text.layer.startswith("B.") else [])]
    return [
        "gr_text", text.text, ["at", text.x, text.y, text.turn], ["layer", text.layer], uuid_of("words", number),
        ["effects", ["font", ["size", text.size[1], text.size[0]], ["thickness", text.thickness]],
         *([["justify", *justify]] if justify else [])],
    ]  # fmt: skip


def _track(track: Track, net: int) -> Node:
    """Return the S-expression of a track; `net`: number of its net."""
    return [
        "segment", ["start", *track.start], ["end", *track.stop], ["width", track.width], ["layer", track.layer],
        ["net", net], uuid_of("track", *track.start, *track.stop, track.layer),
    ]  # fmt: skip


def _via(via: Via, net: int) -> Node:
    """Return the S-expression of a via; `net`: number of its net."""
    return [
        "via", ["at", via.x, via.y], ["size", via.size], ["drill", via.drill], ["layers", "F.Cu", "B.Cu"],
        ["net", net], uuid_of("via", via.x, via.y),
    ]  # fmt: skip


def _zone(plane: Plane, net: int) -> Node:
    """Return the S-expression of the copper plane with its computed polygons; `net`: number of its net."""
    return [
        "zone", ["net", net], ["net_name", plane.net], ["layer", plane.layer], uuid_of("plane"), ["name", "rail plane"],
        ["hatch", Word("edge"), 0.5], ["connect_pads", ["clearance", plane.clearance]], ["min_thickness", 0.25],
        ["filled_areas_thickness", NO],
        ["fill", YES, ["thermal_gap", 0.4], ["thermal_bridge_width", 0.6]],
        ["polygon", _points(plane.outline)],
        *(["filled_polygon", ["layer", plane.layer], _points(polygon)] for polygon in plane.filled),
    ]  # fmt: skip


def _points(corners: Iterable[Point]) -> Node:
    """Return the S-expression of the corners of a polygon, in millimetres."""
    return ["pts", *(["xy", *corner] for corner in corners)]
