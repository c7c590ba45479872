"""Detection of mesh files that are cut short, from which an obstacle would be lost without notice."""

from __future__ import annotations

import re
from pathlib import Path

from resgrid.errors import InputError

_STL_HEAD, _STL_TRIANGLE = 84, 50
"""Bytes before the triangles of a binary STL file, and bytes of a triangle."""

_ELEMENT = re.compile(rb"^element\s+\S+\s+(\d+)", re.MULTILINE)
"""Pattern of the line in a PLY header that holds the number of vertices, faces or other elements."""


def check_complete(data: bytes, suffix: str, path: Path) -> None:
    """Raise InputError for the content of an STL or PLY file that is visibly cut short.

    OBJ files contain no counts.  XML parsers reject COLLADA files that are cut short.

    `data`: content of the file; `suffix`: suffix in lower case; `path`: name of the file, for the message.
    """
    if suffix == ".stl":
        _check_stl(data, path)
    elif suffix == ".ply":
        head, mark, body = data.partition(b"end_header")
        if not mark:
            raise _cut_short(path, "a header that ends with end_header", "no such line")
        if re.search(rb"^format\s+ascii", head, re.MULTILINE):
            _check_lines(body, sum(int(count) for count in _ELEMENT.findall(head)), path)


def _check_stl(data: bytes, path: Path) -> None:
    """Raise InputError for an STL file that is cut short: binary by its length, ASCII by its last line."""
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096].lower():
        facets, ends = data.lower().count(b"facet normal"), data.lower().count(b"endfacet")
        if facets != ends or b"endsolid" not in data[-4096:].lower():
            raise _cut_short(path, f"{facets} times endfacet and a line endsolid", f"{ends} times endfacet")
        return
    count = int.from_bytes(data[_STL_HEAD - 4 : _STL_HEAD], "little")
    if len(data) < _STL_HEAD + count * _STL_TRIANGLE:
        raise _cut_short(path, f"{_STL_HEAD + count * _STL_TRIANGLE} bytes for {count} triangles", f"{len(data)} bytes")


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
