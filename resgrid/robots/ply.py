"""Checks of the text of PLY mesh files: truncation, missing coordinates, number of faces; trimesh reads the meshes."""

from __future__ import annotations

import re

from resgrid.errors import InputError

_ELEMENT = re.compile(rb"^element\s+\S+\s+(\d+)", re.MULTILINE)
"""Pattern of a line in a PLY header that declares an element: vertices, faces or others; group 1 is their number."""

_FACES = re.compile(rb"^element\s+face\s+(\d+)", re.MULTILINE)
"""Pattern of the line in a PLY header that declares the faces; group 1 is their number."""

_VERTICES = re.compile(rb"^element\s+vertex\s+0*[1-9]\d*\s*?$(.*?)(?=^element\s|\Z)", re.MULTILINE | re.DOTALL)
"""Pattern of the lines of a PLY header that declare at least one vertex; group 1 holds the lines of properties."""

_PROPERTY = re.compile(rb"^property\s.*?(\S+)\s*?$", re.MULTILINE)
"""Pattern of the line in a PLY header that declares a property; group 1 is its name."""


def check_ply(data: bytes, name: str) -> None:
    """Raise InputError if a PLY file is cut short, or if the vertices of the file lack a coordinate.

    A file counts as cut short if its header has no end, or if it is text with fewer lines than the header declares.
    `data`: bytes of the file; `name`: name of the file in messages.

    trimesh checks the length of binary files only: from the text of a file that is cut short it would read a part.
    """
    head, mark, body = data.partition(b"end_header")
    if not mark:
        raise _cut_short(name, "a header that ends with end_header", "no such line")
    vertices = _VERTICES.search(head)
    lacking = [axis for axis in "xyz" if vertices and axis.encode() not in _PROPERTY.findall(vertices[1])]
    if lacking:
        raise InputError(
            f"{name}: the vertices of this PLY file lack {' and '.join(lacking)}, but x, y and z are needed; save it "
            "again with all three"
        )
    needed = sum(map(int, _ELEMENT.findall(head)))
    found = sum(1 for line in body.splitlines() if line.strip())
    if re.search(rb"^format\s+ascii", head, re.MULTILINE) and found < needed:
        raise _cut_short(name, f"{needed} lines of vertices and faces", str(found))


def count_faces(data: bytes) -> int:
    """Return the number of faces that the header of a PLY file declares, 0 if none; `data`: bytes of the file."""
    found = _FACES.search(data.partition(b"end_header")[0])
    return 0 if found is None else int(found[1])


def _cut_short(name: str, needed: str, found: str) -> InputError:
    return InputError(f"{name}: the file is cut short or damaged: it needs {needed}, but has {found}; copy it again")
