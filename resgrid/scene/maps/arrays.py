"""Maps that are NumPy arrays."""

from __future__ import annotations

from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from resgrid.budget import require_grid_memory
from resgrid.errors import InputError
from resgrid.files import read_bytes
from resgrid.frame import Frame
from resgrid.scene.maps.data import MapData, placed_axes
from resgrid.space import MAX_DIMENSIONS, Cell

HEADER_READERS = {(1, 0): "read_array_header_1_0", (2, 0): "read_array_header_2_0"}


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
    return MapData(placed_axes(array.shape, **placing), Frame(), np.ascontiguousarray(array, dtype=np.uint8))


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
    require_grid_memory(shape, str(path))
    missing = prod(shape) * dtype.itemsize - (len(data) - stream.tell())
    if missing > 0:
        raise InputError(f"{path}: the file is cut short: {missing} bytes are missing; copy it again")
