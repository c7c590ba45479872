"""Headers of PLY files: detection of files that are cut short, and the number of faces."""

from __future__ import annotations

import re

from resgrid.errors import InputError

_ELEMENT = re.compile(rb"^element\s+\S+\s+(\d+)", re.MULTILINE)
"""Pattern of the line in a PLY header that holds the number of vertices, faces or other elements."""

_FACES = re.compile(rb"^element\s+face\s+(\d+)", re.MULTILINE)
"""Pattern of the line in a PLY header that holds the number of faces."""


def check_ply(data: bytes, name: str) -> None:
    """Raise InputError for the bytes of a PLY file that is visibly cut short; `name`: name of the file in messages.

    trimesh checks the length of binary files only: from the text of a file that is cut short it would read a part.
    """
    head, mark, body = data.partition(b"end_header")
    if not mark:
        raise _cut_short(name, "a header that ends with end_header", "no such line")
    needed = sum(map(int, _ELEMENT.findall(head)))
    found = sum(1 for line in body.splitlines() if line.strip())
    if re.search(rb"^format\s+ascii", head, re.MULTILINE) and found < needed:
        raise _cut_short(name, f"{needed} lines of vertices and faces", str(found))


def count_faces(data: bytes) -> int:
    """Return the number of faces in the header of a PLY file; `data`: bytes of the file."""
    found = _FACES.search(data.partition(b"end_header")[0])
    return 0 if found is None else int(found[1])


def _cut_short(name: str, needed: str, found: str) -> InputError:
    return InputError(f"{name}: the file is cut short or damaged: it needs {needed}, but has {found}; copy it again")
