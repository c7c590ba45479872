"""Reader of ESRI ASCII grids, and the type `Raster`, which rasters of all file formats have."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.spice.read.files import deck_bytes, decode, normalise

NODATA = -9999.0
"""Value of empty cells of a raster, as in Circuitscape; the header of the file may state a further value."""

_ORIGIN = ("xllcorner", "yllcorner", "xllcenter", "yllcenter")
_KEYS = frozenset(("ncols", "nrows", *_ORIGIN, "cellsize", "dx", "dy", "nodata_value", "nodata"))
_OTHERS = {
    b"II*\0": "a GeoTIFF",
    b"MM\0*": "a GeoTIFF",
    b"II+\0": "a GeoTIFF",
    b"MM\0+": "a GeoTIFF",
    b"\x1f\x8b": "compressed (gzip)",
    b"\x93NUMPY": "a NumPy array",
}
_LIST = re.compile(r"\s*([-+.\deE]+[ \t,]+){2}[-+.\deE]+[ \t]*\n")


@dataclass(frozen=True, eq=False)
class Raster:
    """Values of the cells of a raster, with the place of the raster on the map.

    `cells` (rows, columns): values, top row first, NaN for an empty cell; `corner`: map coordinates (x, y) of the lower
    left corner; `size`: width of a cell in these coordinates; `profile`: georeference of a GeoTIFF as keywords of
    `rasterio.open`, None for an ASCII grid.
    """

    cells: NDArray[np.float64]
    corner: tuple[float, float]
    size: float
    profile: Mapping[str, object] | None = None


def read_ascii_grid(path: Path) -> Raster:
    """Return a raster from an ESRI ASCII grid; raise InputError for another format and for a damaged file."""
    data = deck_bytes(path, str(path))
    other = next((kind for mark, kind in _OTHERS.items() if data.startswith(mark)), None)
    text = "" if other else decode(normalise(data, str(path)))
    if _LIST.match(text):
        other = "a list of points"
    if other:
        raise InputError(f"{path} is {other}, which is not read here; write it as an ESRI ASCII grid (.asc)")
    words = text.split()
    keys = [key.lower() for key in takewhile(lambda word: word.lower() in _KEYS, words[::2])]
    if len(set(keys)) < len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise InputError(f"{path}: its header gives {twice} twice; remove one of the lines")
    values = words[1 : 2 * len(keys) : 2] + words[2 * len(keys) :]
    try:
        if text.count("_") > sum(key.count("_") for key in keys):  # float() would skip the mark
            raise ValueError(f"found {next(word for word in values if '_' in word)!r}")
        numbers = np.array(values, dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{path}: a cell or a value of the header is not a number ({error})") from None
    header = dict(zip(keys, numbers.tolist(), strict=False))
    rows, columns = (header.get(key, 0.0) for key in ("nrows", "ncols"))
    if not (rows >= 1 and columns >= 1 and rows.is_integer() and columns.is_integer()):
        raise InputError(f"{path}: the header must give nrows and ncols, whole numbers of at least 1")
    misplaced = next((key for key in (*_ORIGIN, "cellsize", "dx") if not np.isfinite(header.get(key, 0.0))), None)
    if misplaced is not None or min(header.get("cellsize", 1.0), header.get("dx", 1.0)) <= 0:
        key = misplaced or ("cellsize" if "cellsize" in header else "dx")
        bound = "a finite number" if key in _ORIGIN else "a positive, finite number"
        raise InputError(f"{path}: the header gives {key} {header[key]:g}; it must be {bound}")
    if header.get("dx") != header.get("dy"):
        sizes = " x ".join(f"{header.get(key, float('nan')):g}" for key in ("dx", "dy"))
        raise InputError(f"{path}: its cells are {sizes}; Circuitscape's cells are square: resample the grid")
    cells = _without_empty(numbers[len(keys) :], header, path).reshape(int(rows), int(columns))
    size = header.get("cellsize", header.get("dx", 1.0))
    low = tuple(header.get(f"{axis}llcorner", header.get(f"{axis}llcenter", 0.5 * size) - 0.5 * size) for axis in "xy")
    return Raster(cells, (low[0], low[1]), size)


def _without_empty(cells: NDArray[np.float64], header: dict[str, float], path: Path) -> NDArray[np.float64]:
    """Return `cells` with NaN for empty cells, shape (cells,); raise InputError for a wrong number of cells.

    `cells` (cells,): values row by row, changed in place; `header`: numbers of the header by key in lower case, such as
    ``ncols`` or ``nodata_value``; `path`: the file, for messages.
    """
    rows, columns = header["nrows"], header["ncols"]
    if len(cells) != rows * columns:
        raise InputError(f"{path}: it holds {len(cells)} cells, but its header gives {rows:g} x {columns:g}")
    empty = header.get("nodata_value", header.get("nodata", NODATA))
    cells[(cells == empty) | (cells == NODATA)] = np.nan
    if np.isinf(cells).any():
        row, column = divmod(int(np.argmax(np.isinf(cells))), int(columns))
        raise InputError(f"{path}: the cell in row {row}, column {column} (from 0) is infinite")
    return cells
