"""Choice and titles of plane slices through spaces with three or four axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.plot.plane import Cut, PicturePlane
from resgrid.plot.style import axis_label

_MOST_SLICES = 6
"""Default number of slices normal to one axis; an axis of fewer cells has one slice per cell."""


_LONG = 22
"""Largest number of characters of a position in the title of a slice that the words "(through a goal)" may follow.

After a longer position these words are on a line of their own.
"""


def cuts_of(
    space: ConfigurationSpace, axis: int | None, indices: Sequence[int] | None, through: Sequence[int] | None
) -> list[Cut]:
    """Return the slices of a space with three or four axes, each as pairs of a normal axis and a cell index along it.

    `axis`: normal axis, None for one slice for each pair of axes; `indices`: cell indices along `axis`, by default at
    most six; `through`: cell that the slices contain, by default the first goal cell in C order, or the cell in the
    middle without goals.  With four axes, slices normal to `axis` are also normal to the last of the other three axes.
    Raises InputError for slices outside the space, and for `indices` without `axis`.
    """
    goals = np.argwhere(space.cell == Cell.GOAL)
    middle = goals[0] if len(goals) else np.array(space.shape) // 2
    centre = [int(index) for index in (middle if through is None else through)]
    if axis is None:
        if indices is not None:
            raise InputError("indices of slices need the axis that is normal to them: give axis")
        shown = combinations(range(space.ndim), 2)
        return [tuple((n, centre[n]) for n in range(space.ndim) if n not in pair) for pair in shown]
    if not 0 <= axis < space.ndim:
        numbers = ", ".join(map(str, range(space.ndim - 1)))
        raise InputError(f"axis = {axis}, but the space has axes {numbers} and {space.ndim - 1}")
    others = [number for number in range(space.ndim) if number != axis]
    fixed = [(number, centre[number]) for number in others[2:]]
    chosen = _checked_indices(space.shape[axis], indices, centre[axis])
    return [tuple(sorted([(axis, index), *fixed])) for index in chosen]


def _checked_indices(size: int, indices: Sequence[int] | None, centre: int) -> list[int]:
    """Return the cell indices of slices normal to an axis of `size` cells; raise InputError for invalid `indices`.

    By default, at most six nearly evenly spaced indices, which include `centre`.
    """
    if indices is None:
        spread = np.linspace(0, size - 1, min(_MOST_SLICES, size)).round().astype(int)
        spread[np.abs(spread - centre).argmin()] = centre
        return [int(index) for index in np.unique(spread)]
    wrong = [index for index in indices if not 0 <= index < size]
    if wrong or not len(indices):
        raise InputError(
            f"slice {wrong[0] if wrong else '(none)'} is not one of the cells 0 to {size - 1} of the axis; "
            "give indices in this range"
        )
    return [int(index) for index in indices]


def slice_title(space: ConfigurationSpace, plane: PicturePlane, cut: Cut) -> str:
    """Return the title of a slice: positions along the normal axes, and whether the slice contains a goal cell."""
    parts = [
        f"{axis_label(replace(space.axes[normal], unit=''), of_map=plane.of_map)} = "
        f"{space.axes[normal].centres[index]:.3g} {space.axes[normal].unit}"
        for normal, index in cut
    ]
    title = ",\n".join(parts)
    if not np.any(plane.cell == Cell.GOAL):
        return title
    return f"{title}{chr(10) if len(parts[-1]) > _LONG else ' '}(through a goal)"
