"""The reachable place that is nearest to a goal, for paths that end there in place of the goal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.scene.goal_placement import goal_cells
from resgrid.scene.goals import GoalCell, GoalJoints, GoalPoint
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import cell_centre


def goal_points(scene: Scene) -> NDArray[np.float64]:
    """Return points in the goals of a scene, in axis units, shape (g, d).

    d is the number of axes, or smaller if a goal states a place without a heading.
    """
    points: list[NDArray[np.float64]] = []
    for goal in scene.goals:
        match goal:
            case GoalPoint(point):
                points.append(scene.frame.from_world(point)[np.newaxis])
            case GoalCell(cell):
                centre = cell_centre(scene.axes, scene.frame, cell, "goal")
                points.append(scene.frame.from_world(centre)[np.newaxis])
            case GoalJoints(lower, upper):
                points.append(scene.frame.from_world(np.add(lower, upper) / 2)[np.newaxis])
            case _:
                cells = goal_cells(scene, goal, np.zeros([axis.cells for axis in scene.axes], dtype=bool), "goal")
                points.append(cells.points)
    if scene.map is not None and scene.axes[: len(scene.map.axes)] == scene.map.axes:
        at = np.argwhere(scene.map.cell == Cell.GOAL)
        axes = scene.map.axes
        points.append(np.array([axis.lower for axis in axes]) + (at + 0.5) * [axis.spacing for axis in axes])
    d = min(part.shape[1] for part in points if len(part))
    return np.concatenate([part[:, :d] for part in points])


def nearest_to_goals(
    space: ConfigurationSpace, cells: NDArray[np.int64], goals: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """Return the cell (ndim,) nearest to any goal, its point (ndim,) nearest to this goal, and their distance.

    Points and distances are in axis units; only the first d coordinates count.  `cells` (n, ndim): candidates; `goals`
    (g, d): points.
    """
    d, half = goals.shape[1], space.spacing / 2 * (1 - 1e-6)
    centre = space.axis_centre(cells)
    turn = (space.upper - space.lower)[:d]
    best = (np.inf, 0, centre[0])
    for goal in goals:
        offset = goal - centre[:, :d]
        offset -= np.where(space.periodic[:d], turn * np.round(offset / turn), 0.0)
        inside = np.clip(offset, -half[:d], half[:d])
        apart = np.linalg.norm(offset - inside, axis=1)
        row = int(np.argmin(apart))
        if apart[row] < best[0]:
            point = centre[row].copy()
            point[:d] += inside[row]
            best = (float(apart[row]), row, point)
    return cells[best[1]], best[2], best[0]
