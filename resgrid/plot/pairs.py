"""The map of cells of Connolly & Grupen (1992): the workspace on the left, the configuration space on the right."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.planning.separation import Separation
from resgrid.planning.streamline import Path, Streamline
from resgrid.plot.fields import plot_space
from resgrid.plot.figures import new_figure
from resgrid.plot.paint import VIRTUAL, paint_cells
from resgrid.plot.paths import plot_streamlines
from resgrid.plot.robots import mark_shapes, plot_robot_path
from resgrid.plot.separations import plot_separation
from resgrid.plot.style import FAILURE, PATHS, TEXT, refresh_legend
from resgrid.robots import Robot, Shape
from resgrid.space import ConfigurationSpace

_PAGE = 7.4


def plot_pair(
    path: Path,
    robot: Robot,
    space: ConfigurationSpace,
    obstacles: Sequence[Shape] = (),
    goals: Sequence[Shape] = (),
    *,
    others: Sequence[Streamline] = (),
    virtual: NDArray[np.bool_] | None = None,
    verdict: Separation | None = None,
    separating: Sequence[Shape] = (),
    title: str = "",
    caption: str = "",
) -> Figure:
    """Draw a robot along a path in its workspace, beside the path in a configuration space of two axes.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
        The robot is drawn along it; at its start alone where it goes nowhere.
    robot : Robot
    space : ConfigurationSpace
        Of two axes.
    obstacles, goals : sequence of Shape
        Of the workspace.
    others : sequence of Streamline
        More paths for the configuration space.
    virtual : ndarray of bool, shape of the space, optional
        Obstacle cells that stand for no body, such as strips along singularities; drawn paler.
    verdict : Separation, optional
        Of the path's start, where it reaches no goal: the configuration space then shows what separates it.
    separating : sequence of Shape
        Obstacles of the workspace to be marked as those that separate.
    title, caption : str
        Above and below the figure.

    Returns
    -------
    matplotlib.figure.Figure
        18.8 cm wide.

    Raises
    ------
    InputError
        If the space does not have two axes, or the robot does not move in the plane.
    """
    figure = new_figure(_PAGE, 4.4 + 0.15 * (caption.count("\n") + 2 if caption else 0))
    left, right = figure.subplots(1, 2)
    plot_robot_path(path, robot, space, obstacles, goals, left)
    if separating:
        mark_shapes(separating, left, FAILURE, "keeps it from the goals")
        refresh_legend(left)
    if verdict is None:
        lines = [path, *others] if isinstance(path, Streamline) else list(others)
        plot_configurations(lines, space, right, virtual=virtual)
        if not isinstance(path, Streamline):
            _draw_line(path.line, space, right)
    else:
        plot_separation(verdict, right, virtual=virtual)
    if title:
        figure.suptitle(title, fontsize=TEXT + 2)
    if caption:
        figure.supxlabel("\n" + caption, fontsize=TEXT - 1, x=0.02, ha="left")
    return figure


def _draw_line(points: NDArray[np.float64], space: ConfigurationSpace, axes: Axes) -> None:
    """A polyline in axis units, with copies where it crosses seams, and its first point."""
    extent = space.upper - space.lower
    turns = [range(-2, 3) if ring else range(1) for ring in space.periodic]
    if len(points) > 1:
        for by in product(*turns):
            axes.plot(*space.to_world(points + by * extent).T, color=PATHS[0], linewidth=1.5, zorder=4, label="path")
    x, y = space.to_world(points[0])
    axes.scatter(x, y, s=22, facecolor="white", edgecolor="black", linewidth=0.9, zorder=5, label="start")
    refresh_legend(axes)


def plot_configurations(
    paths: Sequence[Streamline],
    space: ConfigurationSpace,
    ax: Axes | None = None,
    *,
    virtual: NDArray[np.bool_] | None = None,
) -> Axes:
    """Draw a configuration space of two axes, virtual obstacles paler, with paths.

    Parameters
    ----------
    paths : sequence of Streamline
    space : ConfigurationSpace
    ax : matplotlib.axes.Axes, optional
        Made when None.
    virtual : ndarray of bool, shape of the space, optional

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes.
    """
    axes = plot_space(space, ax)
    if virtual is not None and virtual.any():
        paint_cells(space, virtual, VIRTUAL, "virtual obstacle", axes)
    if paths:
        plot_streamlines(paths, space, axes)
    axes.set_title("Configuration space", fontsize=TEXT)
    refresh_legend(axes)
    return axes
