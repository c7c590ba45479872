"""Comparison of the Gerber and drill files in an archive for a board manufacturer with those of the board."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from resgrid._internal.files import decode
from resgrid.errors import InputError
from resgrid.hardware.excellon import Hole, parse_excellon
from resgrid.hardware.gerber import CopperShape, parse_gerber

ORDER = "gerbers.zip"
"""Name of the archive in a board's folder that is sent to a manufacturer."""

_COPPER = re.compile(r"%TF\.FileFunction,Copper,L(\d+),")


def copper_layer(text: str) -> int | None:
    """Return the number of the copper layer that a Gerber file holds, from 1 for the front; None for other files."""
    match = _COPPER.search(text)
    return int(match[1]) if match else None


def compare_order(folder: Path, layers: Mapping[int, Sequence[CopperShape]], holes: Iterable[Hole]) -> list[str]:
    """Return a message for every copper layer of the archive for a manufacturer that differs from the board.

    A further message follows if the holes differ. Outlines and holes must be equal, without a tolerance.
    `folder`: folder of the board, perhaps with ``gerbers.zip``; `layers`: copper of the board by number of the layer;
    `holes`: all holes of the board.  Without an archive there is no message.
    """
    archive = folder / ORDER
    if not archive.is_file():
        return []
    try:
        with zipfile.ZipFile(archive) as files:
            texts = {name: decode(files.read(name), archive / name) for name in sorted(files.namelist())}
        ordered = {number: parse_gerber(text, name) for name, text in texts.items() if (number := copper_layer(text))}
        drilled = [hole for name, text in texts.items() if name.endswith(".drl") for hole in parse_excellon(text, name)]
    except (zipfile.BadZipFile, InputError, OSError) as error:
        return [f"{ORDER} cannot be read ({error}); export the Gerber files again"]
    messages = [
        f"{ORDER}: copper layer {number} differs from the board; export the Gerber files again"
        for number in sorted({*layers, *ordered})
        if _outlines(layers.get(number, ())) != _outlines(ordered.get(number, ()))
    ]
    if set(drilled) != set(holes):
        messages.append(f"{ORDER}: the holes differ from the board; export the drill files again")
    return messages


def _outlines(shapes: Iterable[CopperShape]) -> set[bytes]:
    """Return the outlines of shapes in a normal form, as bytes, so that equal shapes have equal outlines."""
    return {shape.geometry.normalize().wkb for shape in shapes}
