"""Messages about paths that reach no goal: reasons and remedies that follow from the space and the wiring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.drive_checks import touches_obstacle
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.robots import PointRobot
from resgrid.scene.nearest_place import nearest_place, why_blocked
from resgrid.scene.scene import Scene

FAILURE_REASONS = {
    "no_path": "obstacles separate the start from every goal",
    "no_current": "no current leaves the last cell of the path: drive every cell (drive = 'uniform')",
    "start_blocked": "the start lies in an obstacle",
    "goal_blocked": "no free cell has a path to a goal: move the goal, or open a passage to it",
}
"""Message for every value of `Outcome` except ``"reached"``."""

_FLAT = (
    "no current flows here, because these cells are connected to a goal but to no obstacle: open the obstacles "
    "(boundary = 'neumann', or k below 1)"
)
_EDGE = ", or let the edge count as an obstacle (edge = 'obstacle')"
_EQUAL = (
    "no current flows in cell {cell}, because the neighbours that it is joined to have the same potential, as they may "
    "by symmetry: open the obstacles (boundary = 'neumann', or k below 1), which drives every cell"
)
_OFF_ROUTE = (
    "the current from the driven start cell {start} to the goals does not pass through cell {cell}: drive every cell "
    "(drive = 'uniform')"
)
_BROKEN = (
    "no current leaves cell {cell}, because resistors of the circuit are missing: solve the circuit without faults"
)

_MORE_PROOFS = "use more cells, or a larger value of the robot's halvings"
"""Remedy in messages about undecided cells, which become fewer with more cells or more halvings of cells."""


def failure_reason(outcome: str, space: ConfigurationSpace, cell: tuple[int, ...]) -> str | None:
    """Return the reason why a path ended with an outcome, and a remedy, as a message; None for ``"reached"``.

    `outcome`: value of `Outcome`; `space`: space of the path; `cell`: start cell of the path.  The messages of
    `resgrid.planning.advice` also name changes of the scene that open a path.
    """
    if outcome not in FAILURE_REASONS:
        return None
    parts = [undecided_reason(outcome, space, cell) or FAILURE_REASONS[outcome]]
    if outcome == "start_blocked" and isinstance(space.robot, PointRobot) and space.robot.radius:
        parts = [f"{parts[0]}, or too near to one for the robot's radius of {space.robot.radius:g}"]
    if outcome in ("no_path", "start_blocked"):
        remedy = getattr(space.robot, "remedy", "")
        parts += [nearest_start(space, cell), "open a passage" if outcome == "no_path" else "", remedy]
    return "; ".join(part for part in parts if part)


def no_current_reason(
    space: ConfigurationSpace, wiring: Wiring, cell: tuple[int, ...], flows: NDArray[np.bool_]
) -> str:
    """Return the reason why no current leaves the last cell of a path, and a remedy, as a message.

    `wiring`: wiring of the field; `cell`: last cell of the path; `flows` (shape of the space): mask of the free cells
    that current leaves, one of which the message suggests as a start.
    """
    if wiring.start is not None:
        reason = _OFF_ROUTE.format(start=tuple(wiring.start), cell=cell)
    elif wiring.is_driven or wiring.leak:
        reason = _BROKEN.format(cell=cell)
    else:
        region = label_regions(space.cell == Cell.FREE, space.periodic)
        joined, edges = region == region[cell], wiring.edges(space)
        if touches_obstacle(space, edges, joined):
            reason = _EQUAL.format(cell=cell)
        else:
            borders = (joined.take([0, -1], axis).any() for axis, rule in enumerate(edges) if rule == "open")
            reason = _FLAT + _EDGE * any(borders)
    place = nearest_place(flows, cell, space.axes, space.frame)
    return f"{reason}; the nearest {kind_of_place(space)} with a current is {place}" if place else reason


def blocked_start_reason(scene: Scene, space: ConfigurationSpace, cell: tuple[int, ...], goal: str = "a goal") -> str:
    """Return the reason why a start of a scene is blocked, and the nearest place for it, as a message.

    `space`: space of the scene, possibly without goals; `cell`: cell of the start; `goal`: name of the goals of the
    space, such as "via[0]".
    """
    reason = undecided_reason("start_blocked", space, cell) or f"the start {why_blocked(scene, cell)}"
    nearest = nearest_start(space, cell, goal)
    if not nearest:
        place = nearest_place(space.cell != Cell.OBSTACLE, cell, space.axes, space.frame)
        nearest = f"the nearest free {kind_of_place(space)} is {place}" if place else ""
    return "; ".join(part for part in (reason, nearest) if part)


def undecided_reason(
    outcome: str, space: ConfigurationSpace, cell: tuple[int, ...], ends: tuple[str, str] = ("the start", "every goal")
) -> str | None:
    """Return the reason of a failure, and a remedy, if undecided cells cause the failure; otherwise None.

    An undecided cell is an obstacle only because neither freedom nor a collision was proven.  `outcome`: value of
    `Outcome`; `cell`: start cell of the path; `ends`: names of the start and of the goals of the path.
    """
    if space.undecided is None:
        return None
    if outcome == "start_blocked" and space.undecided[cell]:
        return f"the start lies in an undecided cell, for which no proof of freedom was found: {_MORE_PROOFS}"
    if outcome == "no_path":
        region = label_regions((space.cell != Cell.OBSTACLE) | space.undecided, space.periodic)
        if region[cell] in region[space.cell == Cell.GOAL]:
            return f"undecided cells separate {ends[0]} from {ends[1]}: {_MORE_PROOFS}"
    return None


def nearest_start(space: ConfigurationSpace, cell: tuple[int, ...], goal: str = "a goal") -> str:
    """Return a phrase with the goal-connected place or configuration nearest to `cell`.

    The phrase is empty if no cell of the space is goal-connected.  `goal`: name of the goals of the space.
    """
    place = nearest_place(space.goal_connected, cell, space.axes, space.frame)
    return f"the nearest {kind_of_place(space)} with a path to {goal} is {place}" if place else ""


def kind_of_place(space: ConfigurationSpace) -> str:
    """Return the word for a point of a space in messages: a place in the workspace, or a configuration."""
    return "place" if space.robot is None or space.robot.moves_in_workspace else "configuration"
