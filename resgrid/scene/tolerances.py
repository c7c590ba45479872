"""Goal cells of a point with a tolerance, and headings at the goal of robots that do not turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Point
from resgrid.errors import InputError
from resgrid.robots import Ball, GoalCells
from resgrid.robots.cells import region_cells
from resgrid.scene.goals import GoalPoint
from resgrid.scene.scene import Scene


def tolerant_goal(scene: Scene, point: Point, tolerance: float) -> GoalCells:
    """Return the mask of the cells within a distance of a goal point, and for each a configuration of the goal.

    Obstacle cells are included.  `point`: place of the robot's reference point in the coordinates of the space, or a
    configuration (x, y, heading), whose heading has no tolerance; `tolerance`: largest distance of the reference point
    from this place, in the unit of the place.  The configurations are in axis units.
    """
    robot, axes = scene.robot, scene.axes
    if robot.base is not None or robot.moves_in_workspace or len(point) < len(axes):
        return robot.goal_cells(axes, Ball(point, tolerance))
    places, near = region_cells(axes[:2], Ball(point[:2], tolerance))
    turns, headings = region_cells(axes[2:], point[2:])
    points = np.column_stack([near, np.repeat(headings, len(near), axis=0)])
    return GoalCells(places[:, :, np.newaxis] & turns, points)


def require_no_heading(scene: Scene, key: str) -> None:
    """Raise InputError unless the scene's robot may have a goal with ``heading``: a point or a disc in the plane.

    Other robots have no heading, or give theirs as third coordinate of the goal.  `key`: key path of the goal.
    """
    if scene.robot.turning_length is not None:
        raise InputError(
            f"{key}.heading: this robot has a heading of its own; give it as third coordinate of the point, and remove "
            "heading"
        )
    if not scene.robot.moves_in_workspace or scene.ndim != 2:
        raise InputError(f"{key}.heading applies to points and discs in the plane, not to this robot; remove heading")


def goal_heading(scene: Scene, end: NDArray[np.float64]) -> float | None:
    """Return the heading in radians that a scene demands at the end of a path that reaches a goal; None for no demand.

    The heading is that of the goal point nearest to the end of the path, among the goal points at most their tolerance
    plus the width of a cell away.  `end` (ndim,): last point of the path in world coordinates.
    """
    slack = max(axis.spacing for axis in scene.axes)
    distance = {
        goal: float(np.linalg.norm(np.subtract(goal.point, end)))
        for goal in scene.goals
        if isinstance(goal, GoalPoint) and len(goal.point) == len(end)
    }
    within = [goal for goal, apart in distance.items() if apart <= goal.tolerance + slack]
    return min(within, key=distance.__getitem__).heading if within else None
