"""Advice for failed paths of a scene: the reason, and remedies that were tried before they are recommended."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial

from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import ResgridError
from resgrid.planning.failure_reasons import FAILURE_REASONS, nearest_start, undecided_reason
from resgrid.planning.node_paths import NodePath
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.robots import PointRobot
from resgrid.scene import GoalCell, GoalJoints, Scene, build_space
from resgrid.scene.goals import Goal
from resgrid.scene.nearest_place import has_unknown, place_text, why_blocked
from resgrid.scene.overrides import apply_overrides
from resgrid.scene.world_coordinates import cell_centre, locate_point

_MOST_CELLS = 2**24
"""Maximum number of cells of a space in which a remedy is tried, for robots that are points or discs."""

_MOST_CELLS_OF_BODIES = 2**17
"""Maximum number of cells of a space in which a remedy is tried, for robots other than points and discs.

Such robots need more time per cell.
"""

Change = Callable[[], Scene]
"""Function without arguments that returns a changed copy of a scene."""


@dataclass(frozen=True, eq=False)
class Advisor:
    """Advice for failed paths of a scene.

    `scene`: scene of the paths.  The space of every tried remedy is cached, because several paths of a scene need it.
    """

    scene: Scene
    _spaces: dict[str, ConfigurationSpace | None] = field(default_factory=dict, init=False)

    @cached_property
    def _has_unknown(self) -> bool:
        """Whether the map of the scene has unknown cells that block configurations."""
        return has_unknown(self.scene)

    def reason(self, path: Streamline | NodePath) -> str | None:
        """Return a message with the reason why a path reaches no goal, and remedies; None if it reaches a goal."""
        if path.outcome not in (Outcome.START_BLOCKED, Outcome.NO_PATH):
            return path.reason
        cell = tuple(path.cells[0].tolist())
        is_blocked = path.outcome is Outcome.START_BLOCKED
        why = f"the start {why_blocked(self.scene, cell)}" if is_blocked else FAILURE_REASONS[path.outcome]
        parts = [undecided_reason(path.outcome, path.space, cell) or why]
        remedies = list(self._remedies(path, unknown="unknown space" in why))
        parts += [nearest_start(path.space, cell), *remedies]
        if not remedies and not is_blocked:
            parts.append("open a passage")
        return "; ".join(part for part in parts if part)

    def _remedies(self, path: Streamline | NodePath, *, unknown: bool) -> Iterator[str]:
        """Yield a phrase for every change of the scene that opens a path from the start of `path` to a goal.

        The changes are: unknown cells are free, only the centre of a cell is tested, a smaller robot, more cells.  A
        smaller body is named without a trial for robots that are not points or discs.  `unknown`: whether unknown
        cells of the map block the start; the option that makes them free is then yielded even if it opens no path.
        """
        scene = self.scene
        if self._has_unknown:
            helps = self._helps("unknown", partial(apply_overrides, scene, {"map.unknown": "free"}), path)
            if unknown or helps:
                yield "--unknown free makes unknown cells free" + (" and opens a path" if helps else "")
        is_coarse = scene.sampling == "conservative" and bool(scene.robot.remedy)
        if is_coarse and self._helps("sampling", partial(scene.replace, sampling="centre"), path):
            yield "--set sampling=centre opens a path, because it tests only the centre of each cell"
        if isinstance(scene.robot, PointRobot) and scene.robot.radius:
            if self._helps("robot", partial(dataclasses.replace, scene, robot=scene.robot.shrunk), path):
                yield scene.robot.remedy
        elif scene.robot.remedy:
            yield scene.robot.remedy
        if scene.map is not None:
            yield from self._finer_maps(path)
        elif self._helps("cells", partial(_finer, scene), path):
            yield f"refine the grid: twice as many cells on each axis open a path{_places_of_goal_cells(self.scene)}"

    def _finer_maps(self, path: Streamline | NodePath) -> Iterator[str]:
        """Yield a phrase for the first finer division of the map that opens a path from the start of `path`.

        Divisions: half the value of the map's key ``coarsen``, then 1; without ``coarsen``, and only for a robot with a
        size, twice and four times the value of the key ``refine``.
        """
        assert self.scene.map is not None
        table = self.scene.map.table
        coarse, fine = table.get("coarsen") or 1, table.get("refine") or 1
        if coarse > 1:
            trials = [("coarsen", count) for count in dict.fromkeys((coarse // 2, 1))]
        elif self.scene.robot.remedy:  # cells of a map without a robot's size are exact
            trials = [("refine", fine * factor) for factor in (2, 4)]
        else:
            return
        for key, count in trials:
            if self._helps(f"{key}={count}", partial(apply_overrides, self.scene, {f"map.{key}": count}), path):
                space = self._spaces[f"{key}={count}"]
                assert space is not None
                yield f"--{key} {count} opens a path, with {' x '.join(map(str, space.shape))} cells"
                return

    def _helps(self, name: str, change: Change, path: Streamline | NodePath) -> bool:
        """Return whether a goal can be reached from the start of `path` after a change of the scene.

        The result is False if the changed scene is invalid or has too many cells.  `name`: key of the change in the
        cache of results; `change`: function without arguments that returns the changed scene.
        """
        if name not in self._spaces:
            self._spaces[name] = _changed_space(change)
        space = self._spaces[name]
        if space is None:
            return False
        cell, _ = locate_point(space.axes, space.frame, tuple(path.points[0].tolist()), "starts")
        return bool(space.goal_connected[cell]) or space.cell[cell] == Cell.GOAL


def _places_of_goal_cells(scene: Scene) -> str:
    """Return a phrase with the centres, in world coordinates, of the goals that a scene gives as cells; else ``""``.

    With another number of cells, the indices of these goal cells are no longer valid, but their centres are.
    """
    cells = [goal.cell for goal in scene.goals if isinstance(goal, GoalCell)]
    if not cells:
        return ""
    centres = [cell_centre(scene.axes, scene.frame, cell, "goal") for cell in cells]
    return f", with goals at {', '.join(map(place_text, centres))} in place of goal cells, which are renumbered"


def _finer(scene: Scene) -> Scene:
    """Return a scene with twice as many cells on each axis; a goal given as a cell becomes a goal at its centre."""
    axes = tuple(dataclasses.replace(axis, cells=2 * axis.cells) for axis in scene.axes)
    goals: list[Goal] = []
    for goal in scene.goals:
        if isinstance(goal, GoalCell):
            centre = cell_centre(scene.axes, scene.frame, goal.cell, "goal")
            goals.append(GoalJoints(centre, centre))
        else:
            goals.append(goal)
    return dataclasses.replace(scene, axes=axes, goals=tuple(goals))


def _changed_space(change: Change) -> ConfigurationSpace | None:
    """Return the space of the scene that the function `change` returns; None if it is invalid or has too many cells."""
    try:
        scene = change()
        most = _MOST_CELLS if isinstance(scene.robot, PointRobot) else _MOST_CELLS_OF_BODIES
        cells = math.prod(axis.cells for axis in scene.axes)
        return build_space(scene, require_goal=False) if cells <= most else None
    except ResgridError:
        return None
