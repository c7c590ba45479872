"""Writer of a board as a folder with a KiCad project."""

from __future__ import annotations

import os
from pathlib import Path

from resgrid._internal.files import SUMMARY, whole_folder
from resgrid.hardware.board import Board
from resgrid.hardware.board_files import described, write_board
from resgrid.io.tables import json_text


def save_board(board: Board, file: str | os.PathLike[str]) -> Path:
    """Write the KiCad project of a board and its documents into a folder, and return the folder.

    The documents are the bill of materials, expected voltages, a record of the circuit as JSON, and a README.
    `file`: name of the folder, which is created. Files that need the program kicad-cli, and the picture of the jumper
    plan, are written only by the subcommand ``resgrid board``.
    """
    with whole_folder(Path(file)) as work:
        names = write_board(board, work)
        text = json_text({"files": dict(described([*names, SUMMARY]))}) + "\n"
        (work / SUMMARY).write_text(text, encoding="utf-8")
    return Path(file)
