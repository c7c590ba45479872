"""Pictures of the workspace: obstacles, goals, and poses of the robot along a path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray
from shapely.geometry.polygon import orient

from resgrid._internal.colours import GOAL
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.any_field import FieldPath
from resgrid.planning.any_path import AnyPath
from resgrid.planning.blocking_obstacles import Separation
from resgrid.plot.arms import draw_arm, draw_arm_scene, draw_tool_paths, is_in_space
from resgrid.plot.figures import PAGE, add_title, axes_or_new, caption_height, new_figure
from resgrid.plot.motions import Motion, dense_motion, empty_space, goal_places, poses_along, reference_of
from resgrid.plot.panels import draw_space
from resgrid.plot.paths import MOST_ENDS, draw_line, draw_path, draw_separation
from resgrid.plot.plane import kinds_of, paint, plane_of, unknown_cells
from resgrid.plot.style import (
    FAILURE,
    HIDDEN,
    OBSTACLE,
    PATHS,
    TEXT,
    add_swatch,
    dress,
    mark,
    refresh_legend,
)  # fmt: skip
from resgrid.robots import CellSet, HalfSpace, Robot, Shape, to_shapely
from resgrid.scene.scene import Scene

_GHOSTS = 12
"""Default number of poses of a robot in the plane that are drawn along a path."""
_START, _END = "#2b2b2b", "#0072B2"
_EARLY, _LATE = np.array(to_rgb("#b5b5b5")), np.array(to_rgb("#7fb2d6"))


def draw_scene(scene: Scene, ax: Axes | None = None) -> Axes:
    """Draw the workspace of a scene: obstacles, hidden obstacles, goals and starts; return the axes.

    `ax`: axes to draw on, by default those of a new figure.
    """
    if is_in_space(scene):
        return draw_arm_scene(scene, ax)
    axes = _draw_surroundings(scene, ax)
    places = np.array([reference_of(start, scene) for start in scene.starts]).reshape(-1, 2)
    mark(places, axes, "start")
    _frame(axes, scene, [places])
    refresh_legend(axes)
    return axes


def draw_robot(path: Motion, scene: Scene, ax: Axes | None = None, *, ghosts: int | None = None) -> Axes:
    """Draw poses of a scene's robot along a path, and the path of its reference point, such as the tip of an arm.

    The robot is black at the start, blue at the end and pale between.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or array_like of float, shape (n, ndim)
        An array holds configurations in world coordinates.
    scene : Scene
        Scene with a robot that moves in the plane, or an arm in space.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default those of a new figure.
    ghosts : int, optional
        Number of poses, 1 to 1000, evenly spaced by the distance that the robot's points move; by default 12 in the
        plane and 5 in space.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If the path does not fit the scene, or the robot does not move in the plane and is not an arm in space.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml")
    >>> ax = rg.plot.draw_robot(rg.plan(scene).path((0.5, 6.5)), scene, ghosts=5)
    """
    if is_in_space(scene):
        return draw_arm(path, scene, ax, ghosts=5 if ghosts is None else ghosts)
    robot = scene.robot
    poses = dense_motion(path, scene)
    shown = poses_along(poses, scene, _GHOSTS if ghosts is None else ghosts)
    axes = _draw_surroundings(scene, ax)
    _draw_poses(robot, shown, axes)
    tip = robot.reference_point(poses)
    if len(tip) > 1:
        effects = [Stroke(linewidth=2.4, foreground="white"), Normal()]
        label = f"path of the {robot.reference}"
        axes.plot(tip[:, 0], tip[:, 1], color=PATHS[0], linewidth=1.4, zorder=6, path_effects=effects, label=label)
        mark(tip[:1], axes, "start", "")
        mark(tip[-1:], axes, "end", "")
    if robot.base is not None:
        axes.scatter([robot.base[0]], [robot.base[1]], s=30, marker="s", facecolor="black", zorder=7, label="base")
    outlines = (shapely.get_coordinates(shape) for pose in shown for shape in robot.shapes_at(pose))
    _frame(axes, scene, [tip, *outlines])
    refresh_legend(axes)
    return axes


def draw_tip_paths(paths: Sequence[FieldPath], scene: Scene, ax: Axes | None = None) -> Axes:
    """Draw the paths of an arm's tip, or of another robot's reference point, in the workspace.

    Parameters
    ----------
    paths : sequence of Streamline
        Paths of the robot.
    scene : Scene
        Scene with a robot that moves in the plane, or an arm in space.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If a path does not fit the scene, or the robot does not move in the plane and is not an arm in space.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml", start=[(0.5, 6.5), (0.5, 0.5)])
    >>> ax = rg.plot.draw_tip_paths(rg.plan(scene).paths(), scene)
    """
    if is_in_space(scene):
        return draw_tool_paths(paths, scene, ax)
    robot = scene.robot
    axes = _draw_surroundings(scene, ax)
    lines = [robot.reference_point(dense_motion(path, scene)) for path in paths]
    label = f"paths of the {robot.reference}"
    axes.add_collection(LineCollection(lines, colors=PATHS[0], linewidths=0.6, alpha=0.8, zorder=4, label=label))
    mark([line[0] for line in lines], axes, "start", "")
    if len(lines) <= MOST_ENDS:
        mark([line[-1] for line in lines], axes, "end", "")
    _frame(axes, scene, lines)
    refresh_legend(axes)
    return axes


def draw_workspace_and_space(
    path: AnyPath,
    scene: Scene,
    *,
    virtual: NDArray[np.bool_] | None = None,
    verdict: Separation | None = None,
    separating: Sequence[Shape] = (),
    title: str = "",
    caption: str = "",
) -> Figure:
    """Draw poses of a robot along a path in its workspace, and the path in a configuration space of two axes.

    This is the layout of Connolly & Grupen (1992).

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
        Path in a space of two axes.  Without a path to a goal, the robot is drawn at its start only.
    scene : Scene
        Scene with a robot that moves in the plane, or an arm in space.
    virtual : ndarray of bool, shape of the space, optional
        Mask of obstacle cells that no body occupies, such as strips along singularities; drawn paler.
    verdict : Separation, optional
        Obstacles that separate the start from the goals; drawn in the configuration space in place of the path.
    separating : sequence of Shape
        Obstacles of the workspace that are marked as separating the start from the goals.
    title, caption : str
        Texts above the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Figure 18.8 cm wide.

    Raises
    ------
    InputError
        If the space does not have two axes, or the robot does not move in the plane and is not an arm in space.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml")
    >>> figure = rg.plot.draw_workspace_and_space(rg.plan(scene).path((0.5, 6.5)), scene)
    """
    plane_of((path if verdict is None else verdict).space)
    legend = 0.7 if scene.robot.workspace_ndim == 3 else 0.0  # a row of the legend for every verdict of cells
    figure = new_figure(PAGE, 4.4 + legend + caption_height(caption))
    left, right = figure.subplots(1, 2)
    draw_robot(path, scene, left)
    mark_shapes(separating, left, FAILURE, "separates the start from the goals")
    refresh_legend(left)
    if verdict is not None:
        draw_separation(verdict, right, virtual=virtual)
    else:
        draw_space(path.space, right, virtual=virtual)
        if isinstance(path, FieldPath):
            draw_path(path, right)
        else:
            draw_line(path, right)
    right.set_title("Configuration space", fontsize=TEXT)
    add_title(figure, title, caption)
    return figure


def mark_shapes(shapes: Sequence[Shape], axes: Axes, colour: str, label: str, order: float = 2.2) -> None:
    """Fill shapes of the workspace with a colour, and add a legend entry.

    `label`: legend entry; `order`: drawing order of matplotlib (zorder).
    """
    for shape in shapes:
        fill(to_shapely(shape), axes, facecolor=colour, edgecolor="#00000080", linewidth=0.5, zorder=order)
    if shapes:
        add_swatch(axes, label, colour)


def fill(shape: Any, axes: Axes, **style: Any) -> list[PathPatch]:
    """Fill a shapely polygon, or the polygons of a collection, except for their holes; return the patches.

    `style`: options of matplotlib's PathPatch.
    """
    patches = []
    for part in map(orient, getattr(shape, "geoms", [shape])):
        rings = [part.exterior, *part.interiors]
        path = Path.make_compound_path(*(Path(np.asarray(ring.coords)[:, :2], closed=True) for ring in rings))
        patches.append(PathPatch(path, **style))
        axes.add_patch(patches[-1])
    return patches


def _draw_surroundings(scene: Scene, ax: Axes | None) -> Axes:
    """Draw map cells, obstacles, hidden obstacles and goals of a scene; return the axes.

    `ax`: axes to draw on, None for a new figure.  Raises InputError if the robot does not move in a plane.
    """
    if scene.robot.moves_in_workspace and scene.ndim != 2:
        raise InputError(
            f"the workspace of a scene with {scene.ndim} axes is not a plane; draw its space or its field instead"
        )
    axes = axes_or_new(ax)
    if scene.map is not None:
        known = ConfigurationSpace(scene.map.axes, scene.map.cell, frame=scene.map.frame)
        obstacles, goals, _ = kinds_of(known.cell, known.cell != Cell.FREE)
        paint(plane_of(known), axes, obstacles, goals, *unknown_cells(known.cell, scene.map.unknown))
    mark_shapes(scene.obstacles, axes, OBSTACLE, "obstacle", 2.0)
    mark_shapes(scene.hidden, axes, HIDDEN, "hidden obstacle", 2.4)
    mark_shapes(_goal_regions(scene), axes, GOAL, "goal", 1.5)
    mark(goal_places(scene), axes, "goal")
    unit = "m" if scene.robot.base is not None else scene.axes[0].unit
    axes.set(aspect="equal", xlabel=f"x ({unit})", ylabel=f"y ({unit})")
    axes.set_title("Workspace", fontsize=TEXT)
    dress(axes)
    return axes


def _goal_regions(scene: Scene) -> list[Shape]:
    """Return the goals of a scene that are shapes in the plane, without sets of cells."""
    return [
        goal for goal in scene.goals if isinstance(goal, Shape) and not isinstance(goal, CellSet) and goal.ndim == 2
    ]


def _draw_poses(robot: Robot, poses: NDArray[np.float64], axes: Axes) -> None:
    """Draw poses (n, ndim) of a robot along a path; the first and the last one have strong colours."""
    ends = {len(poses) - 1: ("robot at the end", _END), 0: ("robot at the start", _START)}
    for number, (pose, part) in enumerate(zip(poses, np.linspace(0.0, 1.0, len(poses)).tolist(), strict=True)):
        label, colour = ends.get(number, ("", to_hex((1 - part) * _EARLY + part * _LATE)))
        draw_pose(robot, pose, axes, colour, label, bold=bool(label), order=3.0 + part / 2 + bool(label))


def draw_pose(
    robot: Robot, pose: NDArray[np.float64], axes: Axes, colour: str, label: str = "", *, bold: bool = True,
    order: float = 7.5,
) -> list[Artist]:  # fmt: skip
    """Draw the bodies and joints of a robot in one configuration; return the artists, an empty list for a point.

    `pose` (ndim,): configuration in world coordinates; `label`: legend entry, empty for none; `bold`: whether the lines
    are thick and the fill is strong; `order`: drawing order of matplotlib (zorder).
    """
    drawn: list[Artist] = []
    for shape in robot.shapes_at(pose):
        if shape.area:
            face, width = (colour, 0.75 if bold else 0.25), 1.2 if bold else 0.6
            drawn += fill(shape, axes, facecolor=face, edgecolor=colour, linewidth=width, zorder=order)
    joints = skeleton(robot, pose)
    if len(joints):
        width, size = (2.4, 3.6) if bold else (1.0, 1.6)
        drawn += axes.plot(
            *joints.T, color=colour, linewidth=width, marker="o", markersize=size, solid_capstyle="round",
            zorder=order, label=label,
        )  # fmt: skip
    elif label and drawn:
        add_swatch(axes, label, colour)
    return drawn


def skeleton(robot: Robot, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the joint positions (n, 2) of a robot whose bodies are a chain of segments; shape (0, 2) for other robots.

    `pose` (ndim,): configuration in world coordinates.
    """
    cores = [part.core[0] for part in robot.parts(pose[np.newaxis])]
    if not all(isinstance(core, shapely.LineString) for core in cores):
        return np.empty((0, 2))
    points = shapely.get_coordinates(cores)
    return np.asarray(points[np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1))])


def _frame(axes: Axes, scene: Scene, lines: list[NDArray[np.float64]]) -> None:
    """Set the limits of a workspace picture.

    For a robot whose configurations are positions, the limits are those of the grid.  For other robots, they contain
    `lines` (n, 2), the bounded shapes of the scene, and the reach of an arm, so that all pictures of an arm have the
    same limits.
    """
    robot = scene.robot
    if robot.moves_in_workspace:
        places, margin = plane_of(empty_space(scene)).corners, 0.0
    else:
        shapes = (*scene.obstacles, *scene.hidden, *_goal_regions(scene))
        corners = [np.array(shape.bounds) for shape in shapes if not isinstance(shape, HalfSpace | CellSet)]
        if robot.base is not None:
            corners.append(np.add([[-robot.reach] * 2, [robot.reach] * 2], robot.base))
        places, margin = np.concatenate([*lines, *corners, goal_places(scene)]), 0.05
    low, high = places.min(axis=0), places.max(axis=0)
    around = margin * float((high - low).max())
    axes.set(xlim=(low[0] - around, high[0] + around), ylim=(low[1] - around, high[1] + around))
