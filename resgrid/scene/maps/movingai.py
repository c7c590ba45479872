"""MovingAI benchmark maps (``.map``) and their scenarios (``.scen``).

Format: N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", IEEE Trans. Comput. Intell. AI in Games 4 (2012) 144,
and https://movingai.com/benchmarks/formats.html.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np

from resgrid.budget import SMALLER_MAP, require_grid_memory
from resgrid.errors import InputError
from resgrid.files import read_text
from resgrid.scene.maps.arrays import MapCells, cells_from_rows, placed_axes
from resgrid.space import Cell

TERRAIN = ".G@OTSW"
PASSABLE = ".GS"
TYPES = ("octile", "tile", "octile_unicost")
SCENARIO_FIELDS = 9


@dataclass(frozen=True)
class Query:
    """One problem of a scenario file.

    Attributes
    ----------
    bucket : int
        Difficulty class: the optimal length divided by four.
    map : str
        The map file as the scenario names it.
    width, height : int
        Size of the map.
    start, goal : tuple of int
        Cells in this package's convention: file column ``c``, row ``r`` (row 0 on top) is ``(c, height - 1 - r)``.
    optimal_length : float
        Length of the shortest octile path, in cells; diagonal steps cost sqrt(2) and cut no corner.
    """

    bucket: int
    map: str
    width: int
    height: int
    start: tuple[int, int]
    goal: tuple[int, int]
    optimal_length: float


def read_movingai(path: Path, passable: str = PASSABLE) -> MapCells:
    """Read a MovingAI map; a cell is 1 x 1, in units of ``cell``.

    Parameters
    ----------
    passable
        Letters of free terrain.
    """
    unknown = sorted(set(passable) - set(TERRAIN))
    if unknown:
        raise InputError(f"map.passable: {''.join(unknown)!r} is no terrain; the letters are {TERRAIN}")
    lines = read_text(path).split("\n")
    first, width, height = _header(lines, path)
    rows = lines[first : first + height]
    while rows and not rows[-1].strip():
        rows.pop()
    _check_rows(rows, lines, path, first, width, height)
    require_grid_memory((width, height), str(path), remedy=SMALLER_MAP)
    letters = np.frombuffer("".join(row.rstrip() for row in rows).encode(), dtype=np.uint8).reshape(height, width)
    free = np.zeros(256, dtype=bool)
    free[[ord(letter) for letter in passable]] = True
    cell = cells_from_rows(np.where(free[letters], Cell.FREE, Cell.OBSTACLE).astype(np.uint8))
    return MapCells(placed_axes(cell.shape), cell)


def read_queries(file: str | os.PathLike[str]) -> list[Query]:
    r"""Read the problems of a MovingAI scenario file, version 1.

    Parameters
    ----------
    file : path-like
        The ``.scen`` file.

    Returns
    -------
    list of Query
        In the order of the file.

    Raises
    ------
    InputError
        If the version or a line is wrong; the message names the line.

    Examples
    --------
    >>> from pathlib import Path
    >>> size = Path("a.scen").write_text("version 1\n0\ta.map\t4\t2\t0\t0\t1\t1\t1.41421356\n")
    >>> (query,) = rg.read_queries("a.scen")
    >>> query.start, query.goal, query.optimal_length
    ((0, 1), (1, 0), 1.41421356)
    """
    path = Path(file)
    lines = read_text(path).split("\n")
    version = lines[0].split()
    if len(version) != 2 or version[0] != "version" or version[1] not in ("1", "1.0"):
        raise InputError(f"{path}: line 1: expected 'version 1', got {lines[0][:40]!r}; is this a scenario file?")
    return [_query(line, path, number) for number, line in enumerate(lines[1:], 2) if line.strip()]


def _header(lines: list[str], path: Path) -> tuple[int, int, int]:
    values: dict[str, str] = {}
    for number, line in enumerate(lines[:8], 1):
        words = line.split()
        if words == ["map"]:
            return number, *_sizes(values, path)
        if len(words) != 2 or words[0] not in ("type", "height", "width"):
            raise InputError(
                f"{path}: line {number}: expected 'type octile', 'height N', 'width N' and 'map', got {line[:40]!r}"
            )
        if words[0] == "type" and words[1] not in TYPES:
            raise InputError(f"{path}: line {number}: type {words[1]!r} is not square; it may be {', '.join(TYPES)}")
        values[words[0]] = words[1]
    raise InputError(f"{path}: the header does not end with a line 'map'; is this a MovingAI map?")


def _sizes(values: dict[str, str], path: Path) -> tuple[int, int]:
    sizes = []
    for key in ("width", "height"):
        text = values.get(key, "")
        if not (text.isascii() and text.isdigit() and len(text) < 16 and int(text) > 0):
            raise InputError(f"{path}: the header needs '{key} N' with N at least 1, got {text[:20] or 'nothing'!r}")
        sizes.append(int(text))
    return sizes[0], sizes[1]


def _check_rows(rows: list[str], lines: list[str], path: Path, first: int, width: int, height: int) -> None:
    known = set(TERRAIN)
    for number, row in enumerate(rows, first + 1):
        row = row.rstrip()  # noqa: PLW2901
        if set(row) - known:
            column = next(i for i, letter in enumerate(row) if letter not in known)
            raise InputError(
                f"{path}: line {number}, column {column + 1}: {row[column]!r} is no terrain; the letters are {TERRAIN}"
            )
        if len(row) != width:
            raise InputError(
                f"{path}: line {number}: the row has {len(row)} letters, but the header says width {width}"
            )
    if len(rows) < height:
        raise InputError(f"{path}: the file ends after {len(rows)} rows, but the header says height {height}")
    for number, line in enumerate(lines[first + height :], first + height + 1):
        if line.strip():
            raise InputError(f"{path}: line {number}: more rows than the header's height {height}")


def _query(line: str, path: Path, number: int) -> Query:
    words = [word.strip() for word in line.split("\t")]
    words = words if len(words) == SCENARIO_FIELDS else line.split()
    try:
        bucket, width, height, start_x, start_y, goal_x, goal_y = (int(words[i]) for i in (0, 2, 3, 4, 5, 6, 7))
        length = float(words[8])
        if len(words) != SCENARIO_FIELDS or not isfinite(length) or length < 0:
            raise ValueError
    except (ValueError, IndexError):
        raise InputError(
            f"{path}: line {number}: expected 9 fields: bucket, map, width, height, start x, start y, goal x, goal y, "
            f"optimal length; got {line[:60]!r}"
        ) from None
    for name, x, y in (("start", start_x, start_y), ("goal", goal_x, goal_y)):
        if not (0 <= x < width and 0 <= y < height):
            raise InputError(f"{path}: line {number}: the {name} ({x}, {y}) is outside the {width} x {height} map")
    start, goal = (start_x, height - 1 - start_y), (goal_x, height - 1 - goal_y)
    return Query(bucket, words[1], width, height, start, goal, length)
