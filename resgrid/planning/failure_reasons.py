"""Messages about paths that reach no goal: reasons and remedies that follow from the space alone."""

from __future__ import annotations

from resgrid.core.cell import Cell
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.scene.nearest_place import nearest_place

FAILURE_REASONS = {
    "no_path": "obstacles separate the start from every goal",
    "no_current": "the current here is too small to give a direction: use --drive uniform",
    "start_blocked": "the start lies in an obstacle",
    "goal_blocked": "no free cell has a path to a goal: move the goal, or open a passage to it",
}
"""Message for every value of `Outcome` except ``"reached"``."""

FLAT = (
    "no current flows here, because these cells are connected to a goal but to no obstacle: open the obstacles "
    "(boundary = 'neumann', or k below 1), or let the edge count as an obstacle (edge = 'obstacle')"
)
"""Message for the outcome ``no_current`` in a circuit without a drive, whose current comes from the obstacle rail."""

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
    if outcome in ("no_path", "start_blocked"):
        remedy = getattr(space.robot, "remedy", "")
        parts += [nearest_start(space, cell), "open a passage" if outcome == "no_path" else "", remedy]
    return "; ".join(part for part in parts if part)


def undecided_reason(outcome: str, space: ConfigurationSpace, cell: tuple[int, ...]) -> str | None:
    """Return the reason of a failure, and a remedy, if cells without a proof cause the failure; otherwise None.

    `outcome`: value of `Outcome`; `cell`: start cell of the path.
    """
    if space.undecided is None:
        return None
    if outcome == "start_blocked" and space.undecided[cell]:
        return f"the start lies in an undecided cell, for which no proof of freedom was found: {_MORE_PROOFS}"
    if outcome == "no_path":
        region = label_regions((space.cell != Cell.OBSTACLE) | space.undecided, space.periodic)
        if region[cell] in region[space.cell == Cell.GOAL]:
            return f"undecided cells separate the start from every goal: {_MORE_PROOFS}"
    return None


def nearest_start(space: ConfigurationSpace, cell: tuple[int, ...]) -> str:
    """Return a phrase with the goal-connected place or configuration nearest to `cell`.

    The phrase is empty if no cell of the space is goal-connected.
    """
    place = nearest_place(space.goal_connected, cell, space.axes, space.frame)
    kind = "place" if space.robot is None or space.robot.moves_in_workspace else "configuration"
    return f"the nearest {kind} with a path to a goal is {place}" if place else ""
