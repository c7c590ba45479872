"""Pictures of the workspace: obstacles, goals, and the robot itself along a path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgb
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.planning.streamline import Path as RobotPath, Streamline
from resgrid.planning.workspace import dense
from resgrid.plot.figures import axes_or_new
from resgrid.plot.style import GOAL, OBSTACLE, PATHS, TEXT, add_swatch, dress, refresh_legend
from resgrid.robots import CellSet, HalfSpace, Robot, Shape, to_shapely
from resgrid.space import ConfigurationSpace

GHOSTS = 12
_START, _EARLY, _LATE, _END = "#2b2b2b", "#b5b5b5", "#7fb2d6", "#0072B2"


def plot_robot_path(
    path: RobotPath,
    robot: Robot,
    space: ConfigurationSpace,
    obstacles: Sequence[Shape] = (),
    goals: Sequence[Shape] = (),
    ax: Axes | None = None,
    *,
    ghosts: int = GHOSTS,
    colour: str = PATHS[0],
) -> Axes:
    """Draw a robot in its workspace along a path: black at the start, blue at the end, pale between; and its tip's way.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
    robot : Robot
        That moves in the plane.
    space : ConfigurationSpace
    obstacles, goals : sequence of Shape
        Of the workspace.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    ghosts : int
        How many poses to draw, at least 1; evenly spaced along the way that the robot's points move.
    colour : str
        Of the tip's way.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the path does not fit the space, or the robot does not move in the plane.
    """
    if not 1 <= ghosts <= 1000:
        raise InputError(f"ghosts = {ghosts}, but 1 to 1000 poses can be drawn")
    poses = _dense(path, robot)
    axes = plot_workspace(obstacles, goals, ax, unit=_unit(robot, space), legend=False)
    shown = poses[_evenly(poses, robot, ghosts)]
    for number, pose in enumerate(shown):
        share = number / max(len(shown) - 1, 1)
        _draw_pose(robot, pose, axes, share, first=number == 0, last=number == len(shown) - 1)
    tip = robot.reference_point(poses)
    if len(tip) > 1:
        _draw_way(tip, robot, axes, colour)
    if robot.base is not None:
        axes.scatter([robot.base[0]], [robot.base[1]], s=30, marker="s", facecolor="black", zorder=7, label="base")
    _frame(axes, robot, [tip, *_outlines(robot, shown)], obstacles, goals)
    refresh_legend(axes)
    return axes


def _draw_way(tip: NDArray[np.float64], robot: Robot, axes: Axes, colour: str) -> None:
    effects = [Stroke(linewidth=2.4, foreground="white"), Normal()]
    label = f"way of the {robot.reference}"
    axes.plot(tip[:, 0], tip[:, 1], color=colour, linewidth=1.4, zorder=6, path_effects=effects, label=label)
    for place, size, marker, face in ((tip[:1], 22, "o", "white"), (tip[-1:], 70, "*", GOAL)):
        axes.scatter(
            place[:, 0], place[:, 1], s=size, marker=marker, facecolor=face, edgecolor="black", linewidth=0.8, zorder=8
        )


def plot_tip_ways(
    paths: Sequence[Streamline],
    robot: Robot,
    space: ConfigurationSpace,
    obstacles: Sequence[Shape] = (),
    goals: Sequence[Shape] = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw the ways of an arm's tip, or of another robot's reference point, along many paths.

    Parameters
    ----------
    paths : sequence of Streamline
    robot : Robot
        That moves in the plane.
    space : ConfigurationSpace
    obstacles, goals : sequence of Shape
        Of the workspace.
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If a path does not fit the space, or the robot does not move in the plane.
    """
    axes = plot_workspace(obstacles, goals, ax, unit=_unit(robot, space), legend=False)
    lines = [robot.reference_point(_dense(path, robot)) for path in paths]
    label = f"ways of the {robot.reference}"
    axes.add_collection(LineCollection(lines, colors=PATHS[0], linewidths=0.6, alpha=0.8, zorder=4, label=label))
    for row, size, face in ((0, 5, "white"), (-1, 4, GOAL)):
        ends = np.array([line[row] for line in lines]).reshape(-1, 2)
        axes.scatter(ends[:, 0], ends[:, 1], s=size, facecolor=face, edgecolor="black", linewidth=0.3, zorder=5)
    _frame(axes, robot, lines, obstacles, goals)
    refresh_legend(axes)
    return axes


def plot_workspace(
    obstacles: Sequence[Shape],
    goals: Sequence[Shape] = (),
    ax: Axes | None = None,
    *,
    unit: str = "m",
    legend: bool = True,
) -> Axes:
    """Draw obstacles and goals of a plane.

    Parameters
    ----------
    obstacles, goals : sequence of Shape
    ax : matplotlib.axes.Axes, optional
        Made when None.
    unit : str
        Of lengths, for the labels.
    legend : bool
        Whether to draw the legend.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If a shape is not one of the plane.
    """
    axes = axes_or_new(ax)
    for label, shapes, colour, order in (("obstacle", obstacles, OBSTACLE, 2.0), ("goal", goals, GOAL, 1.5)):
        mark_shapes(shapes, axes, colour, label, order)
    _limit(axes, [], (*obstacles, *goals))
    axes.set_aspect("equal")
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"y ({unit})")
    dress(axes)
    if legend:
        refresh_legend(axes)
    return axes


def _unit(robot: Robot, space: ConfigurationSpace) -> str:
    """Unit of the workspace: that of the axes, unless they are angles."""
    return "m" if robot.base is not None else space.axes[0].unit


def mark_shapes(shapes: Sequence[Shape], axes: Axes, colour: str, label: str, order: float = 2.2) -> None:
    """Fill shapes of the workspace with a colour, and name it in the legend."""
    for shape in shapes:
        _fill(to_shapely(shape), axes, facecolor=colour, edgecolor="#00000080", linewidth=0.5, zorder=order)
    if shapes:
        add_swatch(axes, label, colour)


def _dense(path: RobotPath, robot: Robot) -> NDArray[np.float64]:
    """Configurations in the world close enough for smooth lines, whatever the scale of the workspace."""
    corners = path.line
    travel = float(robot.travel(corners[:-1], corners[1:]).sum())
    return path.space.to_world(dense(path, travel / 400)[0] if travel else corners)


def _evenly(poses: NDArray[np.float64], robot: Robot, count: int) -> NDArray[np.int64]:
    """Numbers of poses that are evenly spaced along what the robot's points travel."""
    along = np.concatenate([[0.0], np.cumsum(robot.travel(poses[:-1], poses[1:]))])
    wanted = np.linspace(0.0, along[-1], count)
    return np.unique(np.searchsorted(along, wanted).clip(0, len(poses) - 1))


def _draw_pose(robot: Robot, pose: NDArray[np.float64], axes: Axes, share: float, *, first: bool, last: bool) -> None:
    strong = first or last
    early, late = np.array(to_rgb(_EARLY)), np.array(to_rgb(_LATE))
    colour = tuple((1 - share) * early + share * late)
    if strong:
        colour = to_rgb(_START if first else _END)
    order = 3.0 + share / 2 + strong
    label = "robot at the start" if first else ("robot at the end" if last else None)
    places = skeleton(robot, pose)
    if len(places):
        _draw_shapes(robot, pose, axes, colour, order, strong=strong)
        axes.plot(
            places[:, 0], places[:, 1], color=colour, linewidth=2.4 if strong else 1.0, marker="o",
            markersize=3.6 if strong else 1.6, solid_capstyle="round", zorder=order, label=label,
        )  # fmt: skip
        return
    _draw_shapes(robot, pose, axes, colour, order, strong=strong)
    if label and any(shape.area for shape in robot.shapes_at(pose)):
        add_swatch(axes, label, to_hex(colour))


def skeleton(robot: Robot, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Joints of a robot whose parts are segments, one after the other, shape (n, 2); else none."""
    import shapely

    cores = [part.core[0] for part in robot.parts(pose[np.newaxis])]
    if not all(isinstance(core, shapely.LineString) for core in cores):
        return np.empty((0, 2))
    points = shapely.get_coordinates(cores)
    return np.asarray(points[np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1))])


def _draw_shapes(
    robot: Robot, pose: NDArray[np.float64], axes: Axes, colour: tuple[float, ...], order: float, *, strong: bool
) -> None:
    for shape in robot.shapes_at(pose):
        if shape.area:
            _fill(
                shape, axes, facecolor=(*colour, 0.75 if strong else 0.25), edgecolor=colour,
                linewidth=1.2 if strong else 0.6, zorder=order,
            )  # fmt: skip


def _fill(shape: Any, axes: Axes, **style: Any) -> None:
    """Fill a shapely polygon, holes left open."""
    from shapely.geometry.polygon import orient

    for part in map(orient, getattr(shape, "geoms", [shape])):
        rings = [part.exterior, *part.interiors]
        path = Path.make_compound_path(*(Path(np.asarray(ring.coords)[:, :2], closed=True) for ring in rings))
        axes.add_patch(PathPatch(path, **style))


def _outlines(robot: Robot, poses: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    import shapely

    return [shapely.get_coordinates(shape) for pose in poses for shape in robot.shapes_at(pose)]


def _frame(
    axes: Axes, robot: Robot, lines: list[NDArray[np.float64]], obstacles: Sequence[Shape], goals: Sequence[Shape]
) -> None:
    """Limits around everything; an arm's are those of its reach, so that its pictures can be compared."""
    if robot.base is not None:
        base = np.asarray(robot.base)
        lines = [*lines, np.stack([base - robot.reach, base + robot.reach])]
    _limit(axes, lines, (*obstacles, *goals))
    axes.set_title("Workspace", fontsize=TEXT)


def _limit(axes: Axes, lines: list[NDArray[np.float64]], shapes: Sequence[Shape]) -> None:
    """Limits that hold lines and shapes, as far as they are bounded."""
    bounded = [np.array(shape.bounds) for shape in shapes if not isinstance(shape, HalfSpace | CellSet)]
    if not lines and not bounded:
        return
    everything = np.concatenate([*lines, *bounded])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.05 * max(float((high - low).max()), 1e-9)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
