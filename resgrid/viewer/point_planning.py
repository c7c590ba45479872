"""Planning for the 3-D view of a point or ball: paths after a move of the start or goal; no display code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.planning.pipeline import problem_of, require_uniform
from resgrid.planning.planner import Planner, plan
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.robots import PointRobot
from resgrid.scene.scene import Scene
from resgrid.viewer.planning import Motion, failure_text, farthest_start, with_goal

_FRAMES = 600
"""Number of equally spaced places along a path that the slider of the view shows, besides the points of the path."""

_BALL = 0.3
"""Smallest radius of the ball that shows the robot, as a multiple of the smallest cell width."""


class PointPlan:
    """A solved space of a point or a ball, whose start and goal can change.

    Parameters
    ----------
    planner : Planner
        The solved space, with three axes.
    wiring : Wiring
        Boundary conditions of the circuit.
    k : float or None
        Weight of the Dirichlet field of a blend; None without a blend.
    start : ndarray of float64, shape (3,), or None
        Start in world coordinates; None for a place far from the goals.
    title : str
        Title of the view.

    Attributes
    ----------
    start : ndarray of float64, shape (3,)
        Start in world coordinates.
    goal : ndarray of float64, shape (3,), or None
        Goal in world coordinates; None for the goals of the space.
    is_solved : bool
        Whether the current field was solved for `goal`; False after a goal in an obstacle cell.
    lower, upper : ndarray of float64, shape (3,)
        Corners of the grid, in axis units.
    """

    def __init__(
        self, planner: Planner, wiring: Wiring, k: float | None, start: NDArray[np.float64] | None, title: str
    ) -> None:
        self.planner, self.wiring, self.k, self.title = planner, wiring, k, title
        self.goal: NDArray[np.float64] | None = None
        self.is_solved = True
        self.start = farthest_start(planner) if start is None else start
        self.lower, self.upper = self.space.lower, self.space.upper

    @classmethod
    def of_scene(cls, scene: Scene, space: ConfigurationSpace | None) -> PointPlan:
        """Return the solved space of a scene; `space`: space of the scene, None to build it."""
        require_uniform(scene, "the 3-D view")
        problem = problem_of(scene, space=space)
        k = problem.ks[0] if problem.ks else None
        start = np.array(scene.starts[0], dtype=np.float64) if scene.starts else None
        return cls(plan(problem.space, problem.wiring, k=k), problem.wiring, k, start, scene.title)

    @classmethod
    def of_path(cls, path: Streamline) -> PointPlan:
        """Return a newly solved space of a path's field, with the first point of the path as start."""
        wiring, k = path.field.wiring, path.field.k
        blended = k if 0.0 < k < 1.0 else None
        return cls(plan(path.space, wiring, k=blended), wiring, blended, path.points[0], "")

    @property
    def space(self) -> ConfigurationSpace:
        """The configuration space with its current goal."""
        return self.planner.space

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes x, y and z."""
        return self.space.axes

    @property
    def names(self) -> Sequence[str]:
        """Names of the axes."""
        return [axis.name for axis in self.axes]

    @property
    def radius(self) -> float:
        """Radius of the ball that shows the robot, in axis units."""
        robot = self.space.robot
        own = robot.radius if isinstance(robot, PointRobot) else 0.0
        return max(own, _BALL * min(axis.spacing for axis in self.axes))

    @property
    def centre(self) -> NDArray[np.float64]:
        """Place (3,) in the middle of the view, in axis units."""
        return (self.lower + self.upper) / 2

    @property
    def size(self) -> float:
        """Extent of the view, in axis units: half the diagonal of the grid."""
        return float(np.linalg.norm(self.upper - self.lower)) / 2

    @property
    def handle_size(self) -> float:
        """Length of the arrows of a handle that drags start or goal, in axis units."""
        return max(0.12 * self.size, 2 * self.radius)

    def places(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the places (n, 3) of the robot in configurations (n, 3), which are the configurations themselves."""
        return configurations

    def towards(self, near: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:  # noqa: ARG002
        """Return the configuration (3,) inside the grid that is nearest to a dragged handle.

        `near` (3,): previous configuration, not used; `place` (3,): position of the handle in the world.
        """
        return np.clip(place, self.lower, self.upper)

    def set_goal(self, goal: NDArray[np.float64]) -> None:
        """Solve again for a single goal (3,); raise InputError if the goal lies in an obstacle."""
        self.planner = plan(with_goal(self.space, goal), self.wiring, k=self.k)

    def motion(self) -> Motion:
        """Return the path from the start as a motion at constant speed, without times in seconds.

        If no path reaches a goal, the motion stays at the start.
        """
        path = self.planner.path(self.start)
        if path.outcome is not Outcome.REACHED:
            return self.resting(failure_text(path))
        unit = self.axes[0].unit
        clearance = "no obstacle" if not np.isfinite(path.clearance) else f"clearance {path.clearance:.3g} {unit}"
        text = f"**reached** goal {path.goal}  \nlength {path.length:.4g} {unit}  \n{clearance}"
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.points, axis=0), axis=1))])
        if not along[-1]:
            return self.resting(text)
        fraction = np.linspace(0.0, 1.0, _FRAMES)
        every = np.unique(np.concatenate([fraction, along / along[-1]]))
        places = np.stack([np.interp(every, along / along[-1], column) for column in path.points.T], axis=1)
        return Motion(places, every, False, text)

    def resting(self, text: str) -> Motion:
        """Return a motion that stays at the start; `text`: reason, as Markdown."""
        return Motion(np.stack([self.start, self.start]), np.array([0.0, 1.0]), False, text)
