"""Reader of the triangles of STL files, binary and ASCII; rejects files that are not complete.

Other readers of STL return the readable part of a damaged file.  A dropped triangle is a missed collision, so that this
reader raises InputError for everything that is not a complete file.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError

_HEAD, _FACET = 84, 50
"""Number of bytes of the head of a binary file, which ends with the number of triangles, and of every triangle."""

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""Data type of a triangle in a binary file: normal (ignored), corners (3, 3), and attribute (ignored)."""

_NUMBER = rb"\s+(\S+)\s+(\S+)\s+(\S+)\s+"
_TRIANGLE = re.compile(
    rb"facet\s+normal" + _NUMBER + rb"outer\s+loop\s+" + 3 * (rb"vertex" + _NUMBER) + rb"endloop\s+endfacet",
    re.IGNORECASE,
)
"""Pattern of a triangle in an ASCII file; its groups are the numbers of the normal and of the three corners."""


def read_stl(data: bytes, name: str) -> NDArray[np.float64]:
    """Return the corners (t, 3, 3) of the triangles of an STL file, in its units.

    Parameters
    ----------
    data : bytes
        Content of the file.
    name : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If the file is neither a complete binary file nor a complete ASCII file.
    """
    if len(data) >= _HEAD:
        count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
        if len(data) == _HEAD + count * _FACET:
            return np.frombuffer(data, _RECORD, count, _HEAD)["corners"].astype(np.float64)
    if not re.match(rb"\s*solid\b", data, re.IGNORECASE):
        raise _damaged(name, f"{len(data)} bytes are no whole number of triangles")
    return _ascii_corners(data, name)


def _ascii_corners(data: bytes, name: str) -> NDArray[np.float64]:
    """Return the corners (t, 3, 3) of the triangles of an ASCII file, which may hold several solids.

    Raises InputError for a file with other text than complete solids. `name`: name of the file in messages.
    """
    found = _TRIANGLE.findall(data)
    lines = len(re.findall(rb"^\s*facet\b", data, re.IGNORECASE | re.MULTILINE))
    if len(found) != lines or not re.search(rb"\bendsolid\b[^\n]*\s*\Z", data, re.IGNORECASE):
        raise _damaged(name, f"the file ends or is interrupted after {len(found)} complete triangles")
    try:
        corners = np.array([triangle[3:] for triangle in found]).astype(np.float64)
    except ValueError:
        raise _damaged(name, "a coordinate is no number") from None
    return corners.reshape(-1, 3, 3)


def _damaged(name: str, problem: str) -> InputError:
    """Return the InputError for a damaged file; `name`: name of the file; `problem`: phrase that states the damage."""
    return InputError(f"{name}: the mesh cannot be read as STL ({problem}); export it again")
