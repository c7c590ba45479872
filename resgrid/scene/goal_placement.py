"""Goal cells of a scene, and the remedies in messages about goals in blocked cells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Point, extent_of
from resgrid.core.cell import Cell
from resgrid.errors import InputError, ResgridError
from resgrid.robots import Box, GoalCells, PointRobot, URDFRobot
from resgrid.scene.goals import Goal, GoalCell, GoalJoints, GoalPoint, GoalPose
from resgrid.scene.keepout import keepouts_of
from resgrid.scene.maps.formats import format_of
from resgrid.scene.maps.pictures import THRESHOLD, read_raster
from resgrid.scene.maps.preparation import KEYS
from resgrid.scene.nearest_place import (
    are_unknown,
    form_of,
    is_unknown,
    nearest_cell,
    nearest_place,
    usable,
    why_blocked,
)
from resgrid.scene.obstacle_cells import obstacle_cells, obstacle_shapes
from resgrid.scene.scene import Scene
from resgrid.scene.tolerances import require_no_heading, tolerant_goal
from resgrid.scene.trials import Change, changed_scene, finer_values, place_of_goal, with_division, with_unknown_free
from resgrid.scene.world_coordinates import check_cell, locate_point, over_map, to_space


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
            remedies = _remedies(scene, goal, blocked, cell, is_unknown=is_unknown(scene, cell))
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
        unseen, first = are_unknown(scene, met), tuple(np.argwhere(met)[0].tolist())
        raise InputError(
            f"{key}: this goal lies {'in unknown space' if unseen else 'inside an obstacle'} (all of its "
            f"{int(met.sum())} cells); {_remedies(scene, goal, blocked, first, is_unknown=unseen)}"
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
    goals = cells_over_map(scene, scene.map.cell == Cell.GOAL, f"{where}: the goal cells of the map")
    if blocked[goals].all():
        raise InputError(f"{where}: the robot touches an obstacle in all goal cells of the map; {scene.robot.remedy}")
    free = goals & ~blocked
    return GoalCells(free, np.full((int(free.sum()), scene.ndim), np.nan))


def cells_over_map(scene: Scene, values: NDArray[Any], subject: str) -> NDArray[Any]:
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


def _remedies(scene: Scene, goal: Goal, blocked: NDArray[np.bool_], cell: tuple[int, ...], *, is_unknown: bool) -> str:
    """Return the remedies for a goal in a blocked cell as text: the nearest free place, and options that free the goal.

    The place is reachable from a start or, without a start in a free cell, in the largest free region.  For a goal that
    is given as a cell, the place is a cell.  `blocked`: mask of obstacle cells, shape of the space; `cell`: index of
    the goal's cell along each axis; `is_unknown`: whether the goal is blocked by unknown space.
    """
    form = form_of(goal)
    place = nearest_place(usable(scene, blocked), cell, scene.axes, scene.frame, form)
    options = [*_map_options(scene, goal, is_unknown=is_unknown), *_robot_options(scene, cell)]
    if place is None:
        parts = ["no cell is free" + "; remove obstacles" * (not options)]
    elif scene.robot.base is not None:  # the goal is a place of an arm's tip, not a cell
        parts = ["move or enlarge it"]
    else:
        whose = "that a start can reach" if scene.starts else "of the largest free region"
        parts = [f"move it to a free {form} {whose}, the nearest is {place}{_grey(scene, cell)}"]
    return "; ".join([*parts, *options])


def _map_options(scene: Scene, goal: Goal, *, is_unknown: bool) -> Iterator[str]:
    """Yield a phrase for every option of the map that makes a usable cell of a blocked goal free.

    `is_unknown`: whether the goal is blocked by unknown space.
    """
    if is_unknown:
        if _freed(goal, partial(with_unknown_free, scene)) is not None:
            yield "--unknown free treats unknown cells as free"
        elif isinstance(scene.robot, PointRobot) and scene.robot.radius:
            smaller = partial(with_unknown_free, replace(scene, robot=scene.robot.shrunk))
            if _freed(goal, smaller) is not None:
                yield "--unknown free together with a smaller radius of the robot frees it"
    for count in finer_values(scene):
        found = _freed(place_of_goal(scene, goal), partial(with_division, scene, "coarsen", count))
        if found is not None:
            cell = tuple(np.argwhere(found)[0].tolist())
            name = f"; cells then have other numbers, and the goal is cell {cell}" * isinstance(goal, GoalCell)
            yield f"--coarsen {count} frees it, with {' x '.join(map(str, found.shape))} cells{name}"
            return


def _freed(goal: Goal, change: Change) -> NDArray[np.bool_] | None:
    """Return the mask of the usable cells of a goal in a changed scene; None without such a cell.

    `change`: function that returns the changed scene, for which the result is None if it is invalid or too large.
    """
    scene = changed_scene(change)
    if scene is None:
        return None
    try:
        blocked, _ = obstacle_cells(scene, keepouts_of(scene))
        single = _single_cell(scene, goal, "goal")
        met = _region(scene, goal).cells if single is None else np.zeros_like(blocked)
    except ResgridError:
        return None
    if single is not None:
        met[single[1]] = True
    met &= usable(scene, blocked)
    return met if met.any() else None


def _robot_options(scene: Scene, cell: tuple[int, ...]) -> Iterator[str]:
    """Yield a phrase for every change of the robot's size, or of the criterion of free cells, that frees a cell.

    A smaller body is named without a trial for robots that are not points or discs.  `cell`: index of the goal's cell
    along each axis.
    """
    if isinstance(scene.robot, PointRobot) and scene.robot.radius:
        obstacles = obstacle_shapes(scene)
        if not scene.robot.shrunk.occupancy(scene.axes, obstacles, scene.sampling)[cell]:
            yield scene.robot.remedy
        if scene.sampling == "conservative" and not scene.robot.occupancy(scene.axes, obstacles, "centre")[cell]:
            yield "--set sampling=centre frees it"
    elif scene.robot.remedy:
        yield scene.robot.remedy


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
