"""Disconnection proofs: whether a start has a path (Connolly & Grupen 1992, section 3.2), and the blocking obstacles.

Free cells are connected across faces.  They are separated by groups of obstacle cells, which are connected across
faces, edges or corners (the digital Jordan curve theorem, Rosenfeld 1970).  Removing a group connects all regions and
groups that touch it.  The minimum number of groups to remove is therefore the length of a shortest path in the graph
of regions and groups.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.values import frozen, picture_html
from resgrid.core.cell import Cell
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.obstacle_groups import Barriers, adjacency, group_obstacles
from resgrid.planning.streamline import Outcome
from resgrid.planning.trace import one_start, start_cells, static_outcomes
from resgrid.scene import Scene, build_space
from resgrid.scene.keepout import forbidden_places, keepouts_of
from resgrid.scene.world_coordinates import to_space

_MOST_PARTS = 63
"""Maximum number of parts of a scene that block cells; for more, InputError is raised.

A part is one obstacle, the map, a keep-out mask, unknown space, the virtual obstacles, or the robot (self-collision).
The parts that block a cell are the bits of a 64-bit number.
"""


@frozen
@dataclass(frozen=True, eq=False)
class Obstruction:
    """Groups of obstacle cells that separate a start from one goal region.

    An entry of `Separation.obstructions`, which `resgrid.find_blocking_obstacles` returns for a space.  A group is a
    set of obstacle cells that touch each other at faces, edges or corners; `Separation.barriers` numbers the groups.

    Attributes
    ----------
    goal : int
        Index of the goal region.
    least : tuple of int
        Indices of a minimum set of groups whose removal opens a path, in the order from start to goal, with the fewest
        cells among several minimum sets.  Empty if a path exists.
    alone : tuple of int
        Indices of all groups whose removal opens a path without the removal of another group.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 6.0, 6)], [0, 1, 0, 1, 0, 2])
    >>> rg.find_blocking_obstacles(space, cell=(0,)).obstructions[0]
    Obstruction(goal=0, least=(0, 1), alone=())
    """

    goal: int
    least: tuple[int, ...]
    alone: tuple[int, ...]


@frozen
@dataclass(frozen=True, eq=False)
class Separation:
    """Disconnection proof of a space: the groups of obstacle cells that separate a start from the goals.

    Returned by `resgrid.find_blocking_obstacles` for a space.

    Attributes
    ----------
    space : ConfigurationSpace
        The space.
    start : tuple of int
        Index of the start cell along every axis.
    outcome : Outcome
        ``REACHED`` if a path to a goal exists; otherwise ``NO_PATH``, ``GOAL_BLOCKED`` or ``START_BLOCKED``.
    barriers : Barriers
        All groups of obstacle cells.
    region : ndarray of bool, shape of the space
        Mask of the cells that the start can reach, goal cells included.
    bounding : tuple of int
        Indices of the groups that share a face with the region; empty if the start lies in an obstacle.
    obstructions : tuple of Obstruction
        One entry for each goal region.
    edge : bool
        Whether the region touches the edge of the grid.
    separating : tuple of int
        Indices of the smallest of the goals' minimum sets of groups; empty if a path exists.
    mask : ndarray of bool, shape of the space
        Mask of the cells of the `separating` groups.

    Examples
    --------
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 6.0, 6)], [0, 1, 0, 1, 0, 2])
    >>> proof = rg.find_blocking_obstacles(space, cell=(0,))
    >>> str(proof.outcome), proof.separating
    ('no_path', (0, 1))
    >>> np.flatnonzero(proof.mask), np.flatnonzero(proof.region)
    (array([1, 3]), array([0]))
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

    @property
    def separating(self) -> tuple[int, ...]:
        """Indices into ``barriers`` of a set of groups of obstacle cells whose removal opens a path to a goal.

        Each goal has a minimum set of such groups; this is the smallest of these sets, and empty if a path exists.
        """
        if self.outcome is Outcome.REACHED:
            return ()
        return min((item.least for item in self.obstructions if item.least), key=len, default=())

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Mask of the cells of the `separating` groups, shape of the space."""
        return self.barriers.mask(*self.separating)


@frozen
@dataclass(frozen=True, eq=False)
class SceneSeparation:
    """Disconnection proof of a scene: the obstacles that separate a start from the goals.

    Returned by `resgrid.find_blocking_obstacles` for a scene.

    Attributes
    ----------
    space : ConfigurationSpace
        Space of the scene.
    start : tuple of int
        Index of the start cell along every axis.
    outcome : Outcome
        ``REACHED`` if a path to a goal exists; otherwise ``NO_PATH``, ``GOAL_BLOCKED`` or ``START_BLOCKED``.
    region : ndarray of bool, shape of the space
        Mask of the cells that the start can reach, goal cells included.
    parts : mapping of str to ndarray of bool, shape of the space
        Masks of blocked cells by name of the blocking part: ``"obstacle[0]"`` as in the scene file, ``"map"``,
        ``"mask[0]"`` (a keep-out mask), ``"unknown"`` (unknown space), ``"singularity"`` (virtual obstacles),
        ``"robot"`` (self-collision).  Empty if a path exists.
    separating : tuple of str
        Names of a smallest set of parts whose removal opens a path.  Empty if a path exists, or if no set of at most
        `most` parts (an argument of `find_blocking_obstacles`) opens a path.
    alone : tuple of str
        Names of all parts whose removal opens a path without the removal of another part.
    mask : ndarray of bool, shape of the space
        Mask of the cells that the `separating` parts block.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml")
    >>> wall = rg.Box((0.0, 2.0), (8.0, 2.5))
    >>> proof = rg.find_blocking_obstacles(scene.replace(obstacles=(*scene.obstacles, wall)), (0.5, 6.5))
    >>> proof.separating, list(proof.parts)
    (('obstacle[3]',), ['obstacle[0]', 'obstacle[1]', 'obstacle[2]', 'obstacle[3]'])
    >>> int(proof.mask.sum()), int(proof.region.sum())
    (8, 35)
    """

    space: ConfigurationSpace
    start: tuple[int, ...]
    outcome: Outcome
    region: NDArray[np.bool_]
    parts: Mapping[str, NDArray[np.bool_]]
    separating: tuple[str, ...]
    alone: tuple[str, ...]

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Mask of the cells that the `separating` parts block, shape of the space."""
        masks = [self.parts[name] for name in self.separating]
        return np.any(masks, axis=0) if masks else np.zeros(self.space.shape, dtype=np.bool_)


@overload
def find_blocking_obstacles(
    where: ConfigurationSpace,
    start: ArrayLike | None = ...,
    *,
    cell: Sequence[int] | None = ...,
    virtual: ArrayLike | None = ...,
) -> Separation: ...
@overload
def find_blocking_obstacles(
    where: Scene, start: ArrayLike | None = ..., *, cell: Sequence[int] | None = ..., most: int = ...
) -> SceneSeparation: ...
def find_blocking_obstacles(
    where: ConfigurationSpace | Scene,
    start: ArrayLike | None = None,
    *,
    cell: Sequence[int] | None = None,
    virtual: ArrayLike | None = None,
    most: int = 3,
) -> Separation | SceneSeparation:
    """Decide whether a start has a path to a goal, and otherwise find the obstacles that separate the start from goals.

    For a space, the obstacles are groups of obstacle cells that are connected across faces, edges or corners, also
    across periodic seams.  The edge of the grid is not a group and cannot be removed, but edge and groups together can
    enclose a region.  Several obstacles of a scene, and virtual obstacles, often form a single group.
    For a scene, the obstacles themselves are removed instead, by trying sets of them.  Cells of a goal region that a
    removed obstacle covered become goal cells.

    Parameters
    ----------
    where : ConfigurationSpace or Scene
        For a scene, the space is built with all obstacles and once per obstacle.
    start : array_like of float, shape (ndim,)
        Start in world coordinates; a point on a border between cells belongs to a free cell if it touches one.
    cell : sequence of int, optional
        Start cell, instead of `start`.
    virtual : array_like of bool, shape of the space, optional
        For a space: mask of virtual obstacle cells (without a body, such as strips along singularities or margins),
        which form separate groups.  The returned sets then still open a path, but need not be minimum sets.
    most : int
        For a scene: maximum size of the sets of obstacles that are tried.

    Returns
    -------
    Separation or SceneSeparation
        ``outcome`` is ``REACHED`` if a path exists, otherwise ``NO_PATH``, ``GOAL_BLOCKED`` or ``START_BLOCKED``;
        ``separating`` holds the groups, or names of obstacles, to remove.

    Raises
    ------
    InputError
        If the start lies outside the grid, there is no goal cell, a scene has more than 63 obstacles, or `most` is
        below 1.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml")
    >>> wall = rg.Box((0.0, 2.0), (8.0, 2.5))
    >>> verdict = rg.find_blocking_obstacles(scene.replace(obstacles=(*scene.obstacles, wall)), (0.5, 6.5))
    >>> str(verdict.outcome), verdict.separating
    ('no_path', ('obstacle[3]',))
    """
    if isinstance(where, Scene):
        return _scene_separation(where, start, cell, most)
    space = where
    if not space.goal_count:
        raise InputError("the space has no goal cell; add a goal to find the obstacles before it")
    at = _cell_of(space, one_start(space, start, cell))
    barriers = group_obstacles(space, virtual)
    links = barriers.links
    here, free = int(links.node[at]), space.cell[at] != Cell.OBSTACLE
    region = (links.node == here) & free
    ends = [region.take(end, axis).any() for axis in range(space.ndim) if not space.periodic[axis] for end in (0, -1)]
    return Separation(
        space=space,
        start=at,
        outcome=_connectivity(space, at),
        barriers=barriers,
        region=region,
        bounding=links.adjacent_groups(here) if free else (),
        obstructions=tuple(_obstruction(barriers, at, goal) for goal in range(space.goal_count)),
        edge=any(ends),
    )


def _connectivity(space: ConfigurationSpace, cell: tuple[int, ...]) -> Outcome:
    """Return the outcome of paths from a start cell that follows from connectivity alone: ``REACHED`` or a failure."""
    return Outcome(str(static_outcomes(space, np.array([cell]))[0]) or Outcome.REACHED)


def _cell_of(space: ConfigurationSpace, point: NDArray[np.float64]) -> tuple[int, ...]:
    """Return the indices of the cell of a start `point` (ndim,), in axis units.

    A point on a border between cells belongs to a free cell if it touches one.
    """
    return tuple(start_cells(space, point[np.newaxis])[0][0].tolist())


def _obstruction(barriers: Barriers, start: tuple[int, ...], goal: int) -> Obstruction:
    """Return the groups of obstacle cells that separate the cell `start` from the goal region with index `goal`.

    `barriers`: all groups of obstacle cells of the space.
    """
    space, links = barriers.space, barriers.links
    target = tuple(np.argwhere(space.goal_region == goal)[0].tolist())
    here, there = int(links.node[start]), int(links.node[target])
    if here == there:
        return Obstruction(goal, (), ())

    def between(opened: tuple[int, ...]) -> tuple[int, ...]:
        """Return indices of the groups of obstacle cells on a shortest path from start to goal across groups.

        The groups `opened` count as free.  The result is empty if no further group lies between start and goal.
        """
        remaining = adjacency(barriers, opened) if opened else links
        return remaining.groups_between(int(remaining.node[start]), int(remaining.node[target]))

    adjacent = {here - links.regions} if here >= links.regions else set(links.adjacent_groups(here))
    candidates = sorted(adjacent & set(links.adjacent_groups(there)))
    least: tuple[int, ...] = ()
    # One pass is enough unless virtual groups fill the gaps between the corners of real ones.
    while more := between(least):
        least += more
    return Obstruction(goal, least, tuple(group for group in candidates if not between((group,))))


def _scene_separation(scene: Scene, start: ArrayLike | None, cell: Sequence[int] | None, most: int) -> SceneSeparation:
    """Return the parts of a scene that separate a start from the goals, found by removing sets of at most `most` parts.

    A part is one obstacle, the map, a keep-out mask, unknown space, the virtual obstacles, or the robot
    (self-collision).  `start` (ndim,): start in world coordinates, or None; `cell`: start cell, if `start` is None.
    """
    if most < 1:
        raise InputError(f"most = {most} must be at least 1: opening a path removes at least one obstacle")
    space = build_space(scene)
    point = one_start(space, start, cell)
    at = _cell_of(space, point)
    outcome = _connectivity(space, at)
    label = label_regions(space.cell != Cell.OBSTACLE, space.periodic)
    region = (label == label[at]) & (label > 0)
    if outcome is Outcome.REACHED:
        return SceneSeparation(space, at, outcome, region, {}, (), ())
    parts = _blocking_parts(scene, space)
    if len(parts) > _MOST_PARTS:
        raise InputError(
            f"the scene has {len(parts)} obstacles, more than {_MOST_PARTS}; merge some, or pass the scene's space"
            " instead of the scene"
        )
    bits = np.zeros(space.shape, dtype=np.uint64)  # bit n is set if part n blocks the cell
    for number, mask in enumerate(parts.values()):
        bits[mask] |= np.uint64(1 << number)
    without_obstacles = dataclasses.replace(
        scene,
        robot=scene.robot.bare(self_collision=False),
        obstacles=(),
        mask=(),
        map=scene.map and scene.map.without_obstacles(),
    )
    opened = np.where(build_space(without_obstacles).cell == Cell.GOAL, np.uint8(Cell.GOAL), np.uint8(Cell.FREE))

    def opens(*removed: int) -> bool:
        """Return whether a path exists if the parts of the scene with the indices `removed` block no cells."""
        kept = np.uint64(2**64 - 1 - sum(1 << number for number in removed))
        remaining = space.with_cells(np.where((bits & kept) == 0, opened, np.uint8(Cell.OBSTACLE)))
        return _connectivity(remaining, _cell_of(remaining, point)) is Outcome.REACHED

    names = tuple(parts)
    alone = tuple(name for number, name in enumerate(names) if opens(number))
    larger = () if alone else (n for size in range(2, most + 1) for n in combinations(range(len(names)), size))
    chosen = next((numbers for numbers in larger if opens(*numbers)), ())
    separating = alone[:1] or tuple(names[number] for number in chosen)
    return SceneSeparation(space, at, outcome, region, parts, separating, alone)


def _blocking_parts(scene: Scene, space: ConfigurationSpace) -> dict[str, NDArray[np.bool_]]:
    """Return the masks of blocked cells, shape of the space, by name of the part of the scene that blocks them.

    Names: ``"obstacle[0]"`` and so on, ``"map"``, ``"mask[0]"`` and so on (keep-out masks), ``"unknown"`` (unknown
    space of the map), ``"singularity"`` (virtual obstacles), and ``"robot"`` (self-collision) for all other blocked
    cells.  Parts that block no cell are left out.
    """
    plain = scene.robot.bare()
    itself = plain.occupancy(scene.axes, [], scene.sampling)
    parts = {
        f"obstacle[{number}]": plain.occupancy(scene.axes, [to_space(shape, scene.frame)], scene.sampling) & ~itself
        for number, shape in enumerate(scene.obstacles)
    }
    if scene.map is not None:
        parts["map"] = plain.occupancy(scene.axes, [scene.map.obstacles], scene.sampling) & ~itself
    keepouts = keepouts_of(scene)
    parts |= {
        effect.name: plain.occupancy(scene.axes, [effect.obstacle], scene.sampling) & ~itself
        for effect in keepouts
        if effect.obstacle is not None
    }
    parts |= forbidden_places(scene, keepouts)
    if plain != scene.robot:
        parts["singularity"] = scene.robot.occupancy(scene.axes, [], scene.sampling) & ~itself
    blocked = space.cell == Cell.OBSTACLE
    parts["robot"] = blocked & ~np.any([*parts.values(), np.zeros_like(blocked)], axis=0)
    return {name: mask & blocked for name, mask in parts.items() if np.any(mask & blocked)}
