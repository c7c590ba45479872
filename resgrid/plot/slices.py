"""Spaces of three axes on paper: slices normal to one of them, or one normal to each, side by side under one legend."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.plot.figures import PAGE, new_figure, panel_height
from resgrid.plot.plane import Plane, draw_cells, finish, plane_slice
from resgrid.plot.style import SMALL, TEXT, axis_label
from resgrid.space import Cell, ConfigurationSpace

_PANELS = 6


@dataclass(frozen=True, eq=False)
class Slice:
    """The cells of one `index` along the axis `normal` of a space with three axes."""

    space: ConfigurationSpace
    normal: int
    index: int

    @cached_property
    def plane(self) -> Plane:
        """Where it lies on paper."""
        return plane_slice(self.space, self.normal, self.index)

    @property
    def title(self) -> str:
        """Which slice it is."""
        axis = self.space.axes[self.normal]
        name = axis_label(replace(axis, unit=""), of_map=self.plane.of_map)
        through_goal = bool(np.any(self.of(self.space.cell) == Cell.GOAL))
        return f"{name} = {axis.centres[self.index]:.3g} {axis.unit}{' (through a goal)' if through_goal else ''}"

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """What the slice holds of values of all cells."""
        return np.asarray(np.moveaxis(values, self.normal, 0)[self.index])

    def seen(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the space as seen along the normal, in axis units.  Shapes: `points` (n, 3); returns (n, 2)."""
        return np.delete(points, self.normal, axis=1)

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points lie in the slice."""
        lower, upper = self.space.axes[self.normal].edges[[self.index, self.index + 1]]
        return np.asarray((points[:, self.normal] >= lower) & (points[:, self.normal] <= upper))


def draw_in_slices(
    space: ConfigurationSpace,
    paint: Callable[[Slice, Axes], None],
    *,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
    through: Sequence[int] | None = None,
) -> Figure:
    """Draw the cells of slices, and what `paint` adds to each.

    `axis, indices`: the slices, by default one normal to each axis; `through`: a cell they hold, by default a goal's.
    """
    if space.ndim != 3:
        raise InputError(f"a space of {space.ndim} axes has no picture: fix an axis, and draw what is left")
    slices = [Slice(space, normal, index) for normal, index in _cuts(space, axis, indices, through)]
    columns = min(3, len(slices))
    rows = -(-len(slices) // columns)
    tallest = max(part.plane.aspect for part in slices)
    figure = new_figure(max(PAGE * columns / 3, 3.4), rows * (panel_height(PAGE / 3 - 0.6, tallest) - 0.5) + 0.9)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for part, panel in zip(slices, panels, strict=False):
        paint(part, panel)
        draw_cells(part.plane, panel)
        finish(part.plane, panel, columns=0)
        panel.set_title(part.title, fontsize=TEXT)
    for panel in panels[len(slices) :]:
        panel.set_axis_off()
    _add_legend(figure, panels[: len(slices)])
    return figure


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
