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
from resgrid.planning.advice import Advisor
from resgrid.planning.certify import certify
from resgrid.planning.escape_leg import escape_leg
from resgrid.planning.leg_reasons import separation_reason
from resgrid.planning.nearest_to_goals import goal_points, nearest_to_goals
from resgrid.planning.node_paths import NodePath
from resgrid.planning.pipeline import require_uniform, scene_wiring
from resgrid.planning.planner import plan
from resgrid.planning.streamline import Outcome, Polyline, Streamline
from resgrid.planning.trace import start_cell
from resgrid.robots import GoalCells
from resgrid.robots.cells import merge_goals
from resgrid.scene import Scene, build_space
from resgrid.scene.goal_placement import goal_cells, map_goals
from resgrid.scene.goals import GoalCell, GoalPoint
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.sampling import adding
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
    via: Sequence[Sequence[float] | GoalCell] = (),
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
    via : sequence of sequence of float or GoalCell
        Intermediate places (or poses, of a robot that turns) in world coordinates, or cells, which stand for
        their centres, in this order, as in the action ComputePathThroughPoses of Nav2.
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
    places = tuple(place if isinstance(place, GoalCell) else GoalPoint(tuple(place)) for place in via)
    stops = [with_goals(free, _stop(scene, place, blocked, f"via[{n}]")) for n, place in enumerate(places)]
    goals, problems = final_goals(scene, blocked, skip_blocked=approximate)
    final = with_goals(free, goals)
    chain = _Chain(Advisor(scene, places), final, k, tuple(np.asarray(start, dtype=np.float64).tolist()))
    if escape and free.cell[start_cell(free, chain.at)] == Cell.OBSTACLE:
        targets = (stops or [final])[0]
        near = targets.goal_connected | (targets.cell == Cell.GOAL)
        leg = escape_leg(scene, free, np.asarray(chain.at), near if near.any() else ~blocked)
        if leg is not None:
            chain.add(Leg(leg, "escape", certified=False))
            chain.begin = chain.at
    for number, stop in enumerate(stops):
        if not chain.follow(stop, "via", number):
            return chain.result(free)
    if (
        not chain.follow(final, "goal", len(stops), "; ".join(problems))
        and approximate
        and chain.outcome is not Outcome.START_BLOCKED
    ):
        chain.approach(free, goal_points(scene))
    return chain.result(free)


class _Chain:
    """Legs of a path while they are planned.

    `advisor`: advice for the scene of the path; `final`: space with the goals of the scene; `k`: weight of the
    Dirichlet field, None for the first one of the scene; `start`: in world coordinates; `begin`: begin of the first leg
    with a field, and `at`: end of the last leg, both first the start; `legs`: the legs so far; `outcome`, `reason`:
    outcome of the last leg that was tried, and the reason why this leg reaches no goal; `distance`: distance of the end
    from the nearest goal, in axis units, -1 if unknown.
    """

    def __init__(self, advisor: Advisor, final: ConfigurationSpace, k: float | None, start: Point) -> None:
        self.advisor, self.final, self.start, self.begin, self.at = advisor, final, start, start, start
        self.k = next(iter(advisor.scene.k), None) if k is None else k
        self.legs: list[Leg] = []
        self.outcome, self.reason, self.distance = Outcome.REACHED, "", -1.0

    def add(self, leg: Leg) -> None:
        """Append a leg, and set `at` to its end."""
        self.legs.append(leg)
        self.at = tuple(leg.path.points[-1].tolist())

    def follow(
        self, space: ConfigurationSpace, kind: Literal["via", "goal", "approximate"], number: int, problem: str = ""
    ) -> bool:
        """Append the certified path from the end of the last leg to a goal; return whether this path exists.

        Without such a path, set `outcome` and `reason`.  `space`: space with goals; `kind`: kind of the leg; `number`:
        number of intermediate places before the leg; `problem`: reason if the space has no goal.
        """
        name = f"via[{number}]" if kind == "via" else "a goal"
        if space.cell[start_cell(space, self.at)] == Cell.OBSTACLE:
            self.outcome = Outcome.START_BLOCKED
            self.reason = self.advisor.of_blocked_start(space, self.at, name)
            return False
        if not space.goal_count:
            self.outcome, self.reason = Outcome.GOAL_BLOCKED, problem
            return False
        path = plan(space, scene_wiring(self.advisor.scene), k=self.k).path(self.at)
        certify(path)
        if path.outcome is Outcome.REACHED:
            self.add(Leg(path, kind, certified=True))
            return True
        self.outcome = path.outcome
        if path.outcome is Outcome.NO_PATH and self.advisor.via:
            final = self.final.cell == Cell.GOAL
            self.reason = separation_reason(self.advisor, space, final, self.at, self.begin, number)
        else:
            self.reason = f"via[{number}]: " * (kind == "via") + (self.advisor.reason(path) or "")
        return False

    def approach(self, space: ConfigurationSpace, goals: NDArray[np.float64]) -> None:
        """Append the leg to the reachable place that is nearest to one of the points `goals` (g, d), in axis units.

        `outcome` and `reason` stay those of the failed leg; `distance` is set to the distance of the place from this
        goal point, in axis units.  `space`: space without goals.
        """
        outcome, reason = self.outcome, self.reason
        region = label_regions(space.cell != Cell.OBSTACLE, space.periodic)
        reachable = np.argwhere(region == region[start_cell(space, self.at)])
        cell, point, distance = nearest_to_goals(space, reachable, goals)
        mask = np.zeros(space.shape, dtype=bool)
        mask[tuple(cell)] = True
        self.follow(with_goals(space, GoalCells(mask, point[np.newaxis])), "approximate", len(self.advisor.via))
        self.outcome, self.reason, self.distance = outcome, reason, distance

    def result(self, space: ConfigurationSpace) -> LegPath:
        """Return the path of the legs; `space`: space without goals."""
        reason = None if self.outcome is Outcome.REACHED else self.reason
        distance = None if self.distance < 0 else self.distance
        return LegPath(tuple(self.legs), self.outcome, reason, distance, space, self.start)


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


def _stop(scene: Scene, place: GoalPoint | GoalCell, blocked: NDArray[np.bool_], key: str) -> GoalCells:
    """Return the cells of an intermediate place, with its point in each; the point of a cell is its centre.

    `blocked`: mask of obstacle cells, shape of the space; `key`: key path of the place, for messages.
    """
    found = goal_cells(scene, place, blocked, key)
    if not isinstance(place, GoalCell):
        return found
    centre = scene.frame.from_world(cell_centre(scene.axes, scene.frame, place.cell, key))
    return GoalCells(found.cells, centre[np.newaxis])
