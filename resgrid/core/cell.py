"""The state of a cell, and checks of the arrays of a space: states, undecided cells, conductivities and goal points."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import real_numbers
from resgrid.core.axis import Axis, rounding
from resgrid.errors import InputError

MAX_DIMENSIONS = 4
"""Maximum number of axes of a configuration space."""


class Cell(IntEnum):
    """State of a cell of a configuration space: free, obstacle or goal.

    Examples
    --------
    >>> cell = np.zeros((3, 3), dtype=np.uint8)
    >>> cell[1], cell[2, 2] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    >>> cell
    array([[0, 0, 0],
           [1, 1, 1],
           [0, 0, 2]], dtype=uint8)
    """

    FREE = 0
    OBSTACLE = 1
    GOAL = 2


def checked_undecided(cells: NDArray[np.uint8], undecided: ArrayLike) -> NDArray[np.bool_]:
    """Return the mask `undecided` as a read-only boolean array of the shape of the grid.

    A cell is undecided if neither freedom nor a collision of its configurations was proven; it then counts as an
    obstacle.  Raise InputError if the mask has another shape, or is True for a cell that is not an obstacle.  `cells`:
    `Cell` code of every cell.
    """
    mask = np.array(undecided, dtype=np.bool_)
    if mask.shape != cells.shape or (mask & (cells != Cell.OBSTACLE)).any():
        raise InputError("undecided must have the shape of the grid, and be True for obstacle cells only")
    mask.flags.writeable = False
    return mask


def checked_cells(axes: tuple[Axis, ...], given: ArrayLike) -> NDArray[np.uint8]:
    """Return cell codes as a uint8 array of the axes' shape; raise InputError for a wrong shape or value.

    InputError is also raised for no axis, for more than 4 axes, and for axes of equal names.  `axes`: axes of the
    space; `given`: codes (0 free, 1 obstacle, 2 goal) or booleans (True is an obstacle) of all cells.
    """
    cell = real_numbers("cell", given)
    if not 1 <= len(axes) <= MAX_DIMENSIONS:
        raise InputError(f"a configuration space has 1 to {MAX_DIMENSIONS} axes, got {len(axes)}")
    expected = tuple(axis.cells for axis in axes)
    if cell.shape != expected:
        raise InputError(f"cell has shape {cell.shape}, but the axes have {expected} cells; make them equal")
    names = [axis.name for axis in axes]
    if len(set(names)) < len(names):
        raise InputError(f"two axes have the same name: {names}; give every axis a different name")
    plain = cell.dtype.kind == "u" and cell.max(initial=0) <= max(Cell)
    if not plain and not np.all(np.isin(cell, list(Cell))):
        where = tuple(np.argwhere(~np.isin(cell, list(Cell)))[0].tolist())
        raise InputError(f"cell {where} is {cell[where]}; it must be 0 (free), 1 (obstacle) or 2 (goal)")
    return np.array(cell, dtype=np.uint8, order="C")


def checked_conductivity(shape: tuple[int, ...], value: ArrayLike) -> NDArray[np.float64]:
    """Return the conductivities of cells as an array of floats of `shape`, the shape of the grid.

    `value`: conductivity of every cell, relative to the default 1.  Raise InputError if `value` has another shape, or
    an entry that is not positive and finite.
    """
    conductivity = np.array(value, dtype=np.float64, order="C")
    if conductivity.shape != shape:
        raise InputError(f"conductivity has shape {conductivity.shape}, but the cells have {shape}; make them equal")
    good = np.isfinite(conductivity) & (conductivity > 0)
    if not good.all():
        where = tuple(int(i) for i in np.argwhere(~good)[0])
        raise InputError(f"conductivity must be positive and finite; cell {where} has {conductivity[where]}")
    return conductivity


def checked_goal_points(axes: tuple[Axis, ...], cells: NDArray[np.uint8], value: ArrayLike) -> NDArray[np.float64]:
    """Return the goal points in axis units (goal cells, ndim); raise InputError if one lies outside its cell.

    A goal point is the configuration in a goal cell that solves the goal, such as the joint angles that put an arm's
    tip on its target; all its coordinates are NaN if every configuration of the cell does.  `axes`, `cells`: axes of
    the space and `Cell` codes; `value` (goal cells, ndim): points in axis units, in C order of the goal cells.
    """
    points = np.array(value, dtype=np.float64, order="C")
    goals = np.argwhere(cells == Cell.GOAL)
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    if points.shape != goals.shape:
        raise InputError(f"goal_points have shape {points.shape}, but the goal cells need {goals.shape}")
    local = (points - lower) / spacing - goals
    outside = np.any(np.abs(local - 0.5) > 0.5 + rounding(axes), axis=1)
    outside |= np.isinf(points).any(axis=1) | (np.isnan(points).any(axis=1) != np.isnan(points).all(axis=1))
    if outside.any():
        first = int(np.argmax(outside))
        raise InputError(
            f"the goal point {points[first].tolist()} does not lie in its cell {tuple(goals[first].tolist())}"
        )
    return points
