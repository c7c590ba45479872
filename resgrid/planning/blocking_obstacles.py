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
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from resgrid._internal.values import frozen, picture_html
from resgrid.core.regions import cells_at_faces, label_regions, with_margin
from resgrid.core.space import Cell, ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.streamline import Outcome
from resgrid.planning.trace import one_start, start_cells, static_outcomes
from resgrid.scene import Scene, build_space
from resgrid.scene.world_coordinates import to_space

_MOST_PARTS = 63


@frozen
@dataclass(frozen=True, eq=False)
class Barriers:
    """The obstacle cells of a space in groups that meet across faces, edges or corners.

    `label` as the space: group of every obstacle cell, numbered from 0 in C order of their first cell, real ones
    before virtual ones; -1 elsewhere; `virtual` (groups,): which groups are virtual obstacles.
    """

    space: ConfigurationSpace
    label: NDArray[np.int32]
    virtual: NDArray[np.bool_]

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """Number of cells of every group, shape (groups,)."""
        return np.bincount(self.label[self.label >= 0], minlength=len(self.virtual))

    @cached_property
    def links(self) -> RegionGraph:
        """Which regions and groups touch."""
        return _link(self)

    def mask(self, *groups: int) -> NDArray[np.bool_]:
        """Cells of some groups, shape of the space."""
        return np.isin(self.label, groups) & (self.label >= 0)


@dataclass(frozen=True, eq=False)
class RegionGraph:
    """Regions of free and goal cells, and groups of obstacle cells, as the nodes of a graph of who touches whom.

    `node` as the space: region or group of every cell: regions first; `regions`: number of regions; node ``regions +
    g`` is group ``g``; `graph` (nodes, nodes): symmetric; a path costs 1 for every group it goes through, and a
    little for every cell of it.
    """

    node: NDArray[np.int64]
    regions: int
    graph: sparse.csr_array

    def groups_beside(self, node: int) -> tuple[int, ...]:
        """Groups that share a face with a region or group."""
        beside = self.graph.indices[self.graph.indptr[node] : self.graph.indptr[node + 1]]
        return tuple(sorted(int(other) - self.regions for other in beside if other >= self.regions))

    def groups_between(self, first: int, last: int) -> tuple[int, ...]:
        """Groups on a cheapest path between two nodes, in its order, ends included."""
        from scipy.sparse.csgraph import dijkstra

        _, before = dijkstra(self.graph, directed=False, indices=np.array([first]), return_predecessors=True)
        nodes = [last]
        while nodes[-1] != first:
            nodes.append(int(before[0, nodes[-1]]))
        return tuple(node - self.regions for node in reversed(nodes) if node >= self.regions)


@frozen
@dataclass(frozen=True, eq=False)
class Obstruction:
    """What stands between a start and one goal region.

    `goal`: its number; `least`: the least set of groups whose removal opens a way, in the order of the way, of several
    the one with the fewest cells; empty where there is a path; `alone`: every group whose removal alone opens a way.
    """

    goal: int
    least: tuple[int, ...]
    alone: tuple[int, ...]


@frozen
@dataclass(frozen=True, eq=False)
class Separation:
    """Whether a start of a space is separated from the goals, and by which groups of obstacle cells.

    `start`: its cell; `outcome`: ``REACHED`` where a path to some goal exists; `barriers`: every group; `region` as the
    space: cells that can be reached, goal cells included; `bounding`: groups that touch it; `obstructions`: one for
    each goal region; `edge`: whether the region touches an edge of the grid, which no removal opens.
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
        """Groups in the least set of the goal that is easiest to reach; empty where a path exists."""
        if self.outcome is Outcome.REACHED:
            return ()
        return min((item.least for item in self.obstructions if item.least), key=len, default=())

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Cells of the `separating` groups, shape of the space."""
        return self.barriers.mask(*self.separating)


@frozen
@dataclass(frozen=True, eq=False)
class SceneSeparation:
    """Whether a start of a scene is separated from the goals, and by which of its obstacles.

    `space, start, outcome, region`: as in `Separation`; `parts` as the space: what blocks cells, and which, by name:
    ``"obstacle[0]"`` as in the scene's file, ``"map"``, ``"singularity"`` (virtual obstacles alone), ``"robot"``
    (collisions with itself); `separating`: the smallest set whose removal opens a way, the first found of several;
    empty where a path exists, or no set as small as asked for will do; `alone`: every part whose removal alone does.
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
        """Cells that the `separating` parts block, shape of the space."""
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
    """Say whether a start has a path, and if not which obstacles separate it from the goals.

    Of a space these are groups of obstacle cells, which count as one where they meet across faces, edges or corners,
    periodic axes included.  The edge of the grid is no group: nothing lies beyond it, but together with groups that
    touch it, it encloses.  The images of several obstacles, and virtual ones, often melt into one group; of a scene the
    same is asked of the obstacles themselves, by trying sets of them.  What is taken away gives back the part of the
    goals' regions that it covered.

    Parameters
    ----------
    where : ConfigurationSpace or Scene
        A scene is sampled as a whole, and once for each obstacle.
    start : array_like of float, shape (ndim,)
        World coordinates; a point on a border belongs to a free cell if it touches one.
    cell : sequence of int, optional
        Instead of `start`: a cell.
    virtual : array_like of bool, shape of the space, optional
        Of a space: which obstacle cells are virtual (no body: strips along singularities, margins); they make groups of
        their own.  Then the sets returned still open a way, but need not be the least.
    most : int
        Of a scene: the largest set of obstacles that is tried.

    Returns
    -------
    Separation or SceneSeparation
        ``outcome`` is ``REACHED`` where a path exists, otherwise ``NO_PATH``, ``GOAL_BLOCKED`` or ``START_BLOCKED``;
        ``separating`` are the groups, or names of obstacles, that must go.

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
        raise InputError("the space has no goal cell, so that no start is separated from one")
    at = _cell_of(space, one_start(space, start, cell))
    barriers = _group_obstacles(space, virtual)
    links = barriers.links
    here, free = int(links.node[at]), space.cell[at] != Cell.OBSTACLE
    region = (links.node == here) & free
    ends = [region.take(end, axis).any() for axis in range(space.ndim) if not space.periodic[axis] for end in (0, -1)]
    return Separation(
        space=space,
        start=at,
        outcome=_verdict(space, at),
        barriers=barriers,
        region=region,
        bounding=links.groups_beside(here) if free else (),
        obstructions=tuple(_obstruction(barriers, at, goal) for goal in range(space.goal_count)),
        edge=any(ends),
    )


def _verdict(space: ConfigurationSpace, cell: tuple[int, ...]) -> Outcome:
    """What connectivity says of a start cell: ``REACHED`` if a goal can be."""
    return Outcome(str(static_outcomes(space, np.array([cell]))[0]) or Outcome.REACHED)


def _cell_of(space: ConfigurationSpace, point: NDArray[np.float64]) -> tuple[int, ...]:
    return tuple(start_cells(space, point[np.newaxis])[0][0].tolist())


def _obstruction(barriers: Barriers, start: tuple[int, ...], goal: int) -> Obstruction:
    space, links = barriers.space, barriers.links
    target = tuple(np.argwhere(space.goal_region == goal)[0].tolist())
    here, there = int(links.node[start]), int(links.node[target])
    if here == there:
        return Obstruction(goal, (), ())

    def between(opened: tuple[int, ...]) -> tuple[int, ...]:
        """Groups on a shortest path when some have been taken away; none if it is open."""
        left = _link(barriers, opened) if opened else links
        return left.groups_between(int(left.node[start]), int(left.node[target]))

    beside = {here - links.regions} if here >= links.regions else set(links.groups_beside(here))
    candidates = sorted(beside & set(links.groups_beside(there)))
    least: tuple[int, ...] = ()
    # Once is enough unless virtual groups fill the gaps between the corners of real ones.
    while more := between(least):
        least += more
    return Obstruction(goal, least, tuple(group for group in candidates if not between((group,))))


def _scene_separation(scene: Scene, start: ArrayLike | None, cell: Sequence[int] | None, most: int) -> SceneSeparation:
    if most < 1:
        raise InputError(f"most = {most}, but at least one obstacle must be taken away to open a way")
    space = build_space(scene)
    point = one_start(space, start, cell)
    at = _cell_of(space, point)
    outcome = _verdict(space, at)
    label = label_regions(space.cell != Cell.OBSTACLE, space.periodic)
    region = (label == label[at]) & (label > 0)
    if outcome is Outcome.REACHED:
        return SceneSeparation(space, at, outcome, region, {}, (), ())
    parts = _blocking_parts(scene, space)
    if len(parts) > _MOST_PARTS:
        raise InputError(
            f"the scene has {len(parts)} obstacles, and at most {_MOST_PARTS} can be told apart; merge some, or ask "
            "for the separation of its space"
        )
    bits = np.zeros(space.shape, dtype=np.uint64)  # one for each part that blocks a cell
    for number, mask in enumerate(parts.values()):
        bits[mask] |= np.uint64(1 << number)
    bare = dataclasses.replace(
        scene,
        robot=scene.robot.bare(self_collision=False),
        obstacles=(),
        map=scene.map and scene.map.without_obstacles(),
    )
    opened = np.where(build_space(bare).cell == Cell.GOAL, np.uint8(Cell.GOAL), np.uint8(Cell.FREE))

    def opens(*removed: int) -> bool:
        """Whether there is a path where what some parts alone block is free, or goal."""
        kept = np.uint64(2**64 - 1 - sum(1 << number for number in removed))
        left = space.with_cells(np.where((bits & kept) == 0, opened, np.uint8(Cell.OBSTACLE)))
        return _verdict(left, _cell_of(left, point)) is Outcome.REACHED

    names = tuple(parts)
    alone = tuple(name for number, name in enumerate(names) if opens(number))
    larger = () if alone else (n for size in range(2, most + 1) for n in combinations(range(len(names)), size))
    chosen = next((numbers for numbers in larger if opens(*numbers)), ())
    separating = alone[:1] or tuple(names[number] for number in chosen)
    return SceneSeparation(space, at, outcome, region, parts, separating, alone)


def _blocking_parts(scene: Scene, space: ConfigurationSpace) -> dict[str, NDArray[np.bool_]]:
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


def _group_obstacles(space: ConfigurationSpace, virtual: ArrayLike | None = None) -> Barriers:
    """Group the obstacle cells that meet across faces, edges or corners; `virtual`, as the space, by themselves."""
    obstacle = space.cell == Cell.OBSTACLE
    marked = np.zeros(space.shape, dtype=np.bool_) if virtual is None else np.asarray(virtual)
    if marked.shape != space.shape or marked.dtype.kind != "b":
        raise InputError(
            f"virtual must be a boolean array of shape {space.shape}, got {marked.dtype} of shape {marked.shape}"
        )
    real, added = (label_regions(obstacle & kind, space.periodic, corners=True) - 1 for kind in (~marked, marked))
    first = int(real.max()) + 1
    label = np.where(added >= 0, added + np.int32(first), real)
    return Barriers(space, label, np.arange(first + int(added.max()) + 1) >= first)


def _link(barriers: Barriers, opened: tuple[int, ...] = ()) -> RegionGraph:
    """Find out which regions and groups touch, with some groups taken away."""
    space = barriers.space
    passable = (space.cell != Cell.OBSTACLE) | barriers.mask(*opened)
    region = label_regions(passable, space.periodic).astype(np.int64) - 1
    regions = int(region.max()) + 1
    node = np.where(passable, region, regions + barriers.label)
    cost = np.concatenate([np.zeros(regions), 1.0 + barriers.sizes / (1.0 + barriers.sizes.sum())])
    wide = with_margin(node, space.periodic)
    faces = [np.stack([side.ravel() for side in cells_at_faces(wide, axis)], axis=1) for axis in range(space.ndim)]
    pairs = np.unique(np.sort(np.concatenate([pair[pair[:, 0] != pair[:, 1]] for pair in faces]), axis=1), axis=0)
    first, last = np.concatenate([pairs, pairs[:, ::-1]]).T
    # Half a group's cost on the way in, half on the way out.
    graph = sparse.coo_array((0.5 * (cost[first] + cost[last]), (first, last)), shape=(len(cost), len(cost)))
    return RegionGraph(node, regions, graph.tocsr())
