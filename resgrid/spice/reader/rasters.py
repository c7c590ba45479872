"""Rasters in the ESRI ASCII grid format."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.spice.reader.sources import decode, normalise, read_bytes

_KEYS = frozenset({"ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize", "nodata_value"})
_MAX_CELLS = 2**28
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_LIST = re.compile(r"\s*([-+.\deE]+[ \t,]+){2}[-+.\deE]+[ \t]*\n")


@dataclass(frozen=True, eq=False)
class Raster:
    """A raster map.

    `source`: the file, as displayed; `values` (rows, columns): top row first; `present` (rows, columns): whether a
    cell has a value.
    """

    source: str
    values: NDArray[np.float64]
    present: NDArray[np.bool_]

    def filled(self, value: float) -> NDArray[np.float64]:
        """Values, with ``value`` where there is none."""
        return np.where(self.present, self.values, value)


def read_raster(path: str | os.PathLike[str]) -> Raster:
    """Read an ESRI ASCII grid."""
    source = os.fspath(path)
    data = read_bytes(Path(source), source)
    if data.startswith(_TIFF):
        raise InputError(f"{source} is a GeoTIFF, which is not read here; write it as an ESRI ASCII grid (.asc)")
    text = decode(normalise(data, source))
    header, body = _header(text, source)
    if not header and _LIST.match(body):
        raise InputError(f"{source} is a list of points, which is not read here; write it as an ESRI ASCII grid (.asc)")
    rows, columns = (_count(header, key, source) for key in ("nrows", "ncols"))
    if rows * columns > _MAX_CELLS:
        raise InputError(f"{source}: {rows} x {columns} cells are too many; at most {_MAX_CELLS} are read")
    words = body.split()
    if len(words) != rows * columns:
        raise InputError(f"{source}: it holds {len(words)} cells, but its header says {rows} x {columns}")
    try:
        values = np.array(list(map(float, words)), dtype=np.float64).reshape(rows, columns)
    except ValueError as error:
        raise InputError(f"{source}: a cell is no number ({error})") from None
    present = np.isfinite(values) & (values != header.get("nodata_value", -9999.0))
    if not np.all(np.isfinite(values) | np.isnan(values)):
        raise InputError(f"{source}: a cell is infinite")
    return Raster(source, values, present)


def _header(text: str, source: str) -> tuple[dict[str, float], str]:
    header: dict[str, float] = {}
    position = 0
    while position < len(text):
        end = text.find("\n", position)
        words = text[position : end if end >= 0 else len(text)].split()
        if words and words[0].lower() not in _KEYS:
            break
        if words:
            try:
                header[words[0].lower()] = float(words[1])
            except (IndexError, ValueError):
                raise InputError(f"{source}: the header line {words[0]!r} has no number") from None
        position = end + 1 if end >= 0 else len(text)
    return header, text[position:]


def _count(header: dict[str, float], key: str, source: str) -> int:
    value = header.get(key, 0.0)
    if not (value >= 1 and value == int(value)):
        raise InputError(f"{source}: the header must say {key}, a whole number of at least 1")
    return int(value)
