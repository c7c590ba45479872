"""From a scene to its configuration space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.robots import CellSet, Sampling, Shape
from resgrid.robots.point import PointRobot
from resgrid.scene.files import require_memory
from resgrid.scene.place import located, to_space
from resgrid.scene.scene import Goal, GoalCell, GoalPoint, Scene
from resgrid.space import Axis, Cell, ConfigurationSpace


def sample(scene: Scene, *, require_goal: bool = True) -> ConfigurationSpace:
    """Cut a scene into cells.

    A cell is an obstacle as the scene's ``sampling`` says (see `PointRobot.occupancy`); the border of the grid is none.
    A goal region holds the free cells whose centre lies in it, or, where there is none, the free cells it overlaps.
    A start in an obstacle is no error here: its path will say so.

    Parameters
    ----------
    scene : Scene
        The scene.
    require_goal : bool
        Whether a scene without any goal is an error.

    Returns
    -------
    ConfigurationSpace

    Raises
    ------
    InputError
        If there is no goal, a goal lies outside the grid or wholly in obstacles, or a start lies outside the grid;
        the message names the key.
    BudgetError
        If the grid would not fit in memory; raised before anything is allocated.
    """
    where = scene.source or "scene"
    require_memory(tuple(axis.cells for axis in scene.axes), f"{where}: grid")
    blocked = scene.robot.occupancy(scene.axes, _obstacles(scene), scene.sampling)
    cell = np.where(blocked, Cell.OBSTACLE, Cell.FREE).astype(np.uint8)
    for number, goal in enumerate(scene.goals):
        cell[_goal_cells(scene, goal, blocked, f"{where}: goal[{number}]")] = Cell.GOAL
    _place_map_goals(scene, cell, blocked, where)
    if require_goal and not (cell == Cell.GOAL).any():
        raise InputError(f"{where}: there is no goal; add a [[goal]] to the scene, or say --goal X,Y")
    for number, start in enumerate(scene.starts):
        located(scene.axes, scene.frame, start, f"{where}: starts[{number}]")
    return ConfigurationSpace(scene.axes, cell, _conductivity(scene))


def _obstacles(scene: Scene) -> list[Shape]:
    shapes = [to_space(shape, scene.frame) for shape in scene.obstacles]
    if scene.map is not None:
        shapes.append(CellSet(scene.axes, scene.map.cell == Cell.OBSTACLE))
    return shapes


def _goal_cells(scene: Scene, goal: Goal, blocked: NDArray[np.bool_], key: str) -> NDArray[np.bool_]:
    if isinstance(goal, GoalPoint | GoalCell):
        cell = _one_cell(scene, goal, key)
        if blocked[cell]:
            raise InputError(f"{key}: {_place(goal)} lies in an obstacle (cell {cell}); move it to a free place")
        single = np.zeros_like(blocked)
        single[cell] = True
        return single
    region = _covered(scene.axes, to_space(goal, scene.frame), "centre")
    if not region.any():
        region = _covered(scene.axes, to_space(goal, scene.frame), "conservative")
    if not region.any():
        raise InputError(f"{key}: this goal lies outside the grid ({_extent(scene.axes)}); move it inside")
    if blocked[region].all():
        raise InputError(
            f"{key}: this goal lies inside an obstacle (all {int(region.sum())} cells of it); "
            "move or enlarge it, or make the robot's radius smaller"
        )
    return region & ~blocked


def _one_cell(scene: Scene, goal: GoalPoint | GoalCell, key: str) -> tuple[int, ...]:
    if isinstance(goal, GoalPoint):
        return located(scene.axes, scene.frame, goal.point, key)
    if not all(0 <= index < axis.cells for index, axis in zip(goal.cell, scene.axes, strict=True)):
        size = " x ".join(str(axis.cells) for axis in scene.axes)
        raise InputError(f"{key}: cell {list(goal.cell)} is not in the grid of {size} cells (counted from 0)")
    return goal.cell


def _covered(axes: tuple[Axis, ...], shape: Shape, rule: Sampling) -> NDArray[np.bool_]:
    return PointRobot().occupancy(axes, [shape], rule)


def _place_map_goals(scene: Scene, cell: NDArray[np.uint8], blocked: NDArray[np.bool_], where: str) -> None:
    if scene.map is None:
        return
    goals = scene.map.cell == Cell.GOAL
    if goals.any() and blocked[goals].all():
        raise InputError(
            f"{where}: all goal cells of the map lie within the robot's radius of obstacles; make it smaller"
        )
    cell[goals & ~blocked] = Cell.GOAL


def _conductivity(scene: Scene) -> NDArray[np.float64] | None:
    if not scene.areas:
        return None
    conductivity = np.ones(tuple(axis.cells for axis in scene.axes))
    for area in scene.areas:
        conductivity[_covered(scene.axes, to_space(area.shape, scene.frame), "centre")] = area.conductivity
    return conductivity


def _place(goal: GoalPoint | GoalCell) -> str:
    return f"the point {list(goal.point)}" if isinstance(goal, GoalPoint) else f"the cell {list(goal.cell)}"


def _extent(axes: tuple[Axis, ...]) -> str:
    return ", ".join(f"{axis.name} in [{axis.lower:g}, {axis.upper:g}]" for axis in axes)
