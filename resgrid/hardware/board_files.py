"""Writer of the files in a board's folder: KiCad project, lists, README, record, and files for a manufacturer.

kicad-cli writes the files for a manufacturer, pictures and the printed schematic.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from resgrid._internal.files import write_text
from resgrid.hardware.bill import BILL, VOLTAGES, format_bill, format_voltages
from resgrid.hardware.board import FILE, REVISION, Board
from resgrid.hardware.board_schematic import draw_schematic
from resgrid.hardware.kicad.footprints import LIBRARY, Graphics, PlacedFootprint, format_footprint
from resgrid.hardware.kicad.pcb import BoardDrawing, format_board
from resgrid.hardware.kicad.project import format_footprint_table, format_project, format_symbol_table
from resgrid.hardware.kicad.schematic import PROJECT, Sheet, format_sheet, symbol_path
from resgrid.hardware.kicad.symbols import format_symbols
from resgrid.hardware.plane import fill_plane
from resgrid.hardware.record import format_record
from resgrid.hardware.routing import route
from resgrid.hardware.silkscreen import draw_silkscreen
from resgrid.hardware.teacher_readme import format_readme
from resgrid.hardware.tools import KicadCli

_CORNER_RADIUS = 3.0
"""Radius of the rounded corners of the board, in millimetres."""

_SHEETS = (("A4", 297.0, 210.0), ("A3", 420.0, 297.0), ("A2", 594.0, 420.0), ("A1", 841.0, 594.0))
"""Paper sizes for the drawing of the board: name, width and height in millimetres, ascending; the first fit is used.

A drawing that fits on none of them gets the size A0.
"""

_TITLE_BLOCK = 45.0
"""Height of a sheet's title block with its margins, in millimetres, which the board must leave free."""

_FIRST_TIME = (1980, 1, 1, 0, 0, 0)
"""Time stamp (year, month, day, hour, minute, second) of all files in ``gerbers.zip``.

A fixed time stamp gives the same bytes of the archive for the same files.
"""


def board_files(board: Board, *, manufactured: bool = False) -> dict[str, str]:
    """Return the content of the text files of a board by file name; names in subfolders contain a slash.

    `manufactured`: whether the README also describes the files that kicad-cli writes for a manufacturer; otherwise it
    explains how to make them.
    """
    sheets = draw_schematic(board.placement)
    comments = (board.subtitle, *board.legend[:2])
    symbols = {placed.symbol.name: placed.symbol for sheet in sheets for placed in sheet.symbols}
    footprints = {placed.footprint.name: placed.footprint for placed in board.placement.parts}
    files = {
        f"{PROJECT}.kicad_pro": format_project(PROJECT, [(sheet.identity, sheet.name or "Root") for sheet in sheets]),
        FILE: format_board(_drawing(board, sheets)),
        f"{LIBRARY}.kicad_sym": format_symbols([symbols[name] for name in sorted(symbols)]),
        "sym-lib-table": format_symbol_table(),
        "fp-lib-table": format_footprint_table(),
        f"{PROJECT}.record.json": format_record(board.record()),
        BILL: format_bill(board),
        VOLTAGES: format_voltages(board),
        "README.md": format_readme(board, board.predicted_yields, manufactured=manufactured),
    }
    for sheet in sheets:
        files[sheet.file] = format_sheet(sheet, sheets[0], board.title, REVISION, comments)
    for name, footprint in footprints.items():
        files[f"{LIBRARY}.pretty/{name}.kicad_mod"] = format_footprint(footprint)
    return files


def write_board(board: Board, folder: Path, *, manufactured: bool = False) -> list[str]:
    """Write the text files of a board into an existing folder; return their names relative to the folder, sorted.

    `manufactured`: whether the README also describes the files that kicad-cli writes for a manufacturer; otherwise it
    explains how to make them.
    """
    files = board_files(board, manufactured=manufactured)
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        write_text(folder / name, text)
    return sorted(files)


def _drawing(board: Board, sheets: list[Sheet]) -> BoardDrawing:
    """Return the drawing of a board: outline, footprints, tracks, vias, copper plane and printed texts.

    `sheets`: sheets of the schematic; each footprint refers to its symbol there.
    """
    placement = board.placement
    routing = route(placement)
    paths = {
        placed.reference: symbol_path(sheet, placed.reference)
        for sheet in sheets
        for placed in sheet.symbols
        if placed.symbol.on_board and not placed.symbol.power
    }
    (x0, y0), (width, height) = placement.origin, placement.size
    needed = (x0 * 2 + width, y0 + height + _TITLE_BLOCK)
    paper = next((name for name, *size in _SHEETS if needed[0] <= size[0] and needed[1] <= size[1]), "A0")
    return BoardDrawing(
        board.title,
        REVISION,
        (board.subtitle, *board.legend[:2]),
        placement.size,
        placement.origin,
        _CORNER_RADIUS,
        paper,
        [_with_path(placed, paths) for placed in placement.parts],
        routing.tracks,
        routing.vias,
        fill_plane(placement, routing),
        silkscreen_of(board),
    )


def silkscreen_of(board: Board) -> Graphics:
    """Return the texts and lines that are printed on a board."""
    return draw_silkscreen(board.placement, (board.title, board.subtitle, board.legend), board.starts)


def _with_path(placed: PlacedFootprint, paths: Mapping[str, str]) -> PlacedFootprint:
    """Return a copy of a footprint that refers to the part's symbol in the schematic, if the part has a symbol.

    `paths`: UUIDs that lead to each symbol, as text such as ``/UUID/UUID``, by reference of the part.
    """
    return replace(placed, path=paths.get(placed.reference, ""))


def manufacture(kicad: KicadCli, folder: Path) -> list[str]:
    """Run kicad-cli to write the files for a manufacturer, pictures and a printed schematic; return their names.

    `folder`: folder with the text files of the board, to which the new files are added. The names are relative to it.
    """
    board, sheet = folder / FILE, folder / f"{PROJECT}.kicad_sch"
    gerbers = folder / "gerbers"
    gerbers.mkdir(exist_ok=True)
    layers = "F.Cu,B.Cu,F.Mask,B.Mask,F.Paste,F.SilkS,B.SilkS,Edge.Cuts"
    picture = ("--background", "opaque", "-w", "1600", "-h", "1600")
    runs = (
        ("pcb", "export", "gerbers", "--layers", layers, "-o", gerbers, board),
        ("pcb", "export", "drill", "-o", gerbers, board),
        ("pcb", "export", "pos", "--format", "csv", "--units", "mm", "-o", folder / "positions.csv", board),
        ("pcb", "export", "ipcd356", "-o", folder / "grid.d356", board),
        ("sch", "export", "pdf", "-o", folder / "schematic.pdf", sheet),
        ("pcb", "render", "--side", "top", *picture, "-o", folder / "board_front.png", board),
        ("pcb", "render", "--side", "bottom", *picture, "-o", folder / "board_back.png", board),
    )
    for run in runs:
        kicad.run(*run)
    for left in folder.glob("*.kicad_prl"):
        left.unlink()
    names = sorted(file.relative_to(folder).as_posix() for file in gerbers.iterdir())
    _pack(folder, names)
    return [*names, "gerbers.zip", "positions.csv", "grid.d356", "schematic.pdf", "board_front.png", "board_back.png"]


def _pack(folder: Path, names: list[str]) -> None:
    """Write the archive ``gerbers.zip`` into `folder`; `names`: paths of the archived files, relative to `folder`."""
    with zipfile.ZipFile(folder / "gerbers.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.writestr(zipfile.ZipInfo(Path(name).name, _FIRST_TIME), (folder / name).read_bytes())


def described(names: list[str]) -> Iterator[tuple[str, str]]:
    """Yield each of the given file names of a board's folder with a description of the file as text."""
    abouts = {
        ".kicad_pro": "the KiCad project",
        ".kicad_sch": "the schematic, or a sheet of it",
        ".kicad_pcb": "the board",
        ".kicad_sym": "symbols of the project",
        ".kicad_mod": "a footprint of the project",
        "-lib-table": "table of the project's libraries",
        ".record.json": "parts, nets and expected voltages, for 'resgrid check'",
        BILL: "parts to buy",
        VOLTAGES: "expected voltage of every test pad",
        "README.md": "instructions for teachers",
        "jumper_plan.pdf": "the bridges of this scene",
        "jumper_plan.png": "the bridges of this scene",
        "expected_voltages.pdf": "picture of the expected voltages",
        "expected_voltages.png": "picture of the expected voltages",
        "summary.json": "this summary as JSON",
        "gerbers.zip": "files for the manufacturer",
        "positions.csv": "places of the parts",
        "grid.d356": "nets of all pads (IPC-D-356)",
        "schematic.pdf": "the printed schematic",
        "board_front.png": "picture of the front",
        "board_back.png": "picture of the back",
    }
    for name in names:
        yield name, next((about for end, about in abouts.items() if name.endswith(end)), "Gerber or drill file")
