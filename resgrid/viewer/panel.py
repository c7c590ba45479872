"""Controls of the 3-D view: a slider along the path, a play button, and handles for start and goal."""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resgrid.viewer.ball_models import ROBOT_BALL, BallModel, add_voxels
from resgrid.viewer.models import END, ROBOT, START, ArmModel, add_ghosts, add_line, add_surroundings
from resgrid.viewer.planning import ArmPlan, Motion, answer
from resgrid.viewer.point_planning import PointPlan

if TYPE_CHECKING:
    import viser

_RATE = 30.0
"""Number of pictures of the moving robot per second while the motion plays."""

_UNTIMED_SECONDS = 5.0
"""Time in which a whole path without times is played, in seconds."""

_STEPS = 400
"""Number of steps of a slider from one end to the other."""

_PLAY, _PAUSE = "Play", "Pause"

Model = ArmModel | BallModel
"""A robot in the view that can be moved: an arm or a ball."""


class ControlPanel:
    """The controls of a 3-D view, and the threads that plan after changes and play the motion.

    `server`: server of viser; `task`: solved space with start and goal, which no other object may change; `motion`:
    displayed path; `robot`: model of the moving robot; `ghosts`: models at "start" and "goal".
    """

    def __init__(self, server: viser.ViserServer, task: ArmPlan | PointPlan) -> None:
        self.server, self.task = server, task
        self.motion: Motion = answer(task, None)
        self._closed, self._changed, self._playing = threading.Event(), threading.Event(), threading.Event()
        self._lock, self._display = threading.Lock(), threading.Lock()
        self._wanted: dict[str, NDArray[np.float64]] = {}
        self.robot, *ghosts = self._add_models()
        self.ghosts = dict(zip(("start", "goal"), ghosts, strict=True))
        self._add_controls()
        self._show_motion()
        self._threads = [
            threading.Thread(target=run, daemon=True, name=f"resgrid viewer {run.__name__}")
            for run in (self._plan_again, self._play)
        ]
        for thread in self._threads:
            thread.start()

    def _add_models(self) -> tuple[Model, Model, Model]:
        """Add the surroundings, and return the models of the moving robot and of the robot at start and at goal."""
        task, server = self.task, self.server
        if isinstance(task, PointPlan):
            add_voxels(server, task.space)
            return (
                BallModel(server, "robot", task.radius, ROBOT_BALL),
                BallModel(server, "start", task.radius, START),
                BallModel(server, "end", task.radius, END),
            )
        add_surroundings(server, task.scene, task.robot)
        return (ArmModel(server, task.robot, "robot", ROBOT), *add_ghosts(server, task.robot))

    def close(self) -> None:
        """End the threads that plan and play; the result of a computation that still runs is not shown."""
        with self._display:
            self._closed.set()
        self._changed.set()
        self._playing.set()

    def _add_controls(self) -> None:
        gui = self.server.gui
        gui.set_panel_label(self.task.title or "resgrid")
        self.status = gui.add_markdown("")
        self.slider: Any = gui.add_slider("along the path", 0.0, 1.0, 1.0 / _STEPS, 0.0)
        self.button = gui.add_button(_PLAY)
        self.slider.on_update(lambda _: self._show_pose())
        self.button.on_click(lambda _: self._toggle())
        end = self.motion.configurations[-1]
        self.joints, self.handles = {}, {}
        for which, pose in (("start", self.task.start), ("goal", end)):
            with gui.add_folder(which):
                self.joints[which] = [self._joint_slider(which, number, value) for number, value in enumerate(pose)]
            handle = self.server.scene.add_transform_controls(
                f"/{which}_handle", scale=self.task.handle_size, disable_rotations=True,
                disable_sliders=True, depth_test=False,
            )  # fmt: skip
            handle.on_update(partial(self._dragged, which))
            self.handles[which] = handle
            self._place(which, pose)
        visible = gui.add_checkbox("show start and goal", True)
        visible.on_update(lambda _: self._show_ends(visible.value))

    def _joint_slider(self, which: str, number: int, value: float) -> Any:
        """Return a new slider for one joint or coordinate.

        `which`: "start" or "goal"; `number`: index of the joint or coordinate; `value`: initial value, in axis units.
        """
        axis = self.task.axes[number]
        step = (axis.upper - axis.lower) / _STEPS
        slider = self.server.gui.add_slider(
            f"{self.task.names[number]} ({axis.unit})", axis.lower, axis.upper, step,
            float(np.clip(value, axis.lower, axis.upper)),
        )  # fmt: skip
        slider.on_update(partial(self._slid, which))
        return slider

    def _pose_of(self, which: str) -> NDArray[np.float64]:
        """Return the configuration (ndim,) that the sliders show; `which`: "start" or "goal"."""
        return np.array([slider.value for slider in self.joints[which]], dtype=np.float64)

    def _slid(self, which: str, event: Any) -> None:
        """Plan again after a user has moved a slider; ignore values that the program has set.

        `which`: "start" or "goal"; `event`: event of viser, whose `client_id` is None if the program set the value.
        """
        if event.client_id is not None:
            self._ask(which, self._pose_of(which))

    def _dragged(self, which: str, event: Any) -> None:
        """Move the start or the goal to the place of its handle when a drag of the handle ends.

        `which`: "start" or "goal"; `event`: event of viser.
        """
        if event.phase != "end":
            return
        place = np.asarray(self.handles[which].position, dtype=np.float64)
        self.set(which, self.task.towards(self._pose_of(which), place))

    def set(self, which: str, pose: NDArray[np.float64]) -> None:
        """Set the start or the goal, show it in its sliders, and plan again.

        `which`: "start" or "goal"; `pose` (ndim,): configuration.
        """
        self._write_sliders(which, pose)
        self._ask(which, pose)

    def _write_sliders(self, which: str, pose: NDArray[np.float64]) -> None:
        """Show a configuration `pose` (ndim,) in the sliders without planning again; `which`: "start" or "goal"."""
        for slider, value in zip(self.joints[which], pose, strict=True):
            slider.value = float(value)

    def _ask(self, which: str, pose: NDArray[np.float64]) -> None:
        """Request a path for a new start or goal.

        During a computation, a new start replaces a start that still waits, and a new goal a goal that still waits.
        `which`: "start" or "goal"; `pose` (ndim,): configuration.
        """
        self._place(which, pose)
        with self._lock:
            self._wanted[which] = pose
        self.status.content = "planning ..."
        self._changed.set()

    def _place(self, which: str, pose: NDArray[np.float64]) -> None:
        """Move the robot model and the handle of the start or the goal to a configuration.

        `which`: "start" or "goal"; `pose` (ndim,): configuration.
        """
        self.ghosts[which].move(pose)
        self.handles[which].position = self.task.places(pose.reshape(1, -1))[0]

    def _show_ends(self, visible: bool) -> None:
        for which in ("start", "goal"):
            self.ghosts[which].show(visible)
            self.handles[which].visible = visible

    def _plan_again(self) -> None:
        """Compute paths for requested starts and goals until the view is closed; runs in a thread."""
        while True:
            self._changed.wait()
            self._changed.clear()
            if self._closed.is_set():
                return
            with self._lock:
                wanted, self._wanted = self._wanted, {}
            if not wanted:
                continue
            if "start" in wanted:
                self.task.start = wanted["start"]
            motion = answer(self.task, wanted.get("goal"))
            with self._display:
                if not self._closed.is_set() and not self._changed.is_set():
                    self.motion = motion
                    self._show_motion()

    def _show_motion(self) -> None:
        """Show the path of the tool or the ball, the outcome, and the robot at the position of the slider."""
        add_line(self.server, self.task.places(self.motion.configurations))
        if self.task.goal is None:
            self._place("goal", self.motion.configurations[-1])
            self._write_sliders("goal", self.motion.configurations[-1])
        self._show_pose()
        self.status.content = self.motion.text

    def _show_pose(self) -> None:
        self.robot.move(self.motion.at(self.slider.value * self.motion.times[-1]))

    def _toggle(self) -> None:
        """Start to play the motion, or stop it."""
        if self._playing.is_set():
            self._playing.clear()
            return
        if self.slider.value >= 1.0:
            self.slider.value = 0.0
        self._playing.set()

    def _play(self) -> None:
        """Advance the slider along the path while the motion plays, until the view is closed; runs in a thread."""
        while True:
            self._playing.wait()
            began, first = time.monotonic(), self.slider.value
            while self._playing.is_set():
                duration = self.motion.times[-1] if self.motion.is_timed else _UNTIMED_SECONDS
                with self._display:
                    if self._closed.is_set():
                        return
                    self.button.label = _PAUSE
                    self.slider.value = min(first + (time.monotonic() - began) / max(duration, 1e-3), 1.0)
                    if self.slider.value >= 1.0:
                        self._playing.clear()
                time.sleep(1.0 / _RATE)
            with self._display:
                if not self._closed.is_set():
                    self.button.label = _PLAY
