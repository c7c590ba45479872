"""Pictures of streamlines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.plot.figures import axes_or_new
from resgrid.plot.plane import Plane, finish, plane_of
from resgrid.plot.style import FAILURE, GOAL, LINE_STYLES, PATHS, refresh_legend
from resgrid.space import ConfigurationSpace

_FEW = 40


def plot_streamlines(
    paths: Sequence[Streamline],
    space: ConfigurationSpace,
    ax: Axes | None = None,
    *,
    k: Sequence[float] | None = None,
) -> Axes:
    """Draw streamlines, their starts and their ends; a cross marks a start that leads nowhere.

    Parameters
    ----------
    paths : sequence of Streamline
    space : ConfigurationSpace
        Of two axes: lines break at its periodic seams.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    k : sequence of float, optional
        Blend of each path; paths of one blend share a colour and a line style, and the legend names it.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes, or ``k`` or the paths do not match.
    """
    plane = plane_of(space)
    if k is not None and len(k) != len(paths):
        raise InputError(f"{len(k)} values of k for {len(paths)} paths; give one for each")
    require_paths(paths, space)
    axes = axes_or_new(ax, plane.aspect)
    draw_streamlines(paths, space, plane, axes, k)
    finish(plane, axes, [path.axis_points for path in paths])
    refresh_legend(axes)
    return axes


def plot_path(path: Streamline, space: ConfigurationSpace, ax: Axes | None = None) -> Axes:
    """Draw one streamline; as `plot_streamlines` otherwise.

    Parameters
    ----------
    path : Streamline
    space : ConfigurationSpace
        Of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes
    """
    return plot_streamlines([path], space, ax)


def require_paths(paths: Sequence[Streamline], space: ConfigurationSpace) -> None:
    """Refuse streamlines of a space with another number of axes."""
    for number, path in enumerate(paths):
        if path.axis_points.shape[1:] != (space.ndim,):
            raise InputError(f"path {number} has {path.axis_points.shape[-1]} coordinates, the space {space.ndim} axes")


def draw_streamlines(
    paths: Sequence[Streamline],
    space: ConfigurationSpace,
    plane: Plane,
    axes: Axes,
    k: Sequence[float] | None = None,
) -> None:
    """Draw streamlines of a space with two axes, without touching limits or legend."""
    reached = [number for number, path in enumerate(paths) if path.outcome == Outcome.REACHED]
    kinds: Sequence[float | None] = [None] if k is None else sorted(set(k))
    for rank, kind in enumerate(kinds):
        mine = [paths[number] for number in reached if k is None or k[number] == kind]
        if mine:
            _draw_lines([plane.place(line) for path in mine for line in pieces(path, space)], axes, rank, _label(kind))
    if reached:
        _draw_ends([paths[number] for number in reached], plane, axes)
    _draw_failures([path for path in paths if path.outcome != Outcome.REACHED], plane, axes)


def pieces(path: Streamline, space: ConfigurationSpace) -> list[NDArray[np.float64]]:
    """Cut a streamline where it crosses a periodic seam.  Returns (n, ndim)."""
    points = path.axis_points
    if len(points) < 2:
        return []
    starts, ends = points[:-1], points[1:].copy()
    extent = np.where(space.periodic, space.upper - space.lower, np.inf)
    # A segment lies in the cell of its first point: of the copies of its end, take the one in that cell.
    ends -= np.where(space.periodic, extent, 0.0) * np.round((ends - space.axis_centre(path.point_cells[:-1])) / extent)
    torn = np.flatnonzero(np.any(np.abs(ends[:-1] - starts[1:]) > 0.5 * extent, axis=1)) + 1
    bounds = [0, *torn.tolist(), len(starts)]
    return [np.concatenate([starts[first:last], ends[last - 1 : last]]) for first, last in pairwise(bounds)]


def _label(k: float | None) -> str:
    if k is None:
        return "path"
    kind = {0.0: " (Neumann)", 1.0: " (Dirichlet)"}.get(k, "")
    return f"$k$ = {k:g}{kind}"


def _draw_lines(lines: list[NDArray[np.float64]], axes: Axes, rank: int, label: str) -> None:
    few = len(lines) <= _FEW
    width = 1.5 if few else 0.5
    effects: list[Any] = [Stroke(linewidth=width + 1.4, foreground="white"), Normal()] if few else []
    axes.add_collection(
        LineCollection(
            lines,
            colors=PATHS[rank % len(PATHS)],
            linestyles=[LINE_STYLES[rank % len(LINE_STYLES)]] if few else "solid",
            linewidths=width,
            alpha=1.0 if few else 0.6,
            path_effects=effects,
            label=label,
            zorder=4,
        ),
        autolim=False,
    )


def _draw_ends(paths: list[Streamline], plane: Plane, axes: Axes) -> None:
    few = len(paths) <= _FEW
    starts = plane.place(np.unique([path.axis_points[0] for path in paths], axis=0))
    ends = plane.place(np.unique([path.axis_points[-1] for path in paths], axis=0))
    axes.scatter(
        starts[:, 0], starts[:, 1], s=22 if few else 1.5, marker="o", facecolor="white" if few else "black",
        edgecolor="black", linewidth=0.9 if few else 0.0, label="start", zorder=5,
    )  # fmt: skip
    axes.scatter(
        ends[:, 0], ends[:, 1], s=70 if few else 8, marker="*", facecolor=GOAL, edgecolor="black",
        linewidth=0.7 if few else 0.2, label="goal reached", zorder=6,
    )  # fmt: skip


def _draw_failures(paths: list[Streamline], plane: Plane, axes: Axes) -> None:
    for outcome, count in sorted(Counter(path.outcome for path in paths).items()):
        starts = plane.place(np.array([path.axis_points[0] for path in paths if path.outcome == outcome]))
        axes.scatter(
            starts[:, 0], starts[:, 1], s=34 if count <= _FEW else 4, marker="x", color=FAILURE, linewidth=1.6,
            label=f"{outcome.value.replace('_', ' ')} ({count} start{'s' if count > 1 else ''})", zorder=6,
            path_effects=[Stroke(linewidth=3.0, foreground="white"), Normal()] if count <= _FEW else [],
        )  # fmt: skip
