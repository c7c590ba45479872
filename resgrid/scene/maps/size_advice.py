"""Advice in errors for maps with too many cells: options that make the map smaller, and the resulting sizes."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, prod

from resgrid._internal.memory import require_grid_memory

_SOLUTION = 40
"""Approximate memory for solving a circuit, divided by the memory for sampling a scene: the cells of the same grid."""


def smaller_map(shape: Sequence[int], ratio: float, known: Sequence[tuple[int, int]] | None) -> str:
    """Return text that names the options which make a map fit in memory, with the numbers of cells that remain.

    `shape`: number of cells along every axis of the map; `ratio`: needed divided by available memory; `known`: window
    of the cells of known occupancy, for each axis the first index and the index after the last one; None for a map
    without unknown cells.
    """
    box = {2: "X0,Y0,X1,Y1", 3: "X0,Y0,Z0,X1,Y1,Z1"}.get(len(shape))
    parts = [] if box is None else [f"--crop {box} keeps the part that you need"]
    kept = list(shape) if known is None else [end - first for first, end in known]
    if kept != list(shape):
        parts = ["--crop known" + _joined(kept, ratio * prod(kept) / prod(shape))]
    return ", or ".join([*parts, _joined(shape, ratio).strip()])


def require_divided_memory(shape: Sequence[int], refine: int) -> None:
    """Raise BudgetError if the cells of a divided map do not fit in memory.

    The message names a value of ``refine`` with which the solution of the circuit fits as well.  `shape`: number of
    cells along every axis before the division; `refine`: number of parts of each cell along an axis.
    """
    divided = tuple(cells * refine for cells in shape)
    require_grid_memory(divided, "map", remedy=lambda ratio: coarser_division(divided, _SOLUTION * ratio, refine))


def coarser_division(shape: Sequence[int], ratio: float, refine: int) -> str:
    """Return text that names the value of the option ``refine`` which makes a divided map fit in memory.

    `shape`: number of cells along every axis of the divided map; `ratio`: needed divided by available memory; `refine`:
    number of parts of a cell of the map along each axis.
    """
    whole = [cells // refine for cells in shape]
    kept = max(int(refine / max(ratio, 1.0) ** (1 / len(shape))), 1)
    option = f"--refine {kept} leaves" if kept > 1 else "without --refine it has"
    return f"{option} {_size([cells * kept for cells in whole])} cells"


def _joined(shape: Sequence[int], ratio: float) -> str:
    """Return text with the option ``coarsen`` that divides the number of cells by at least `ratio`, and the new size.

    `shape`: number of cells along every axis; `ratio`: needed divided by available memory; if it is at most 1, the text
    contains no option.  The new size is the number of coarse cells along every axis.
    """
    step = ceil(max(ratio, 1.0) ** (1 / len(shape)))
    while prod(ceil(cells / step) for cells in shape) * ratio > prod(shape):
        step += 1
    option = f" --coarsen {step}" if step > 1 else ""
    return f"{option} leaves {_size([ceil(cells / step) for cells in shape])} cells"


def _size(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))
