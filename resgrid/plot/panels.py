"""Panels of a space's picture: a strip for one axis, a plane for two, slices with a common legend for more axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.plot.figures import PAGE, axes_or_new, figure_of, new_figure, panel_height
from resgrid.plot.plane import (
    Cut,
    Mask,
    PicturePlane,
    draw_cells,
    draw_image,
    finish,
    free_label,
    paint,
    plane_of,
    sliced,
    space_kinds,
    unknown_cells,
)
from resgrid.plot.slices import cuts_of, slice_title
from resgrid.plot.style import (
    FREE,
    LONG_LABEL,
    PATHS,
    SMALL,
    TEXT,
    add_colour_bar,
    add_swatch,
    axis_label,
    dress,
    refresh_legend,
    spanning,
    strength_map,
)

VIRTUAL = "#8c8c8c"
"""Colour of obstacle cells that no body occupies, such as cells near singularities of an arm."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One matplotlib axes of a picture: a space of one or two axes, or a slice of a space with more axes.

    `space`: the space; `axes`: matplotlib axes; `plane`: plane of the picture, None for one axis; `cut`: numbers of the
    axes normal to the slice with the cell index along each, empty without a slice.
    """

    space: ConfigurationSpace
    axes: Axes
    plane: PicturePlane | None
    cut: Cut = ()

    @property
    def normals(self) -> list[int]:
        """Numbers of the axes normal to the slice."""
        return [normal for normal, _ in self.cut]

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the cells in the panel: all values, or those of the slice.

        `values`: one value per cell, shape of the space.
        """
        return sliced(values, self.cut)

    def seen(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the picture coordinates (n, 2) of n points; in a slice, those of their projections on the slice.

        With one axis, the vertical coordinate is the middle of the panel.  `points` (n, ndim): in axis units.
        """
        if self.plane is None:
            return np.column_stack([points, np.full(len(points), np.mean(self.axes.get_ylim()))])
        return self.plane.frame.to_world(np.delete(points, self.normals, axis=1))

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return the mask (n,) of points inside the slice, which is one cell thick and includes both of its faces.

        `points` (n, ndim): in axis units.
        """
        inside = np.ones(len(points), dtype=np.bool_)
        for normal, index in self.cut:
            lower, upper = self.space.axes[normal].edges[[index, index + 1]]
            inside &= (points[:, normal] >= lower) & (points[:, normal] <= upper)
        return inside

    def paint(self, *masks: Mask, order: float = 2.2) -> None:
        """Paint masks of the space's cells above the image; masks with at least one cell get a legend entry.

        `masks`: mask (shape of the space), colour and legend entry of each; `order`: drawing order of matplotlib
        (zorder).
        """
        if self.plane is not None:
            own: list[Mask] = [(self.of(where), colour, label) for where, colour, label in masks]
            paint(self.plane, self.axes, *own, order=order)
            return
        edges = self.space.axes[0].edges
        for where, colour, label in masks:
            for left, right in zip(edges[:-1][where], edges[1:][where], strict=True):
                self.axes.axvspan(left, right, color=colour, linewidth=0, label=label, zorder=0.5)

    def draw_cells(self) -> None:
        """Draw obstacles, goals and free cells without a path to a goal, and set limits and labels of the panel."""
        if self.plane is not None:
            if self.cut and self.space.undecided is not None:  # the legend counts the cells outside of the slices too
                for where, colour, label in space_kinds(self.space):
                    if where.any():
                        add_swatch(self.axes, label, colour)
            draw_cells(self.plane, self.axes)
            finish(self.plane, self.axes, columns=0)
            return
        self.paint(*space_kinds(self.space), order=2.0)
        axis = self.space.axes[0]
        self.axes.set(xlim=(axis.lower, axis.upper), xlabel=axis_label(axis))
        self.axes.set_yticks([])
        dress(self.axes)

    def plot_curve(self, values: NDArray[np.float64], quantity: str, **style: Any) -> None:
        """Draw values (cells,) over the axis of a space with one axis.

        `quantity`: label of the vertical axis; `style`: options of matplotlib's plot.
        """
        centres = self.space.axes[0].centres
        self.axes.plot(centres, values, "o-", markersize=3, linewidth=1.2, color=PATHS[3], **style)
        self.axes.set_ylabel(quantity, fontsize=TEXT)
        self.axes.yaxis.set_major_locator(AutoLocator())


Layer = Callable[[Panel], tuple[ScalarMappable, str] | None]
"""Function that draws on a panel; it returns the image and the label of a colour bar, or None for no colour bar."""


def draw_panels(
    space: ConfigurationSpace,
    ax: Axes | None,
    *layers: Layer,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
    through: Sequence[int] | None = None,
    columns: int = 3,
    strip: float = 0.3,
) -> Axes | Figure:
    """Draw layers above each other on one matplotlib axes, or on each slice of a space with three or four axes.

    `ax`: axes to draw on, None for a new figure; `layers`: functions that draw on a panel; `axis`: number of the
    space's axis normal to the slices (with four axes they are also normal to the last of the other axes), None for one
    slice for each pair of axes; `indices`: cell indices of the slices along `axis`, by default at most six; `through`:
    cell (ndim,) that the slices contain, by default a goal cell; `columns`: largest number of legend columns of a space
    with one or two axes; `strip`: height over width of the picture of a space with one axis.  Returns the axes, or the
    figure of a space with more than two axes.
    """
    if space.ndim <= 2:
        plane = plane_of(space) if space.ndim == 2 else None
        panels = [Panel(space, axes_or_new(ax, strip if plane is None else plane.aspect), plane)]
    else:
        panels = _slices(space, ax, cuts_of(space, axis, indices, through))
    shown: Axes | Figure = panels[0].axes if space.ndim <= 2 else figure_of(panels[0].axes)
    for layer in layers:
        bars = [layer(panel) for panel in panels]
        if bars[0] is not None:
            colours, label = bars[0]
            add_colour_bar(colours, shown, label)
    if isinstance(shown, Axes):
        refresh_legend(shown, columns)
    else:
        add_figure_legend(shown, panels)
    return shown


def draw_known(panel: Panel) -> tuple[ScalarMappable, str] | None:
    """Draw the cells of a panel and the relative conductivity of the space: as colours, or as a curve for one axis.

    Returns the image and the label of its colour bar; None for one axis, and for a space without conductivities.
    """
    conductivity, label = panel.space.conductivity, "conductivity (relative)"
    if conductivity is None or panel.plane is None:
        panel.draw_cells()
        if conductivity is not None:
            panel.plot_curve(conductivity, label)
        return None
    low, high = float(conductivity.min()), float(conductivity.max())
    norm = LogNorm(low, high) if high > 30 * low else spanning(low, high)
    image = draw_image(
        panel.plane, panel.of(conductivity), panel.axes, cmap=strength_map().reversed(), norm=norm, zorder=0.5
    )
    panel.draw_cells()
    return image, label


def draw_space(
    space: ConfigurationSpace,
    ax: Axes | None = None,
    *,
    virtual: NDArray[np.bool_] | None = None,
    unknown: NDArray[np.bool_] | None = None,
    axis: int | None = None,
    indices: Sequence[int] | None = None,
) -> Axes | Figure:
    """Draw obstacles, goals and the conductivity of a space.

    Returns the axes, or the figure of a space with more than two axes.  `ax`: axes to draw on, by default those of a
    new figure; `virtual`: mask of obstacle cells that no body occupies, such as cells near singularities; `unknown`:
    mask of obstacle cells of unknown occupancy; both have colours of their own and the shape of the space, None for no
    such cells; `axis`: number of the space's axis normal to the slices of a space with three or four axes, None for
    one slice through a goal for each pair of axes; `indices`: cell indices of the slices along `axis`, by default at
    most six.
    """
    painted = painter(*virtual_cells(virtual), *unknown_cells(space.cell, unknown))
    return draw_panels(space, ax, name_free_cells, draw_known, painted, axis=axis, indices=indices)


def name_free_cells(panel: Panel) -> None:
    """Add a legend entry for free cells, unless they have the colours of the conductivity."""
    space = panel.space
    if space.conductivity is None and (panel.of(space.cell) == Cell.FREE).any():
        add_swatch(panel.axes, free_label(space), FREE)


def paint_unknown(picture: Axes | Figure, space: ConfigurationSpace, unknown: NDArray[np.bool_] | None) -> None:
    """Paint cells of unknown occupancy over the obstacles in every panel of a picture of a space with two axes.

    `unknown`: mask of these cells, shape of the space; None to leave the picture unchanged.  Pictures of spaces with
    other numbers of axes stay unchanged, too.
    """
    masks = unknown_cells(space.cell, unknown)
    for axes in figure_of(picture).axes if masks and space.ndim == 2 else ():
        if axes.get_legend() is not None:  # a colour bar has none
            paint(plane_of(space), axes, *masks)
            refresh_legend(axes)


def painter(*masks: Mask) -> Layer:
    """Return a function of a `Panel` that paints masks of cells.

    `masks`: tuples of a mask (shape of the space), the colour of its cells, and the legend entry.
    """
    return lambda panel: panel.paint(*masks)


def virtual_cells(virtual: NDArray[np.bool_] | None) -> list[Mask]:
    """Return a list with one tuple: mask of obstacle cells that no body occupies, its colour and its legend entry.

    The list is empty if `virtual`, this mask (shape of the space), is None.
    """
    return [] if virtual is None else [(virtual, VIRTUAL, "virtual obstacle")]


def _slices(space: ConfigurationSpace, ax: Axes | None, cuts: Sequence[Cut]) -> list[Panel]:
    """Return one panel of a new figure for each slice; raise InputError unless `ax` is None."""
    if ax is not None:
        raise InputError(f"a space with {space.ndim} axes is drawn in several slices and cannot use one ax; omit ax")
    planes = [plane_of(space, cut) for cut in cuts]
    columns = min(3, len(cuts))
    rows = -(-len(cuts) // columns)
    height = panel_height(PAGE / 3 - 0.6, max(plane.aspect for plane in planes)) - 0.5 + 0.15 * (space.ndim - 3)
    figure = new_figure(max(PAGE * columns / 3, 3.4), rows * height + 0.9)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for unused in grid[len(cuts) :]:
        unused.set_axis_off()
    panels = [Panel(space, axes, plane, cut) for axes, plane, cut in zip(grid, planes, cuts, strict=False)]
    for panel, plane in zip(panels, planes, strict=True):
        panel.axes.set_title(slice_title(space, plane, panel.cut), fontsize=TEXT)
    return panels


def add_figure_legend(figure: Figure, panels: list[Panel]) -> None:
    """Add one legend below a figure, with the entries of all panels."""
    entries: dict[str, Artist] = {}
    for panel in panels:
        handles, labels = panel.axes.get_legend_handles_labels()
        entries.update(zip(labels, handles, strict=True))
    columns = 4 if max(map(len, entries), default=0) < LONG_LABEL else 3
    figure.legend(
        handles=list(entries.values()), labels=list(entries), loc="outside lower center", ncols=columns, fontsize=SMALL,
        frameon=False, columnspacing=1.2,
    )  # fmt: skip
