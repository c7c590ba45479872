"""Advice for failed paths of a scene: the reason, and remedies that were tried before they are recommended."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from resgrid.core.axis import Point
from resgrid.core.cell import Cell
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError, ResgridError
from resgrid.planning.escape_leg import escape_leg
from resgrid.planning.failure_reasons import FAILURE_REASONS, blocked_start_reason, nearest_start, undecided_reason
from resgrid.planning.node_paths import NodePath
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.planning.trace import start_cell
from resgrid.robots import PointRobot
from resgrid.scene import GoalCell, Scene, build_space
from resgrid.scene.goal_placement import goal_cells
from resgrid.scene.goals import Goal
from resgrid.scene.nearest_place import has_unknown, is_unknown, place_text
from resgrid.scene.trials import (
    MOST_CELLS,
    Change,
    changed_scene,
    finer_values,
    place_of_goal,
    with_division,
    with_unknown_free,
)
from resgrid.scene.world_coordinates import cell_centre

_ESCAPE = (
    "--escape of 'resgrid path' (in Python: escape=True of plan_legs) first leaves the inflated zone on a straight "
    "line, which is not certified"
)


class _Trial(NamedTuple):
    """A changed scene, and its configuration space."""

    scene: Scene
    space: ConfigurationSpace


@dataclass(frozen=True, eq=False)
class Advisor:
    """Advice for failed paths of a scene.

    `scene`: scene of the paths; `via`: intermediate places of every path, in their order.  The space of every tried
    remedy is cached, because several paths of a scene need it.
    """

    scene: Scene
    via: tuple[Goal, ...] = ()
    _spaces: dict[str, _Trial | None] = field(default_factory=dict, init=False)

    @cached_property
    def _has_unknown(self) -> bool:
        """Whether the map of the scene has unknown cells that block configurations."""
        return has_unknown(self.scene)

    def reason(self, path: Streamline | NodePath) -> str | None:
        """Return a message with the reason why a path reaches no goal, and remedies; None if it reaches a goal."""
        start = tuple(path.points[0].tolist())
        if path.outcome is Outcome.START_BLOCKED:
            return self.of_blocked_start(path.space, start)
        if path.outcome is not Outcome.NO_PATH:
            return path.reason
        cell = tuple(path.cells[0].tolist())
        parts = [undecided_reason(path.outcome, path.space, cell) or FAILURE_REASONS[path.outcome]]
        parts += [nearest_start(path.space, cell), *self.openings(start)]
        return "; ".join(part for part in parts if part)

    def of_blocked_start(self, space: ConfigurationSpace, start: Point, goal: str = "a goal") -> str:
        """Return a message with the reason why a start is blocked, and remedies.

        `space`: space of the first leg; `start`: in world coordinates; `goal`: name of the goals of this space.
        """
        cell = start_cell(space, start)
        parts = [blocked_start_reason(self.scene, space, cell, goal), *self._remedies(start, cell)]
        near = space.goal_connected | (space.cell == Cell.GOAL)
        is_round = isinstance(self.scene.robot, PointRobot) and self.scene.robot.radius > 0
        if is_round and self.scene.drive != "start" and space.cell.size <= MOST_CELLS:
            near = near if near.any() else space.cell != Cell.OBSTACLE
            if escape_leg(self.scene, space, np.asarray(start), near) is not None:
                parts.append(_ESCAPE)
        return "; ".join(parts)

    def openings(self, start: Point) -> list[str]:
        """Return a phrase for every change of the scene that opens a path from a start in a free cell to a goal.

        `start`: in world coordinates.  Without such a change, the only phrase is to open a passage.
        """
        return list(self._remedies(start)) or ["open a passage"]

    def _remedies(self, start: Point, blocked: tuple[int, ...] | None = None) -> Iterator[str]:
        """Yield a phrase for every change of the scene that opens a path from a start to a goal.

        The changes are: unknown cells are free, only the centre of a cell is tested, a smaller robot, more cells.  A
        smaller body is named without a trial for robots that are not points or discs.  `start`: in world coordinates;
        `blocked`: cell of a blocked start.  If this cell is blocked as unknown, the option that frees it is yielded
        even if it opens no path.
        """
        scene = self.scene
        if self._has_unknown:
            helps = self._helps("unknown", partial(with_unknown_free, scene), start)
            frees = blocked is not None and is_unknown(scene, blocked) and self._frees("unknown", start)
            if frees or helps:
                yield "--unknown free makes unknown cells free" + (" and opens a path" if helps else "")
        is_coarse = scene.sampling == "conservative" and bool(scene.robot.remedy)
        if is_coarse and self._helps("sampling", partial(scene.replace, sampling="centre"), start):
            yield "--set sampling=centre opens a path, because it tests only the centre of each cell"
        if isinstance(scene.robot, PointRobot) and scene.robot.radius:
            if self._helps("robot", partial(dataclasses.replace, scene, robot=scene.robot.shrunk), start):
                yield scene.robot.remedy
        elif scene.robot.remedy:
            yield scene.robot.remedy
        if scene.map is not None:
            yield from self._finer_maps(start)
        elif self._helps("cells", partial(_finer, scene), start):
            places = self._places_of_cells(start)
            yield f"refine the grid: twice as many cells on each axis open a path{places}"

    def _finer_maps(self, start: Point) -> Iterator[str]:
        """Yield a phrase for the first finer division of the map that opens a path from a start.

        Divisions: half the value of the map's key ``coarsen``, then 1; without ``coarsen``, and only for a robot with a
        size, twice and four times the value of the key ``refine``.  `start`: in world coordinates.
        """
        assert self.scene.map is not None
        trials = [("coarsen", count) for count in finer_values(self.scene)]
        if not trials and self.scene.robot.remedy:  # cells of a map without a robot's size are exact
            fine = self.scene.map.table.get("refine") or 1
            trials = [("refine", fine * factor) for factor in (2, 4)]
        for key, count in trials:
            if self._helps(f"{key}={count}", partial(with_division, self.scene, key, count), start):
                trial = self._spaces[f"{key}={count}"]
                assert trial is not None
                size = " x ".join(map(str, trial.space.shape))
                yield f"--{key} {count} opens a path, with {size} cells{self._places_of_cells(start)}"
                return

    def _places_of_cells(self, start: Point) -> str:
        """Return a phrase with the centres, in world coordinates, of the places that are given as cells; else ``""``.

        With another number of cells, the indices of these cells are no longer valid, but their centres are.  `start`:
        in world coordinates.
        """
        scene, cells = self.scene, []
        for name, places in (("via", self.via), ("goal", scene.goals)):
            centres = [
                place_text(cell_centre(scene.axes, scene.frame, place.cell, name))
                for place in places
                if isinstance(place, GoalCell)
            ]
            cells += [f"{name} at {', '.join(centres)}"] * bool(centres)
        if not cells:
            return ""
        words = " and ".join([f"the start at {place_text(start)}", *cells])
        return f", with {words} in place of cells, which are renumbered"

    def _helps(self, name: str, change: Change, start: Point) -> bool:
        """Return whether a path leads from a start through all intermediate places to a goal after a change.

        The result is False if the changed scene is invalid or has too many cells.  `name`: key of the change in the
        cache of results; `change`: function without arguments that returns the changed scene; `start`: in world
        coordinates.
        """
        if name not in self._spaces:
            self._spaces[name] = _trial(change)
        trial = self._spaces[name]
        if trial is None:
            return False
        space, cell = trial.space, start_cell(trial.space, start)
        if not self.via:
            return bool(space.goal_connected[cell]) or space.cell[cell] == Cell.GOAL
        blocked = space.cell == Cell.OBSTACLE
        region = label_regions(~blocked, space.periodic)
        try:
            stops = [goal_cells(trial.scene, place_of_goal(self.scene, via), blocked, "via").cells for via in self.via]
        except InputError:
            return False
        stops.append(space.cell == Cell.GOAL)
        return not blocked[cell] and all((region[stop] == region[cell]).any() for stop in stops)

    def _frees(self, name: str, start: Point) -> bool:
        """Return whether a start lies in a free cell after the change with a key in the cache of results."""
        trial = self._spaces[name]
        return trial is not None and trial.space.cell[start_cell(trial.space, start)] != Cell.OBSTACLE


def _finer(scene: Scene) -> Scene:
    """Return a scene with twice as many cells on each axis; a goal given as a cell becomes a goal at its centre."""
    axes = tuple(dataclasses.replace(axis, cells=2 * axis.cells) for axis in scene.axes)
    goals = tuple(place_of_goal(scene, goal) for goal in scene.goals)
    return dataclasses.replace(scene, axes=axes, goals=goals)


def _trial(change: Change) -> _Trial | None:
    """Return the scene that the function `change` returns, with its space; None if it is invalid or too large."""
    scene = changed_scene(change)
    try:
        return None if scene is None else _Trial(scene, build_space(scene, require_goal=False))
    except ResgridError:
        return None
