"""Pictures of controlled motion: workspace with contact forces, configuration space with modes and lessons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.control.log import ContactLog, Ending, Mode, Run
from resgrid.control.plant import plant_of
from resgrid.errors import InputError
from resgrid.plot.figures import PAGE, add_title, caption_height, new_figure, panel_height
from resgrid.plot.panels import draw_space
from resgrid.plot.plane import paint_cells, plane_of, seam_shifts, wrapped
from resgrid.plot.style import FAILURE, PATHS, TEXT, mark, refresh_legend
from resgrid.plot.workspace import draw_robot
from resgrid.scene.scene import Scene
from resgrid.space import Cell

MODES: dict[Mode, tuple[str, Any, str]] = {
    Mode.STREAMLINE: ("#0072B2", "-", "follows its streamline"),
    Mode.PUSHED: ("#CC79A7", "-", "is pushed"),
    Mode.SLIDING: ("#D55E00", "-", "slides along an obstacle"),
    Mode.STICKING: (FAILURE, "-", "touches an obstacle and sticks"),
    Mode.FOLLOWING: ("#E69F00", "-", "follows the equipotential along an obstacle"),
    Mode.JAM: (FAILURE, "-", "is jammed: the force lies along the streamline"),
    Mode.LEARNING: ("#000000", "-", "learns what it touched"),
    Mode.RETREATING: ("#000000", (0, (2, 1)), "goes back the way it came"),
    Mode.RECOVERING: ("#009E73", "-", "leaves an obstacle cell"),
    Mode.DITHERING: ("#56B4E9", (0, (1, 1)), "shakes itself loose"),
    Mode.WAITING: (FAILURE, (0, (1, 1)), "waits for the grid to settle"),
    Mode.ARRIVED: ("#0072B2", "-", "has arrived"),
    Mode.HOMING: ("#0072B2", (0, (4, 1)), "goes straight to the goal in its cell"),
}
"""Colour and line style of the path in every mode, and what the robot does."""

LEARNT = "#D55E00"
FORCE = "#B2182B"
_HIDDEN_CELLS = "#e3bcbc"
_FORCE_LENGTH = 0.12
"""Of the largest contact force, as a share of the picture's width."""

_MOST_ARROWS = 8


def draw_run(run: Run, *, title: str = "", caption: str = "") -> Figure:
    """Draw a run: workspace with contact forces and poses; beside it, of two axes, the path with modes and lessons."""
    flat = run.space.ndim == 2
    height = panel_height(PAGE / 2 - 0.6, panel_aspect(run)) + 0.4 + caption_height(caption)
    figure = new_figure(PAGE, height)
    left = figure.add_subplot(1, 2, 1) if flat else figure.add_subplot()
    draw_robot(without_rests(run.configuration), scene_of(run), left)
    _draw_forces(run.contacts, left)
    refresh_legend(left)
    if flat:
        draw_configurations(run, figure.add_subplot(1, 2, 2))
    add_title(figure, title, caption)
    return figure


def draw_runs(runs: Sequence[Run], *, title: str = "", caption: str = "") -> Figure:
    """Draw the same motion at several k: paths of the reference point, and paths through configuration space."""
    figure = new_figure(PAGE, 5.0 + caption_height(caption))
    left, right = figure.subplots(1, 2)
    scene = scene_of(runs[0])
    draw_robot(runs[0].configuration[:1], scene, left, ghosts=1)
    draw_configurations(runs[0], right, path=False)
    for run, colour in zip(runs, PATHS, strict=False):
        label = f"k = {run.field.k:g}" + ("" if run.ending is Ending.ARRIVED else f" ({run.ending})").replace("_", " ")
        path = without_rests(run.configuration)
        tip = scene.robot.reference_point(path)
        left.plot(*tip.T, color=colour, linewidth=1.4, zorder=6, label=label)
        for shift in seam_shifts(run.space):
            right.plot(*(path + shift).T, color=colour, linewidth=1.4, zorder=4, label=label)
    for axes in (left, right):
        refresh_legend(axes)
    add_title(figure, title, caption)
    return figure


def scene_of(run: Run) -> Scene:
    """The scene that was set in motion."""
    if run.scene is None:
        raise InputError("this run had no scene, so that nobody knows its workspace; make it by simulation(scene)")
    return run.scene


def panel_aspect(run: Run) -> float:
    """Height over width of the taller panel; the workspace of an arm or of what turns is drawn as a square."""
    flat = run.space.ndim == 2 and scene_of(run).robot.moves_in_workspace
    return plane_of(run.space).aspect if flat else 1.0


def _draw_forces(contacts: ContactLog, axes: Axes) -> None:
    """Arrows of some contact forces on the robot."""
    count = len(contacts.step)
    if not count:
        return
    rows = np.unique(np.linspace(0, count - 1, min(count, _MOST_ARROWS)).astype(np.int64))
    axes.quiver(
        *contacts.point[rows].T, *(contacts.force[rows] * force_scale(contacts, axes)).T, color=FORCE, angles="xy",
        scale_units="xy", scale=1.0, width=0.006, zorder=9, label="contact force",
    )  # fmt: skip


def force_scale(contacts: ContactLog, axes: Axes) -> float:
    """Length on paper of a unit of force."""
    left, right = axes.get_xlim()
    return _FORCE_LENGTH * (right - left) / float(np.hypot(*contacts.force.T).max())


def draw_configurations(run: Run, axes: Axes, *, path: bool = True) -> None:
    """Draw what happened in a configuration space of two axes: the path in colours of its modes, the cells learnt."""
    if run.space.ndim != 2:
        raise InputError(f"the configuration space of this motion has {run.space.ndim} axes, and a picture has two")
    learnt = run.learnt
    scene = scene_of(run)
    plant = plant_of(scene)
    known = run.space.with_cells(np.where(learnt, np.uint8(Cell.FREE), run.space.cell))
    obstacle = known.cell == Cell.OBSTACLE
    virtual = None
    if (bare := scene.robot.bare()) != scene.robot:
        touched = bare.occupancy(scene.axes, plant.obstacles[: plant.known], "conservative")
        virtual = plant.itself & obstacle & ~touched
    draw_space(known, axes, virtual=virtual)
    hidden = (plant.true_space(known).cell == Cell.OBSTACLE) & ~obstacle
    paint_cells(plane_of(known), hidden, _HIDDEN_CELLS, "hidden obstacle", axes)
    if path:
        _draw_path(run, axes)
        if learnt.any():
            draw_lessons(run.space.centre(np.argwhere(learnt)), axes)
    axes.set_title("Configuration space", fontsize=TEXT)
    refresh_legend(axes)


def without_rests(configuration: NDArray[np.float64]) -> NDArray[np.float64]:
    """Configurations without repetitions."""
    keep = np.ones(len(configuration), dtype=np.bool_)
    keep[1:] = np.any(np.diff(configuration, axis=0) != 0.0, axis=1)
    return configuration[keep]


def _draw_path(run: Run, axes: Axes) -> None:
    """The path in colours of its modes, with copies where it crosses seams, and its ends."""
    path, space = run.configuration, run.space
    own = [(shift, space.from_world(path + shift)) for shift in seam_shifts(space)]
    copies = [shift for shift, at in own if np.any(np.all((at >= space.lower) & (at <= space.upper), axis=-1))]
    for shift in copies:
        axes.plot(*(path + shift).T, color="white", linewidth=3.0, zorder=3.8)
    steps = np.stack([path[:-1], path[1:]], axis=1)
    moves = np.any(steps[:, 0] != steps[:, 1], axis=1)
    for mode, (colour, line, _) in MODES.items():
        chosen = steps[moves & (run.mode[:-1] == mode)]
        if len(chosen):
            lines = list(np.concatenate([chosen + shift for shift in copies]))
            axes.add_collection(LineCollection(lines, colors=colour, linestyles=[line], linewidths=1.7, zorder=4.2))
            axes.plot([], [], color=colour, linestyle=line, linewidth=1.7, label=mode.name.lower())
    taught = wrapped(path[[lesson.step for lesson in run.lessons]], space)
    if len(taught):
        axes.scatter(taught[:, 0], taught[:, 1], s=12, marker="D", color="black", zorder=5, label="learning")
    ends = wrapped(path[[0, -1]], space)
    mark(ends[:1], axes, "start")
    if run.ending is Ending.ARRIVED:
        mark(ends[1:], axes, "goal", "")
    else:
        mark(ends[1:], axes, "failure", str(run.ending).replace("_", " "))


def draw_lessons(centres: NDArray[np.float64], axes: Axes) -> Any:
    """Circle cells learnt, shape (c, 2)."""
    return axes.scatter(
        centres[:, 0], centres[:, 1], s=9 if len(centres) < 60 else 5, marker="o", facecolor="none", edgecolor=LEARNT,
        linewidth=0.6, zorder=3, label="cell learnt",
    )  # fmt: skip
