"""Pictures of controlled motion: workspace with contact forces, configuration space with modes and lessons."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.control.log import ContactLog, Ending, Mode, Run
from resgrid.control.plant import plant_of
from resgrid.errors import InputError
from resgrid.planning.streamline import Polyline
from resgrid.plot.fields import plot_space
from resgrid.plot.figures import new_figure, panel_height
from resgrid.plot.paint import VIRTUAL, paint_cells
from resgrid.plot.plane import plane_of
from resgrid.plot.robots import mark_shapes, plot_robot_path
from resgrid.plot.style import FAILURE, GOAL, OBSTACLE, PATHS, TEXT, refresh_legend
from resgrid.robots import CellSet, HalfSpace, Shape
from resgrid.scene.scene import GoalCell, GoalJoints, GoalPoint, Scene
from resgrid.space import Cell, ConfigurationSpace

MODES: dict[Mode, tuple[str, Any]] = {
    Mode.STREAMLINE: ("#0072B2", "-"),
    Mode.PUSHED: ("#CC79A7", "-"),
    Mode.SLIDING: ("#D55E00", "-"),
    Mode.STICKING: (FAILURE, "-"),
    Mode.FOLLOWING: ("#E69F00", "-"),
    Mode.JAM: (FAILURE, "-"),
    Mode.LEARNING: ("#000000", "-"),
    Mode.RETREATING: ("#000000", (0, (2, 1))),
    Mode.RECOVERING: ("#009E73", "-"),
    Mode.DITHERING: ("#56B4E9", (0, (1, 1))),
    Mode.WAITING: (FAILURE, (0, (1, 1))),
    Mode.ARRIVED: ("#0072B2", "-"),
    Mode.HOMING: ("#0072B2", (0, (4, 1))),
}
"""Colour and line style of the way in every mode."""

HIDDEN = "#b96b6b"
LEARNT = "#D55E00"
FORCE = "#B2182B"
_PAGE = 7.4
_MOST_ARROWS = 8


def plot_run(run: Run, scene: Scene, *, title: str = "", caption: str = "") -> Figure:
    """Draw a controlled motion.

    Parameters
    ----------
    run : Run
    scene : Scene
        The one that it was simulated in.
    title, caption : str
        Above and below the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Workspace with hidden obstacles, contact forces and some poses of the robot; beside it, where the configuration
        space has two axes, the way in colours of the modes, with cells learnt circled.
    """
    flat = run.space.ndim == 2
    below = 0.15 * (caption.count("\n") + 2 if caption else 0)
    figure = new_figure(_PAGE, panel_height(_PAGE / 2 - 0.6, panel_aspect(run.space, scene)) + 0.4 + below)
    left = figure.add_subplot(1, 2, 1) if flat else figure.add_subplot()
    plot_run_workspace(run, scene, left)
    if flat:
        plot_run_configurations(run, scene, figure.add_subplot(1, 2, 2))
    if title:
        figure.suptitle(title, fontsize=TEXT + 2)
    if caption:
        figure.supxlabel("\n" + caption, fontsize=TEXT - 1, x=0.02, ha="left")
    return figure


def panel_aspect(space: ConfigurationSpace, scene: Scene) -> float:
    """Height over width of the taller panel; the workspace of what turns is drawn as a square."""
    flat = scene.robot.moves_in_workspace
    return max(plane_of(space).aspect if space.ndim == 2 else 1.0, 0.0 if flat else 1.0)


def plot_run_workspace(run: Run, scene: Scene, axes: Axes) -> Axes:
    """Draw what happened in the workspace: poses, the way of the tip, contact forces."""
    known, hidden, goals = bodies_of(scene)
    way = thinned(run.configuration)
    plot_robot_path(Polyline(way, run.space), scene.robot, run.space, (*known, *hidden), goals, axes)
    dress_workspace(scene, hidden, axes)
    draw_forces(run.contacts, _few(run.contacts), axes)
    zoom(run, scene, axes)
    refresh_legend(axes)
    return axes


def zoom(run: Run, scene: Scene, axes: Axes) -> None:
    """Show what a motion is about: the robot on its way, bounded obstacles and goals."""
    known, hidden, goals = bodies_of(scene)
    bounded = [shape for shape in (*known, *hidden, *goals) if not isinstance(shape, HalfSpace | CellSet)]
    if scene.robot.moves_in_workspace:
        corners = plane_of(run.space).corners
        (left, low), (right, high) = corners.min(axis=0), corners.max(axis=0)
        axes.set(xlim=(left, right), ylim=(low, high))
        return
    boxes = [np.array(shape.bounds) for shape in bounded]
    poses = run.configuration[np.linspace(0, len(run.configuration) - 1, 24).astype(np.int64)]
    boxes += [np.array(shape.bounds).reshape(2, 2) for pose in poses for shape in scene.robot.shapes_at(pose)]
    low, high = np.concatenate(boxes).min(axis=0), np.concatenate(boxes).max(axis=0)
    middle, half = (low + high) / 2, 0.56 * float((high - low).max())
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))


def bodies_of(scene: Scene) -> tuple[list[Shape], list[Shape], list[Shape]]:
    """Obstacles on the map, hidden ones, and goals that are shapes."""
    return list(scene.obstacles), list(scene.hidden), [goal for goal in scene.goals if isinstance(goal, Shape)]


def dress_workspace(scene: Scene, hidden: Sequence[Shape], axes: Axes) -> None:
    """Mark what the map does not show, what came from a map file, and goals that are places."""
    if scene.map is not None:
        known = ConfigurationSpace(scene.axes, scene.map.cell, frame=scene.frame)
        for code, colour, label in ((Cell.OBSTACLE, OBSTACLE, "obstacle"), (Cell.GOAL, GOAL, "goal")):
            if (known.cell == code).any():
                paint_cells(known, known.cell == code, colour, label, axes)
    if hidden:
        mark_shapes(hidden, axes, HIDDEN, "hidden obstacle", 2.4)
    places = goal_places(scene)
    if len(places):
        x, y = places.T
        axes.scatter(x, y, s=70, marker="*", facecolor=GOAL, edgecolor="black", linewidth=0.7, zorder=6, label="goal")


def goal_places(scene: Scene) -> NDArray[np.float64]:
    """Where the robot's reference point is at goals that are places, cells or configurations, shape (g, 2)."""
    grid = ConfigurationSpace(
        scene.axes, np.zeros([axis.cells for axis in scene.axes], dtype=np.uint8), frame=scene.frame
    )
    places = [_reference(goal, scene, grid) for goal in scene.goals if not isinstance(goal, Shape)]
    return np.reshape(places, (-1, 2))


def _reference(goal: GoalPoint | GoalCell | GoalJoints, scene: Scene, grid: ConfigurationSpace) -> NDArray[np.float64]:
    match goal:
        case GoalPoint(point) if len(point) == 2:
            return np.array(point)
        case GoalPoint(point):
            pose = np.array(point)
        case GoalCell(cell):
            pose = grid.centre(np.array(cell))
        case GoalJoints(lower, upper):
            pose = (np.array(lower) + upper) / 2
    return scene.robot.reference_point(pose.reshape(1, -1))[0, :2]


def draw_forces(contacts: ContactLog, rows: NDArray[np.int64], axes: Axes) -> Any:
    """Arrows of contact forces on the robot, the largest as long as a tenth of the picture."""
    if not len(contacts.step):
        return None
    size = float(np.abs(np.diff(axes.get_xlim()))[0])
    largest = float(np.hypot(*contacts.force.T).max())
    arrows = contacts.force[rows] * (0.12 * size / largest)
    return axes.quiver(
        *contacts.point[rows].T, *arrows.T, color=FORCE, angles="xy", scale_units="xy", scale=1.0, width=0.006,
        zorder=9, label="contact force",
    )  # fmt: skip


def _few(contacts: ContactLog) -> NDArray[np.int64]:
    count = len(contacts.step)
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_ARROWS)).astype(np.int64)) if count else np.arange(0)


def plot_run_configurations(run: Run, scene: Scene, axes: Axes, *, way: bool = True) -> Axes:
    """Draw what happened in a configuration space of two axes: the way in colours of its modes, the cells learnt."""
    if run.space.ndim != 2:
        raise InputError(f"the configuration space of this motion has {run.space.ndim} axes, and a picture has two")
    learnt = run.learnt
    plant = plant_of(scene)
    known = run.space.with_cells(np.where(learnt, np.uint8(Cell.FREE), run.space.cell))
    plot_space(known, axes)
    if scene.robot.bare() != scene.robot:
        virtual = plant.itself & (known.cell == Cell.OBSTACLE) & ~_touched(scene, plant.obstacles[: plant.known])
        if virtual.any():
            paint_cells(known, virtual, VIRTUAL, "virtual obstacle", axes)
    hidden = (plant.true_space(known).cell == Cell.OBSTACLE) & (known.cell != Cell.OBSTACLE)
    if hidden.any():
        paint_cells(known, hidden, "#e3bcbc", "hidden obstacle", axes)
    if way:
        draw_way(run, axes)
        draw_lessons(run, learnt, axes)
        _mark_ends(run, axes)
    axes.set_title("Configuration space", fontsize=TEXT)
    refresh_legend(axes)
    return axes


def _touched(scene: Scene, shapes: Sequence[Shape]) -> NDArray[np.bool_]:
    """Cells in which an arm meets an obstacle, strips along singularities left out."""
    return scene.robot.bare().occupancy(scene.axes, shapes, "conservative")


def thinned(configuration: NDArray[np.float64]) -> NDArray[np.float64]:
    """Configurations without repetitions, for a way."""
    keep = np.ones(len(configuration), dtype=np.bool_)
    keep[1:] = np.any(np.diff(configuration, axis=0) != 0.0, axis=1)
    return configuration[keep]


def draw_way(run: Run, axes: Axes) -> None:
    """The way in colours of its modes, with copies where it crosses seams."""
    way = run.configuration
    copies = [by for by in seam_shifts(run.space) if _is_inside(way + by, run.space)]
    for by in copies:
        axes.plot(*(way + by).T, color="white", linewidth=3.0, zorder=3.8)
    steps = np.stack([way[:-1], way[1:]], axis=1)
    moves = np.any(steps[:, 0] != steps[:, 1], axis=1)
    for mode, (colour, line) in MODES.items():
        chosen = steps[moves & (run.mode[:-1] == mode)]
        if len(chosen):
            lines = list(np.concatenate([chosen + by for by in copies]))
            axes.add_collection(LineCollection(lines, colors=colour, linestyles=[line], linewidths=1.7, zorder=4.2))
            axes.plot([], [], color=colour, linestyle=line, linewidth=1.7, label=mode.name.lower())
    taught = way[[lesson.step for lesson in run.lessons]]
    if len(taught):
        taught = wrapped(taught, run.space)
        axes.scatter(taught[:, 0], taught[:, 1], s=12, marker="D", color="black", zorder=5, label="learning")


def seam_shifts(space: ConfigurationSpace) -> list[NDArray[np.float64]]:
    """Shifts in the world by which what crosses seams is drawn again."""
    turns = [range(-2, 3) if ring else range(1) for ring in space.periodic]
    return list(space.frame.turned_to_world(np.array(list(product(*turns))) * (space.upper - space.lower)))


def _is_inside(points: NDArray[np.float64], space: ConfigurationSpace) -> bool:
    own = space.from_world(points)
    return bool(np.any(np.all((own >= space.lower) & (own <= space.upper), axis=-1)))


def wrapped(points: NDArray[np.float64], space: ConfigurationSpace) -> NDArray[np.float64]:
    """Points of the world brought back into the grid across periodic seams."""
    own, extent = space.from_world(points), space.upper - space.lower
    return space.to_world(np.where(space.periodic, space.lower + np.mod(own - space.lower, extent), own))


def draw_lessons(run: Run, learnt: NDArray[np.bool_], axes: Axes) -> None:
    """Circle the cells learnt."""
    if not learnt.any():
        return
    centres = run.space.centre(np.argwhere(learnt))
    axes.scatter(
        centres[:, 0], centres[:, 1], s=9 if len(centres) < 60 else 5, marker="o", facecolor="none", edgecolor=LEARNT,
        linewidth=0.6, zorder=3, label="cell learnt",
    )  # fmt: skip


def mark_start(place: NDArray[np.float64], axes: Axes) -> None:
    """A white disc where a motion starts."""
    axes.scatter(place[0], place[1], s=22, facecolor="white", edgecolor="black", linewidth=0.9, zorder=6, label="start")


def _mark_ends(run: Run, axes: Axes) -> None:
    start, end = wrapped(run.configuration[[0, -1]], run.space)
    mark_start(start, axes)
    if run.ending is Ending.ARRIVED:
        axes.scatter(end[0], end[1], s=70, marker="*", facecolor=GOAL, edgecolor="black", linewidth=0.7, zorder=6)
    else:
        label = str(run.ending).replace("_", " ")
        axes.scatter(end[0], end[1], s=34, marker="x", color=FAILURE, linewidth=1.6, zorder=6, label=label)


def plot_runs_by_k(
    runs: Sequence[Run], shares: Sequence[float], scene: Scene, *, title: str = "", caption: str = ""
) -> Figure:
    """Draw the same motion at several blends: ways of the tip, and ways through the configuration space.

    Parameters
    ----------
    runs : sequence of Run
    shares : sequence of float
        The k of each.
    scene : Scene
        With a configuration space of two axes.
    title, caption : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    if not runs:
        raise InputError("there is no run to draw: give at least one")
    figure = new_figure(_PAGE, 5.0 + 0.15 * (caption.count("\n") + 2 if caption else 0))
    left, right = figure.subplots(1, 2)
    known, hidden, goals = bodies_of(scene)
    begin = Polyline(runs[0].configuration[:1], runs[0].space)
    plot_robot_path(begin, scene.robot, runs[0].space, (*known, *hidden), goals, left, ghosts=1)
    dress_workspace(scene, hidden, left)
    plot_run_configurations(runs[0], scene, right, way=False)
    for run, k, colour in zip(runs, shares, PATHS, strict=False):
        label = f"k = {k:g}" + ("" if run.ending is Ending.ARRIVED else f" ({run.ending})").replace("_", " ")
        way = thinned(run.configuration)
        left.plot(*scene.robot.reference_point(way).T, color=colour, linewidth=1.4, zorder=6, label=label)
        for by in seam_shifts(run.space):
            right.plot(*(way + by).T, color=colour, linewidth=1.4, zorder=4, label=label)
    zoom(runs[0], scene, left)
    for axes in (left, right):
        refresh_legend(axes)
    if title:
        figure.suptitle(title, fontsize=TEXT + 2)
    if caption:
        figure.supxlabel("\n" + caption, fontsize=TEXT - 1, x=0.02, ha="left")
    return figure
