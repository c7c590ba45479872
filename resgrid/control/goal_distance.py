"""Distance between a configuration of a robot and the nearest goal of its scene.

A goal cell may contain configurations that do not solve the goal.  Therefore a robot may be in a goal cell, and its
distance from the goal may still be above 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.control.escape import goal_offset
from resgrid.core.axis import Point
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.robots import Ball, Box, Robot, Shape
from resgrid.robots.geometry import RigidPart, obstacles_of
from resgrid.scene.goals import Goal, GoalCell, GoalJoints, GoalPoint, GoalPose
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import to_space

Vector = NDArray[np.float64]


def goal_distance(space: ConfigurationSpace, configuration: Vector, scene: Scene | None) -> float:
    """Return the distance of a configuration from the nearest goal; 0 inside a goal.

    For a goal in the workspace (a shape or a point) the result is the distance from the robot's reference point (the
    tip of an arm) to the goal, in metres.  For a goal cell or joint angles it is the distance between configurations,
    in axis units.  Without a scene, or for a scene without goals, it is the distance in axis units to the configuration
    that solves the goal in the cell of the configuration; NaN if this cell is not a goal cell.

    `space`: configuration space; `configuration` (ndim,): in axis coordinates; `scene`: gives the goals, None for the
    goal cells of the space.
    """
    if scene is not None and scene.goals:
        return min(_distance(scene, space, goal, configuration) for goal in scene.goals)
    cell = tuple(space.split(_wrapped(space, configuration))[0].tolist())
    if space.cell[cell] != Cell.GOAL:
        return float("nan")
    return float(np.linalg.norm(goal_offset(space, _wrapped(space, configuration))))


def _distance(scene: Scene, space: ConfigurationSpace, goal: Goal, configuration: Vector) -> float:
    """Return the distance of a configuration from one goal of a scene; 0 inside the goal.

    For a goal in the workspace it is the distance of the robot's reference point in metres, else a distance between
    configurations in axis units.  `scene`: gives the robot; `space`: configuration space, with axes and frame; `goal`:
    a shape, point, cell or joint ranges; a tool pose raises InputError; `configuration` (ndim,): in axis coordinates.
    """
    robot, frame, width = scene.robot, space.frame, space.spacing
    match goal:
        case GoalCell(cell):
            corner = space.lower + np.array(cell) * width
            return _from_box(space, configuration, corner, corner + width)
        case GoalJoints(lower, upper):
            shape: Shape = Box(lower, upper)
            is_place = not frame.is_world
        case GoalPoint(point, tolerance):
            place = tuple(np.asarray(frame.from_world(point)).tolist())
            if robot.base is None and len(place) == space.ndim != 2 and not tolerance:
                return _from_box(space, configuration, np.array(place), np.array(place))
            if tolerance and len(place) == space.ndim != 2:
                return _from_tolerant_pose(robot, space, place, tolerance, configuration)
            return _from_place(robot, space, Ball(place, tolerance), configuration)
        case GoalPose():
            raise InputError("the distance of a tool from a goal pose is not computed")
        case _:
            shape, is_place = goal, goal.ndim == 2
    if is_place:
        return _from_place(robot, space, to_space(shape, frame), configuration)
    return _from_box(space, configuration, *map(np.array, shape.bounds))


def _from_tolerant_pose(
    robot: Robot, space: ConfigurationSpace, place: Point, tolerance: float, configuration: Vector
) -> float:
    """Return the distance of a configuration from a goal configuration with a tolerance, in axis units.

    The distance is 0 inside the goal.  `place`: goal configuration in axis coordinates; `tolerance`: largest Euclidean
    distance from the goal in the first two coordinates, or in all coordinates for a robot that moves in the workspace;
    other coordinates have no tolerance; `configuration` (ndim,): in axis coordinates.
    """
    gap = np.array(place) - _wrapped(space, configuration)
    turn = (space.upper - space.lower)[space.periodic]
    gap[space.periodic] -= turn * np.round(gap[space.periodic] / turn)
    free = len(gap) if robot.moves_in_workspace else 2
    apart = max(float(np.linalg.norm(gap[:free])) - tolerance, 0.0)
    return float(np.hypot(apart, np.linalg.norm(gap[free:])))


def _from_place(robot: Robot, space: ConfigurationSpace, shape: Shape, configuration: Vector) -> float:
    """Return the distance of the robot's reference point from a shape in the workspace, in metres.

    Over periodic axes the shape has several copies, shifted by whole periods; the nearest counts.  NaN for an empty
    shape.  `robot`: robot; `space`: configuration space; `shape`: shape in axis coordinates; `configuration` (ndim,):
    in axis coordinates.
    """
    import shapely

    at = robot.reference_point(_wrapped(space, configuration)[np.newaxis])
    point = RigidPart(np.asarray(shapely.points(at)), 0.0)
    copies = obstacles_of([shape], robot.workspace_axes(space.axes))
    return min((float(copy.distance(point)[0]) for copy in copies), default=float("nan"))


def _from_box(space: ConfigurationSpace, configuration: Vector, lower: Vector, upper: Vector) -> float:
    """Return the distance of a configuration from a box in configuration space, in axis units; 0 inside the box.

    Periodic axes wrap around.  `configuration` (ndim,): in axis coordinates; `lower, upper` (ndim,): smallest and
    largest coordinates of the box.
    """
    turn = np.where(space.periodic, space.upper - space.lower, 0.0)
    at = _wrapped(space, configuration) + np.multiply.outer([-1.0, 0.0, 1.0], turn)
    return float(np.linalg.norm(np.maximum(np.maximum(lower - at, at - upper), 0.0).min(axis=0)))


def _wrapped(space: ConfigurationSpace, configuration: Vector) -> Vector:
    """Return a configuration (ndim,) in axis coordinates, shifted by whole periods into the range of periodic axes."""
    turn = space.upper - space.lower
    return np.asarray(np.where(space.periodic, space.lower + np.mod(configuration - space.lower, turn), configuration))
