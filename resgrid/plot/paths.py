"""Pictures of paths in configuration space, of what separates a start from the goals, and of clearance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError
from resgrid.planning.planner import ClearanceCurve
from resgrid.planning.separation import SceneSeparation, Separation
from resgrid.planning.streamline import Outcome, Streamline
from resgrid.plot.fields import draw_plane_space
from resgrid.plot.figures import axes_or_new
from resgrid.plot.plane import Plane, finish, paint_cells, plane_of
from resgrid.plot.slices import Slice
from resgrid.plot.style import FAILURE, GOAL, LINE_STYLES, PATHS, TEXT, dress, mark, refresh_legend
from resgrid.space import Cell, ConfigurationSpace

_FEW = 40
_REGION = "#9ecae1"
_REACHABLE, _SEPARATING = "can be reached from the start", "must go for a goal to be reached"


def draw_plane_paths(paths: Sequence[Streamline], ax: Axes | None = None, *, k: Sequence[float] | None = None) -> Axes:
    """Draw streamlines in a space of two axes; see `resgrid.plot.pages.draw_streamlines`."""
    space = paths[0].space
    plane = plane_of(space)
    axes = draw_plane_space(space) if ax is None else ax
    reached = [path for path in paths if path.outcome == Outcome.REACHED]
    for rank, (blend, own) in enumerate(by_blend(paths, k)):
        if own:
            _draw_lines([plane.place(line) for path in own for line in seam_pieces(path)], axes, rank, blend)
    if reached:
        _draw_ends(reached, plane, axes)
    _draw_failures([path for path in paths if path.outcome != Outcome.REACHED], plane, axes)
    finish(plane, axes, [path.axis_points for path in paths])
    return axes


def by_blend(paths: Sequence[Streamline], k: Sequence[float] | None) -> list[tuple[float | None, list[Streamline]]]:
    """Every k in ascending order, None where none is given, and those of its paths that reach a goal."""
    if k is not None and len(k) != len(paths):
        raise InputError(f"{len(k)} values of k for {len(paths)} paths; give one for each")
    if paths:
        require_paths(paths, paths[0].space)
    blends: Sequence[float | None] = [None] * len(paths) if k is None else k
    return [
        (
            blend,
            [path for path, at in zip(paths, blends, strict=True) if at == blend and path.outcome == Outcome.REACHED],
        )
        for blend in sorted(set(blends), key=lambda blend: blend or 0.0)
    ]


def blend_label(k: float | None) -> str:
    """What a legend calls the paths of one k."""
    kind = {0.0: " (Neumann)", 1.0: " (Dirichlet)"}.get(-1.0 if k is None else k, "")
    return "path" if k is None else f"$k$ = {k:g}{kind}"


def draw_in_slice(
    lines: Sequence[NDArray[np.float64]], part: Slice, axes: Axes, *, colour: str = PATHS[0], label: str = "path"
) -> None:
    """Draw lines of three axes, shape (n, 3) in axis units: faintly, and boldly where the slice holds them."""
    for line in lines:
        inside, seen = part.holds(line), part.seen(line)
        axes.plot(*seen.T, color=colour, linewidth=0.7, alpha=0.7, zorder=4, label=f"{label}, projected")
        if inside.any():
            bold = np.where(inside[:, None], seen, np.nan)
            axes.plot(*bold.T, color=colour, linewidth=2.2, zorder=5, label=f"{label} in the slice")


def mark_outcome(path: Streamline, place: ArrayLike, axes: Axes) -> None:
    """Mark where a path starts on paper: a disc, or a cross that names why it leads nowhere."""
    reached = path.outcome == Outcome.REACHED
    mark(place, axes, "start" if reached else "failure", None if reached else path.outcome.value.replace("_", " "))


def require_paths(paths: Sequence[Streamline], space: ConfigurationSpace) -> None:
    """Refuse streamlines of a space with another number of axes."""
    for number, path in enumerate(paths):
        if path.axis_points.shape[1:] != (space.ndim,):
            raise InputError(f"path {number} has {path.axis_points.shape[-1]} coordinates, the space {space.ndim} axes")


def seam_pieces(path: Streamline) -> list[NDArray[np.float64]]:
    """Cut a streamline where it crosses a periodic seam.  Returns (n, ndim)."""
    points, space = path.axis_points, path.space
    if len(points) < 2:
        return []
    starts, ends = points[:-1], points[1:].copy()
    extent = np.where(space.periodic, space.upper - space.lower, np.inf)
    # A segment lies in the cell of its first point: of the copies of its end, take the one in that cell.
    ends -= np.where(space.periodic, extent, 0.0) * np.round((ends - space.axis_centre(path.point_cells[:-1])) / extent)
    torn = np.flatnonzero(np.any(np.abs(ends[:-1] - starts[1:]) > 0.5 * extent, axis=1)) + 1
    bounds = [0, *torn.tolist(), len(starts)]
    return [np.concatenate([starts[first:last], ends[last - 1 : last]]) for first, last in pairwise(bounds)]


def _draw_lines(lines: list[NDArray[np.float64]], axes: Axes, rank: int, k: float | None) -> None:
    few = len(lines) <= _FEW
    width = 1.5 if few else 0.5
    effects: list[Any] = [Stroke(linewidth=width + 1.4, foreground="white"), Normal()] if few else []
    drawn = LineCollection(
        lines, colors=PATHS[rank % len(PATHS)], linestyles=[LINE_STYLES[rank % len(LINE_STYLES)]] if few else "solid",
        linewidths=width, alpha=1.0 if few else 0.6, path_effects=effects, zorder=4,
        label=blend_label(k),
    )  # fmt: skip
    axes.add_collection(drawn, autolim=False)


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


def separated(result: Separation | SceneSeparation) -> list[tuple[NDArray[np.bool_], str, str]]:
    """Masks of what a separation is about, the colour of each, and its name."""
    reachable = result.region & (result.space.cell == Cell.FREE)
    return [(reachable, _REGION, _REACHABLE), (result.mask, FAILURE, _SEPARATING)]


def draw_plane_separation(
    result: Separation | SceneSeparation, ax: Axes | None = None, *, virtual: NDArray[np.bool_] | None = None
) -> Axes:
    """Draw a separation in a space of two axes; see `resgrid.plot.pages.draw_separation`."""
    space = result.space
    axes = draw_plane_space(space, ax, virtual=virtual)
    for mask, colour, label in separated(result):
        paint_cells(plane_of(space), mask, colour, label, axes)
    x, y = space.centre(result.start)
    reached = result.outcome is Outcome.REACHED
    axes.scatter(
        x, y, s=34, marker="o" if reached else "X", facecolor="white", edgecolor="black", linewidth=0.9, zorder=6,
        label=f"start: {result.outcome.value.replace('_', ' ')}",
    )  # fmt: skip
    refresh_legend(axes, columns=2)
    return axes


def draw_clearance_curve(curve: ClearanceCurve, ax: Axes | None = None, *, unit: str = "", cell: float = 0.0) -> Axes:
    """Draw the mean clearance of paths against k or the wall resistance, with the spread between starts.

    A bar of half a cell's width, if that is given, shows how small a difference means nothing.
    """
    axes = axes_or_new(ax, 0.7)
    part = curve.clearance[:, curve.counted]
    low, high = np.percentile(part, [25, 75], axis=1)
    axes.fill_between(curve.value, low, high, color=PATHS[3], alpha=0.18, linewidth=0, label="half of the starts")
    axes.plot(
        curve.value, curve.mean, color=PATHS[3], marker="o", markersize=3.5, linewidth=1.4,
        label=f"mean of {int(curve.counted.sum())} starts",
    )  # fmt: skip
    if cell:
        axes.errorbar(
            0.93 if curve.knob == "k" else 0.07, low.min() + cell / 4, yerr=cell / 4, color="black", linewidth=0.9,
            capsize=2.5, label="half a cell", transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    suffix = f" ({unit})" if unit else ""
    axes.set_xlabel("$k$ (0 Neumann, 1 Dirichlet)" if curve.knob == "k" else "wall resistance (Ω)", fontsize=TEXT)
    axes.set_ylabel(f"clearance of the path{suffix}", fontsize=TEXT)
    if curve.knob != "k" and (curve.value[np.isfinite(curve.value)] > 0).sum() > 1:
        axes.set_xscale("symlog", linthresh=float(curve.value[curve.value > 0].min()))
        axes.xaxis.set_major_locator(FixedLocator(curve.value[np.isfinite(curve.value)].tolist()))
        axes.xaxis.set_minor_locator(NullLocator())
    dress(axes)
    axes.legend(fontsize=TEXT - 1, frameon=False)
    return axes
