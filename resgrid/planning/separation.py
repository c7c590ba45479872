"""Completeness (Connolly & Grupen 1992, section 3.2): whether a start has a path, and which obstacles separate it.

Free cells meet across faces; what separates them are groups of obstacle cells that meet across faces, edges or corners
(the digital Jordan curve theorem, Rosenfeld 1970).  Taking a whole group away joins everything that touches it, so the
least number of groups that must go is the length of a shortest path over regions and groups.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import AccuracyError, InputError
from resgrid.frozen import frozen, picture_html
from resgrid.planning.barriers import Barriers, group_obstacles, link
from resgrid.planning.fields import Field
from resgrid.planning.streamline import Outcome
from resgrid.planning.trace import one_start, start_cells, static_outcomes
from resgrid.scene import Scene, sample
from resgrid.scene.world import to_space
from resgrid.space import Cell, ConfigurationSpace

_MOST_PARTS = 63


@dataclass(frozen=True, eq=False)
class Obstruction:
    """What stands between a start and one goal region.

    `goal`: number of the goal region; `least`: the least set of obstacle groups whose removal opens a way, in the
    order of the way; of several the one with the fewest cells. Empty where there is a path; `alone`: every group
    whose removal alone opens a way.
    """

    goal: int
    least: tuple[int, ...]
    alone: tuple[int, ...]


@frozen
@dataclass(frozen=True, eq=False)
class Separation:
    """Whether a start is separated from the goals, and by what.

    Attributes
    ----------
    space : ConfigurationSpace
    start : tuple of int
        The start's cell.
    outcome : Outcome
        ``REACHED`` where a path exists (to some goal); otherwise ``NO_PATH``, ``GOAL_BLOCKED`` or ``START_BLOCKED``.
    barriers : Barriers
        Every group of obstacle cells.
    region : ndarray of bool, shape of the space
        Cells that can be reached from the start, goal cells included; empty where the start is blocked.
    bounding : tuple of int
        Groups that touch that region.
    obstructions : tuple of Obstruction
        One for each goal region, in their order.
    edge : bool
        Whether the region touches an edge of the grid, which no removal opens.
    """

    space: ConfigurationSpace
    start: tuple[int, ...]
    outcome: Outcome
    barriers: Barriers
    region: NDArray[np.bool_]
    bounding: tuple[int, ...]
    obstructions: tuple[Obstruction, ...]
    edge: bool

    _repr_html_ = picture_html

    @cached_property
    def separating(self) -> tuple[int, ...]:
        """Groups in the least set of the goal that is easiest to reach; empty where a path exists."""
        if self.outcome is Outcome.REACHED:
            return ()
        return min((item.least for item in self.obstructions if item.least), key=len, default=())

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Cells of the `separating` groups, shape of the space."""
        return self.barriers.mask(*self.separating)


def separation(
    space: ConfigurationSpace, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None,
    virtual: ArrayLike | None = None,
) -> Separation:  # fmt: skip
    """Say whether a start has a path, and if not which obstacles separate it from each goal.

    Obstacle cells count as one group where they meet across faces, edges or corners, periodic axes included.  The
    edge of the grid is no group: nothing lies beyond it, but together with groups that touch it, it encloses.

    Parameters
    ----------
    space : ConfigurationSpace
    start : array_like of float, shape (ndim,)
        World coordinates; a point on a border belongs to a free cell if it touches one.
    cell : sequence of int, optional
        Instead of `start`: a cell.
    virtual : array_like of bool, shape of the space, optional
        Which obstacle cells are virtual (no body: strips along singularities, margins); they make groups of their own.
        Then the sets returned still open a way, but need not be the least.

    Returns
    -------
    Separation

    Raises
    ------
    InputError
        If the start lies outside the grid, or there is no goal cell.
    """
    if not space.goal_count:
        raise InputError("the space has no goal cell, so that no start is separated from one")
    cells, _ = start_cells(space, one_start(space, start, cell)[np.newaxis])
    at = tuple(cells[0].tolist())
    barriers = group_obstacles(space, virtual)
    links = barriers.links
    here = int(links.node[at])
    region = (links.node == here) & (space.cell[at] != Cell.OBSTACLE)
    return Separation(
        space=space,
        start=at,
        outcome=verdict_of(space, at),
        barriers=barriers,
        region=region,
        bounding=links.groups_beside(here) if space.cell[at] != Cell.OBSTACLE else (),
        obstructions=tuple(_obstruction(barriers, at, goal) for goal in range(space.goal_count)),
        edge=_touches_edge(space, region),
    )


def check_verdicts(field: Field) -> None:
    """Check a field against the verdict of connectivity, in every free cell.

    Where no chain of free cells leads to a goal, nothing may arrive (``log_drop`` of -inf, no node, or no potential
    below the obstacle rail's) and no current may flow; everywhere else something must arrive.

    Parameters
    ----------
    field : Field

    Raises
    ------
    AccuracyError
        Naming the first cell where field and connectivity disagree.
    """
    space = field.space
    free = space.cell == Cell.FREE
    if field.log_drop is not None:
        arrives = ~(np.isneginf(field.log_drop) | np.isnan(field.log_drop))
        wrong = free & (arrives != space.goal_connected)
    elif field.boundary == "neumann":
        wrong = free & (np.isfinite(field.potential) != space.goal_connected)
    else:
        wrong = np.zeros(space.shape, dtype=np.bool_)
    wrong |= free & ~space.goal_connected & _carries_current(field)
    if wrong.any():
        cell = tuple(np.argwhere(wrong)[0].tolist())
        verdict = "a path" if space.goal_connected[cell] else "no path"
        raise AccuracyError(f"connectivity finds {verdict} from cell {cell}, but the field says otherwise", field)


def verdict_of(space: ConfigurationSpace, cell: tuple[int, ...]) -> Outcome:
    """What connectivity says of a start cell: ``REACHED`` if a goal can be."""
    return Outcome(str(static_outcomes(space, np.array([cell]))[0]) or Outcome.REACHED)


def _obstruction(barriers: Barriers, start: tuple[int, ...], goal: int) -> Obstruction:
    space, links = barriers.space, barriers.links
    target = tuple(np.argwhere(space.goal_region == goal)[0].tolist())
    here, there = int(links.node[start]), int(links.node[target])
    if here == there:
        return Obstruction(goal, (), ())
    if here >= links.regions:
        candidates = {here - links.regions} & set(links.groups_beside(there))
    else:
        candidates = set(links.groups_beside(here)) & set(links.groups_beside(there))
    alone = tuple(group for group in sorted(candidates) if not _between(barriers, start, target, (group,)))
    return Obstruction(goal, _least(barriers, start, target), alone)


def _least(barriers: Barriers, start: tuple[int, ...], target: tuple[int, ...]) -> tuple[int, ...]:
    """Take the groups on a shortest path away and look again, until the way is open.

    Once is enough unless virtual groups fill the gaps between the corners of real ones.
    """
    opened: tuple[int, ...] = ()
    while more := _between(barriers, start, target, opened):
        opened += more
    return opened


def _between(
    barriers: Barriers, start: tuple[int, ...], target: tuple[int, ...], opened: tuple[int, ...]
) -> tuple[int, ...]:
    """Groups on a shortest path from start to target when some have been taken away; none if it is open."""
    links = link(barriers, opened) if opened else barriers.links
    return links.groups_between(int(links.node[start]), int(links.node[target]))


def _touches_edge(space: ConfigurationSpace, region: NDArray[np.bool_]) -> bool:
    return any(
        bool(region.take(end, axis).any()) for axis in range(space.ndim) if not space.periodic[axis] for end in (0, -1)
    )


def _carries_current(field: Field) -> NDArray[np.bool_]:
    """Cells with a current through any face."""
    flows = np.zeros(field.space.shape, dtype=np.bool_)
    for axis, direction in enumerate(field.face_direction):
        along = np.moveaxis(direction, axis, 0) != 0
        flows |= np.moveaxis(along[:-1] | along[1:], 0, axis)
    return flows


@frozen
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
        parts["map"] = plain.occupancy(scene.axes, [scene.map.obstacles], scene.sampling) & ~itself
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
    cells = scene.map and scene.map.without_obstacles()
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
