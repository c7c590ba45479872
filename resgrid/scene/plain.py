"""Maps that are nothing but an array: grey pictures, epic's pictures, NumPy files."""

from __future__ import annotations

from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.scene.files import read_bytes, require_memory
from resgrid.scene.images import read_raster
from resgrid.scene.map_data import MapData, cells_from_rows, placed_axes
from resgrid.space import MAX_DIMENSIONS, Cell

THRESHOLD = 128
"""Grey value from which a pixel is free, of a picture that does not say."""

HEADER_READERS = {(1, 0): "read_array_header_1_0", (2, 0): "read_array_header_2_0"}


def read_grey(path: Path, threshold: int = THRESHOLD, **placing: Any) -> MapData:
    """Read a picture in which dark is an obstacle."""
    grey = read_raster(path).grey
    rows = np.where(grey < threshold, Cell.OBSTACLE, Cell.FREE).astype(np.uint8)
    return _placed(cells_from_rows(rows), placing)


def read_epic(path: Path, **placing: Any) -> MapData:
    """Read a picture by the convention of epic: 0 is an obstacle, 255 a goal, everything between is free.

    Colours are turned to grey by their rounded luma, opacity is ignored (K. Wray, D. Ruiken, R. Grupen and
    S. Zilberstein, "Log-space harmonic function path planning", IROS 2016; OpenCV's ``IMREAD_GRAYSCALE``).
    """
    grey = read_raster(path).grey
    rows = np.where(grey == 0, Cell.OBSTACLE, np.where(grey == 255, Cell.GOAL, Cell.FREE)).astype(np.uint8)
    return _placed(cells_from_rows(rows), placing)


def read_npy(path: Path, **placing: Any) -> MapData:
    """Read a NumPy array of cell codes (0 free, 1 obstacle, 2 goal) or truth values (true is an obstacle)."""
    data = read_bytes(path)
    _check_npy(data, path)
    try:
        array = np.lib.format.read_array(BytesIO(data), allow_pickle=False)
    except (ValueError, TypeError, EOFError, OSError) as error:
        raise InputError(f"{path}: the array is damaged ({error})") from None
    wrong = ~np.isin(array, list(Cell))
    if wrong.any():
        where = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise InputError(f"{path}: cell {where} is {array[where]}; it may be 0 (free), 1 (obstacle) or 2 (goal)")
    return _placed(np.ascontiguousarray(array, dtype=np.uint8), placing)


def _placed(cell: NDArray[np.uint8], placing: dict[str, Any]) -> MapData:
    return MapData(placed_axes(cell.shape, **placing), Frame(), cell)


def _check_npy(data: bytes, path: Path) -> None:
    """Refuse by the header alone: before anything is allocated for what it announces."""
    stream = BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = getattr(np.lib.format, HEADER_READERS[version])
        shape, _, dtype = read_header(stream)
    except Exception as error:  # a damaged header goes through Python's own tokenizer, which raises what it likes
        raise InputError(f"{path}: this is not an .npy file that can be read ({error})") from None
    if dtype.kind not in "bui":
        raise InputError(f"{path}: cells are whole numbers or truth values, this array holds {dtype}")
    if not 1 <= len(shape) <= MAX_DIMENSIONS or min(shape) < 1:
        raise InputError(f"{path}: the array has shape {shape}; a map has 1 to {MAX_DIMENSIONS} axes, none empty")
    require_memory(shape, str(path))
    missing = prod(shape) * dtype.itemsize - (len(data) - stream.tell())
    if missing > 0:
        raise InputError(f"{path}: the file is cut short: {missing} bytes are missing; copy it again")
