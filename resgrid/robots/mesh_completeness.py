"""Detection of mesh files that are cut short, from which an obstacle would be lost without notice."""

from __future__ import annotations

import re
from pathlib import Path

from resgrid.errors import InputError

_ELEMENT = re.compile(rb"^element\s+\S+\s+(\d+)", re.MULTILINE)
"""Pattern of the line in a PLY header that holds the number of vertices, faces or other elements."""


def check_complete(data: bytes, suffix: str, path: Path) -> None:
    """Raise InputError for the content of a PLY file that is visibly cut short.

    The reader of STL files and XML parsers reject such files themselves; OBJ files contain no counts.

    `data`: content of the file; `suffix`: suffix in lower case; `path`: name of the file, for the message.
    """
    if suffix == ".ply":
        head, mark, body = data.partition(b"end_header")
        if not mark:
            raise _cut_short(path, "a header that ends with end_header", "no such line")
        if re.search(rb"^format\s+ascii", head, re.MULTILINE):
            _check_lines(body, sum(int(count) for count in _ELEMENT.findall(head)), path)


def _lines(data: bytes) -> list[bytes]:
    """Return the lines of a text without empty ones, stripped of spaces."""
    return [line.strip() for line in data.splitlines() if line.strip()]


def _check_lines(body: bytes, needed: int, path: Path) -> None:
    """Raise InputError unless a text has as many lines as its header announces."""
    found = len(_lines(body))
    if found < needed:
        raise _cut_short(path, f"{needed} lines of vertices and faces", f"{found}")


def _cut_short(path: Path, needed: str, found: str) -> InputError:
    return InputError(f"{path}: the file is cut short or damaged: it needs {needed}, but has {found}; copy it again")
