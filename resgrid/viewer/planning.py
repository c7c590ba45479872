"""Planning for the 3-D view after a move of the start or the goal, without display code.

`ArmPlan` is the solved scene of an arm.  The other definitions serve points and balls, too: motions, the interface of a
solved space, and the change of the goal of a space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError, ResgridError
from resgrid.planning.any_path import AnyPath
from resgrid.planning.node_paths import NodePath
from resgrid.planning.pipeline import problem_of, require_uniform
from resgrid.planning.planner import Planner, plan
from resgrid.planning.shortcuts import shortcut
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.planning.time_parameterization import time_parameterize
from resgrid.planning.workspace import sample_path, workspace_clearance
from resgrid.robots import URDFRobot
from resgrid.scene.scene import Scene

_FRAMES = 600
"""Number of configurations into which a path is divided for the slider of the view."""

_CLEARANCE_STEP = 0.02
"""Largest motion of any point of the robot between two configurations whose clearance is computed, in metres."""

_ITERATIONS = 40
"""Largest number of iterations of the inverse kinematics that moves the tool to a dragged handle.

The last configuration is used after these iterations, or after an iteration that changes every joint by less than 1e-5
radians or metres.
"""

_DAMPING = 0.05
"""Damping ``d`` of the step ``J^T (J J^T + d^2 I)^-1 e`` of the inverse kinematics, in metres.

``J`` is the Jacobian of the tool's place, and ``e`` the vector from the tool to the handle.  The damping limits steps
near singularities.
"""

_LONGEST = 0.3
"""Largest magnitude of the change of a joint in one iteration of the inverse kinematics, in radians or metres."""


_CENTRE = np.array([0.0, 0.0, 0.3])
"""Vector from the robot's base to the middle of the view, as a multiple of the robot's reach."""


@dataclass(frozen=True)
class Motion:
    """A path as a sequence of configurations with an outcome.

    `configurations` (n, ndim): in world coordinates; `times` (n,): ascending, in seconds, or from 0 to 1 for a path
    without times; `is_timed`: whether `times` are seconds; `text`: outcome with length, clearance and duration or the
    reason, as Markdown.
    """

    configurations: NDArray[np.float64]
    times: NDArray[np.float64]
    is_timed: bool
    text: str

    def at(self, time: float) -> NDArray[np.float64]:
        """Return the interpolated configuration (ndim,) at a time; the first or last one for times outside the path.

        `time`: in the unit of `times`.
        """
        return np.array([np.interp(time, self.times, column) for column in self.configurations.T])


class ArmPlan:
    """A solved scene with an arm, whose start and goal can change.

    Parameters
    ----------
    scene : Scene
        Scene with an arm in space.
    space : ConfigurationSpace, optional
        Space of the scene; by default it is built.

    Attributes
    ----------
    start : ndarray of float64, shape (ndim,)
        Start configuration.
    goal : ndarray of float64, shape (ndim,), or None
        Goal configuration; None for the goals of the scene.
    is_solved : bool
        Whether the current field was solved for `goal`; False after a goal in a cell that is not free.
    """

    def __init__(self, scene: Scene, space: ConfigurationSpace | None = None) -> None:
        self.scene, self.robot = scene, require_arm(scene)
        require_uniform(scene, "the 3-D view")
        problem = problem_of(scene, space=space)
        self.wiring, self.k = problem.wiring, problem.ks[0] if problem.ks else None
        self.planner: Planner = plan(problem.space, self.wiring, k=self.k)
        self.lower, self.upper = (np.array([getattr(axis, end) for axis in scene.axes]) for end in ("lower", "upper"))
        self.goal: NDArray[np.float64] | None = None
        self.is_solved = True
        self.start = np.array(scene.starts[0], dtype=np.float64) if scene.starts else farthest_start(self.planner)

    @property
    def title(self) -> str:
        """Title of the scene."""
        return self.scene.title

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes of the configuration space: one per joint that moves."""
        return self.scene.axes

    @property
    def names(self) -> Sequence[str]:
        """Names of the joints that move."""
        return self.robot.moving

    @property
    def centre(self) -> NDArray[np.float64]:
        """Place (3,) in the middle of the view, in metres."""
        base: NDArray[np.float64] = self.robot.tree.placement[0, :3, 3]
        return base + _CENTRE * self.robot.reach

    @property
    def size(self) -> float:
        """Extent of the view in metres: the reach of the robot."""
        return self.robot.reach

    @property
    def handle_size(self) -> float:
        """Length of the arrows of a handle that drags start or goal, in metres."""
        return 0.2 * min(1.0, self.robot.reach)

    def places(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the places (n, 3) of the tool in the world, in metres, for configurations (n, ndim)."""
        return self.robot.reference_point(configurations)

    def set_goal(self, goal: NDArray[np.float64]) -> None:
        """Solve again with one goal configuration (ndim,) in place of all goals, without computing free cells again."""
        self.planner = plan(with_goal(self.planner.space, goal), self.wiring, k=self.k)

    def motion(self) -> Motion:
        """Return the shortened path from the start as a motion, with times if the joints have velocity limits.

        If no path reaches a goal, the motion stays at the start.
        """
        path = self.planner.path(self.start)
        if path.outcome is not Outcome.REACHED:
            return self.resting(failure_text(path))
        short: AnyPath = shortcut(path)
        clearance = workspace_clearance(short, self.scene.obstacles, step=_CLEARANCE_STEP)
        text = f"**reached** goal {path.goal}  \nclearance {clearance:.3f} m"
        try:
            timed = time_parameterize(short)
        except InputError:
            return self._untimed(short, text)
        times = np.linspace(0.0, timed.duration, _FRAMES)
        return Motion(timed.at(times)[0], times, True, f"{text}  \nduration {timed.duration:.2f} s")

    def _untimed(self, path: AnyPath, text: str) -> Motion:
        """Return a path without times as a motion; `text`: outcome and clearance, as Markdown."""
        travel = float(self.robot.travel(path.line[:-1], path.line[1:]).sum())
        poses = path.space.to_world(sample_path(path, travel / _FRAMES)[0] if travel else path.line)
        return Motion(poses, np.linspace(0.0, 1.0, len(poses)), False, text)

    def resting(self, text: str) -> Motion:
        """Return a motion that stays at the start; `text`: reason, as Markdown."""
        return Motion(np.stack([self.start, self.start]), np.array([0.0, 1.0]), False, text)

    def towards(self, near: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a configuration (ndim,) that brings the tool as close as possible to a place, by damped least squares.

        `near` (ndim,): configuration from which the iteration starts; `place` (3,): in the world, in metres. The result
        lies within the limits of the axes (Wampler 1986).
        """
        joints, step = near.copy(), 1e-6
        for _ in range(_ITERATIONS):
            poses = np.vstack([joints, joints + step * np.eye(len(joints))])
            tool = self.robot.reference_point(poses)
            error, jacobian = place - tool[0], (tool[1:] - tool[0]).T / step
            change = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING**2 * np.eye(3), error)
            joints = np.clip(joints + np.clip(change, -_LONGEST, _LONGEST), self.lower, self.upper)
            if np.abs(change).max() < 1e-5:
                break
        return joints


def farthest_start(planner: Planner) -> NDArray[np.float64]:
    """Return the centre (ndim,) of the goal-connected free cell with the highest potential, a start far from goals."""
    field = planner.field
    height = np.where(field.space.goal_connected & (field.space.cell == Cell.FREE), field.potential, -np.inf)
    return planner.space.centre(np.unravel_index(int(np.nanargmax(height)), height.shape))


def with_goal(space: ConfigurationSpace, goal: NDArray[np.float64]) -> ConfigurationSpace:
    """Return a space with a configuration (ndim,) in world coordinates as its single goal.

    Raises InputError if the goal lies in an obstacle cell.
    """
    cell = np.where(space.cell == Cell.GOAL, Cell.FREE, space.cell).astype(np.uint8)
    place = tuple(space.locate(goal).tolist())
    if cell[place] == Cell.OBSTACLE:
        raise InputError("the goal lies in a cell that is not proven free; move it")
    cell[place] = Cell.GOAL
    return ConfigurationSpace(
        space.axes, cell, space.conductivity, frame=space.frame, goal_points=[space.from_world(goal)],
        robot=space.robot, undecided=space.undecided,
    )  # fmt: skip


def require_arm(scene: Scene) -> URDFRobot:
    """Return the robot of a scene; raise InputError unless it is an arm from a URDF file."""
    if not isinstance(scene.robot, URDFRobot):
        raise InputError(
            "the 3-D view shows arms from URDF files, and points and balls in space, but the robot of this scene is "
            "neither; use live(scene), or draw(scene)"
        )
    return scene.robot


class Task(Protocol):
    """Interface of a solved space whose goal can change, and whose path can be shown.

    `goal` (ndim,): goal configuration, None for the goals of the scene; `is_solved`: whether the current field was
    solved for `goal`.
    """

    goal: NDArray[np.float64] | None
    is_solved: bool

    def set_goal(self, goal: NDArray[np.float64]) -> None:
        """Solve again for a single goal configuration (ndim,)."""

    def motion(self) -> Motion:
        """Return the path from the start as a motion."""

    def resting(self, text: str) -> Motion:
        """Return a motion that stays at the start; `text`: reason, as Markdown."""


def answer(task: Task, goal: NDArray[np.float64] | None) -> Motion:
    """Return the motion of a task to the goal configuration `goal` (ndim,), or for None to the goals that the task has.

    After an error of resgrid, the motion stays at the start and contains the message of the error.  A goal that caused
    an error is kept: the next call with None tries this goal again.
    """
    if goal is not None:
        task.goal, task.is_solved = goal, False
    try:
        if task.goal is not None and not task.is_solved:
            task.set_goal(task.goal)
            task.is_solved = True
        return task.motion()
    except ResgridError as error:
        return task.resting(f"**no path**  \n{error}")


def failure_text(path: Streamline | NodePath) -> str:
    """Return the outcome of a path that reaches no goal, with the reason, as Markdown."""
    reason = {
        Outcome.START_BLOCKED: "the start lies in a cell that is not proven free; move it",
        Outcome.NO_PATH: "no path through proven cells joins start and goal",
    }.get(path.outcome, path.reason or "no current flows at the start")
    return f"**{path.outcome.value.replace('_', ' ')}**  \n{reason}"
