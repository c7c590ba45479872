"""Animations: a robot under control, the wavefront of a new obstacle; pictures one by one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.control.log import Mode, Run
from resgrid.control.relaxation import Wavefront
from resgrid.errors import InputError
from resgrid.planning.streamline import Polyline
from resgrid.plot.control import (
    FORCE,
    LEARNT,
    MODES,
    bodies_of,
    dress_workspace,
    mark_start,
    panel_aspect,
    plot_run_configurations,
    seam_shifts,
    wrapped,
    zoom,
)
from resgrid.plot.control_maps import add_change_bar, draw_change, draw_wavefront
from resgrid.plot.figures import new_figure, panel_height
from resgrid.plot.films import MOST_FRAMES, Frame
from resgrid.plot.plane import plane_of
from resgrid.plot.robots import plot_robot_path, skeleton
from resgrid.plot.style import TEXT, refresh_legend
from resgrid.scene.scene import Scene

ROBOT = "#0072B2"
MODE_WORDS = {
    Mode.STREAMLINE: "follows its streamline",
    Mode.PUSHED: "is pushed",
    Mode.SLIDING: "slides along an obstacle",
    Mode.STICKING: "touches an obstacle and sticks",
    Mode.FOLLOWING: "follows the equipotential along an obstacle",
    Mode.JAM: "is jammed: the force lies along the streamline",
    Mode.LEARNING: "learns what it touched",
    Mode.RETREATING: "goes back the way it came",
    Mode.RECOVERING: "leaves an obstacle cell",
    Mode.DITHERING: "shakes itself loose",
    Mode.WAITING: "waits for the grid to settle",
    Mode.ARRIVED: "has arrived",
}
_DPI = 100
_HELD = 12
_PANEL = 3.6


def run_frames(run: Run, scene: Scene, *, count: int = 120) -> Iterator[Frame]:
    """Pictures of a controlled motion: workspace with contact forces, configuration space, what the robot does.

    Parameters
    ----------
    run : Run
    scene : Scene
        The one that it was simulated in.
    count : int
        How many, evenly in time, 2 to `MOST_FRAMES`; the last one is held for a moment.

    Yields
    ------
    ndarray of uint8, shape (height, width, 3)

    Raises
    ------
    InputError
        If the count is out of range.
    """
    if not 2 <= count <= MOST_FRAMES - _HELD:
        raise InputError(f"count = {count}, but an animation has 2 to {MOST_FRAMES - _HELD} frames")
    flat = run.space.ndim == 2
    figure = new_figure(8.6 if flat else 4.6, panel_height(_PANEL, panel_aspect(run.space, scene)) + 0.4)
    left = figure.add_subplot(1, 2, 1) if flat else figure.add_subplot()
    moving: list[_WorkspaceArtists | _ConfigurationArtists] = [_WorkspaceArtists(run, scene, left)]
    if flat:
        moving.append(_ConfigurationArtists(run, scene, figure.add_subplot(1, 2, 2)))
    figure.suptitle(" ", fontsize=TEXT + 2)
    _settle_layout(figure)
    for row in frame_rows(run, count).tolist():
        for artists in moving:
            artists.show(row)
        mode = Mode(run.mode[row])
        figure.suptitle(f"{run.time[row]:.2f} s: the robot {MODE_WORDS[mode]}", fontsize=TEXT + 2, color=MODES[mode][0])
        frame = _drawn(figure)
        yield frame
    for _ in range(_HELD):
        yield frame


def frame_rows(run: Run, count: int) -> NDArray[np.int64]:
    """Rows of a log, evenly in time, with the last one and every lesson's."""
    times = np.linspace(run.time[0], run.time[-1], count)
    rows = np.searchsorted(run.time, times).clip(0, len(run.time) - 1)
    lessons = [lesson.step for lesson in run.lessons][:count]
    return np.unique([*rows.tolist(), *lessons, len(run.time) - 1])[: MOST_FRAMES - _HELD]


class _WorkspaceArtists:
    """What moves in the workspace."""

    def __init__(self, run: Run, scene: Scene, axes: Axes) -> None:
        self._run, self._scene, self._axes = run, scene, axes
        known, hidden, goals = bodies_of(scene)
        begin = Polyline(run.configuration[:1], run.space)
        plot_robot_path(begin, scene.robot, run.space, (*known, *hidden), goals, axes, ghosts=1)
        dress_workspace(scene, hidden, axes)
        zoom(run, scene, axes)
        self._tips = scene.robot.reference_point(run.configuration)
        (self._way,) = axes.plot([], [], color=ROBOT, linewidth=1.0, alpha=0.7, zorder=4)
        mark_start(self._tips[0], axes)
        axes.plot([], [], color=ROBOT, linewidth=0, marker="o", label="robot")
        contacts = run.contacts
        if len(contacts.step):
            axes.plot([], [], color=FORCE, linewidth=2, label="contact force")
        refresh_legend(axes)
        self._outlines = list[Any]()
        self._unit = 0.12 * float(np.abs(np.diff(axes.get_xlim()))[0])
        self._largest = float(np.hypot(*contacts.force.T).max()) if len(contacts.step) else 1.0

    def show(self, row: int) -> None:
        for artist in self._outlines:
            artist.remove()
        self._outlines.clear()
        self._way.set_data(*self._tips[: row + 1].T)
        robot, pose = self._scene.robot, self._run.configuration[row]
        bodies = [shape for shape in robot.shapes_at(pose) if shape.area]
        joints = skeleton(robot, pose)
        if len(joints):
            self._outlines += self._axes.plot(*joints.T, color=ROBOT, linewidth=3, marker="o", zorder=8)
        elif not bodies:
            self._outlines += self._axes.plot(*self._tips[row], color=ROBOT, marker="o", markersize=7, zorder=8)
        for shape in bodies:
            for part in getattr(shape, "geoms", [shape]):
                self._outlines += self._axes.fill(*part.exterior.xy, color=ROBOT, alpha=0.6, zorder=7.5)
        contacts = self._run.contacts
        for number in np.flatnonzero(contacts.step == row).tolist():
            tail, force = contacts.point[number], contacts.force[number] * (self._unit / self._largest)
            self._outlines += self._axes.plot(*np.stack([tail, tail + force]).T, color=FORCE, linewidth=2, zorder=9)
            self._outlines += self._axes.plot(*tail, "o", color=FORCE, markersize=4, zorder=9)


class _ConfigurationArtists:
    """What moves in a configuration space of two axes."""

    def __init__(self, run: Run, scene: Scene, axes: Axes) -> None:
        self._run, self._axes = run, axes
        plot_run_configurations(run, scene, axes, way=False)
        mark_start(wrapped(run.configuration[0], run.space), axes)
        (self._place,) = axes.plot([], [], "o", color=ROBOT, markersize=5, zorder=6, label="robot")
        self._ways = [axes.plot([], [], color=ROBOT, linewidth=1.4, zorder=4)[0] for _ in seam_shifts(run.space)]
        self._cells = axes.scatter([], [], s=5, facecolor="none", edgecolor=LEARNT, linewidth=0.6, zorder=3)
        if run.lessons:
            axes.scatter([], [], s=9, facecolor="none", edgecolor=LEARNT, linewidth=0.6, label="cell learnt")
        refresh_legend(axes)

    def show(self, row: int) -> None:
        run = self._run
        way = run.configuration[: row + 1]
        for line, by in zip(self._ways, seam_shifts(run.space), strict=True):
            line.set_data(*(way + by).T)
        place = wrapped(way[-1], run.space)
        self._place.set_data(place[:1], place[1:])
        self._place.set_color(MODES[Mode(run.mode[row])][0])
        cells = [lesson.cells for lesson in run.lessons if lesson.step <= row]
        if cells:
            self._cells.set_offsets(run.space.centre(np.concatenate(cells)))


def wavefront_frames(front: Wavefront, run: Run | None = None) -> Iterator[Frame]:
    """Pictures of a change of the map that spreads through the grid, one for each of its times.

    Parameters
    ----------
    front : Wavefront
        Of a space with two axes.
    run : Run, optional
        A robot that moved meanwhile, at its nominal speed; its place is marked.

    Yields
    ------
    ndarray of uint8, shape (height, width, 3)

    Raises
    ------
    InputError
        If there are too many times, or the space does not have two axes.
    """
    if len(front.cells) > MOST_FRAMES:
        raise InputError(f"{len(front.cells)} times, but an animation has at most {MOST_FRAMES} frames")
    figure = new_figure(5.2, panel_height(_PANEL, plane_of(front.after).aspect) + 0.2)
    axes = figure.add_subplot()
    image = draw_wavefront(front, 0, axes)
    aspect = axes.get_aspect()
    add_change_bar(image, axes)
    places = np.full((len(front.cells), 2), np.nan) if run is None else _places(front, run)
    (trail,) = axes.plot([], [], color="black", linewidth=0, marker=".", markersize=2, zorder=5)
    (robot,) = axes.plot([], [], "o", color="black", markersize=6, zorder=6, label="robot" if run else "")
    if run is not None:
        mark_start(places[0], axes)
    refresh_legend(axes)
    _settle_layout(figure)
    image.set_visible(False)
    for row in range(len(front.cells)):
        later = draw_change(front, row, axes)
        axes.set_aspect(aspect)
        trail.set_data(*places[: row + 1].T)
        robot.set_data(*places[row : row + 1].T)
        yield _drawn(figure)
        later.remove()


def _places(front: Wavefront, run: Run) -> NDArray[np.float64]:
    """Where the robot was at the times of a wavefront."""
    speeds = np.linalg.norm(run.velocity, axis=1)
    seconds = front.cells * float(front.after.spacing.min()) / max(float(speeds.max()), 1e-300)
    rows = np.searchsorted(run.time, seconds).clip(0, len(run.time) - 1)
    return wrapped(run.configuration[rows], run.space)


def _settle_layout(figure: Figure) -> None:
    """Lay out once, for a picture whose axes move from frame to frame cannot be watched."""
    figure.set_dpi(_DPI)
    for _ in range(2):  # axes of a fixed aspect find their place in two rounds
        figure.canvas.draw()
    figure.set_layout_engine("none")


def _drawn(figure: Figure) -> Frame:
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]
