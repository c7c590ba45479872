"""Checks whether current flows through the free cells of a space, from connectivity alone, and their messages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.regions import cells_at_faces, sides_of_cells, with_margin
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import InputError

NO_GOAL = "the space has no goal cell: add a goal, or make it at least one cell large"
WALLED_IN = "nothing is driven: no free cell is connected to a goal; move the goal or open a path to it"
FLAT = (
    "nothing is driven: no free cell that is connected to a goal touches an obstacle, or an edge that counts as one; "
    "add an obstacle, set edge = 'obstacle', or choose boundary = 'neumann'"
)
ONE_VOLTAGE = (
    "nothing is driven: no component of the circuit touches two rails or has a current source, so that all "
    "currents are zero; add a second rail (an obstacle, an edge that counts as one), open a path to the goal, or "
    "inject the same current into every free cell (boundary = 'neumann')"
)
NO_DRIVE = (
    "nothing is driven: a circuit with open obstacles and drive = 'none' is for effective resistances; leave out "
    "drive = 'none'"
)


def why_undriven(space: ConfigurationSpace, wiring: Wiring) -> str | None:
    """Return a message why no current flows through any free cell, from connectivity alone; None if current flows."""
    edges = wiring.edges(space)
    if wiring.has_islands:
        return NO_DRIVE
    if not space.goal_connected.any():
        return WALLED_IN
    if wiring.start is not None:
        start = tuple(wiring.start)
        reached = bool(space.goal_connected[start])
        return None if reached else f"nothing is driven: no path of free cells joins the start cell {start} to a goal"
    if wiring.drive == "uniform" or wiring.leak:
        return None
    return None if touches_obstacle(space, edges, space.goal_connected) else FLAT


def require_drive(wiring: Wiring, what: str) -> None:
    """Raise InputError for a wiring with open obstacles and drive "none".

    `what`: noun for the feature that needs a drive; subject of the error message.
    """
    if wiring.has_islands:
        raise InputError(
            f"drive = 'none' is for effective resistances, but {what} needs currents: leave out drive = 'none'"
        )


def touches_obstacle(space: ConfigurationSpace, edges: Sequence[str], cells: NDArray[np.bool_]) -> bool:
    """Return whether any of the given cells touches an obstacle cell, or an edge that counts as an obstacle.

    `edges`: ``"obstacle"``, ``"open"`` or ``"periodic"`` per axis; `cells` (shape of the space): the given cells as a
    mask.
    """
    for axis, rule in enumerate(edges):
        obstacle = with_margin(space.cell == Cell.OBSTACLE, space.periodic, beyond=rule == "obstacle")
        lower, upper = cells_at_faces(obstacle, axis)
        if np.any(cells & (sides_of_cells(lower, axis)[0] | sides_of_cells(upper, axis)[1])):
            return True
    return False
