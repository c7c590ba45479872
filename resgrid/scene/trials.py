"""Changed copies of a scene, in which remedies are tried before a message recommends them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from resgrid.core.cell import Cell
from resgrid.errors import ResgridError
from resgrid.robots import PointRobot
from resgrid.scene.goals import Goal, GoalCell, GoalJoints
from resgrid.scene.overrides import apply_overrides
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import cell_centre

MOST_CELLS = 2**24
"""Maximum number of cells of a space in which a remedy is tried, for robots that are points or discs."""

_MOST_CELLS_OF_BODIES = 2**17
"""Maximum number of cells of a space in which a remedy is tried, for robots other than points and discs.

Such robots need more time per cell.
"""

Change = Callable[[], Scene]
"""Function without arguments that returns a changed copy of a scene."""


def changed_scene(change: Change) -> Scene | None:
    """Return the scene that the function `change` returns; None if it is invalid or has too many cells for a trial."""
    try:
        scene = change()
    except ResgridError:
        return None
    most = MOST_CELLS if isinstance(scene.robot, PointRobot) else _MOST_CELLS_OF_BODIES
    return scene if math.prod(axis.cells for axis in scene.axes) <= most else None


def with_unknown_free(scene: Scene) -> Scene:
    """Return a copy of a scene with a map, in which the unknown cells of this map are free."""
    cells = scene.map
    assert cells is not None
    if cells.surroundings is not None or cells.unknown is None:
        return apply_overrides(scene, {"map.unknown": "free"})
    blocked = cells.unknown & (cells.cell == Cell.OBSTACLE)
    cell = np.where(blocked, np.uint8(Cell.FREE), cells.cell)
    table = {**cells.table, "unknown": "free"}
    return dataclasses.replace(scene, map=dataclasses.replace(cells, cell=cell, table=table))


def with_division(scene: Scene, key: str, count: int) -> Scene:
    """Return a copy of a scene whose map has another division into cells; goal cells become goals at their centres.

    `key`: key of the map's table, "coarsen" or "refine"; `count`: its new value.
    """
    goals = tuple(place_of_goal(scene, goal) for goal in scene.goals)
    return apply_overrides(dataclasses.replace(scene, goals=goals), {f"map.{key}": count})


def finer_values(scene: Scene) -> list[int]:
    """Return the values of the map's key ``coarsen`` to try: half the present value, then 1; none without ``coarsen``.

    `scene`: a scene, with or without a map.
    """
    present = (scene.map.table.get("coarsen") or 1) if scene.map is not None else 1
    return list(dict.fromkeys((present // 2, 1))) if present > 1 else []


def place_of_goal(scene: Scene, goal: Goal) -> Goal:
    """Return a goal that does not depend on the numbers of cells: a `GoalCell` becomes a goal at its centre."""
    if not isinstance(goal, GoalCell):
        return goal
    centre = cell_centre(scene.axes, scene.frame, goal.cell, "goal")
    return GoalJoints(centre, centre)
