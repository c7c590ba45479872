"""Paths for a stream of maps: the plan for each map reuses the solution for the previous map."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Point
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import AccuracyError, CertificateError, InputError
from resgrid.planning.certify import certify
from resgrid.planning.failure_reasons import blocked_start_reason
from resgrid.planning.legs import final_goals, with_goals
from resgrid.planning.node_paths import NodePath
from resgrid.planning.pipeline import require_uniform, scene_wiring
from resgrid.planning.planner import Planner, plan
from resgrid.planning.replanning import Replanning
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.planning.trace import start_cell
from resgrid.robots import Robot
from resgrid.scene import Scene, build_space
from resgrid.scene.goals import GoalPoint
from resgrid.scene.maps.formats import map_options
from resgrid.scene.overrides import build_changed
from resgrid.scene.reading import Document
from resgrid.scene.recordings.scenes import MAP_KEYS, UnusableMapError, cells_of_snapshot, check_map_table
from resgrid.scene.recordings.snapshot import MapSnapshot, Pose
from resgrid.scene.scene import check_attributes
from resgrid.scene.tolerances import goal_heading

_FIXED = ("axes", "map", "frame", "source", "hidden", "control")
"""Attributes of a scene that options cannot change: the snapshots give them, or they have no effect on paths."""


@dataclass(frozen=True, eq=False)
class StreamedPath:
    """The path for one snapshot of a recording.  Returned by `StreamPlanner`.

    Attributes
    ----------
    snapshot : MapSnapshot
        The map, with the poses of robot and goal, for which the path was planned.
    path : Streamline, NodePath or None
        The path, also of a negative outcome; None if the start lies outside the map, no goal has a free cell, or
        `outcome` is None.
    outcome : Outcome or None
        Outcome of the plan; None if there is no plan, because the map, the start or the goal is missing, the frame of
        the map changed, or the field is not direction-safe.
    reason : str or None
        Reason why no certified path reaches a goal; None if one does.
    certified : bool
        Whether the path has passed `certify`.
    replanning : Replanning or None
        Report of the update of the previous field; None for the first plan, and if nothing was solved.
    seconds : float
        Processor time from the occupancies to the certified path, in seconds.
    planner : Planner or None
        Solved space of this snapshot; if nothing was solved, that of the last solved snapshot, or None without one.
    scene : Scene or None
        Scene with the snapshot's map and any goals in the options of the planner; None before the first usable map.
    start : tuple of float or None
        Start in world coordinates (x, y), in metres; for a robot that turns, also the heading in radians times the
        turning length, in metres, of the robot; None if the start is unknown.
    solved : bool
        Whether the space of this snapshot was solved.
    reached : bool
        Whether the path reaches a goal and is certified.
    points : ndarray of float64, shape (n, ndim)
        Points of the path in the frame of the map, in metres; a third coordinate is the heading in radians times the
        turning length.  Empty without a certified path to a goal.
    length : float or None
        Length of the path in metres; None without a certified path to a goal.
    clearance : float or None
        Smallest distance of the path from obstacle cells in metres; None without a certified path to a goal.
    heading : float or None
        For a robot whose space has no heading: heading that the goal demands, in radians; None without one.

    Examples
    --------
    >>> snapshot = rg.maps.MapSnapshot(np.zeros((4, 6)), 0.5, start=(0.2, 0.2, 0.0))
    >>> rg.maps.StreamPlanner(goal=(2.75, 1.75)).plan(snapshot)
    <StreamedPath reached: length 3.04, clearance 0.2, certified>
    """

    snapshot: MapSnapshot
    path: Streamline | NodePath | None = None
    outcome: Outcome | None = None
    reason: str | None = None
    certified: bool = False
    replanning: Replanning | None = None
    seconds: float = 0.0
    planner: Planner | None = field(default=None, repr=False)
    scene: Scene | None = field(default=None, repr=False)
    start: Point | None = None
    solved: bool = False
    _maker: StreamPlanner | None = field(default=None, repr=False)
    _frame_id: str | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        word = "not planned" if self.outcome is None else str(self.outcome)
        if not self.reached:
            return f"<StreamedPath {word}: {self.reason}>"
        return f"<StreamedPath {word}: length {self.length:.4g}, clearance {self.clearance:.4g}, certified>"

    @property
    def reached(self) -> bool:
        """Whether the path reaches a goal and is certified."""
        return self.outcome is Outcome.REACHED and self.certified

    @property
    def points(self) -> NDArray[np.float64]:
        """Points of the path in the frame of the map, in metres (n, ndim); empty without a certified path to a goal."""
        return self.path.points if self.reached and self.path is not None else np.zeros((0, 2))

    @property
    def length(self) -> float | None:
        """Length of the path in metres; None without a certified path to a goal."""
        return self.path.length if self.reached and self.path is not None else None

    @property
    def clearance(self) -> float | None:
        """Smallest distance of the path from obstacle cells in metres; None without a certified path to a goal."""
        return self.path.clearance if self.reached and self.path is not None else None

    @property
    def heading(self) -> float | None:
        """Heading that the reached goal demands, in radians; None without a certified path or a demanded heading."""
        if not self.reached or self.path is None or self.scene is None:
            return None
        goals = self.scene.goals or _goals(self.scene, self.snapshot.goal, 0.0)
        return goal_heading(replace(self.scene, goals=goals), self.path.points[-1])


class StreamPlanner:
    """Planner for a stream of maps, from a recording or from a running robot.

    For each snapshot, the solved space of the snapshot before is updated (`Planner.update`); the path equals that of a
    plan without earlier snapshots.  Outcomes without a path, such as a blocked goal, are results and not errors.

    Parameters
    ----------
    goal_tolerance : float
        Largest distance from the goal, in metres, for goals from the snapshots.
    **options
        Options of `read_scene` for maps of ROS: ``unknown``, ``lethal``, ``least_conductivity``, ``crop``, ``coarsen``,
        ``refine``, ``periodic``, ``headings``; and the keywords of `Scene.replace`, such as ``goal=(5, 0)``, ``k=0.9``
        or ``robot=rg.DiscRobot(0.2)``.  A ``goal`` or ``start`` replaces those of the snapshots.

    Raises
    ------
    InputError
        If an option is unknown.

    Examples
    --------
    >>> planner = rg.maps.StreamPlanner(goal=(5.5, 0.5), robot=rg.DiscRobot(0.4))
    >>> grid = np.zeros((6, 6), dtype=np.int8)
    >>> first = planner.plan(rg.maps.MapSnapshot(grid, 1.0, start=(0.5, 0.5, 0.0)))
    >>> grid[0, 3] = 100
    >>> planner.plan(rg.maps.MapSnapshot(grid, 1.0, start=(0.5, 0.5, 0.0)), after=first).replanning.method
    'elimination'
    """

    def __init__(self, *, goal_tolerance: float = 0.0, **options: Any) -> None:
        table = {key: options.pop(key) for key in (*MAP_KEYS, *map_options()) if key in options}
        check_attributes(options, *MAP_KEYS)
        for key in _FIXED:
            if key in options:
                raise InputError(f"{key} does not apply to a stream of maps; leave it out")
        self._options, self._changes, self._tolerance = options, dict[str, Any](), float(goal_tolerance)
        self._table, self._source = table, "recording"
        robot = options.get("robot")
        self._extent = robot.extent if isinstance(robot, Robot) else 0.0
        check_map_table(table)

    @classmethod
    def of_changes(
        cls, table: Mapping[str, Any], changes: Mapping[str, Any], source: str, goal_tolerance: float = 0.0
    ) -> StreamPlanner:
        """Return the planner for options of the command line.

        Parameters
        ----------
        table : mapping
            Options for reading the maps, by name, such as ``"unknown"`` or ``"crop"``.
        changes : mapping
            Values of keys of the scene by key path, such as ``"robot.radius"``, as text or as values.
        source : str
            Name of the recording, for messages.
        goal_tolerance : float
            Largest distance from the goal, in metres, for goals from the snapshots.

        Returns
        -------
        StreamPlanner

        Raises
        ------
        InputError
            If an option of maps does not apply to recordings.
        """
        planner = cls(goal_tolerance=goal_tolerance)
        check_map_table(table)
        planner._table, planner._changes, planner._source = dict(table), dict(changes), source
        return planner

    def paths(self, snapshots: Iterable[MapSnapshot]) -> Iterator[StreamedPath]:
        """Yield the path for every snapshot of a recording or of another source.

        Parameters
        ----------
        snapshots : iterable of MapSnapshot
            The snapshots, such as a `Recording`.

        Yields
        ------
        StreamedPath
            Path and outcome, in the order of the snapshots.

        Raises
        ------
        InputError
            If an option does not fit the map or the robot.
        """
        last = None
        for snapshot in snapshots:
            last = self.plan(snapshot, after=last)
            yield last

    def plan(self, snapshot: MapSnapshot, after: StreamedPath | None = None) -> StreamedPath:
        """Return the path for one snapshot.

        Parameters
        ----------
        snapshot : MapSnapshot
            The map, with the poses of robot and goal.
        after : StreamedPath, optional
            Result for the snapshot before, whose work is reused.

        Returns
        -------
        StreamedPath
            Path and outcome.

        Raises
        ------
        InputError
            If an option does not fit the map or the robot, or `after` comes from another planner.
        """
        if after is not None and after._maker is not self:
            raise InputError("after is the result of another StreamPlanner; leave it out for the first snapshot")
        begin = process_time()
        before = StreamedPath(snapshot) if after is None else after
        base = StreamedPath(
            snapshot, planner=before.planner, scene=before.scene, _maker=self, _frame_id=before._frame_id
        )
        return replace(self._planned(base), seconds=process_time() - begin)

    def _planned(self, base: StreamedPath) -> StreamedPath:
        """Return the path for the snapshot of `base`.

        `base`: result without a path for this snapshot, with planner, scene and coordinate frame of earlier snapshots.
        """
        snapshot = base.snapshot
        if not snapshot.has_map:
            return replace(base, reason=snapshot.note or "the map has no cells")
        if base._frame_id not in (None, snapshot.frame_id):
            return replace(
                base, reason=f"the frame of the map changed from {base._frame_id!r} to {snapshot.frame_id!r}"
            )
        try:
            scene = self._scene(snapshot, base.scene)
        except UnusableMapError as error:
            return replace(base, reason=str(error))
        base = replace(base, scene=scene, _frame_id=snapshot.frame_id)
        start, goals = _start(scene, snapshot.start), scene.goals or _goals(scene, snapshot.goal, self._tolerance)
        if start is None or not goals:
            unknown = snapshot.note or "the place of the robot is unknown"
            return replace(base, reason=unknown if start is None else "there is no goal yet")
        base = replace(base, start=start)
        space, outcome, reason = _space(replace(scene, goals=goals, starts=()), start)
        if outcome is not None:
            return replace(base, outcome=outcome, reason=reason)
        return _followed(base, space, start)

    def _scene(self, snapshot: MapSnapshot, last: Scene | None) -> Scene:
        """Return the scene of a snapshot.

        `last`: scene of an earlier snapshot, None without one; if its map has the same axes and frame, only the map is
        replaced.
        """
        if last is not None and last.map is not None:
            cells = cells_of_snapshot(snapshot, last.map.table, last.robot.extent)
            if cells.axes == last.map.axes and cells.frame == last.map.frame:
                return replace(last, map=cells)

        def read(table: Mapping[str, Any], extent: float) -> Any:
            given = {key: value for key, value in table.items() if key not in ("file", "format")}
            check_map_table(given)
            return cells_of_snapshot(snapshot, table, max(extent, self._extent))

        table = {**self._table, "file": self._source, "format": "ros"}
        document = Document({"schema": 1, "title": Path(self._source).stem, "map": table}, self._source, Path(), {})
        scene = build_changed(document, self._changes, read)
        scene = scene.replace(**self._options) if self._options else scene
        _require_fit(scene)
        return scene


def _require_fit(scene: Scene) -> None:
    """Raise InputError unless the robot of a scene moves in the plane, and the scene has at most one start.

    A scene with drive = 'start' raises InputError, too.
    """
    require_uniform(scene, "a stream of maps")
    if scene.robot.base is not None or scene.robot.workspace_ndim != 2:
        raise InputError(f"{scene.source}: maps of recordings are for robots that move in the plane, not for arms")
    if len(scene.starts) > 1:
        raise InputError(f"{scene.source}: {len(scene.starts)} starts are given; a stream of maps has one at a time")


def _configuration(scene: Scene, pose: Pose) -> Point:
    """Return the configuration of the scene's robot at a pose: x, y, and for a robot that turns a third coordinate.

    The third coordinate is the heading in radians times the turning length, in metres, of the robot.
    """
    turning = scene.robot.turning_length
    return pose[:2] if turning is None else (*pose[:2], pose[2] * turning)


def _start(scene: Scene, pose: Pose | None) -> Point | None:
    """Return the start of the scene, or else the configuration of the robot at the pose `pose`; None without both."""
    if scene.starts:
        return scene.starts[0]
    return None if pose is None else _configuration(scene, pose)


def _goals(scene: Scene, pose: Pose | None, tolerance: float) -> tuple[GoalPoint, ...]:
    """Return the goal at a pose as a tuple of one goal; an empty tuple without a pose.

    `tolerance`: largest accepted distance from the goal, in metres.
    """
    if pose is None:
        return ()
    heading = pose[2] if scene.robot.turning_length is None else None
    return (GoalPoint(_configuration(scene, pose), tolerance, heading),)


def _space(scene: Scene, start: Point) -> tuple[ConfigurationSpace, Outcome | None, str | None]:
    """Return the configuration space, and the outcome and reason if the start or all goals are blocked, else None.

    `start`: start in world coordinates. The space contains the goals only if nothing is blocked. The outcome is
    ``START_BLOCKED`` or ``GOAL_BLOCKED``.
    """
    free = build_space(replace(scene, goals=()), require_goal=False)
    blocked = free.cell == Cell.OBSTACLE
    try:
        cell = start_cell(free, start)
    except InputError as error:
        return free, Outcome.START_BLOCKED, str(error)
    goals, problems = final_goals(scene, blocked, skip_blocked=True)
    if goals.cells.any():
        return with_goals(free, goals), None, None
    if blocked[cell]:
        return free, Outcome.START_BLOCKED, blocked_start_reason(scene, free, cell)
    return free, Outcome.GOAL_BLOCKED, "; ".join(problems)


def _followed(base: StreamedPath, space: ConfigurationSpace, start: Point) -> StreamedPath:
    """Return a copy of `base` that contains the path from a start, its outcome, and whether it is certified.

    `base`: result without a path, with the planner of an earlier snapshot or None; `space`: space with goals; `start`:
    start in world coordinates.
    """
    scene = base.scene
    assert scene is not None
    try:
        if base.planner is None:
            planner = plan(space, scene_wiring(scene), k=next(iter(scene.k), None))
        else:
            planner = base.planner.update(space)
    except AccuracyError as error:
        return replace(base, reason=str(error))
    path = planner.path(start)
    is_blocked = path.outcome is Outcome.START_BLOCKED
    reason = blocked_start_reason(scene, space, start_cell(space, start)) if is_blocked else path.reason
    solved = replace(base, replanning=planner.replanning, planner=planner, solved=True)
    found = replace(solved, path=path, outcome=path.outcome, reason=reason)
    try:
        certify(path)
    except CertificateError as error:
        return replace(found, reason=f"the path is not certified: {error}")
    return replace(found, certified=True)
