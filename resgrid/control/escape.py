"""Straight motions that follow no current: to the goal in a goal cell, or out of a cell without a path.

A goal cell may contain configurations outside the goal.  One configuration in the cell that lies in the goal is known
(`ConfigurationSpace.goal_points`): the configuration that solves the goal.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace

Vector = NDArray[np.float64]
CellIndex = tuple[int, ...]

RECOVERY = 2.0
"""Largest distance of a straight way out of a cell without a path to a goal into a cell with a path.

The distance is the Euclidean norm of the difference of the two cell indices.
"""

_INSIDE = 2e-9
"""Smallest distance of a target from the border of its cell, as a fraction of the cell width."""


def goal_offset(space: ConfigurationSpace, place: Vector, *, sure: bool = True) -> Vector:
    """Return the offset from a point in a goal cell to the configuration that solves the goal, in axis units, (ndim,).

    If every configuration of the cell solves the goal, the offset is 0 or, with an inexact position (`sure` is False),
    leads to the centre of the cell.  A target on the border of the cell is moved 2e-9 of a cell inside, so that its
    cell is unambiguous.  `place` (ndim,): the point, in axis coordinates; `sure`: whether the position is exact.
    """
    cell, local = space.split(place)
    solution = (space.goal_point(cell) - space.lower) / space.spacing - cell
    if np.isnan(solution).any():
        return np.zeros(space.ndim) if sure else np.asarray((0.5 - local) * space.spacing)
    return np.asarray((np.clip(solution, _INSIDE, 1.0 - _INSIDE) - local) * space.spacing)


def goal_offsets(space: ConfigurationSpace, place: Vector, *, sure: bool = True) -> list[tuple[CellIndex, Vector]]:
    """Return goal cells near a point, each with the offset (ndim,) to the configuration that solves its goal.

    Each entry is the index of a cell and the offset.  The cell of the point, which must be a goal cell, comes first.
    Face neighbours for which a single configuration that solves the goal is known follow in order of distance.  Two
    cells that share a face form a convex box, so that straight lines between them stay in goal cells.  `place` (ndim,):
    the point, in axis coordinates; `sure`: whether the position is exact; otherwise, if every configuration of the own
    cell solves the goal, its offset leads to the centre of the cell.  Offsets are in axis units.
    """
    cell, local = space.split(place)
    own = tuple(cell.tolist())
    beside: dict[CellIndex, Vector] = {}
    for axis, by in product(range(space.ndim), (-1, 1)):
        step = by * np.eye(space.ndim, dtype=np.int64)[axis]
        other = neighbour(space, cell + step)
        if other is None or other == own:
            continue
        offset = space.goal_point(other) - space.axis_centre(other) + (step + 0.5 - local) * space.spacing
        if not np.isnan(offset).any():
            beside.setdefault(other, offset)
    nearest = sorted(beside.items(), key=lambda item: float(np.linalg.norm(item[1])))
    return [(own, goal_offset(space, place, sure=sure)), *nearest]


def exits(space: ConfigurationSpace, place: Vector) -> list[tuple[CellIndex, Vector]]:
    """Return the cells with a path to a goal within `RECOVERY` (2) cells of a point's cell, nearest first.

    Each entry is the index of a cell and the offset (ndim,) from the point to the centre of the cell, in axis units.
    The order is by the length of the offset in cells.  Goal cells count as cells with a path; the cell of the point is
    left out.  `place` (ndim,): the point, in axis coordinates.
    """
    cell, local = space.split(place)
    most = int(RECOVERY)
    nearest: dict[CellIndex, tuple[float, Vector]] = {}
    for by in product(range(-most, most + 1), repeat=space.ndim):
        if not 0 < sum(step * step for step in by) <= RECOVERY**2:
            continue
        other = neighbour(space, cell + by)
        if other is not None and (space.cell[other] == Cell.GOAL or space.goal_connected[other]):
            offset = (np.array(by) + 0.5 - local) * space.spacing
            length = float(np.linalg.norm(offset / space.spacing))
            if other not in nearest or length < nearest[other][0]:
                nearest[other] = length, offset
    return [(other, offset) for other, (_, offset) in sorted(nearest.items(), key=lambda item: item[1][0])]


def neighbour(space: ConfigurationSpace, cell: NDArray[np.int64]) -> CellIndex | None:
    """Return a cell index as a tuple, wrapped around periodic axes; None if it lies beyond an end of another axis.

    `cell` (ndim,): index of a cell, which may lie outside the grid.
    """
    other = np.where(space.periodic, cell % space.shape, cell)
    return None if np.any(other < 0) or np.any(other >= space.shape) else tuple(other.tolist())
