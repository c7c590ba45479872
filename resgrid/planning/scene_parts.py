"""Which obstacles of a scene, by their place in its file, keep a start from every goal."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError
from resgrid.planning.completeness import verdict_of
from resgrid.planning.streamline import Outcome
from resgrid.planning.trace import one_start, start_cells
from resgrid.robots import CellSet
from resgrid.scene import MapCells, Scene, sample
from resgrid.scene.world import to_space
from resgrid.space import Cell, ConfigurationSpace

_MOST_PARTS = 63


@dataclass(frozen=True, eq=False)
class Blocking:
    """Which parts of a scene keep a start from every goal.

    Attributes
    ----------
    space : ConfigurationSpace
        The sampled scene.
    start : tuple of int
        The start's cell.
    outcome : Outcome
        ``REACHED`` where a path exists; otherwise ``NO_PATH``, ``GOAL_BLOCKED`` or ``START_BLOCKED``.
    parts : mapping of str to ndarray of bool, shape of the space
        What blocks cells, and which: ``"obstacle[0]"`` as in the scene's file, ``"map"``, ``"singularity"`` (virtual
        obstacles alone), ``"robot"`` (collisions with itself).  A cell may be blocked by several.
    alone : tuple of str
        Every part whose removal alone opens a way to some goal.
    least : tuple of str
        The smallest set whose removal opens a way; the first found if there are several; empty where a path exists,
        or where no set as small as asked for will do.
    """

    space: ConfigurationSpace
    start: tuple[int, ...]
    outcome: Outcome
    parts: Mapping[str, NDArray[np.bool_]]
    alone: tuple[str, ...]
    least: tuple[str, ...]

    def __post_init__(self) -> None:
        for mask in self.parts.values():
            mask.flags.writeable = False

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Cells that the `least` set blocks, shape of the space."""
        masks = [self.parts[name] for name in self.least]
        return np.any(masks, axis=0) if masks else np.zeros(self.space.shape, dtype=np.bool_)


def blocking(
    scene: Scene, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None, most: int = 3
) -> Blocking:
    """Say which obstacles of a scene keep a start from every goal.

    `resgrid.separation` does so for groups of cells of the configuration space, where the images of several obstacles,
    and virtual ones, often melt into one; this asks the same of the obstacles themselves, by trying sets of them.  What
    is taken away gives back the part of the goals' regions that it covered.

    Parameters
    ----------
    scene : Scene
        Sampled as a whole, and once for each obstacle.
    start : array_like of float, shape (ndim,)
        World coordinates.
    cell : sequence of int, optional
        Instead of `start`: a cell.
    most : int
        Largest set that is tried.

    Returns
    -------
    Blocking

    Raises
    ------
    InputError
        If the scene has no goal or more than 63 parts, the start lies outside the grid, or `most` is below 1.
    """
    if most < 1:
        raise InputError(f"most = {most}, but at least one obstacle must be taken away to open a way")
    space = sample(scene)
    point = one_start(space, start, cell)
    at = _cell_of(space, point)
    outcome = verdict_of(space, at)
    if outcome is Outcome.REACHED:
        return Blocking(space, at, outcome, {}, (), ())
    parts = blocking_parts(scene, space)
    names, bits = tuple(parts), _blockers(space, list(parts.values()))
    goal = _whole_goal(scene)

    def opens(*removed: int) -> bool:
        left = _without(space, goal, bits, removed)
        return verdict_of(left, _cell_of(left, point)) is Outcome.REACHED

    alone = tuple(name for number, name in enumerate(names) if opens(number))
    larger = () if alone else (n for size in range(2, most + 1) for n in combinations(range(len(names)), size))
    chosen = next((numbers for numbers in larger if opens(*numbers)), ())
    least = alone[:1] or tuple(names[number] for number in chosen)
    return Blocking(space, at, outcome, parts, alone, least)


def blocking_parts(scene: Scene, space: ConfigurationSpace) -> dict[str, NDArray[np.bool_]]:
    """Cells that each part of a scene blocks, by its name.  Returns as the space."""
    plain = scene.robot.bare()
    itself = plain.occupancy(scene.axes, [], scene.sampling)
    parts = {
        f"obstacle[{number}]": plain.occupancy(scene.axes, [to_space(shape, scene.frame)], scene.sampling) & ~itself
        for number, shape in enumerate(scene.obstacles)
    }
    if scene.map is not None:
        cells = CellSet(scene.axes, scene.map.cell == Cell.OBSTACLE)
        parts["map"] = plain.occupancy(scene.axes, [cells], scene.sampling) & ~itself
    if plain != scene.robot:
        parts["singularity"] = scene.robot.occupancy(scene.axes, [], scene.sampling) & ~itself
    blocked = space.cell == Cell.OBSTACLE
    parts["robot"] = blocked & ~np.any([*parts.values(), np.zeros_like(blocked)], axis=0)
    return {name: mask & blocked for name, mask in parts.items() if np.any(mask & blocked)}


def _blockers(space: ConfigurationSpace, masks: list[NDArray[np.bool_]]) -> NDArray[np.uint64]:
    """Every cell with one bit for each part that blocks it."""
    if len(masks) > _MOST_PARTS:
        raise InputError(
            f"the scene has {len(masks)} obstacles, and at most {_MOST_PARTS} can be told apart; merge some, or ask "
            "resgrid.separation"
        )
    bits = np.zeros(space.shape, dtype=np.uint64)
    for number, mask in enumerate(masks):
        bits[mask] |= np.uint64(1 << number)
    return bits


def _whole_goal(scene: Scene) -> NDArray[np.bool_]:
    """Goal cells as they are where nothing blocks any, shape of the space."""
    cells = scene.map
    if cells is not None:
        cells = MapCells(np.where(cells.cell == Cell.OBSTACLE, np.uint8(Cell.FREE), cells.cell), cells.table)
    robot = scene.robot.bare(self_collision=False)
    return np.asarray(sample(dataclasses.replace(scene, robot=robot, obstacles=(), map=cells)).cell == Cell.GOAL)


def _without(
    space: ConfigurationSpace, goal: NDArray[np.bool_], bits: NDArray[np.uint64], removed: tuple[int, ...]
) -> ConfigurationSpace:
    """The space without some parts: what they alone blocked is free, or goal."""
    kept = np.uint64(2**64 - 1 - sum(1 << number for number in removed))
    open_cell = np.where(goal, np.uint8(Cell.GOAL), np.uint8(Cell.FREE))
    return space.with_cells(np.where((bits & kept) == 0, open_cell, np.uint8(Cell.OBSTACLE)))


def _cell_of(space: ConfigurationSpace, point: NDArray[np.float64]) -> tuple[int, ...]:
    cells, _ = start_cells(space, point[np.newaxis])
    return tuple(cells[0].tolist())
