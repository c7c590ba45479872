"""Diagrams of control: velocities at a contact (figure 14), the share of Dirichlet in a blend, the settling grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import ArrayLike, NDArray

from resgrid.control.announced import Wavefront
from resgrid.control.controller import following_velocity, make_controller
from resgrid.errors import InputError
from resgrid.planning.blend import dirichlet_share
from resgrid.planning.fields import Field
from resgrid.planning.trace import streamline
from resgrid.plot.fields import draw_shading
from resgrid.plot.figures import PAGE, axes_or_new, new_figure
from resgrid.plot.plane import draw_cells, draw_image, finish, paint_cells, plane_of
from resgrid.plot.shading import shading_of
from resgrid.plot.style import FAILURE, HIDDEN, PATHS, SMALL, add_colour_bar
from resgrid.space import Cell

_FAINT = 1e-4
"""Change of the potential at which its colours begin, as a share of the largest one."""


def draw_velocities(
    field: Field, point: ArrayLike, force: ArrayLike, admittance: ArrayLike, ax: Axes | None = None
) -> Axes:
    """Draw what control does at one point: the diagram of figure 14 of Connolly & Grupen (1992).

    Parameters
    ----------
    field : Field
        Of two axes.
    point, force : array_like of float, shape (2,)
        A configuration in the world, and the generalised force of a contact there.
    admittance : array_like of float, shape (2, 2)
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes
        Equipotentials, the streamline, the force ``F``, the nominal velocity ``V0``, ``V = V0 + A F``, and the velocity
        along the equipotential.

    Raises
    ------
    InputError
        If the space does not have two axes, or a value is not as `make_controller` wants it.

    Examples
    --------
    >>> field = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.5).field
    >>> ax = rg.draw_velocities(field, (0.7, 6.0), force=(0.1, 0.2), admittance=np.eye(2))
    """
    plane = plane_of(field.space)
    at, push = np.asarray(point, dtype=np.float64), np.asarray(force, dtype=np.float64)
    if push.shape != (2,) or not np.isfinite(push).all():
        raise InputError(f"force = {push.tolist()} must be two finite numbers, in newtons")
    controller = make_controller(field, admittance=admittance)
    nominal = controller.nominal(at).velocity
    answer = controller.admittance @ push
    axes = axes_or_new(ax, plane.aspect)
    shading = shading_of(field)
    draw_shading(plane, shading, shading.values, axes).set_alpha(0.35)
    draw_cells(plane, axes)
    height = np.ma.masked_invalid(shading.values)
    level = shading.values[tuple(field.space.locate(at))]
    axes.contour(*plane.centres, height, levels=[level], colors="black", linewidths=1.6, zorder=3)
    axes.plot([], [], color="black", linewidth=1.6, label="the robot's equipotential")
    path = streamline(field, at)
    axes.plot(*path.points.T, color="black", linewidth=1.2, linestyle=(0, (4, 2)), zorder=4, label="streamline")
    scale = 0.22 * float((field.space.upper - field.space.lower).max()) / controller.speed
    along = following_velocity(nominal, push)
    _arrow(axes, at, nominal * scale, PATHS[3], "nominal velocity $V_0$")
    _arrow(axes, at, push * (0.8 * scale * controller.speed / float(np.linalg.norm(push))), FAILURE, "force $F$")
    _arrow(axes, at + nominal * scale, answer * scale, PATHS[2], "answer $AF$")
    _arrow(axes, at, (nominal + answer) * scale, PATHS[4], "$V = V_0 + AF$")
    _arrow(axes, at, along * scale, PATHS[0], r"along the equipotential, $v_\phi$")
    axes.scatter(at[:1], at[1:], s=26, color="black", zorder=8, label="robot")
    finish(plane, axes)
    return axes


def _arrow(axes: Axes, tail: NDArray[np.float64], vector: NDArray[np.float64], colour: str, label: str) -> None:
    axes.quiver(
        tail[:1], tail[1:], vector[:1], vector[1:], color=colour, angles="xy", scale_units="xy", scale=1.0,
        width=0.011, zorder=7, label=label,
    )  # fmt: skip


def draw_dirichlet_share(dirichlet: Field, neumann: Field, k: float, ax: Axes | None = None) -> Axes:
    """Draw where a blend is Dirichlet and where it is Neumann, whatever its weight says.

    Parameters
    ----------
    dirichlet, neumann : Field
        Of one space with two axes.
    k : float
    ax : matplotlib.axes.Axes, optional
        Made when None.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    InputError
        If the space does not have two axes, or as `dirichlet_share`.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.5)
    >>> ax = rg.draw_dirichlet_share(planner.obstacle_field, planner.open_field, k=0.5)
    """
    plane = plane_of(dirichlet.space)
    axes = axes_or_new(ax, plane.aspect)
    share = np.where(dirichlet.space.goal_connected, dirichlet_share(dirichlet, neumann, k), np.nan)
    image = draw_image(plane, share, axes, cmap="PuOr_r", vmin=0.0, vmax=1.0, zorder=0.5)
    inside = np.ma.masked_invalid(share)
    if inside.count() and inside.min() < 0.5 < inside.max():
        axes.contour(*plane.centres, inside, levels=[0.5], colors="black", linewidths=0.8, zorder=1.5)
        axes.plot([], [], color="black", linewidth=0.8, label="both equal")
    draw_cells(plane, axes)
    finish(plane, axes)
    add_colour_bar(image, axes, rf"share of the Dirichlet gradient, $k$ = {k:g}")
    return axes


def draw_wavefront(front: Wavefront, *, shown: Sequence[int] | None = None) -> Figure:
    """Draw how a change of the map spreads, as a row of pictures, one for each of the times shown, by default six."""
    plane_of(front.after)
    count = len(front.cells)
    rows = np.unique(np.linspace(0, count - 1, min(count, 6)).astype(int)) if shown is None else np.asarray(shown)
    if rows.dtype.kind not in "iu" or rows.ndim != 1 or not len(rows) or not np.all((rows >= 0) & (rows < count)):
        raise InputError(f"shown = {shown!r} must be at least one of the numbers of its times, 0 to {count - 1}")
    columns = min(len(rows), 3)
    lines = -(-len(rows) // columns)
    figure = new_figure(PAGE, 2.6 * lines + 0.4)
    for place, row in enumerate(rows.tolist(), 1):
        axes = figure.add_subplot(lines, columns, place)
        image = draw_moment(front, row, axes)
        if place % columns == 0 or place == len(rows):
            add_change_bar(image, axes)
        if place <= len(rows) - columns:
            axes.set_xlabel("")
        if place % columns != 1:
            axes.set_ylabel("")
    return figure


def draw_moment(front: Wavefront, row: int, axes: Axes) -> AxesImage:
    """One moment of a wavefront: how far the potential is from where it was."""
    plane = plane_of(front.after)
    image = draw_change(front, row, axes)
    draw_cells(plane, axes)
    new = (front.after.cell == Cell.OBSTACLE) & (front.before.cell != Cell.OBSTACLE)
    paint_cells(plane, new, HIDDEN, "new obstacle", axes)
    finish(plane, axes, columns=0)
    return image


def draw_change(front: Wavefront, row: int, axes: Axes) -> AxesImage:
    """What moves in a wavefront: the change of the potential since the map changed, and the title."""
    changes = np.abs(front.potential - front.first)
    finite = changes[np.isfinite(changes)]
    limit = max(float(np.quantile(finite, 0.995)), 1e-12) if len(finite) else 1.0
    scale = SymLogNorm(limit * _FAINT, vmin=-limit, vmax=limit)
    change = front.potential[row] - front.first
    when, left = f"{front.cells[row]:.3g} cells crossed since the map changed", f"{front.distance[row]:.2g}"
    axes.set_title(f"{when}\n$\\phi$ within {left} of its settled values", fontsize=SMALL)
    return draw_image(plane_of(front.after), change, axes, cmap="RdBu_r", norm=scale, zorder=0.5)


def add_change_bar(image: AxesImage, axes: Axes) -> None:
    """The colour bar of a wavefront, with a tick for every decade that stands clear of zero."""
    add_colour_bar(image, axes, r"change of $\phi$")
    largest = int(np.floor(np.log10(image.norm.vmax or 1.0)))
    decades = 10.0 ** np.arange(largest - 3, largest + 1)
    assert image.colorbar is not None
    image.colorbar.set_ticks([*-decades[::-1], 0.0, *decades])
