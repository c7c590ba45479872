"""Paths of several legs: out of the inflated zone, through intermediate poses, and to a goal or the nearest place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.values import frozen
from resgrid.core.axis import Point
from resgrid.core.cell import Cell
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.certify import certify
from resgrid.planning.escape_leg import escape_leg
from resgrid.planning.node_paths import NodePath
from resgrid.planning.pipeline import require_uniform, scene_wiring
from resgrid.planning.planner import plan
from resgrid.planning.streamline import Outcome, Polyline, Streamline
from resgrid.planning.trace import start_cell
from resgrid.robots import GoalCells
from resgrid.robots.cells import merge_goals
from resgrid.scene import Scene, build_space
from resgrid.scene.goals import GoalCell, GoalJoints, GoalPoint
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.sampling import adding, goal_cells, map_goals
from resgrid.scene.world_coordinates import cell_centre


@dataclass(frozen=True, eq=False)
class Leg:
    """A part of a path of several legs.

    Attributes
    ----------
    path : Streamline, NodePath or Polyline
        The leg; a polyline for a leg out of the inflated zone.
    kind : {"escape", "via", "goal", "approximate"}
        ``"escape"``: the leg ends in the nearest free cell with a path; ``"via"``: at an intermediate pose; ``"goal"``:
        in a goal; ``"approximate"``: at the reachable place that is nearest to a goal.
    certified : bool
        Whether the robot is proven to touch no obstacle on the leg.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml")
    >>> legs = rg.plan_legs(scene, (0.5, 6.5), via=[(7.5, 7.5)]).legs
    >>> [(leg.kind, leg.certified, round(leg.path.length, 1)) for leg in legs]
    [('via', True, 7.1), ('goal', True, 5.7)]
    """

    path: Streamline | NodePath | Polyline
    kind: Literal["escape", "via", "goal", "approximate"]
    certified: bool


@frozen
@dataclass(frozen=True, eq=False)
class LegPath:
    """A path of several legs, of which each begins where the last one ends.

    Returned by `resgrid.plan_legs`.

    Attributes
    ----------
    legs : tuple of Leg
        The legs that were found; empty if no path leads from the start.
    outcome : Outcome
        ``reached`` if the last leg ends in a goal of the scene, otherwise the reason why no leg leads to a goal.  A
        path to the nearest reachable place keeps this reason.
    reason : str or None
        Reason why no goal is reached; None if one is reached.
    distance : float or None
        Distance, in axis units, of the end from the nearest goal, if the path ends at the nearest reachable place;
        otherwise None.
    space : ConfigurationSpace
        Configuration space of the scene, without goals.
    start : tuple of float
        The requested start, in world coordinates.
    points : ndarray of float64, shape (n, ndim)
        Points of all legs in world coordinates, continuous across periodic seams; only the start if there is no leg.
    certified : bool
        Whether the robot is proven to touch no obstacle on any leg; True if there is no leg.
    length : float
        Length of all legs in axis units.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml")
    >>> path = rg.plan_legs(scene, (0.5, 6.5), via=[(7.5, 7.5)])
    >>> path
    <LegPath reached: via, goal; length 12.8, certified>
    >>> str(rg.plan_legs(scene.replace(goal=(3.5, 4.5)), (0.5, 6.5), approximate=True).outcome)
    'goal_blocked'
    """

    legs: tuple[Leg, ...]
    outcome: Outcome
    reason: str | None
    distance: float | None
    space: ConfigurationSpace
    start: Point

    def __repr__(self) -> str:
        kinds = ", ".join(leg.kind for leg in self.legs) or "no leg"
        proof = "certified" if self.certified else "not certified"
        return f"<LegPath {self.outcome}: {kinds}; length {self.length:.3g}, {proof}>"

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Points of all legs in world coordinates, continuous across periodic seams, shape (n, ndim)."""
        lines = [self.space.from_world(self.start)[np.newaxis]]
        turn = np.where(self.space.periodic, self.space.upper - self.space.lower, 0.0)
        for leg in self.legs:
            line = leg.path.line
            gap = lines[-1][-1] - line[0]
            turns = np.divide(gap, turn, out=np.zeros_like(gap), where=turn > 0).round()
            lines.append((line + turns * turn)[1:])
        return self.space.to_world(np.concatenate(lines))

    @property
    def leg_of_points(self) -> NDArray[np.int64]:
        """Index of the leg that leads to each row of `points`, shape (n,); 0 for the first row, the start."""
        counts = [len(leg.path.line) - 1 for leg in self.legs]
        return np.concatenate([np.zeros(1, dtype=np.int64), np.repeat(np.arange(len(counts)), counts)])

    @property
    def certified(self) -> bool:
        """Whether the robot is proven to touch no obstacle on any leg; True if there is no leg."""
        return all(leg.certified for leg in self.legs)

    @property
    def length(self) -> float:
        """Length of all legs in axis units."""
        steps = np.diff(self.space.from_world(self.points), axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())

    @property
    def line(self) -> Polyline:
        """All legs as one path, such as for `time_parameterize`."""
        return Polyline(self.points, self.space)


def plan_legs(
    scene: Scene,
    start: ArrayLike,
    *,
    via: Sequence[Sequence[float]] = (),
    approximate: bool = False,
    escape: bool = False,
    k: float | None = None,
) -> LegPath:
    """Plan a path through intermediate poses, out of the inflated zone, or as near to a goal as possible.

    Every leg except the straight leg out of the inflated zone follows the current of a field and has a certificate.

    Parameters
    ----------
    scene : Scene
        The scene.
    start : array_like of float, shape (ndim,)
        Start in world coordinates.
    via : sequence of sequence of float
        Intermediate places (or poses, of a robot that turns) in world coordinates, in this order, as in the action
        ComputePathThroughPoses of Nav2.
    approximate : bool
        Whether to end at the reachable place that is nearest to a goal, if no goal can be reached.  The outcome remains
        the reason why no goal is reached.  (OMPL calls such a result an approximate solution.)
    escape : bool
        Whether a start in the inflated zone, in which a disc or ball touches an obstacle that does not contain its
        centre, leaves this zone on the shortest straight line to a free cell with a path.  The line is free for the
        centre of the robot only, and thus not certified.
    k : float, optional
        Weight of the Dirichlet field, in [0, 1]; by default the first ``k`` of the scene.

    Returns
    -------
    LegPath
        The legs, the outcome, and, if the path ends at the nearest reachable place, the distance from a goal.

    Raises
    ------
    InputError
        If an intermediate place lies in an obstacle or outside the grid, the scene has no goal, a goal is invalid (in
        an obstacle only without `approximate`), or an option does not fit the robot.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(goal=(3.5, 4.5))
    >>> path = rg.plan_legs(scene, (0.5, 6.5), approximate=True)
    >>> path.legs[0].kind, round(path.distance, 2), path.points[-1].round(2)
    ('approximate', 0.5, array([3.5, 4. ]))
    """
    require_uniform(scene, "plan_legs()")
    if scene.drive == "start":
        raise InputError("drive = 'start' ties one start to the rail, but legs have several; choose drive = 'uniform'")
    if approximate and scene.robot.base is not None:
        raise InputError("approximate applies to robots whose configurations are places, not to arms; enlarge the goal")
    if not scene.goals and (scene.map is None or not (scene.map.cell == Cell.GOAL).any()):
        raise InputError(f"{scene.source or 'scene'}: there is no goal; {adding(scene, 'a [[goal]]', '--goal')}")
    free = build_space(replace(scene, goals=(), map=_without_goals(scene)), require_goal=False)
    blocked = free.cell == Cell.OBSTACLE
    stops = [
        with_goals(free, goal_cells(scene, GoalPoint(tuple(place)), blocked, f"via[{number}]"))
        for number, place in enumerate(via)
    ]
    goals, problems = final_goals(scene, blocked, skip_blocked=approximate)
    final = with_goals(free, goals)
    chain = _Chain(scene, free, k, tuple(np.asarray(start, dtype=np.float64).tolist()))
    if escape and free.cell[start_cell(free, chain.at)] == Cell.OBSTACLE:
        targets = (stops or [final])[0]
        near = targets.goal_connected | (targets.cell == Cell.GOAL)
        leg = escape_leg(scene, free, np.asarray(chain.at), near if near.any() else ~blocked)
        if leg is not None:
            chain.add(Leg(leg, "escape", certified=False))
    for number, stop in enumerate(stops):
        if not chain.follow(stop, "via", f"via[{number}]: "):
            return chain.result()
    if (
        not chain.follow(final, "goal", problem="; ".join(problems))
        and approximate
        and chain.outcome is not Outcome.START_BLOCKED
    ):
        chain.approach(_goal_points(scene))
    return chain.result()


class _Chain:
    """Legs of a path while they are planned.

    `scene`, `space`: the scene and its space without goals; `k`: weight of the Dirichlet field, None for the first one
    of the scene; `at`: end of the last leg, at first the start, in world coordinates; `start`: start, in world
    coordinates; `legs`: the legs so far; `outcome`, `reason`: outcome of the last leg that was tried, and the reason
    why this leg reaches no goal; `distance`: distance of the end from the nearest goal, in axis units, -1 if unknown.
    """

    def __init__(self, scene: Scene, space: ConfigurationSpace, k: float | None, at: Point) -> None:
        self.scene, self.space, self.at, self.start = scene, space, at, at
        self.k = next(iter(scene.k), None) if k is None else k
        self.legs: list[Leg] = []
        self.outcome, self.reason, self.distance = Outcome.REACHED, "", -1.0

    def add(self, leg: Leg) -> None:
        """Append a leg, and set `at` to its end."""
        self.legs.append(leg)
        self.at = tuple(leg.path.points[-1].tolist())

    def follow(
        self, space: ConfigurationSpace, kind: Literal["via", "goal", "approximate"], name: str = "", problem: str = ""
    ) -> bool:
        """Append the certified path from the end of the last leg to a goal; return whether this path exists.

        Without such a path, set `outcome` and `reason`.  `space`: space with goals; `kind`: kind of the leg; `name`:
        prefix of the reason; `problem`: reason if the space has no goal.
        """
        if space.goal_count:
            path = plan(space, scene_wiring(self.scene), k=self.k).path(self.at)
            certify(path)
            if path.outcome is Outcome.REACHED:
                self.add(Leg(path, kind, certified=True))
                return True
            self.outcome, self.reason = path.outcome, f"{name}{path.reason}"
        else:
            is_inside = space.cell[start_cell(space, self.at)] == Cell.OBSTACLE
            self.outcome = Outcome.START_BLOCKED if is_inside else Outcome.GOAL_BLOCKED
            self.reason = "the start lies in an obstacle" if is_inside else problem
        return False

    def approach(self, goals: NDArray[np.float64]) -> None:
        """Append the leg to the reachable place that is nearest to one of the points `goals` (g, d), in axis units.

        `outcome` and `reason` stay those of the failed leg; `distance` is set to the distance of the place from this
        goal point, in axis units.
        """
        outcome, reason = self.outcome, self.reason
        region = label_regions(self.space.cell != Cell.OBSTACLE, self.space.periodic)
        reachable = np.argwhere(region == region[start_cell(self.space, self.at)])
        cell, point, distance = _nearest(self.space, reachable, goals)
        mask = np.zeros(self.space.shape, dtype=bool)
        mask[tuple(cell)] = True
        self.follow(with_goals(self.space, GoalCells(mask, point[np.newaxis])), "approximate")
        self.outcome, self.reason, self.distance = outcome, reason, distance

    def result(self) -> LegPath:
        """Return the path of the legs."""
        reached = self.outcome is Outcome.REACHED
        distance = None if self.distance < 0 else self.distance
        return LegPath(
            tuple(self.legs), self.outcome, None if reached else self.reason, distance, self.space, self.start
        )


def _without_goals(scene: Scene) -> MapCells | None:
    """Return the map of a scene with free cells in place of goal cells; None without a map."""
    if scene.map is None:
        return None
    return replace(scene.map, cell=np.where(scene.map.cell == Cell.GOAL, np.uint8(Cell.FREE), scene.map.cell))


def with_goals(space: ConfigurationSpace, goals: GoalCells) -> ConfigurationSpace:
    """Return a copy of a space without goals, with goals in the cells of the mask `goals.cells`.

    `goals`: mask of the goal cells, and the goal points of these cells.
    """
    cell = np.where(goals.cells, np.uint8(Cell.GOAL), space.cell)
    return ConfigurationSpace(
        space.axes, cell, space.conductivity, frame=space.frame, goal_points=goals.points, robot=space.robot,
        undecided=space.undecided,
    )  # fmt: skip


def final_goals(scene: Scene, blocked: NDArray[np.bool_], *, skip_blocked: bool) -> tuple[GoalCells, list[str]]:
    """Return the free goal cells of a scene, and one message for every goal without a free cell.

    `blocked`: mask of obstacle cells, shape of the space; `skip_blocked`: whether goals without a free cell are left
    out; otherwise the first one raises InputError.
    """
    where, found, problems = scene.source or "scene", list[GoalCells](), list[str]()
    for number, goal in enumerate(scene.goals):
        try:
            found.append(goal_cells(scene, goal, blocked, f"{where}: goal[{number}]"))
        except InputError as error:
            if not skip_blocked:
                raise
            problems.append(str(error).removeprefix(f"{where}: "))
    try:
        found.append(map_goals(scene, blocked, where))
    except InputError as error:
        if not skip_blocked:
            raise
        problems.append(str(error).removeprefix(f"{where}: "))
    return merge_goals(blocked.shape, found), problems


def _goal_points(scene: Scene) -> NDArray[np.float64]:
    """Return points in the goals of a scene, in axis units, shape (g, d).

    d is the number of axes, or smaller if a goal states a place without a heading.
    """
    points: list[NDArray[np.float64]] = []
    for goal in scene.goals:
        match goal:
            case GoalPoint(point):
                points.append(scene.frame.from_world(point)[np.newaxis])
            case GoalCell(cell):
                centre = cell_centre(scene.axes, scene.frame, cell, "goal")
                points.append(scene.frame.from_world(centre)[np.newaxis])
            case GoalJoints(lower, upper):
                points.append(scene.frame.from_world(np.add(lower, upper) / 2)[np.newaxis])
            case _:
                cells = goal_cells(scene, goal, np.zeros([axis.cells for axis in scene.axes], dtype=bool), "goal")
                points.append(cells.points)
    if scene.map is not None and scene.axes[: len(scene.map.axes)] == scene.map.axes:
        at = np.argwhere(scene.map.cell == Cell.GOAL)
        axes = scene.map.axes
        points.append(np.array([axis.lower for axis in axes]) + (at + 0.5) * [axis.spacing for axis in axes])
    d = min(part.shape[1] for part in points if len(part))
    return np.concatenate([part[:, :d] for part in points])


def _nearest(
    space: ConfigurationSpace, cells: NDArray[np.int64], goals: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """Return the cell (ndim,) nearest to any goal, its point (ndim,) nearest to this goal, and their distance.

    Points and distances are in axis units; only the first d coordinates count.  `cells` (n, ndim): candidates; `goals`
    (g, d): points.
    """
    d, half = goals.shape[1], space.spacing / 2 * (1 - 1e-6)
    centre = space.axis_centre(cells)
    turn = (space.upper - space.lower)[:d]
    best = (np.inf, 0, centre[0])
    for goal in goals:
        offset = goal - centre[:, :d]
        offset -= np.where(space.periodic[:d], turn * np.round(offset / turn), 0.0)
        inside = np.clip(offset, -half[:d], half[:d])
        apart = np.linalg.norm(offset - inside, axis=1)
        row = int(np.argmin(apart))
        if apart[row] < best[0]:
            point = centre[row].copy()
            point[:d] += inside[row]
            best = (float(apart[row]), row, point)
    return cells[best[1]], best[2], best[0]
