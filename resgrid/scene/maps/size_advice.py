"""Text of the error for a map with too many cells: options that crop or coarsen it, and the resulting sizes."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, prod

from resgrid.scene.maps.preparation import Window


def smaller_map(shape: Sequence[int], ratio: float, known: Window | None) -> str:
    """Return text that names the options which make a map fit in memory, with the numbers of cells that remain.

    `shape`: number of cells along every axis of the map; `ratio`: needed divided by available memory; `known`: window
    of the cells of known occupancy, None for a map without unknown cells.
    """
    box = {2: "X0,Y0,X1,Y1", 3: "X0,Y0,Z0,X1,Y1,Z1"}.get(len(shape))
    parts = [] if box is None else [f"--crop {box} keeps the part that you need"]
    kept = list(shape) if known is None else [end - first for first, end in known]
    if kept != list(shape):
        parts = ["--crop known" + _joined(kept, ratio * prod(kept) / prod(shape))]
    return ", or ".join([*parts, _joined(shape, ratio).strip()])


def _joined(shape: Sequence[int], ratio: float) -> str:
    """Return text with the option ``coarsen`` that divides the number of cells by at least `ratio`, and the new size.

    `shape`: number of cells along every axis; the new size is the number of coarse cells along every axis.
    """
    step = ceil(max(ratio, 1.0) ** (1 / len(shape)))
    while prod(ceil(cells / step) for cells in shape) * ratio > prod(shape):
        step += 1
    option = f" --coarsen {step}" if step > 1 else ""
    return f"{option} leaves {_size([ceil(cells / step) for cells in shape])} cells"


def _size(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))
