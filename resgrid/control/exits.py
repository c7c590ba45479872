"""Where a robot goes that the current does not lead: to the goal within a goal cell, and out of its own lost cell."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from resgrid.control.controller import RECOVERY
from resgrid.space import Cell, ConfigurationSpace

Vector = NDArray[np.float64]

_INSIDE = 2e-9


def way_to_goal(space: ConfigurationSpace, place: Vector) -> Vector:
    """From a place in a goal cell to the configuration there that solves the goal; 0 where the whole cell does.

    One on the cell's border is taken 2e-9 of a cell inside it, where there is no doubt whose it is.
    """
    cell, local = space.split(place)
    solution = (space.goal_point(cell) - space.lower) / space.spacing - cell
    if np.isnan(solution).any():
        return np.zeros(space.ndim)
    return np.asarray((np.clip(solution, _INSIDE, 1.0 - _INSIDE) - local) * space.spacing)


def ways_home(space: ConfigurationSpace, place: Vector) -> list[tuple[tuple[int, ...], Vector]]:
    """Goal cells whose goal may be taken from a place in one, and the ways: its own, then those across its faces.

    Neighbours that share a face make a convex box, so that these ways meet goal cells alone.
    """
    cell, local = space.split(place)
    own = tuple(int(index) for index in cell)
    beside: dict[tuple[int, ...], Vector] = {}
    for axis, by in product(range(space.ndim), (-1, 1)):
        step = np.zeros(space.ndim, dtype=np.int64)
        step[axis] = by
        other = np.where(space.periodic, (cell + step) % space.shape, cell + step)
        if np.any(other < 0) or np.any(other >= space.shape):
            continue
        at = tuple(int(index) for index in other)
        way = space.goal_point(other) - space.axis_centre(other) + (step + 0.5 - local) * space.spacing
        if at != own and not np.isnan(way).any():
            beside.setdefault(at, way)
    nearest = sorted(beside.items(), key=lambda item: float(np.linalg.norm(item[1])))
    return [(own, way_to_goal(space, place)), *nearest]


def ways_out(space: ConfigurationSpace, place: Vector) -> list[tuple[tuple[int, ...], Vector]]:
    """Cells with a path within `RECOVERY` cells of a place's own, and the ways to their centres, the shortest first."""
    cell, local = space.split(place)
    most = int(RECOVERY)
    found: dict[tuple[int, ...], tuple[float, Vector]] = {}
    for by in product(range(-most, most + 1), repeat=space.ndim):
        if not 0 < sum(step * step for step in by) <= RECOVERY**2:
            continue
        other = np.where(space.periodic, (cell + by) % space.shape, cell + by)
        if np.any(other < 0) or np.any(other >= space.shape):
            continue
        at = tuple(int(index) for index in other)
        if space.cell[at] == Cell.GOAL or space.goal_connected[at]:
            way = (np.array(by) + 0.5 - local) * space.spacing
            length = float(np.linalg.norm(way / space.spacing))
            if at not in found or length < found[at][0]:
                found[at] = length, way
    return [(at, way) for at, (_, way) in sorted(found.items(), key=lambda item: item[1][0])]
