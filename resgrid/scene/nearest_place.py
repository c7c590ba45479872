"""Texts for messages about blocked places (reason, nearest free place), and the searches of cells behind them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.coordinates import coordinate_text
from resgrid.core.axis import Axis, Point
from resgrid.core.cell import Cell
from resgrid.core.frame import Frame
from resgrid.core.regions import label_regions
from resgrid.errors import InputError
from resgrid.robots import PointRobot
from resgrid.scene.goals import Goal, GoalCell
from resgrid.scene.keepout import mask_at
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import cell_centre, locate_point, to_space, unknown_cells


def is_unknown(scene: Scene, cell: tuple[int, ...]) -> bool:
    """Return whether a cell is an obstacle only because its occupancy is unknown in the scene's map.

    `cell`: index of the cell along each axis.  The result is False for a scene without a map.
    """
    unknown = unknown_cells(scene.map, scene.axes)
    return unknown is not None and bool(unknown[cell])


def are_unknown(scene: Scene, cells: NDArray[np.bool_]) -> bool:
    """Return whether all cells of a mask are obstacles only because their occupancy is unknown in the scene's map.

    `cells`: mask, shape of the space.  The result is False for a scene without a map.
    """
    unknown = unknown_cells(scene.map, scene.axes)
    return unknown is not None and bool(unknown[cells].all())


def has_unknown(scene: Scene) -> bool:
    """Return whether the scene has a map, and this map has cells that are obstacles only for unknown occupancy."""
    unknown = unknown_cells(scene.map, scene.axes)
    return unknown is not None and bool(unknown.any())


def why_blocked(scene: Scene, cell: tuple[int, ...]) -> str:
    """Return the reason why a cell is blocked, as text for a message.

    The reason is unknown space, a keep-out area of a mask, a distance from an obstacle below the robot's radius, or an
    obstacle.  The text continues the name of a place, such as ``lies in an obstacle (cell (3, 4))``.  `cell`: index of
    the blocked cell along each axis.
    """
    words = f"(cell {cell})"
    if is_unknown(scene, cell):
        return f"lies in unknown space {words}"
    mask = mask_at(scene, cell)
    if mask is not None:
        return f"lies in the keep-out area of {mask} {words}"
    robot = scene.robot
    if isinstance(robot, PointRobot) and robot.radius and not _is_solid(scene, cell):
        return f"lies too near to an obstacle for the robot's radius of {robot.radius:g} {words}"
    if robot.moves_in_workspace or (robot.base is None and robot.turning_length is None):
        return f"lies in an obstacle {words}"
    return f"lies in an obstacle of configuration space: the robot would touch an obstacle there {words}"


def _is_solid(scene: Scene, cell: tuple[int, ...]) -> bool:
    """Return whether the centre of a cell lies in an obstacle, regardless of the robot's radius.

    `cell`: index of the cell along each axis.
    """
    if scene.map is not None and _on_map(scene) and scene.map.cell[cell[: scene.map.cell.ndim]] == Cell.OBSTACLE:
        return True
    axes = tuple(
        Axis(axis.name, axis.lower + index * axis.spacing, axis.lower + (index + 1) * axis.spacing, 1)
        for axis, index in zip(scene.axes, cell, strict=True)
    )
    shapes = [to_space(shape, scene.frame) for shape in scene.obstacles]
    return bool(PointRobot().occupancy(axes, shapes, "centre").all())


def _on_map(scene: Scene) -> bool:
    """Return whether the scene has a map, and the first axes of the space equal the axes of this map."""
    return scene.map is not None and scene.axes[: len(scene.map.axes)] == scene.map.axes


Form = Literal["place", "cell", "both"]
"""Form of a recommended place: coordinates in the world, the index of a cell, or both."""


def form_of(goal: Goal) -> Form:
    """Return the form in which a message recommends another place for a goal: that in which the goal is given."""
    return "cell" if isinstance(goal, GoalCell) else "place"


def nearest_place(
    allowed: NDArray[np.bool_], cell: tuple[int, ...], axes: Sequence[Axis], frame: Frame, form: Form = "both"
) -> str | None:
    """Return the nearest allowed cell as text: its centre in world coordinates, its index, or both; None without one.

    The text has the form ``(1.3, 3.4)``, ``cell (13, 34)`` or ``(1.3, 3.4), cell (13, 34)``.  Both are right for a
    start: a scene stores the centre of a start that is given as a cell.  `allowed`: mask of cells, shape of the space;
    `cell`: index of the cell from whose centre distances in axis units are measured; `axes`, `frame`: axes of the
    space, and the transformation from axis units to the world.
    """
    nearest = nearest_cell(allowed, cell, axes)
    return None if nearest is None else text_of_cell(nearest, axes, frame, form)


def text_of_cell(cell: tuple[int, ...], axes: Sequence[Axis], frame: Frame, form: Form = "both") -> str:
    """Return a cell as text, in the form of `nearest_place`: its centre in world coordinates, its index, or both.

    `axes`, `frame`: axes of the space, and the transformation from axis units to the world.
    """
    index = f"cell {cell}"
    if form == "cell":
        return index
    place = place_text(cell_centre(tuple(axes), frame, cell, ""), min(axis.spacing for axis in axes) / 10)
    return place if form == "place" else f"{place}, {index}"


def place_text(point: Sequence[float], step: float = 1e-3) -> str:
    """Return a point as text in parentheses, such as ``(1.3, 3.4)``.

    `step`: difference of coordinates that the text must resolve; above 0.001, the value 0.001 is used.  A coordinate
    has the significant digits that this difference needs, at least 6 and at most 15.
    """
    return "(" + ", ".join(coordinate_text(value, min(step, 1e-3)) for value in point) + ")"


def nearest_cell(allowed: NDArray[np.bool_], cell: tuple[int, ...], axes: Sequence[Axis]) -> tuple[int, ...] | None:
    """Return the index of the allowed cell with the nearest centre; None if no cell is allowed.

    `allowed`: mask of cells, shape of the space; `cell`: index of the cell from whose centre distances in axis units
    are measured; `axes`: axes of the space.  Along a periodic axis, the shorter way round counts.  The search examines
    windows around this cell that grow until the result is certain.
    """
    spacing = np.array([axis.spacing for axis in axes])
    for power in count(3, 2):
        ranges = [_window(index, 2**power, axis) for index, axis in zip(cell, axes, strict=True)]
        found = np.argwhere(allowed[np.ix_(*(window % axis.cells for window, axis in zip(ranges, axes, strict=True)))])
        is_all = all(len(window) == axis.cells for window, axis in zip(ranges, axes, strict=True))
        if len(found):
            steps = np.column_stack([window[column] for window, column in zip(ranges, found.T, strict=True)]) - cell
            apart = np.linalg.norm(steps * spacing, axis=1)
            best = int(np.argmin(apart))
            if is_all or apart[best] <= 2**power * spacing.min():
                place = np.array(cell) + steps[best]
                return tuple((place % [axis.cells for axis in axes]).tolist())
        if is_all:
            return None
    raise AssertionError("windows grow until they cover the grid")


def _window(index: int, reach: int, axis: Axis) -> NDArray[np.int64]:
    """Return the indices of cells along an axis that differ from `index` by at most `reach`, in ascending order.

    On a periodic axis, indices may lie outside the grid and count modulo the number of cells; each cell occurs once.
    """
    if axis.periodic:
        before = min(reach, (axis.cells - 1) // 2)
        return np.arange(index - before, index + min(reach, axis.cells // 2) + 1)
    return np.arange(max(index - reach, 0), min(index + reach + 1, axis.cells))


def usable(scene: Scene, blocked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask of free cells that chains of free cells with common faces connect with a start of the scene.

    If no start lies in a free cell, the result is the mask of the largest connected region of free cells.  `blocked`:
    mask of obstacle cells; both masks have the shape of the space.
    """
    region = label_regions(~blocked, [axis.periodic for axis in scene.axes])
    starts = [_cell_of(scene, start) for start in scene.starts]
    numbers = {int(region[cell]) for cell in starts if cell is not None} - {0}
    if not numbers and region.any():
        numbers = {int(np.argmax(np.bincount(region.ravel())[1:])) + 1}
    return np.isin(region, sorted(numbers))


def _cell_of(scene: Scene, point: Point) -> tuple[int, ...] | None:
    """Return the index of the cell that contains a point in world coordinates; None outside the grid."""
    try:
        return locate_point(scene.axes, scene.frame, point, "")[0]
    except InputError:
        return None
