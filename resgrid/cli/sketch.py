"""A text sketch of a space with two axes, for ``resgrid info``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING

import resgrid as rg

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

WIDTH, HEIGHT = 64, 24
"""Largest number of letters per row of a sketch, and largest number of rows."""

MAX_UNKNOWN_FRACTION = 0.5
"""Fraction of the cells; if more cells are unknown, a sketch shows only the surroundings of the known cells."""

MARGIN = 2
"""Width of the border of unknown cells that a cropped sketch shows around the known cells, in cells."""


@dataclass(frozen=True)
class Sketch:
    """A text sketch of a space with two axes.

    `rows`: rows of letters, top row first; the first axis points to the right, the second one upwards; `lower`,
    `upper`: corners of the shown part, in axis units; `cropped`: whether only a part is shown; `key`: meaning of the
    letters.
    """

    rows: list[str]
    lower: tuple[float, float]
    upper: tuple[float, float]
    cropped: bool
    key: str


def sketch(
    space: rg.ConfigurationSpace, starts: Sequence[Sequence[float]], unknown: NDArray[np.bool_] | None
) -> Sketch:
    """Return the text sketch of a space with two axes.

    Unknown cells are marked only where the space treats them as obstacles.  `starts`: points in axis units;
    `unknown`: mask of cells of unknown occupancy in the map, shape of the space, None without such cells.
    """
    import numpy as np

    unseen = np.zeros(space.shape, dtype=np.bool_) if unknown is None else unknown & (space.cell == rg.Cell.OBSTACLE)
    window = _window(space, unseen)
    cropped = any(part.stop - part.start < size for part, size in zip(window, space.shape, strict=True))
    x, y = (axis.edges[[part.start, part.stop]].tolist() for axis, part in zip(space.axes, window, strict=True))
    letters = _letters(space, unseen, window)
    for start in starts:
        (across, up), (columns, rows) = (
            ((at - low) / (high - low) for at, (low, high) in zip(start, (x, y), strict=True)),
            letters.shape,
        )
        across, up = (part if cropped else part % 1.0 for part in (across, up))
        if 0 <= across <= 1 and 0 <= up <= 1:
            letters[min(int(across * columns), columns - 1), min(int(up * rows), rows - 1)] = "S"
    key = "# obstacle, ? unknown, + partly, . free" if unseen.any() else "# obstacle, + partly, . free"
    rows_of_text = ["".join(row) for row in letters.T[::-1].tolist()]
    return Sketch(rows_of_text, (x[0], y[0]), (x[1], y[1]), cropped, f"{key}, G goal, S start")


def _window(space: rg.ConfigurationSpace, unseen: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the ranges of cells to show along both axes.

    The ranges cover the grid, or, if more than half of the cells are unknown but not all, the bounding box of the known
    cells with a margin of 2 cells.  `unseen`: mask of obstacle cells of unknown occupancy, shape of the space.
    """
    import numpy as np

    whole = slice(0, space.shape[0]), slice(0, space.shape[1])
    if unseen.mean() <= MAX_UNKNOWN_FRACTION or unseen.all():
        return whole
    used = [np.flatnonzero((~unseen).any(axis=1 - axis)) for axis in (0, 1)]
    first, second = (
        slice(max(int(where[0]) - MARGIN, 0), min(int(where[-1]) + 1 + MARGIN, size))
        for where, size in zip(used, space.shape, strict=True)
    )
    return first, second


def _letters(space: rg.ConfigurationSpace, unseen: NDArray[np.bool_], window: tuple[slice, slice]) -> NDArray[np.str_]:
    """Return the letters (columns, rows from below) of the cells in a window, resampled to the size of the sketch.

    A letter stands for a block of cells: "G" with a goal cell, "?" all unknown, "#" all obstacles, "." no obstacle, "+"
    otherwise.  The first row is the lowest one.

    `unseen`: mask of obstacle cells of unknown occupancy, shape of the space; `window`: ranges of cells along both
    axes.
    """
    import numpy as np
    from PIL import Image

    x, y = space.axes
    cells = space.cell[window]
    across, up = cells.shape
    # A letter is twice as high as it is wide; axes of different units get the same length.
    shape = up * y.spacing / (across * x.spacing) if x.unit == y.unit else 0.75
    columns = max(min(WIDTH, 2 * across, ceil(2 * HEIGHT / shape)), 1)
    rows = min(max(round(columns * shape / 2), 1), HEIGHT, up)
    masks = (cells == rg.Cell.OBSTACLE, unseen[window], cells == rg.Cell.GOAL)
    blocked, unknown, goal = (
        np.asarray(Image.fromarray(mask.astype(np.float32)).resize((rows, columns), Image.Resampling.BOX))
        for mask in masks
    )
    letters = np.where(blocked > 1 - 1e-5, "#", np.where(blocked == 0.0, ".", "+"))
    letters[unknown > 1 - 1e-5] = "?"
    letters[goal > 0] = "G"
    return letters
