"""Discretisation of a scene to a configuration space (obstacle and goal cells, conductivities), with its messages."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.memory import FEWER_CELLS, FEWER_HEADINGS, Remedy, require_grid_memory
from resgrid.core.axis import Point, extent_of
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.robots import Box, GoalCells, PointRobot, Progress, Shape, URDFRobot
from resgrid.robots.cells import merge_goals
from resgrid.scene.goals import Goal, GoalCell, GoalJoints, GoalPoint, GoalPose
from resgrid.scene.keepout import Keepout, forbidden_places, keepouts_of
from resgrid.scene.maps.formats import format_of
from resgrid.scene.maps.pictures import THRESHOLD, read_raster
from resgrid.scene.maps.preparation import KEYS, extent_of_mask
from resgrid.scene.maps.size_advice import coarser_division, smaller_map
from resgrid.scene.nearest_place import are_unknown, is_unknown, nearest_cell, nearest_place, usable, why_blocked
from resgrid.scene.scene import Scene
from resgrid.scene.tolerances import require_no_heading, tolerant_goal
from resgrid.scene.world_coordinates import check_cell, locate_point, over_map, to_space


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
    obstacles = [*_obstacles(scene), *(effect.obstacle for effect in keepouts if effect.obstacle is not None)]
    blocked, undecided = scene.robot.classify(scene.axes, obstacles, scene.sampling, progress, executor)
    for mask in forbidden_places(scene, keepouts).values():
        blocked = blocked | mask
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


def _obstacles(scene: Scene) -> list[Shape]:
    shapes = [to_space(shape, scene.frame) for shape in scene.obstacles]
    if scene.map is not None:
        shapes.append(scene.map.obstacles)
    return shapes


def goal_cells(scene: Scene, goal: Goal, blocked: NDArray[np.bool_], key: str) -> GoalCells:
    """Return the mask of the free cells of a goal, and for each such cell a configuration that solves the goal.

    Configurations (goal cells, ndim) are in axis units and in C order of the cells; for a `GoalCell`, of which every
    point is a solution, they are NaN.  `blocked`: mask of obstacle cells, shape of the space; `key`: key path of the
    goal, for messages.  Raises InputError if the goal lies outside the grid, is out of reach, or consists of obstacle
    cells.
    """
    if isinstance(goal, GoalPoint) and goal.heading is not None:
        require_no_heading(scene, key)
    single = _single_cell(scene, goal, key)
    if single is not None:
        words, cell, point = single
        if blocked[cell]:
            why = why_blocked(scene, cell)
            remedies = _remedies(scene, blocked, cell)
            if isinstance(goal, GoalPoint) and any(goal is each for each in scene.goals):  # not an intermediate place
                remedies += _tolerance_remedy(scene, blocked, cell, point)
            raise InputError(f"{key}: {words} {why}; {remedies}")
        cells = np.zeros_like(blocked)
        cells[cell] = True
        return GoalCells(cells, np.array([point]))
    try:
        met, points = _region(scene, goal)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None
    if not met.any():
        raise InputError(f"{key}: this goal lies outside the grid ({extent_of(scene.axes)}); move it inside")
    if blocked[met].all():
        place = "in unknown space" if are_unknown(scene, met) else "inside an obstacle"
        raise InputError(
            f"{key}: this goal lies {place} (all of its {int(met.sum())} cells); "
            f"{_remedies(scene, blocked, tuple(np.argwhere(met)[0].tolist()))}"
        )
    return GoalCells(met & ~blocked, points[~blocked[met]])


def _single_cell(scene: Scene, goal: Goal, key: str) -> tuple[str, tuple[int, ...], Point] | None:
    """Return description, cell and point of a goal that is a single cell; None for other goals.

    Such goals are a `GoalCell`, one configuration, and a point without tolerance that is a configuration.  The
    description is a phrase for messages, such as ``the cell [7, 0]``; the cell is its index along each axis; the point
    is in axis units, NaN for a `GoalCell`, of which every point is a solution.  `scene`, `goal`: the scene and one of
    its goals; `key`: key path of the goal, for messages.
    """
    match goal:
        case GoalCell(cell):
            check_cell(scene.axes, cell, key)
            return f"the cell {list(cell)}", cell, (np.nan,) * scene.ndim
        case GoalJoints(point, upper) if point == upper:
            kind = "configuration"
        case GoalPoint(point) if scene.robot.base is None and len(point) == scene.ndim and not goal.tolerance:
            kind = "point"
        case _:
            return None
    return f"the {kind} {list(point)}", *locate_point(scene.axes, scene.frame, point, key)


def _region(scene: Scene, goal: Goal) -> GoalCells:
    match goal:
        case GoalJoints(lower, upper):
            return PointRobot().goal_cells(scene.axes, to_space(Box(lower, upper), scene.frame))
        case GoalPoint(point, tolerance):
            inside = tuple(scene.frame.from_world(point).tolist())
            return tolerant_goal(scene, inside, tolerance) if tolerance else scene.robot.goal_cells(scene.axes, inside)
        case GoalPose():
            if not isinstance(scene.robot, URDFRobot):
                raise InputError("a pose of a tool is a goal of robots of the type urdf only; give a point or a shape")
            return scene.robot.goal_cells(scene.axes, goal.tool_goal)
        case GoalCell():
            raise AssertionError("a GoalCell is handled by _single_cell")
    return scene.robot.goal_cells(scene.axes, to_space(goal, scene.frame))


def map_goals(scene: Scene, blocked: NDArray[np.bool_], where: str) -> GoalCells:
    """Return the mask of the free cells of the space that are goal cells of the scene's map, and NaN for each.

    NaN in place of a configuration means that every point of the cell is a solution.  Without a map, or without goal
    cells in the map, no cell is marked.  `blocked`: mask of obstacle cells, shape of the space; `where`: name of the
    scene, for messages.  Raises InputError if all goal cells of the map are obstacle cells of the space.
    """
    if scene.map is None or not (scene.map.cell == Cell.GOAL).any():
        return GoalCells(np.zeros_like(blocked), np.empty((0, scene.ndim)))
    goals = _over_map(scene, scene.map.cell == Cell.GOAL, f"{where}: the goal cells of the map")
    if blocked[goals].all():
        raise InputError(f"{where}: the robot touches an obstacle in all goal cells of the map; {scene.robot.remedy}")
    free = goals & ~blocked
    return GoalCells(free, np.full((int(free.sum()), scene.ndim), np.nan))


def _conductivity(scene: Scene, keepouts: Sequence[Keepout]) -> NDArray[np.float64] | None:
    costs = None if scene.map is None else scene.map.conductivity
    weighted = [effect for effect in keepouts if (effect.conductivity < 1).any()]
    if not scene.areas and costs is None and not weighted:
        return None
    conductivity = np.ones(tuple(axis.cells for axis in scene.axes))
    if costs is not None:
        conductivity[:] = _over_map(scene, costs, "map.least_conductivity: the costs of places")
    for area in scene.areas:
        inside = PointRobot().occupancy(scene.axes, [to_space(area.shape, scene.frame)], "centre")
        conductivity[inside] = area.conductivity
    for effect in weighted:  # after the areas, because a mask states the largest conductivity of its cells
        np.minimum(conductivity, over_map(effect.conductivity, scene.axes), out=conductivity)
    return conductivity


def _over_map(scene: Scene, values: NDArray[Any], subject: str) -> NDArray[Any]:
    """Return values of the map's cells broadcast to the shape of the space, constant along a heading axis.

    `values`: one value per cell of the map, shape of the map; `subject`: description of the values, for messages.
    Raises InputError if the first axes of the space are not those of the map.
    """
    assert scene.map is not None
    if scene.axes[: values.ndim] != scene.map.axes:
        raise InputError(
            f"{subject} do not apply to a robot whose configurations are not places on the map; leave them out"
        )
    return over_map(values, scene.axes)


def _remedies(scene: Scene, blocked: NDArray[np.bool_], cell: tuple[int, ...]) -> str:
    """Return the remedies for a goal in a blocked cell as text: the nearest free place, and options that free the cell.

    The place is reachable from a start or, without a start in a free cell, in the largest free region.  `blocked`: mask
    of obstacle cells, shape of the space; `cell`: index of the goal's cell along each axis.
    """
    allowed = usable(scene, blocked)
    place = nearest_place(allowed, cell, scene.axes, scene.frame)
    if place is None:
        parts = ["no cell is free"]
    elif scene.robot.base is not None:  # the goal is a place of an arm's tip, not a cell
        parts = ["move or enlarge it"]
    else:
        whose = "that a start can reach" if scene.starts else "of the largest free region"
        parts = [f"move it to a free place {whose}, the nearest is {place}{_grey(scene, cell)}"]
    if is_unknown(scene, cell):
        parts.append("--unknown free treats unknown cells as free")
    if isinstance(scene.robot, PointRobot) and scene.robot.radius:
        obstacles = _obstacles(scene)
        if not scene.robot.shrunk.occupancy(scene.axes, obstacles, scene.sampling)[cell]:
            parts.append(scene.robot.remedy)
        if scene.sampling == "conservative" and not scene.robot.occupancy(scene.axes, obstacles, "centre")[cell]:
            parts.append("--set sampling=centre frees it")
    elif scene.robot.remedy:
        parts.append(scene.robot.remedy)
    return "; ".join(parts)


def _tolerance_remedy(scene: Scene, blocked: NDArray[np.bool_], cell: tuple[int, ...], point: Point) -> str:
    """Return text with the goal tolerance that includes the centre of the nearest reachable free cell.

    The text is empty without such a cell, and for a robot that turns.  `blocked`: mask of obstacle cells, shape of the
    space; `cell`: index of the goal's cell along each axis; `point`: point of the goal, in axis units.
    """
    near = nearest_cell(usable(scene, blocked), cell, scene.axes)
    if near is None or scene.robot.turning_length is not None:
        return ""
    gap = np.array([axis.centres[index] for axis, index in zip(scene.axes, near, strict=True)]) - point
    turn = np.array([axis.upper - axis.lower for axis in scene.axes])
    gap -= np.where([axis.periodic for axis in scene.axes], np.round(gap / turn) * turn, 0.0)
    distance = float(np.linalg.norm(gap))
    digits = 10.0 ** (np.floor(np.log10(distance)) - 1)
    return f"; --goal-tolerance {np.ceil(distance / digits) * digits:.3g} includes that place"


def _grey(scene: Scene, cell: tuple[int, ...]) -> str:
    """Return text with the grey value of an obstacle pixel of a picture and the threshold of free pixels.

    The text is empty for a free pixel, and unless the scene's map is a picture that is neither cropped, coarsened nor
    refined.  `cell`: index of the pixel's cell along each axis.
    """
    table = {} if scene.map is None else scene.map.table
    if scene.map is None or format_of(Path(table["file"]), table) != "image" or any(table.get(key) for key in KEYS):
        return ""
    threshold: int = scene.map.table.get("threshold", THRESHOLD)
    try:
        grey = int(read_raster(Path(scene.map.table["file"])).grey[::-1].T[cell[:2]])
    except InputError:  # the picture came from a pipe, or was removed
        return ""
    return f"; its grey value is {grey}, and cells are free from {threshold} on (--threshold)" * (grey < threshold)
