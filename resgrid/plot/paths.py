"""Pictures of paths in configuration space, of obstacles between a start and the goals, and of clearance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.any_field import FieldPath
from resgrid.planning.any_path import AnyPath, unwrap
from resgrid.planning.blocking_obstacles import SceneSeparation, Separation
from resgrid.planning.clearance_curves import ClearanceCurve
from resgrid.planning.short_path import ShortPath
from resgrid.planning.streamline import Outcome, Polyline
from resgrid.plot.figures import axes_or_new
from resgrid.plot.panels import Layer, Panel, draw_known, draw_panels, name_free_cells, painter, virtual_cells
from resgrid.plot.plane import at_small_goals, finish, seam_shifts
from resgrid.plot.space_view import subdivided
from resgrid.plot.style import FAILURE, FEW, PATHS, TEXT, blend_styles, dress, mark

_PIECES = 256
"""Number of pieces into which each segment of a polyline is divided for slices of a space with three or four axes."""
MOST_ENDS = 12
"""Largest number of paths whose end points are marked; with more paths, no ends are marked, as marks would hide the
goals."""

_REGION = "#9ecae1"
_REACHABLE, _SEPARATING = "reachable from the start", "to be removed for a path to a goal"


def draw_path(
    path: FieldPath, ax: Axes | None = None, *, axis: int | None = None, indices: Sequence[int] | None = None
) -> Axes | Figure:
    """Draw a streamline with its start and end; return the axes, or the figure of a space with more than two axes.

    `ax`: axes to draw on; None for a new figure that also shows the cells of the space; `axis`: number of the space's
    axis normal to the slices of a space with three or four axes, None for one slice for each pair of axes, through the
    end of the path; `indices`: cell indices of the slices along `axis`, by default at most six.
    """
    return draw_streamlines([path], ax, axis=axis, indices=indices)


def draw_streamlines(
    paths: Sequence[FieldPath],
    ax: Axes | None = None,
    *,
    k: Sequence[float] | None = None,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw streamlines with their starts and ends; return the axes, or the figure of a space with more than two axes.

    Streamlines of the same k have the same colour; a cross marks a start without a path to a goal.  `ax`: axes to draw
    on; None for a new figure that also shows the cells of the space; `k`: weight k of the Dirichlet field of each path,
    None for paths of one field; `axis`: number of the space's axis normal to the slices of a space with three or four
    axes, None for one slice for each pair of axes, through the end of the first path that reaches a goal; `indices`:
    cell indices of the slices along `axis`, by default at most six.
    """
    space = paths[0].space
    return draw_panels(
        space, ax, *_ground(space, ax), path_layer(paths, k), axis=axis, indices=indices, through=end_of_first(paths)
    )


def end_of_first(paths: Sequence[FieldPath]) -> list[int] | None:
    """Return the last cell (ndim,) of the first path that reaches a goal; None without such a path."""
    return next((path.cells[-1].tolist() for path in paths if path.outcome is Outcome.REACHED), None)


def _ground(space: ConfigurationSpace, ax: Axes | None) -> list[Layer]:
    """Return the layers drawn below paths: the cells of the space for a new figure, none on a given `ax`."""
    if ax is not None:
        return []
    return [draw_known] if space.undecided is None else [name_free_cells, draw_known]


def path_layer(paths: Sequence[FieldPath], k: Sequence[float] | None) -> Layer:
    """Return a function of a `Panel` that draws the paths that reach a goal, grouped by k, and all starts and ends.

    `paths`: streamlines; `k`: weight k of the Dirichlet field of each path, None for paths of one field.
    """
    groups, reached = by_blend(paths, k), [path for path in paths if path.outcome is Outcome.REACHED]
    failed = Counter(path.outcome for path in paths if path.outcome is not Outcome.REACHED)

    def ends(some: Sequence[FieldPath], panel: Panel, row: int) -> NDArray[np.float64]:
        return panel.seen(np.unique([path.axis_points[row] for path in some], axis=0))

    def layer(panel: Panel) -> None:
        styles = blend_styles([blend for blend, _ in groups])
        for rank, ((blend, own), style) in enumerate(zip(groups, styles, strict=True)):
            lines = [line for path in own for line in seam_pieces(path)]
            _draw_lines(lines, panel, blend_label(blend), is_cased=rank == 0, **style)
        if panel.cut and len(reached) <= MOST_ENDS:
            _frame_cells([cell for path in reached for cell in path.cells], panel)
        if reached:
            mark(ends(reached, panel, 0), panel.axes, "start")
        if 0 < len(reached) <= MOST_ENDS:
            last = ends(reached, panel, -1)
            middles = last if panel.plane is None or panel.cut else at_small_goals(panel.plane, last)
            mark(np.unique(middles, axis=0), panel.axes, "end", "goal reached")
        for outcome, count in sorted(failed.items()):
            label = f"{outcome.value.replace('_', ' ')} ({count} start{'s' if count > 1 else ''})"
            mark(ends([path for path in paths if path.outcome == outcome], panel, 0), panel.axes, "failure", label)
        if panel.plane is not None:
            finish(panel.plane, panel.axes, [panel.seen(path.axis_points) for path in paths], columns=0)

    return layer


def by_blend(paths: Sequence[FieldPath], k: Sequence[float] | None) -> list[tuple[float | None, list[FieldPath]]]:
    """Return a pair for each value of k: the value, and the list of the paths with this k that reach a goal.

    The pairs are in ascending order of k; a list is empty if all paths with this k fail.  `k`: weight k of the
    Dirichlet field of each path; None gives one pair with the value None and all paths that reach a goal.
    """
    if k is not None and len(k) != len(paths):
        raise InputError(f"{len(k)} values of k for {len(paths)} paths; give one for each")
    if paths:
        require_paths(paths, paths[0].space)
    blends: Sequence[float | None] = [None] * len(paths) if k is None else k
    groups: dict[float | None, list[FieldPath]] = {blend: [] for blend in sorted(set(blends), key=lambda b: b or 0.0)}
    for path, blend in zip(paths, blends, strict=True):
        if path.outcome is Outcome.REACHED:
            groups[blend].append(path)
    return list(groups.items())


def blend_label(k: float | None) -> str:
    """Return the legend entry of paths in a blend with Dirichlet weight `k`; "path" if `k` is None."""
    kind = {0.0: " (Neumann)", 1.0: " (Dirichlet)"}.get(-1.0 if k is None else k, "")
    return "path" if k is None else f"$k$ = {k:g}{kind}"


def _draw_lines(
    lines: list[NDArray[np.float64]], panel: Panel, label: str, *, color: str = PATHS[0],
    linestyle: str | tuple[int, tuple[float, ...]] = "-", linewidth: float = 1.5, is_cased: bool = True,
) -> None:  # fmt: skip
    """Draw lines in a panel; in a slice, draw thin projections of the lines, and bold parts inside the slice.

    `lines` (n, ndim): points of each line in axis units; `label`: legend entry; `is_cased`: whether the lines have a
    white outline; `color`, `linestyle`, `linewidth`: options of matplotlib's plot.
    """
    axes, colour = panel.axes, color
    if panel.cut:
        for line in lines:
            inside, seen = panel.holds(line), panel.seen(line)
            axes.plot(*seen.T, color=colour, linewidth=0.7, alpha=0.7, zorder=4, label=f"{label}, projected")
            if inside.any():
                bold = np.where(inside[:, None], seen, np.nan)
                axes.plot(*bold.T, color=colour, linewidth=2.2, zorder=5, label=f"{label} in the slice")
    elif lines:
        few = len(lines) <= FEW
        width = linewidth if few else 0.5
        effects: list[Any] = [Stroke(linewidth=width + 1.2, foreground="white"), Normal()] if few and is_cased else []
        drawn = LineCollection(
            [panel.seen(line) for line in lines], colors=colour, linewidths=width, alpha=1.0 if few else 0.6,
            linestyles=[linestyle] if few else "solid", path_effects=effects, zorder=4,
            label=label,
        )  # fmt: skip
        axes.add_collection(drawn, autolim=False)


def _frame_cells(cells: Sequence[NDArray[np.int64]], panel: Panel) -> None:
    """Draw the outlines of those cells, each (ndim,), that lie in the slice of a panel."""
    inside = [cell for cell in cells if all(cell[normal] == index for normal, index in panel.cut)]
    if panel.plane is None or not inside:
        return
    shown = np.delete(np.unique(inside, axis=0), panel.normals, axis=1)
    plane = panel.plane
    size = np.array([plane.x.spacing, plane.y.spacing])
    outlines = [Rectangle((plane.x.lower, plane.y.lower) + cell * size, *size) for cell in shown]
    panel.axes.add_collection(
        PatchCollection(
            outlines, facecolor="none", edgecolor="black", linewidth=0.8, zorder=4.5, label="cell of the path"
        ),
        autolim=False,
    )


def mark_outcome(path: FieldPath, place: ArrayLike, axes: Axes) -> None:
    """Mark the start of a path: a disc if the path reaches a goal, otherwise a cross with the outcome in the legend.

    `place` (2,): position of the mark, in coordinates of the picture.
    """
    reached = path.outcome == Outcome.REACHED
    mark(place, axes, "start" if reached else "failure", None if reached else path.outcome.value.replace("_", " "))


def require_paths(paths: Sequence[FieldPath], space: ConfigurationSpace) -> None:
    """Raise InputError if the number of coordinates of a streamline differs from the number of axes of the space."""
    for number, path in enumerate(paths):
        if path.axis_points.shape[1:] != (space.ndim,):
            raise InputError(
                f"path {number} has {path.axis_points.shape[-1]} coordinates, but the space has {space.ndim} axes; "
                "draw the paths of one space together"
            )


def seam_pieces(path: FieldPath) -> list[NDArray[np.float64]]:
    """Return the polylines (n, ndim) into which crossings of periodic seams divide a streamline, in axis units."""
    points, space = path.axis_points, path.space
    if len(points) < 2:
        return []
    starts, ends = points[:-1], points[1:].copy()
    extent = np.where(space.periodic, space.upper - space.lower, np.inf)
    # A segment lies in the cell of its first point, so its end is shifted by whole periods into that cell.
    ends -= np.where(space.periodic, extent, 0.0) * np.round((ends - space.axis_centre(path.point_cells[:-1])) / extent)
    torn = np.flatnonzero(np.any(np.abs(ends[:-1] - starts[1:]) > 0.5 * extent, axis=1)) + 1
    bounds = [0, *torn.tolist(), len(starts)]
    return [np.concatenate([starts[first:last], ends[last - 1 : last]]) for first, last in pairwise(bounds)]


def draw_line(
    path: Polyline | ShortPath,
    ax: Axes | None = None,
    *,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw a polyline with its start; return the axes, or the figure of a space with more than two axes.

    `ax`: axes to draw on; None for a new figure that also shows the cells of the space; `axis`: number of the space's
    axis normal to the slices of a space with three or four axes, None for one slice through a goal for each pair of
    axes; `indices`: cell indices of the slices along `axis`, by default at most six.
    """
    return draw_panels(path.space, ax, *_ground(path.space, ax), line_layer([path]), axis=axis, indices=indices)


def line_layer(paths: Sequence[AnyPath]) -> Layer:
    """Return a function of a `Panel` that draws paths, with their copies across periodic seams, and their starts."""
    drawn: list[tuple[list[NDArray[np.float64]], NDArray[np.float64]]] = []
    for path in paths:
        space, points = path.space, unwrap(path)
        copies = [space.from_world(points + shift) for shift in seam_shifts(space)] if len(points) > 1 else []
        lines = [subdivided(line, _PIECES) if space.ndim > 2 else line for line in copies]
        drawn.append((lines, space.from_world(points[:1])))

    def layer(panel: Panel) -> None:
        for lines, start in drawn:
            _draw_lines(lines, panel, "path")
            mark(panel.seen(start), panel.axes, "start")

    return layer


def draw_separation(
    result: Separation | SceneSeparation,
    ax: Axes | None = None,
    *,
    virtual: NDArray[np.bool_] | None = None,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw the cells reachable from a start, and the obstacle cells whose removal opens a path to a goal.

    Returns the axes, or the figure of a space with more than two axes.  `ax`: axes to draw on, by default those of a
    new figure; `virtual`: mask of obstacle cells that no body occupies, shape of the space, None for no such cells;
    `axis`: number of the space's axis normal to the slices of a space with three or four axes, None for one slice
    through the start for each pair of axes; `indices`: cell indices of the slices along `axis`, by default at most six.
    """
    space, outcome = result.space, result.outcome
    reachable = result.region & (space.cell == Cell.FREE)
    masks = [(reachable, _REGION, _REACHABLE), (result.mask, FAILURE, _SEPARATING)]

    def start(panel: Panel) -> None:
        x, y = panel.seen(space.axis_centre(result.start)[np.newaxis]).T
        panel.axes.scatter(
            x, y, s=34, marker="o" if outcome is Outcome.REACHED else "X", facecolor="white", edgecolor="black",
            linewidth=0.9, zorder=6, label=f"start: {outcome.value.replace('_', ' ')}",
        )  # fmt: skip

    layers = draw_known, painter(*virtual_cells(virtual), *masks), start
    return draw_panels(space, ax, *layers, axis=axis, indices=indices, through=result.start, columns=2)


def draw_clearance_curve(curve: ClearanceCurve, ax: Axes | None = None, *, unit: str = "", cell: float = 0.0) -> Axes:
    """Draw the mean clearance of paths against k or the wall resistance, with quartiles; return the axes.

    Mean and quartiles are taken over the starts that the curve counts.  `unit`: unit of the clearance; `cell`: width of
    a cell in this unit; an error bar of half this length shows the discretization error; 0 for no bar.
    """
    axes = axes_or_new(ax, 0.7)
    part = curve.clearance[:, curve.counted]
    low, high = np.percentile(part, [25, 75], axis=1)
    count = int(curve.counted.sum())
    axes.fill_between(
        curve.value, low, high, color=PATHS[3], alpha=0.18, linewidth=0, label=f"middle half of {count} starts"
    )
    axes.plot(
        curve.value, curve.mean, color=PATHS[3], marker="o", markersize=3.5, linewidth=1.4,
        label=f"mean of {count} starts",
    )  # fmt: skip
    if cell:
        axes.errorbar(
            0.93 if curve.parameter == "k" else 0.07, low.min() + cell / 4, yerr=cell / 4, color="black", linewidth=0.9,
            capsize=2.5, label="half a cell", transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    suffix = f" ({unit})" if unit else ""
    axes.set_xlabel("$k$ (0 Neumann, 1 Dirichlet)" if curve.parameter == "k" else "wall resistance (Ω)", fontsize=TEXT)
    axes.set_ylabel(f"clearance of the path{suffix}", fontsize=TEXT)
    if curve.parameter != "k" and (curve.value[np.isfinite(curve.value)] > 0).sum() > 1:
        axes.set_xscale("symlog", linthresh=float(curve.value[curve.value > 0].min()))
        axes.xaxis.set_major_locator(FixedLocator(curve.value[np.isfinite(curve.value)].tolist()))
        axes.xaxis.set_minor_locator(NullLocator())
    dress(axes)
    axes.legend(fontsize=TEXT - 1, frameon=False)
    return axes
