"""Why a path reaches no goal, as far as its space knows; `resgrid.planning.advice` knows the scene as well."""

from __future__ import annotations

from resgrid.core.space import ConfigurationSpace
from resgrid.scene.nearest_place import nearest_place

TROUBLES = {
    "no_path": "obstacles separate the start from every goal",
    "no_current": "the current here is too small to tell a direction: use --drive uniform",
    "start_blocked": "the start lies in an obstacle",
    "goal_blocked": "no free cell has a path to a goal: move the goal, or open a way to it",
}
"""What every outcome but success means."""


def reason_of(outcome: str, space: ConfigurationSpace, cell: tuple[int, ...]) -> str | None:
    """Return why a path that starts in a cell ended with an outcome, and what to do; None for success."""
    if outcome not in TROUBLES:
        return None
    parts = [TROUBLES[outcome]]
    if outcome in ("no_path", "start_blocked"):
        remedy = getattr(space.robot, "remedy", "")
        parts += [nearest_start(space, cell), "open a way" if outcome == "no_path" else "", remedy]
    return "; ".join(part for part in parts if part)


def nearest_start(space: ConfigurationSpace, cell: tuple[int, ...]) -> str:
    """Return where the nearest place, or configuration, with a path to a goal is; empty if there is none."""
    place = nearest_place(space.goal_connected, cell, space.axes, space.frame)
    kind = "place" if space.robot is None or space.robot.moves_in_workspace else "configuration"
    return f"the nearest {kind} with a path to a goal is {place}" if place else ""
