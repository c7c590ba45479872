"""Reader of the triangles of Wavefront OBJ files; ignores materials, and rejects faces that it cannot read.

Other readers of OBJ skip faces that they cannot read, or count negative indices from the end of the file instead of the
last vertex above the face.  A dropped or misplaced triangle is a missed collision, so that this reader raises
InputError for every line that it cannot read.  The format has no end mark: a file that is cut off between two lines
cannot be detected.  Source: Wavefront Object Files (Appendix B1 of the Advanced Visualizer manual).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError

_MOST = 1 << 31
"""Smallest index of a vertex that is too large; such an index raises InputError."""

_CURVED = ("surf", "bsp", "bzp", "cdc", "cdp", "res", "call")
"""Keywords that raise InputError: surfaces that are no polygons, and the inclusion of other files (``call``)."""


def read_obj(data: bytes, name: str) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices (v, 3) of an OBJ file, in its units, and the triangles (t, 3), indices of vertices.

    A polygon becomes a fan of triangles around its first corner; the fan covers the polygon even if it is not convex.

    Parameters
    ----------
    data : bytes
        Content of the file.
    name : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If a vertex or face cannot be read, a face refers to a vertex that does not exist, or the file has surfaces that
        are no polygons.
    """
    points: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    lines = data.decode("utf-8", errors="replace").replace("\r\n", "\n").replace("\\\n", " \x00").split("\n")
    number = 1
    for line in lines:
        words = line.partition("#")[0].replace("\x00", "").split()
        place = f"{name}: line {number}"
        number += 1 + line.count("\x00")
        if not words:
            continue
        if words[0] == "v":
            points.append(_vertex(words[1:], place))
        elif words[0] in ("f", "fo"):
            corners = [_index(word, len(points), place) for word in words[1:]]
            if len(corners) < 3:
                raise InputError(f"{place}: a face has {len(corners)} corners; the mesh is damaged, export it again")
            triangles += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
        elif words[0] in _CURVED:
            raise InputError(f"{place}: {words[0]!r} is no polygon; export the mesh as triangles")
    return np.array(points, dtype=np.float64).reshape(-1, 3), np.array(triangles, dtype=np.int32).reshape(-1, 3)


def _vertex(words: list[str], place: str) -> list[float]:
    """Return the three coordinates of a vertex; a weight or colour after them is ignored.

    `words`: words of the line after the keyword ``v``; `place`: file and line, for messages. Raises InputError for
    fewer than three finite numbers.
    """
    try:
        x, y, z = (float(word) for word in words[:3])
    except ValueError:
        raise InputError(f"{place}: a vertex has no three numbers; the mesh is damaged, export it again") from None
    return [x, y, z]


def _index(word: str, count: int, place: str) -> int:
    """Return the index of a vertex, from 0, of a corner such as ``"3/1/2"``; raise InputError for other words.

    `count`: number of vertices above the face in the file; `place`: file and line, for messages.
    Positive numbers count from 1, and may refer to vertices below the face.  Negative numbers count back from the last
    vertex above the face.
    """
    try:
        number = int(word.partition("/")[0])
    except ValueError:
        raise InputError(
            f"{place}: corner {word!r} has no vertex number; the mesh is damaged, export it again"
        ) from None
    index = number - 1 if number > 0 else count + number
    if not number or not 0 <= index < _MOST:
        raise InputError(f"{place}: corner {word!r} refers to a vertex that does not exist; repair the mesh")
    return index
