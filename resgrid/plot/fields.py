"""Pictures of spaces and fields in the plane: cells, potential with equipotentials, currents."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from resgrid.planning.fields import Field
from resgrid.plot.arrows import current_arrows
from resgrid.plot.blocks import block_means, block_size
from resgrid.plot.figures import axes_or_new
from resgrid.plot.ghosts import add_border, fill_open_walls
from resgrid.plot.plane import MOST_CELLS, Plane, draw_cells, draw_image, finish, plane_of
from resgrid.plot.shading import Shading, no_drop, shading_of, span
from resgrid.plot.style import NO_DROP, SMALL, add_swatch, height_map, refresh_legend, strength_map
from resgrid.space import ConfigurationSpace

_ARROWS = 26


def plot_space(space: ConfigurationSpace, ax: Axes | None = None) -> Axes:
    """Draw obstacles, goals, and the conductivity if there is one.

    Parameters
    ----------
    space : ConfigurationSpace
        Of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes.
    """
    plane = plane_of(space)
    axes = axes_or_new(ax, plane.aspect)
    if space.conductivity is not None:
        _draw_conductivity(plane, space.conductivity, axes)
    draw_cells(plane, axes)
    finish(plane, axes)
    refresh_legend(axes)
    return axes


def plot_potential(
    field: Field,
    ax: Axes | None = None,
    *,
    scale: str = "auto",
    contours: bool = True,
) -> Axes:
    """Draw the potential as an image with equipotential lines.

    Parameters
    ----------
    field : Field
        Of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.
    scale : {"auto", "linear", "log"}
        The potential, or decades of the drop from the high rail, which still tell cells apart where the potential
        rounds to 1; ``"auto"`` takes decades where the drop spans more than two.
    contours : bool
        Whether to draw equipotentials.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes, or the scale does not fit the field.
    """
    plane = plane_of(field.space)
    shading = shading_of(field, scale)
    axes = axes_or_new(ax, plane.aspect)
    image = draw_shading(plane, shading, shading.values, axes, contours=contours)
    draw_no_drop(plane, no_drop(field, shading), axes)
    draw_cells(plane, axes)
    finish(plane, axes)
    add_colour_bar(image, axes, shading.label)
    refresh_legend(axes)
    return axes


def plot_currents(field: Field, ax: Axes | None = None) -> Axes:
    """Draw the direction of the current by arrows of one length, and its magnitude by their colour.

    Parameters
    ----------
    field : Field
        Of two axes.
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes.
    """
    plane = plane_of(field.space)
    axes = axes_or_new(ax, plane.aspect)
    draw_cells(plane, axes)
    arrows = current_arrows(field, -(-plane.cells_shown // _ARROWS))
    if len(arrows.tail):
        position = plane.place(field.space.axis_centre(arrows.tail))
        vector = plane.turn(arrows.vector)
        quiver = axes.quiver(
            *position.T,
            *vector.T,
            arrows.decades,
            cmap=strength_map(),
            norm=_spanning(arrows.decades),
            angles="xy",
            scale_units="xy",
            scale=1.0,
            pivot="mid",
            units="dots",
            width=_shaft_width(axes, plane.cells_shown),
            zorder=3,
        )
        add_colour_bar(quiver, axes, r"$\log_{10}$ of current, in supply / $R$")
    finish(plane, axes)
    refresh_legend(axes)
    return axes


def draw_shading(
    plane: Plane, shading: Shading, values: NDArray[np.float64], axes: Axes, *, contours: bool = True
) -> AxesImage:
    """Draw values of a field in a plane, with equipotentials."""
    image = draw_image(
        plane, values, axes, cmap=shading.colours, vmin=shading.lower, vmax=shading.upper,
        zorder=0.5,
    )  # fmt: skip
    if contours:
        _draw_contours(plane, shading, values, axes)
    return image


def draw_no_drop(plane: Plane, where: NDArray[np.bool_], axes: Axes) -> None:
    """Colour the cells that stay at the high rail."""
    if where.any():
        draw_image(plane, np.where(where, 1.0, np.nan), axes, cmap=ListedColormap([NO_DROP]), zorder=1.0)
        add_swatch(axes, "at the high rail", NO_DROP)


def add_colour_bar(mappable: ScalarMappable, axes: Axes, label: str) -> None:
    """Add a colour bar beside the axes, as tall as they are."""
    bar = axes.figure.colorbar(mappable, cax=axes.inset_axes((1.03, 0.0, 0.035, 1.0)), extend=_beyond(mappable))
    bar.set_label(label, fontsize=SMALL)
    bar.ax.tick_params(labelsize=SMALL, width=0.6, length=2.5)
    bar.ax.yaxis.get_offset_text().set_fontsize(SMALL)


def _beyond(mappable: ScalarMappable) -> Literal["min", "neither"]:
    """Whether values lie below the colour scale."""
    values, lowest = mappable.get_array(), mappable.norm.vmin
    return "min" if values is not None and lowest is not None and np.min(values) < lowest else "neither"


def _draw_contours(plane: Plane, shading: Shading, values: NDArray[np.float64], axes: Axes) -> None:
    block = block_size(values.shape, MOST_CELLS)
    coarse = block_means(values, block)
    if shading.wall is None:
        coarse = fill_open_walls(coarse)
    coarse = add_border(coarse, shading.edge, shading.wall)
    finite = coarse[np.isfinite(coarse)]
    if not finite.size:
        return
    levels = shading.levels[(shading.levels > finite.min()) & (shading.levels < finite.max())]
    if not levels.size:
        return
    index = np.stack(np.meshgrid(*(np.arange(n) for n in coarse.shape), indexing="ij"), axis=-1)
    corner = np.array([plane.x.lower, plane.y.lower])
    spacing = np.array([plane.x.spacing, plane.y.spacing])
    where = plane.place(corner + (index - 0.5) * block * spacing)
    lines = axes.contour(
        where[..., 0], where[..., 1], np.ma.masked_invalid(coarse), levels=levels, colors="black", alpha=0.55,
        linewidths=0.5, linestyles="solid", zorder=1.5,
    )  # fmt: skip
    lines.set_clip_path(Polygon(plane.corners, transform=axes.transData))
    axes.add_line(Line2D([], [], color="black", alpha=0.55, linewidth=0.5, label=shading.lines))


def _draw_conductivity(plane: Plane, conductivity: NDArray[np.float64], axes: Axes) -> None:
    low, high = float(conductivity.min()), float(conductivity.max())
    norm = LogNorm(low, high) if high > 30 * low else Normalize(low, high if high > low else low + 1.0)
    image = draw_image(plane, conductivity, axes, cmap=height_map(), norm=norm, zorder=0.5)
    add_colour_bar(image, axes, "conductivity (relative)")


def _spanning(values: NDArray[np.float64]) -> Normalize:
    low, high = span(values)
    return Normalize(low, high if high > low else low + 1.0)


def _shaft_width(axes: Axes, cells: int) -> float:
    """Shaft of an arrow in dots: about a tenth of its length."""
    width: float = axes.get_window_extent().width
    return max(0.06 * width / min(cells, _ARROWS), 1.0)
