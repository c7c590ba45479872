"""Discretisation of a scene to a configuration space (obstacle and goal cells, conductivities), with its messages."""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.memory import FEWER_CELLS, FEWER_HEADINGS, Remedy, require_grid_memory
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.robots import PointRobot, Progress
from resgrid.robots.cells import merge_goals
from resgrid.scene.goal_placement import cells_over_map, goal_cells, map_goals
from resgrid.scene.keepout import Keepout, keepouts_of
from resgrid.scene.maps.preparation import extent_of_mask
from resgrid.scene.maps.size_advice import coarser_division, smaller_map
from resgrid.scene.obstacle_cells import obstacle_cells
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import locate_point, over_map, to_space


def build_space(
    scene: Scene, *, require_goal: bool = True, progress: Progress | None = None, executor: Executor | None = None
) -> ConfigurationSpace:
    """Return the configuration space of a scene.

    The robot and the scene's ``sampling`` decide which cells are obstacles (see `PointRobot.occupancy`, and the method
    of this name of other robots); the border of the grid makes no cell an obstacle.  A free cell is a goal if it
    contains a configuration with the robot's reference point (an arm's tip) in a goal of the scene, or if it is a goal
    cell of the scene's map.  All inverse solutions of a place in the workspace are goals; the space stores one
    configuration per goal cell.  A start in an obstacle is not an error here; its path has the outcome
    ``start_blocked``.

    Parameters
    ----------
    scene : Scene
        The scene.
    require_goal : bool
        Whether a scene without any goal is an error; if False, the space of such a scene has no goal cell.
    progress : callable, optional
        Called as ``progress(done, total)`` during the computation of obstacle cells, with the finished and the total
        amount of work in arbitrary units.
    executor : concurrent.futures.Executor, optional
        Executor whose workers share the computation of obstacle cells, for a robot from a URDF file; see
        `open_executor`.  By default this process computes them.

    Returns
    -------
    ConfigurationSpace
        The space, with one `Cell` code per cell, and with conductivities if the scene has costs.

    Raises
    ------
    InputError
        If there is no goal although `require_goal` is True, if a goal lies outside the grid, is out of reach or
        consists of obstacle cells, or if a start lies outside the grid; the message names the key.
    BudgetError
        If the grid would not fit in memory; raised before anything is allocated.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> space
    <ConfigurationSpace of 8 x 8 cells, x 0 to 8 cell, y 0 to 8 cell: 7 obstacle, 1 goal>
    >>> (space.cell == rg.Cell.OBSTACLE).sum(axis=0)
    array([0, 1, 1, 0, 4, 0, 1, 0])
    """
    where = scene.source or "scene"
    require_grid_memory(tuple(axis.cells for axis in scene.axes), f"{where}: grid", remedy=remedy_of_size(scene))
    keepouts = keepouts_of(scene)
    blocked, undecided = obstacle_cells(scene, keepouts, progress, executor)
    cell = np.where(blocked, Cell.OBSTACLE, Cell.FREE).astype(np.uint8)
    goals = [map_goals(scene, blocked, where)]
    goals += [goal_cells(scene, goal, blocked, f"{where}: goal[{number}]") for number, goal in enumerate(scene.goals)]
    every = merge_goals(blocked.shape, goals)
    cell[every.cells] = Cell.GOAL
    if require_goal and not (cell == Cell.GOAL).any():
        raise InputError(f"{where}: there is no goal; {adding(scene, 'a [[goal]]', '--goal')}")
    for number, start in enumerate(scene.starts):
        locate_point(scene.axes, scene.frame, start, f"{where}: starts[{number}]")
    costs = _conductivity(scene, keepouts)
    return ConfigurationSpace(
        scene.axes, cell, costs, frame=scene.frame, goal_points=every.points, robot=scene.robot, undecided=undecided
    )


def adding(scene: Scene, key: str, option: str) -> str:
    """Return the remedy for a missing goal or start as text.

    For a scene that was read from a map file, the text names the option of the command line and the keyword of
    `resgrid.read_scene`; for every other scene, the key of scene files and the option.  `key`: name of the key, such as
    "a [[goal]]"; `option`: name of the option, such as "--goal".
    """
    by_option = f"give {with_coordinates(option, scene.ndim)}"
    is_map = scene.map is not None and scene.source is not None and Path(scene.source).suffix.lower() != ".toml"
    if not is_map:
        return f"add {key} to the scene, or {by_option}"
    return f"{by_option} (in Python: {option.lstrip('-')}=({'x, y, z' if scene.ndim == 3 else 'x, y'}) of read_scene)"


def with_coordinates(option: str, ndim: int) -> str:
    """Return an option and its placeholder as text: ``--goal X,Y,Z`` for `ndim` (number of axes) 3, else ``X,Y``."""
    return f"{option} {'X,Y,Z' if ndim == 3 else 'X,Y'}"


def remedy_of_size(scene: Scene) -> Remedy:
    """Return the remedy for a scene whose cells do not fit in memory, for an error message.

    The remedy is a text or, if the first axes of the space are those of a map, a function that returns the text for a
    ratio of needed to available memory.
    """
    cells = scene.map
    if cells is None or scene.axes[: len(cells.axes)] != cells.axes:
        return FEWER_CELLS

    def remedy(ratio: float) -> str:
        assert cells is not None
        refine = cells.table.get("refine") or 1
        if refine > 1:
            return coarser_division(cells.cell.shape, 2 * ratio, refine)  # a solution needs twice the memory
        known = None if cells.unknown is None else extent_of_mask(~cells.unknown)
        fewer = FEWER_HEADINGS + ", or " if len(scene.axes) > len(cells.axes) else ""
        return fewer + smaller_map(cells.cell.shape, ratio, known)

    return remedy


def _conductivity(scene: Scene, keepouts: list[Keepout]) -> NDArray[np.float64] | None:
    costs = None if scene.map is None else scene.map.conductivity
    weighted = [effect for effect in keepouts if (effect.conductivity < 1).any()]
    if not scene.areas and costs is None and not weighted:
        return None
    conductivity = np.ones(tuple(axis.cells for axis in scene.axes))
    if costs is not None:
        conductivity[:] = cells_over_map(scene, costs, "map.least_conductivity: the costs of places")
    for area in scene.areas:
        inside = PointRobot().occupancy(scene.axes, [to_space(area.shape, scene.frame)], "centre")
        conductivity[inside] = area.conductivity
    for effect in weighted:  # after the areas, because a mask states the largest conductivity of its cells
        np.minimum(conductivity, over_map(effect.conductivity, scene.axes), out=conductivity)
    return conductivity
