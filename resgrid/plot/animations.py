"""Animations of controlled runs, trajectories of arms, and map changes that spread through the grid (wavefronts).

The files are GIF with one palette for all frames, or MP4 by ffmpeg.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from resgrid._internal.files import atomic_path
from resgrid.control.run_log import ControlMode, Run
from resgrid.control.wavefronts import Wavefront
from resgrid.errors import InputError, ToolMissingError
from resgrid.planning.time_parameterization import Trajectory
from resgrid.plot.arm_animations import arm_frames
from resgrid.plot.arms import is_in_space
from resgrid.plot.control import (
    FORCE,
    MODES,
    add_change_bar,
    draw_change,
    draw_configurations,
    draw_forces,
    draw_lessons,
    draw_moment,
    panel_aspect,
    scene_of,
)
from resgrid.plot.figures import FRAME_DPI, new_figure, panel_height, settle_layout
from resgrid.plot.plane import plane_of, seam_shifts, wrapped
from resgrid.plot.style import TEXT, mark, refresh_legend
from resgrid.plot.workspace import draw_pose, draw_robot
from resgrid.scene.scene import Scene

ROBOT = "#0072B2"
SUFFIXES = (".gif", ".mp4")
MOST_FRAMES = 600
"""Largest number of frames of an animation; more frames raise InputError."""
_COLOURS = 255
"""Largest number of colours in the palette of a GIF."""
_HELD = 12
"""Number of additional frames that repeat the last picture at the end of the animation of a run or a trajectory."""

_PANEL = 3.6
"""Width of a panel of an animation, in inches."""


def animate(
    value: Run | Wavefront | Trajectory,
    file: str | os.PathLike[str],
    *,
    run: Run | None = None,
    scene: Scene | None = None,
    count: int = 120,
    rate: float = 20.0,
    progress: Callable[[int], object] | None = None,
) -> Path:
    """Write an animation of a controlled run, of an arm along a trajectory, or of a map change spreading in the grid.

    Parameters
    ----------
    value : Run, Trajectory or Wavefront
        A run is shown in its workspace with contact forces and, if its space has two axes, also in configuration space;
        the title states the control mode.  A trajectory of an arm in space is shown among the obstacles of `scene`.  A
        wavefront must have a space with two axes, and is shown at each of its times.
    file : path-like
        The suffix ``.gif`` or ``.mp4`` selects the format; MP4 needs ffmpeg.  The file is written atomically.
    run : Run, optional
        For a wavefront: run of a robot whose position at the time of the frame is marked in each frame; by default no
        robot is shown.
    scene : Scene, optional
        For a trajectory, and required there: scene with the arm and its obstacles.
    count : int
        Number of frames of a run or a trajectory, 2 to 588, evenly spaced in time; the last frame is repeated 12 times.
        A run has further frames at the steps in which control learns obstacles.  Ignored for a wavefront.
    rate : float
        Frames per second, at most 100.
    progress : callable, optional
        Called after each frame with the number of frames so far.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the suffix is unknown, a number is out of range, or the file cannot be written.
    ToolMissingError
        If the file is an MP4 and ffmpeg is not installed.

    Examples
    --------
    >>> run = rg.simulation(rg.read_scene("examples/scenes/lesson.toml"), k=0.9).run()
    >>> rg.animate(run, "run.gif", count=2, rate=1.0).name
    'run.gif'
    """
    if not 0 < rate <= 100:
        raise InputError(f"rate = {rate} must be above 0 and at most 100 frames per second")
    writer = _writer(file, rate)
    frames = _frames(value, count, run, scene)
    with atomic_path(file) as temporary:
        figure = next(frames)
        try:
            with writer.saving(figure, str(temporary), FRAME_DPI):
                for number, _ in enumerate(chain([figure], frames), 1):
                    writer.grab_frame()
                    if progress is not None:
                        progress(number)
        except CalledProcessError as error:
            raise InputError(f"ffmpeg could not write {Path(file).name}: {error.stderr.strip()}") from error
    return Path(file)


def _frames(value: Run | Wavefront | Trajectory, count: int, run: Run | None, scene: Scene | None) -> Iterator[Figure]:
    """Return an iterator over the figures of an animation's frames; no file is written.

    `count`: number of frames of a run or a trajectory; `run`: motion of the robot that is marked on a wavefront, None
    for no robot; `scene`: scene with the arm of a trajectory and its obstacles.
    """
    if isinstance(value, Wavefront):
        return _wavefront_frames(value, run)
    if not 2 <= count <= MOST_FRAMES - _HELD:
        raise InputError(f"count = {count} must lie between 2 and {MOST_FRAMES - _HELD}: it is the number of frames")
    if isinstance(value, Run):
        return _run_frames(value, count)
    if scene is None or not is_in_space(scene):
        raise InputError("an animation of a trajectory needs the scene of an arm in space: give scene")
    return arm_frames(value, scene, count, _HELD)


def check_animation(path: str | os.PathLike[str]) -> None:
    """Raise InputError for an unknown suffix of an animation file, or ToolMissingError for an MP4 without ffmpeg."""
    _writer(path, 20.0)


def _writer(path: str | os.PathLike[str], rate: float) -> AbstractMovieWriter:
    """Return the animation writer that the suffix of `path` selects; `rate`: frames per second."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"cannot write an animation as {str(path)!r}: its suffix must be {' or '.join(SUFFIXES)}")
    if suffix == ".gif":
        return _GifWriter(fps=rate)  # type: ignore[arg-type]
    if not FFMpegWriter.isAvailable():
        raise ToolMissingError("MP4 needs ffmpeg, which is not installed; install it, or write a .gif file")
    return FFMpegWriter(fps=rate, codec="h264")  # type: ignore[arg-type]


class _GifWriter(PillowWriter):
    """GIF writer with one palette for all frames, so that colours do not change between frames."""

    _frames: list[Image.Image]

    def grab_frame(self, **_: Any) -> None:
        """Append the figure to the frames; redraw the figure only if it changed (`savefig` would draw it twice)."""
        canvas = self.fig.canvas
        assert isinstance(canvas, FigureCanvasAgg)
        if self.fig.stale:
            canvas.draw()  # type: ignore[no-untyped-call]
        self._frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Choose the palette from the colours of all frames, and write the frames."""
        if not self._frames:
            return
        colours, number_of = _palette(map(_packed, self._frames))

        def in_palette(frame: Image.Image) -> Image.Image:
            picture = Image.fromarray(number_of[_packed(frame)])
            picture.putpalette(colours.tobytes())
            return picture

        first, *rest = map(in_palette, self._frames)
        duration = max(round(100 / self.fps), 1) * 10
        first.save(self.outfile, format="GIF", save_all=True, append_images=rest, duration=duration, loop=0)


def _packed(frame: Image.Image) -> NDArray[np.uint32]:
    """Return the RGB colours of the pixels of a frame as integers ``0xRRGGBB``, shape (height, width)."""
    red, green, blue = np.moveaxis(np.asarray(frame, dtype=np.uint32), -1, 0)
    return np.asarray(red << 16 | green << 8 | blue)


def _palette(frames: Iterator[NDArray[np.uint32]]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a palette of at most 255 colours, and the palette index of the nearest colour for every colour.

    Half of the palette are the most frequent colours, counted over the pixels that change between frames; each of the
    others is the colour with the largest distance, in RGB coordinates, from all colours chosen before.  `frames`:
    colours (height, width) as integers ``0xRRGGBB``.  Returns the palette (n, 3), RGB from 0 to 255, and the palette
    index of every colour, shape (2**24,), indexed by the colour's integer; 0 for colours that no frame contains.
    """
    from scipy.spatial import KDTree

    counts = Counter[int]()
    last: NDArray[np.uint32] | None = None
    for frame in frames:
        values, number = np.unique(frame if last is None else frame[frame != last], return_counts=True)
        counts.update(dict(zip(values.tolist(), number.tolist(), strict=True)))
        last = frame
    seen = np.array([colour for colour, _ in counts.most_common()], dtype=np.uint32)
    points = np.stack([seen >> 16, seen >> 8 & 255, seen & 255], axis=1).astype(np.float64)
    chosen = list(range(min(len(seen), _COLOURS // 2)))
    distance = np.asarray(KDTree(points[chosen]).query(points)[0])
    while len(chosen) < _COLOURS and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    number_of = np.zeros(1 << 24, dtype=np.uint8)
    number_of[seen] = KDTree(points[chosen]).query(points)[1]
    return points[chosen].astype(np.uint8), number_of


def _run_frames(run: Run, count: int) -> Iterator[Figure]:
    """Yield the figure of a run (simulated motion of a robot under control), redrawn for each frame.

    `count`: number of frames, 2 to 588, without repetitions of the last one.
    """
    flat = run.space.ndim == 2
    figure = new_figure(8.6 if flat else 4.6, panel_height(_PANEL, panel_aspect(run)) + 0.4)
    panels = [_workspace(run, figure.add_subplot(1, 1 + flat, 1))]
    if flat:
        panels.append(_configurations(run, figure.add_subplot(1, 2, 2)))
    figure.suptitle(" ", fontsize=TEXT + 2)
    settle_layout(figure)
    for row in frame_rows(run, count).tolist():
        colour, _, does = MODES[ControlMode(run.mode[row])]
        figure.suptitle(f"{run.time[row]:.2f} s: the robot {does}", fontsize=TEXT + 2, color=colour)
        moving = [artist for panel in panels for artist in panel(row)]
        yield figure
        for _ in range(_HELD if row == len(run.time) - 1 else 0):
            yield figure
        for artist in moving:
            artist.remove()


def frame_rows(run: Run, count: int) -> NDArray[np.int64]:
    """Return the row indices (n,) of a run's log that are shown as frames, ascending.

    The rows are those of `count` evenly spaced times, the last row, and the rows of the first `count` lessons (steps in
    which control adds obstacle cells to its map).  Later lessons are left out if there would be more than 588 frames.
    """
    times = np.linspace(run.time[0], run.time[-1], count)
    rows = np.searchsorted(run.time, times).clip(0, len(run.time) - 1)
    rows[-1] = len(run.time) - 1
    spaced = np.unique(rows)
    lessons = np.unique([lesson.step for lesson in run.lessons][:count]).astype(np.int64)
    extra = np.setdiff1d(lessons, spaced)[: MOST_FRAMES - _HELD - len(spaced)]
    return np.union1d(spaced, extra)


def _workspace(run: Run, axes: Axes) -> Callable[[int], list[Artist]]:
    """Draw the parts of a workspace that do not move; return a function that draws the moving parts of one frame.

    The function takes the index of a row of the run's log, draws the robot, the path of its reference point so far and
    the contact forces, and returns the matplotlib artists.  `axes`: matplotlib axes to draw on.
    """
    robot, contacts = scene_of(run).robot, run.contacts
    draw_robot(run.configuration[:1], scene_of(run), axes, ghosts=1)
    tips = robot.reference_point(run.configuration)
    mark(tips[:1], axes, "start")
    axes.plot([], [], color=ROBOT, linewidth=0, marker="o", label="robot")
    if len(contacts.step):
        axes.plot([], [], color=FORCE, linewidth=2, label="contact force")
    refresh_legend(axes)

    def at(row: int) -> list[Artist]:
        moving: list[Artist] = [*axes.plot(*tips[: row + 1].T, color=ROBOT, linewidth=1.0, alpha=0.7, zorder=4)]
        body = draw_pose(robot, run.configuration[row], axes, ROBOT)
        touches = draw_forces(contacts, np.flatnonzero(contacts.step == row), axes)
        return moving + (body or axes.plot(*tips[row], color=ROBOT, marker="o", markersize=7, zorder=8)) + touches

    return at


def _configurations(run: Run, axes: Axes) -> Callable[[int], list[Artist]]:
    """Draw a configuration space of two axes; return a function that draws the moving parts of one frame.

    The function takes the index of a row of the run's log, draws the robot's position, the path so far and learnt
    cells, and returns their matplotlib artists.  `axes`: matplotlib axes to draw on.
    """
    draw_configurations(run, axes, path=False)
    mark(wrapped(run.configuration[:1], run.space), axes, "start")
    axes.plot([], [], "o", color=ROBOT, markersize=5, label="robot")
    if run.lessons:
        draw_lessons(np.empty((0, 2)), axes)
    refresh_legend(axes)

    def at(row: int) -> list[Artist]:
        path, colour = run.configuration[: row + 1], MODES[ControlMode(run.mode[row])][0]
        moving: list[Artist] = [*axes.plot(*wrapped(path[-1:], run.space).T, "o", color=colour, markersize=5, zorder=9)]
        for shift in seam_shifts(run.space):
            moving += axes.plot(*(path + shift).T, color=ROBOT, linewidth=1.4, zorder=4)
        cells = [lesson.cells for lesson in run.lessons if lesson.step <= row]
        if cells:
            moving.append(draw_lessons(run.space.centre(np.concatenate(cells)), axes))
        return moving

    return at


def _wavefront_frames(front: Wavefront, run: Run | None) -> Iterator[Figure]:
    """Yield the figure of a wavefront (spread of a map change through the grid), redrawn for each of its times.

    `run`: motion of a robot whose position and path until each time are drawn, None for no robot.
    """
    if len(front.cells) > MOST_FRAMES:
        raise InputError(
            f"the wavefront has {len(front.cells)} times, but an animation has at most {MOST_FRAMES} frames; "
            "compute it at fewer times"
        )
    figure = new_figure(5.2, panel_height(_PANEL, plane_of(front.after).aspect) + 0.2)
    axes = figure.add_subplot()
    image = draw_moment(front, 0, axes)
    add_change_bar(image, axes)
    image.set_visible(False)
    places = None if run is None else _places(front, run)
    if places is not None:
        mark(places[:1], axes, "start")
        axes.plot([], [], "o", color="black", markersize=6, label="robot")
    refresh_legend(axes)
    settle_layout(figure)
    for row in range(len(front.cells)):
        moving: list[Artist] = [draw_change(front, row, axes)]
        if places is not None:
            moving += axes.plot(*places[: row + 1].T, ".", color="black", markersize=2, zorder=5)
            moving += axes.plot(*places[row], "o", color="black", markersize=6, zorder=9)
        yield figure
        for artist in moving:
            artist.remove()


def _places(front: Wavefront, run: Run) -> NDArray[np.float64]:
    """Return the robot's positions (times, 2) in world coordinates at the times of a wavefront.

    Time n of a wavefront is the time in which the robot, at the largest speed in the log `run`, crosses n of the
    shortest cell widths.
    """
    speeds = np.linalg.norm(run.velocity, axis=1)
    seconds = front.cells * float(front.after.spacing.min()) / max(float(speeds.max()), 1e-300)
    rows = np.searchsorted(run.time, seconds).clip(0, len(run.time) - 1)
    return wrapped(run.configuration[rows], run.space)
