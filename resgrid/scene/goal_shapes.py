"""`goal_shapes`: selection of those goals of a scene that can be drawn as shapes in three dimensions."""

from __future__ import annotations

from resgrid.robots import CellSet, Shape
from resgrid.scene.goals import GoalPose
from resgrid.scene.scene import Scene


def goal_shapes(scene: Scene) -> list[Shape]:
    """Return the goals of a scene that are regions of three dimensions, in world coordinates.

    They are shapes with three coordinates, and for a `GoalPose` with a radius the ball of the tool's positions.  Goals
    that are cells, single points, configurations, or shapes in the plane are left out.
    """
    regions = [goal.tool_goal.region if isinstance(goal, GoalPose) and goal.radius else goal for goal in scene.goals]
    return [goal for goal in regions if isinstance(goal, Shape) and not isinstance(goal, CellSet) and goal.ndim == 3]
