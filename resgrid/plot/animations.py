"""Animations: a robot under control, the wavefront of a new obstacle; written as GIF or MP4, whole or not at all."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import IO, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.control.fronts import Wavefront
from resgrid.control.log import Mode, Run
from resgrid.errors import InputError, ToolMissingError
from resgrid.files import atomic_path
from resgrid.plot.control import (
    FORCE,
    LEARNT,
    MODES,
    bodies_of,
    dress_workspace,
    plot_run_configurations,
    seam_shifts,
    thinned,
    wrapped,
    zoom,
)
from resgrid.plot.control_maps import draw_wavefront
from resgrid.plot.fields import add_colour_bar
from resgrid.plot.figures import new_figure
from resgrid.plot.robots import plot_robot_path
from resgrid.plot.style import SMALL, TEXT, refresh_legend
from resgrid.robots import Arm
from resgrid.scene.scene import Scene

ANIMATIONS = (".gif", ".mp4")
MOST_FRAMES = 600
_DPI = 100
_HELD = 12

Frame = NDArray[np.uint8]
"""A picture of shape (height, width, 3)."""


def save_animation(
    frames: Iterable[Frame],
    path: str | os.PathLike[str],
    *,
    rate: float = 20.0,
    progress: Callable[[int], object] | None = None,
) -> Path:
    """Write an animation.

    Parameters
    ----------
    frames : iterable of ndarray of uint8, shape (height, width, 3)
        Drawn one by one as they are written; at most `MOST_FRAMES`.
    path : path-like
        Its suffix, ``.gif`` or ``.mp4``, says the format; MP4 needs ffmpeg.
    rate : float
        Frames a second.
    progress : callable, optional
        Told how many frames are drawn.

    Returns
    -------
    Path
        The path.  An interruption leaves no file behind.

    Raises
    ------
    InputError
        If the suffix is unknown, there is no frame or there are too many, or the path cannot be written.
    ToolMissingError
        If ffmpeg is asked for and not installed.
    """
    write = _writer(path)
    if not 0 < rate <= 100:
        raise InputError(f"rate = {rate}, but an animation shows more than 0 and at most 100 frames a second")
    with atomic_path(path) as temporary:
        write(_counted(frames, progress), temporary, rate)
    return Path(path)


def check_animation(path: str | os.PathLike[str]) -> None:
    """Refuse a file that no animation can be written to, before anything is drawn; errors as `save_animation`."""
    _writer(path)


def _writer(path: str | os.PathLike[str]) -> Callable[[Iterator[Frame], Path, float], None]:
    suffix = Path(path).suffix.lower()
    if suffix == ".gif":
        return _write_gif
    if suffix != ".mp4":
        raise InputError(f"cannot write an animation as {str(path)!r}: its suffix must be {' or '.join(ANIMATIONS)}")
    if shutil.which("ffmpeg") is None:
        raise ToolMissingError("MP4 needs ffmpeg, which is not installed; install it, or name the file .gif")
    return _write_mp4


def _counted(frames: Iterable[Frame], progress: Callable[[int], object] | None) -> Iterator[Frame]:
    number = 0
    for number, frame in enumerate(frames, 1):
        if number > MOST_FRAMES:
            raise InputError(f"an animation has at most {MOST_FRAMES} frames; show fewer")
        yield frame
        if progress is not None:
            progress(number)
    if not number:
        raise InputError("an animation needs at least one frame")


def _write_gif(frames: Iterator[Frame], path: Path, rate: float) -> None:
    from PIL import Image

    def picture(frame: Frame) -> Image.Image:
        return Image.fromarray(frame).quantize(128, dither=Image.Dither.NONE)

    first = next(frames)
    rest = (picture(frame) for frame in frames)
    duration = max(round(100 / rate), 1) * 10
    with path.open("wb") as file:
        picture(first).save(file, format="GIF", save_all=True, append_images=rest, duration=duration, loop=0)


def _write_mp4(frames: Iterator[Frame], path: Path, rate: float) -> None:
    first = next(frames)
    height, width = first.shape[:2]
    words = [
        "ffmpeg", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", f"{rate:g}", "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p",
        "-f", "mp4", str(path),
    ]  # fmt: skip
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stdin is not None
        complaint = _feed(process, process.stdin, chain([first], frames))
    except BaseException:
        process.kill()
        process.wait()
        raise
    if process.returncode:
        raise InputError(f"ffmpeg could not write {path.name}: {complaint.strip() or 'no reason given'}")


def _feed(process: subprocess.Popen[bytes], pipe: IO[bytes], frames: Iterator[Frame]) -> str:
    try:
        for frame in frames:
            pipe.write(np.ascontiguousarray(frame).tobytes())
    except BrokenPipeError:
        pass  # it says why on its standard error
    return process.communicate()[1].decode(errors="replace")


def run_frames(run: Run, scene: Scene, *, count: int = 120) -> Iterator[Frame]:
    """Pictures of a controlled motion: workspace with contact forces, configuration space, the mode's name.

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
    figure = new_figure(8.6 if flat else 4.6, 5.0)
    figure.set_dpi(_DPI)
    left = figure.add_subplot(1, 2, 1) if flat else figure.add_subplot()
    moving: list[_WorkspaceArtists | _ConfigurationArtists] = [_WorkspaceArtists(run, scene, left)]
    if flat:
        moving.append(_ConfigurationArtists(run, scene, figure.add_subplot(1, 2, 2)))
    _settle_layout(figure)
    for row in frame_rows(run, count).tolist():
        for artists in moving:
            artists.show(row)
        mode = Mode(run.mode[row]).name.lower()
        figure.suptitle(f"{run.time[row]:.2f} s: {mode}", fontsize=TEXT + 2, color=MODES[Mode(run.mode[row])][0])
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
        plot_robot_path(
            thinned(run.configuration)[:1], scene.robot, run.space, (*known, *hidden), goals, axes, ghosts=1
        )
        dress_workspace(scene, hidden, axes)
        zoom(run, scene, axes)
        axes.plot([], [], color=FORCE, linewidth=2, label="contact force")
        refresh_legend(axes)
        self._outlines = list[Any]()
        contacts = run.contacts
        self._unit = 0.12 * float(np.abs(np.diff(axes.get_xlim()))[0])
        self._largest = float(np.hypot(*contacts.force.T).max()) if len(contacts.step) else 1.0

    def show(self, row: int) -> None:
        for artist in self._outlines:
            artist.remove()
        self._outlines.clear()
        robot, pose = self._scene.robot, self._run.configuration[row]
        if isinstance(robot, Arm):
            joints = robot.joints(pose)
            self._outlines += self._axes.plot(*joints.T, color="#0072B2", linewidth=3, marker="o", zorder=8)
        for shape in robot.shapes_at(pose):
            for part in getattr(shape, "geoms", [shape]) if shape.area else ():
                self._outlines += self._axes.fill(*part.exterior.xy, color="#0072B2", alpha=0.6, zorder=7.5)
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
        (self._place,) = axes.plot([], [], "o", color="black", markersize=5, zorder=6)
        self._ways = [axes.plot([], [], color="#0072B2", linewidth=1.4, zorder=4)[0] for _ in seam_shifts(run.space)]
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
    places = None if run is None else _places(front, run)
    for row in range(len(front.cells)):
        figure = new_figure(5.2, 4.9)
        axes = figure.add_subplot()
        draw_wavefront(front, row, axes)
        add_colour_bar(axes.images[0], axes, r"change of $\phi$")
        if places is not None:
            axes.plot(*places[: row + 1].T, color="black", linewidth=0, marker=".", markersize=2, zorder=5)
            axes.plot(*places[row : row + 1].T, "o", color="black", markersize=6, zorder=6, label="robot")
        refresh_legend(axes)
        axes.title.set_fontsize(SMALL + 1)
        yield _drawn(figure)


def _places(front: Wavefront, run: Run) -> NDArray[np.float64]:
    """Where the robot was at the times of a wavefront."""
    speeds = np.linalg.norm(run.velocity, axis=1)
    seconds = front.cells * float(front.after.spacing.min()) / max(float(speeds.max()), 1e-300)
    rows = np.searchsorted(run.time, seconds).clip(0, len(run.time) - 1)
    return wrapped(run.configuration[rows], run.space)


def _settle_layout(figure: Figure) -> None:
    """Lay out once, for a picture whose axes move from frame to frame cannot be watched."""
    figure.suptitle(" ", fontsize=TEXT + 2)
    figure.canvas.draw()
    figure.set_layout_engine("none")


def _drawn(figure: Figure) -> Frame:
    figure.set_dpi(_DPI)
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]
