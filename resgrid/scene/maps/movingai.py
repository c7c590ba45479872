"""Readers of MovingAI benchmark maps (``.map``), their scenarios (``.scen``) and voxel maps (``.3dmap``).

Formats: N. Sturtevant, "Benchmarks for Grid-Based Pathfinding", IEEE Trans. Comput. Intell. AI in Games 4 (2012) 144,
and https://movingai.com/benchmarks/formats.html; scenarios of version 0: HOG2's ``ScenarioLoader.cpp``; voxel maps:
D. Brewer and N. Sturtevant, "Benchmarks for Pathfinding in 3D Voxel Space", SoCS 2018, and HOG2's ``VoxelGrid.cpp``.
The warehouses of the League of Robot Runners add two letters: ``E`` (emitter) and ``S`` (service), both free.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.files import read_text
from resgrid._internal.memory import SMALLER_MAP, require_grid_memory
from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.scene.maps.arrays import MapCells, cells_from_rows, placed_axes

TERRAIN = ".G@OTSWE"
"""Letters that denote cells in a map."""

PASSABLE = ".GSE"
"""Letters that denote free cells by default."""

TYPES = ("octile", "tile", "octile_unicost")
"""Types of maps (first header line) with square cells."""

SCENARIO_FIELDS = {9: "1", 7: "0"}
"""Version of a scenario by the number of fields per line; version 0 omits the size of the map."""


@dataclass(frozen=True)
class MovingAIScenario:
    r"""One problem of a scenario file.

    Returned by `resgrid.maps.read_movingai_scenarios`, one for each line.

    Attributes
    ----------
    bucket : int
        Difficulty class: the optimal length divided by four.
    map : str
        Name of the map file, as given in the scenario.
    width, height : int
        Size of the map, in cells.
    start, goal : tuple of int, two entries
        Cells in this package's convention: file column ``c``, row ``r`` (row 0 on top) is ``(c, height - 1 - r)``.
    optimal_length : float
        Length of the shortest octile path, in cells; diagonal steps cost sqrt(2) and cut no corner.

    Examples
    --------
    >>> from pathlib import Path
    >>> size = Path("a.scen").write_text("version 1\n0\ta.map\t4\t2\t0\t0\t1\t1\t1.41421356\n")
    >>> scenario = rg.maps.read_movingai_scenarios("a.scen")[0]
    >>> scenario.map, (scenario.width, scenario.height)
    ('a.map', (4, 2))
    >>> scenario.start, scenario.goal, scenario.optimal_length
    ((0, 1), (1, 0), 1.41421356)
    """

    bucket: int
    map: str
    width: int
    height: int
    start: tuple[int, int]
    goal: tuple[int, int]
    optimal_length: float


def read_movingai(path: Path, passable: str = PASSABLE) -> MapCells:
    """Return the cells of a MovingAI map; cells are 1 x 1, in units of ``cell``.

    Parameters
    ----------
    passable
        Letters of free cells.
    """
    unknown = sorted(set(passable) - set(TERRAIN))
    if unknown:
        raise InputError(f"map.passable: {''.join(unknown)!r} is not a letter of terrain; the letters are {TERRAIN}")
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


def open_voxel_list(path: Path) -> tuple[list[int], NDArray[np.int32]]:
    """Return the sizes along x, y and z of a MovingAI voxel map, and its obstacle voxels as indices from 0, (n, 3).

    The file lists the obstacle voxels; all other voxels are free.
    """
    lines = read_text(path).split("\n")
    words = lines[0].split()
    sizes = [int(word) if word.isascii() and word.isdigit() and len(word) < 10 else 0 for word in words[1:]]
    if words[:1] != ["voxel"] or len(sizes) != 3 or min(sizes) < 1:
        raise InputError(f"{path}: line 1: expected 'voxel X Y Z', sizes of at least 1, got {lines[0][:40]!r}")
    if not any(line.strip() for line in lines[1:]):
        return sizes, np.zeros((0, 3), dtype=np.int32)
    try:
        voxels = np.loadtxt(lines[1:], dtype=np.int64, comments=None, ndmin=2)
    except (ValueError, OverflowError):
        raise _first_invalid_line(lines, sizes, path) from None
    if voxels.shape[1] != 3 or ((voxels < 0) | (voxels >= sizes)).any():
        raise _first_invalid_line(lines, sizes, path)
    return sizes, voxels.astype(np.int32)


def _first_invalid_line(lines: list[str], sizes: list[int], path: Path) -> InputError:
    """Return an InputError that names the first line of a voxel map that is not a voxel inside the map.

    `lines`: lines of the file; `sizes`: number of voxels per axis; `path`: name of the file.
    """
    for number, line in enumerate(lines[1:], 2):
        words = line.split()
        is_place = len(words) == 3 and all(word.isascii() and word.isdigit() and len(word) < 16 for word in words)
        if words and not (is_place and all(int(word) < size for word, size in zip(words, sizes, strict=True))):
            size = " x ".join(map(str, sizes))
            return InputError(f"{path}: line {number}: expected a voxel 'x y z' of {size}, got {line[:40]!r}")
    return InputError(f"{path}: the voxels cannot be read; write one voxel 'x y z' per line")


def read_movingai_scenarios(file: str | os.PathLike[str]) -> list[MovingAIScenario]:
    r"""Read the problems of a MovingAI scenario file of version 1 or 0, with or without a version line.

    Parameters
    ----------
    file : path-like
        The ``.scen`` file.  For version 0, the size of a map is read from the map file in the same folder.

    Returns
    -------
    list of MovingAIScenario
        In the order of the file.

    Raises
    ------
    InputError
        If the version or a line is wrong; the message names the line.

    Examples
    --------
    >>> from pathlib import Path
    >>> size = Path("a.scen").write_text("version 1\n0\ta.map\t4\t2\t0\t0\t1\t1\t1.41421356\n")
    >>> (query,) = rg.maps.read_movingai_scenarios("a.scen")
    >>> query.start, query.goal, query.optimal_length
    ((0, 1), (1, 0), 1.41421356)
    """
    path = Path(file)
    lines = read_text(path).split("\n")
    version = lines[0].split()
    first = 1 if version[:1] == ["version"] else 0
    if first and (len(version) != 2 or version[1] not in ("0", "0.0", "1", "1.0")):
        raise InputError(f"{path}: line 1: expected 'version 1' or 'version 0', got {lines[0][:40]!r}")
    sizes = _MapSizes(path)
    return [_query(line, path, number, sizes) for number, line in enumerate(lines[first:], first + 1) if line.strip()]


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
            raise InputError(
                f"{path}: line {number}: type {words[1]!r} does not have square cells; the type must be "
                f"{', '.join(TYPES)}"
            )
        if words[0] in values:
            raise InputError(f"{path}: line {number}: {words[0]!r} is in the header twice; remove one")
        values[words[0]] = words[1]
    raise InputError(f"{path}: the header does not end with a line 'map'; is this a MovingAI map?")


def _sizes(values: dict[str, str], path: Path) -> tuple[int, int]:
    sizes = []
    for key in ("width", "height"):
        text = values.get(key, "")
        if not (text.isascii() and text.isdigit() and len(text) < 16 and int(text) > 0):
            raise InputError(f"{path}: the header needs '{key} N' with N at least 1, got {text[:20]!r}")
        sizes.append(int(text))
    return sizes[0], sizes[1]


def _check_rows(rows: list[str], lines: list[str], path: Path, first: int, width: int, height: int) -> None:
    known = set(TERRAIN)
    for number, row in enumerate(rows, first + 1):
        row = row.rstrip()  # noqa: PLW2901
        if set(row) - known:
            column = next(i for i, letter in enumerate(row) if letter not in known)
            raise InputError(
                f"{path}: line {number}, column {column + 1}: {row[column]!r} is not a letter of terrain; the letters "
                f"are {TERRAIN}"
            )
        if len(row) != width:
            raise InputError(f"{path}: line {number}: the row has {len(row)} letters, but the header has width {width}")
    if len(rows) < height:
        raise InputError(f"{path}: the file ends after {len(rows)} rows, but the header has height {height}")
    for number, line in enumerate(lines[first + height :], first + height + 1):
        if line.strip():
            raise InputError(f"{path}: line {number}: more rows than the header's height {height}")


class _MapSizes(dict[str, tuple[int, int]]):
    """Cache of the sizes (width, height), in cells, of the maps of a version 0 scenario, by name of the map file."""

    def __init__(self, scenario: Path) -> None:
        super().__init__()
        self.scenario = scenario

    def __missing__(self, name: str) -> tuple[int, int]:
        named = self.scenario.parent / name
        file = named if named.is_file() else self.scenario.parent / PurePosixPath(name).name
        if not file.is_file():
            raise InputError(
                f"{self.scenario}: a scenario of version 0 omits the size of its map, and the map file {file} does not "
                "exist; put the map file into the scenario's folder"
            )
        _, width, height = _header(read_text(file).split("\n", 9)[:9], file)
        self[name] = width, height
        return self[name]


def _query(line: str, path: Path, number: int, sizes: Mapping[str, tuple[int, int]]) -> MovingAIScenario:
    words = [word.strip() for word in line.split("\t")]
    words = words if len(words) in SCENARIO_FIELDS else line.split()
    try:
        if len(words) not in SCENARIO_FIELDS:
            raise ValueError
        bucket, *places = (int(word) for word in (words[0], *words[2:-1]))
        length = float(words[-1])
        if not isfinite(length) or length < 0:
            raise ValueError
    except ValueError:
        raise InputError(
            f"{path}: line {number}: expected 9 fields: bucket, map, width, height, start x, start y, goal x, goal y, "
            f"optimal length (or 7, without the size of the map); got {line[:60]!r}"
        ) from None
    width, height, *ends = places if len(places) == 6 else (*sizes[words[1]], *places)
    start_x, start_y, goal_x, goal_y = ends
    for name, x, y in (("start", start_x, start_y), ("goal", goal_x, goal_y)):
        if not (0 <= x < width and 0 <= y < height):
            raise InputError(f"{path}: line {number}: the {name} ({x}, {y}) is outside the {width} x {height} map")
    start, goal = (start_x, height - 1 - start_y), (goal_x, height - 1 - goal_y)
    return MovingAIScenario(bucket, words[1], width, height, start, goal, length)
