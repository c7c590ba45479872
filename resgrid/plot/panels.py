"""Spaces on paper, whatever their dimension: a strip, a plane, or slices side by side under one legend."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.plot.figures import PAGE, axes_or_new, new_figure, panel_height
from resgrid.plot.plane import (
    VIRTUAL,
    Plane,
    draw_cells,
    draw_image,
    finish,
    kinds_of,
    leading_on,
    paint_cells,
    plane_of,
    plane_slice,
)  # fmt: skip
from resgrid.plot.style import (
    PATHS,
    SMALL,
    TEXT,
    add_colour_bar,
    add_scale,
    axis_label,
    dress,
    height_map,
    refresh_legend,
    spanning,
)
from resgrid.space import Cell, ConfigurationSpace

_PANELS = 6
_CONDUCTIVITY = "conductivity (relative)"

Mask = tuple[NDArray[np.bool_], str, str]
"""Cells of a space, their colour and their name."""


@dataclass(frozen=True, eq=False)
class Panel:
    """What one ax shows: a space of one or two axes, or of three the cells `index` along the axis `normal`.

    `plane`: where that lies on paper; None of one axis.
    """

    space: ConfigurationSpace
    axes: Axes
    plane: Plane | None
    normal: int | None = None
    index: int = 0

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """What the panel holds of values of all cells."""
        return values if self.normal is None else np.asarray(np.moveaxis(values, self.normal, 0)[self.index])

    def seen(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points in axis units (n, ndim) on paper (n, 2); those of three axes as seen along the normal."""
        if self.plane is None:
            return np.column_stack([points, np.full(len(points), np.mean(self.axes.get_ylim()))])
        return self.plane.place(points if self.normal is None else np.delete(points, self.normal, axis=1))

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points (n, 3) lie in the slice."""
        assert self.normal is not None
        lower, upper = self.space.axes[self.normal].edges[[self.index, self.index + 1]]
        return np.asarray((points[:, self.normal] >= lower) & (points[:, self.normal] <= upper))

    def paint(self, mask: NDArray[np.bool_], colour: str, label: str) -> None:
        """Paint cells over whatever else there is, and name them in the legend, if there are any."""
        if self.plane is None:
            _draw_bands(self.space, self.axes, (mask, colour, label), 0.6)
        else:
            paint_cells(self.plane, self.of(mask), colour, label, self.axes)


def draw_panels(
    space: ConfigurationSpace,
    ax: Axes | None,
    paint: Callable[[Panel], None],
    *,
    over: bool = False,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
    through: Sequence[int] | None = None,
    columns: int = 3,
) -> Axes | Figure:
    """Draw a space on an ax, or in slices, and what `paint` adds to every panel.

    `over`: an ax that is given shows the space already; `axis, indices, through`: as `draw_in_slices` takes them;
    `columns`: of the legend.
    """
    if space.ndim <= 2:
        plane = plane_of(space) if space.ndim == 2 else None
        panel = Panel(space, axes_or_new(ax, 0.3 if plane is None else plane.aspect), plane)
        if ax is None or not over:
            _draw_known(panel)
        paint(panel)
        refresh_legend(panel.axes, columns)
        return panel.axes

    def whole(panel: Panel) -> None:
        _draw_known(panel)
        paint(panel)

    figure = draw_in_slices(space, ax, whole, axis=axis, indices=indices, through=through)
    if space.conductivity is not None:
        add_scale(figure, ScalarMappable(**_conductivity_style(space.conductivity)), _CONDUCTIVITY)
    return figure


def draw_space(
    space: ConfigurationSpace,
    ax: Axes | None = None,
    *,
    virtual: NDArray[np.bool_] | None = None,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw obstacles, goals, the conductivity if there is one; obstacle cells that stand for no body are paler."""

    def paint(panel: Panel) -> None:
        for mask in virtual_cells(virtual):
            panel.paint(*mask)

    return draw_panels(space, ax, paint, axis=axis, indices=indices)


def virtual_cells(virtual: NDArray[np.bool_] | None) -> list[Mask]:
    """How obstacle cells that stand for no body are painted, if it is known which."""
    return [] if virtual is None else [(virtual, VIRTUAL, "virtual obstacle")]


def draw_strip(space: ConfigurationSpace, axes: Axes) -> None:
    """Draw the cells of a space with one axis as bands."""
    for label, colour, where in kinds_of(space.cell, leading_on(space)):
        _draw_bands(space, axes, (where, colour, label), 0.5)
    axis = space.axes[0]
    axes.set(xlim=(axis.lower, axis.upper), xlabel=axis_label(axis))
    dress(axes)


def _draw_bands(space: ConfigurationSpace, axes: Axes, mask: Mask, order: float) -> None:
    where, colour, label = mask
    edges = space.axes[0].edges
    for index in np.flatnonzero(where).tolist():
        axes.axvspan(edges[index], edges[index + 1], color=colour, linewidth=0, label=label, zorder=order)


def _draw_known(panel: Panel) -> None:
    """The cells, and their conductivity if there is one: as colours, of one axis as a curve."""
    space, axes, plane = panel.space, panel.axes, panel.plane
    if plane is None:
        draw_strip(space, axes)
        axes.set_yticks([])
        if space.conductivity is not None:
            axes.plot(space.axes[0].centres, space.conductivity, "o-", markersize=3, linewidth=1.2, color=PATHS[3])
            axes.set_ylabel(_CONDUCTIVITY, fontsize=TEXT)
            axes.yaxis.set_major_locator(AutoLocator())
        return
    if space.conductivity is not None:
        colours = _conductivity_style(space.conductivity)
        image = draw_image(plane, panel.of(space.conductivity), axes, **colours, zorder=0.5)
        if panel.normal is None:
            add_colour_bar(image, axes, _CONDUCTIVITY)
    draw_cells(plane, axes)
    finish(plane, axes, columns=0)


def _conductivity_style(conductivity: NDArray[np.float64]) -> dict[str, Any]:
    """Colours and their scale for the conductivity of all cells of a space."""
    low, high = float(conductivity.min()), float(conductivity.max())
    return {"cmap": height_map(), "norm": LogNorm(low, high) if high > 30 * low else spanning(low, high)}


def draw_in_slices(
    space: ConfigurationSpace,
    ax: Axes | None,
    paint: Callable[[Panel], None],
    *,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
    through: Sequence[int] | None = None,
) -> Figure:
    """Draw what `paint` draws in slices of a space with three axes.

    `ax`: refused; `axis, indices`: the slices, by default one normal to each axis; `through`: a cell they hold, by
    default a goal's.
    """
    if space.ndim != 3:
        raise InputError(f"a space of {space.ndim} axes has no picture: fix an axis, and draw what is left")
    if ax is not None:
        raise InputError("what has 3 axes is drawn in several slices, not into one ax: leave ax out")
    cuts = _cuts(space, axis, indices, through)
    planes = [plane_slice(space, *cut) for cut in cuts]
    columns = min(3, len(cuts))
    rows = -(-len(cuts) // columns)
    height = panel_height(PAGE / 3 - 0.6, max(plane.aspect for plane in planes)) - 0.5
    figure = new_figure(max(PAGE * columns / 3, 3.4), rows * height + 0.9)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, plane, cut in zip(grid, planes, cuts, strict=False):
        panel = Panel(space, axes, plane, *cut)
        paint(panel)
        panel.axes.set_title(_title(panel), fontsize=TEXT)
    for unused in grid[len(cuts) :]:
        unused.set_axis_off()
    _add_legend(figure, grid[: len(cuts)])
    return figure


def _title(panel: Panel) -> str:
    """Which slice it is."""
    assert panel.normal is not None and panel.plane is not None
    axis = panel.space.axes[panel.normal]
    name = axis_label(replace(axis, unit=""), of_map=panel.plane.of_map)
    through_goal = " (through a goal)" if np.any(panel.plane.cell == Cell.GOAL) else ""
    return f"{name} = {axis.centres[panel.index]:.3g} {axis.unit}{through_goal}"


def _cuts(
    space: ConfigurationSpace, axis: int | None, indices: Sequence[int] | None, through: Sequence[int] | None
) -> list[tuple[int, int]]:
    """Axis and index of every slice."""
    goals = np.argwhere(space.cell == Cell.GOAL)
    middle = goals[0] if len(goals) else np.array(space.shape) // 2
    centre = middle if through is None else np.asarray(through)
    if axis is None:
        if indices is not None:
            raise InputError("indices of slices need the axis they count along")
        return [(normal, int(centre[normal])) for normal in (2, 1, 0)]
    if axis not in (0, 1, 2):
        raise InputError(f"axis = {axis}, but the space has axes 0, 1 and 2")
    size = space.shape[axis]
    if indices is None:
        spread = np.linspace(0, size - 1, min(_PANELS, size)).round().astype(int)
        spread[np.abs(spread - centre[axis]).argmin()] = centre[axis]
        indices = np.unique(spread).tolist()
    wrong = [index for index in indices if not 0 <= index < size]
    if wrong or not len(indices):
        raise InputError(f"slice {wrong[0] if wrong else '(none)'} is not one of the cells 0 to {size - 1} of the axis")
    return [(axis, int(index)) for index in indices]


def _add_legend(figure: Figure, panels: NDArray[np.object_]) -> None:
    entries: dict[str, Artist] = {}
    for panel in panels:
        handles, labels = panel.get_legend_handles_labels()
        entries.update(zip(labels, handles, strict=True))
    figure.legend(
        handles=list(entries.values()), labels=list(entries), loc="outside lower center", ncols=4, fontsize=SMALL,
        frameon=False, columnspacing=1.2,
    )  # fmt: skip
