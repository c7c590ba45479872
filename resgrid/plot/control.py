"""Pictures of control: runs with contact forces and learnt cells, velocities at a contact, blends, and wavefronts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import ArrayLike, NDArray

from resgrid.control.controller import make_controller
from resgrid.control.equipotential import following_velocity
from resgrid.control.external_forces import checked_force
from resgrid.control.plant import plant_of
from resgrid.control.run_log import ContactLog, ControlMode, Run, TerminationReason
from resgrid.control.wavefronts import Wavefront
from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.planning.blend import dirichlet_fraction
from resgrid.planning.fields import Field
from resgrid.planning.trace import streamline
from resgrid.plot.figures import PAGE, add_title, axes_or_new, caption_height, new_figure, panel_height
from resgrid.plot.images import draw_shading
from resgrid.plot.panels import draw_space
from resgrid.plot.plane import draw_cells, draw_image, finish, paint, plane_of, seam_shifts, wrapped
from resgrid.plot.shading import shading_of
from resgrid.plot.style import FAILURE, HIDDEN, PATHS, SMALL, TEXT, add_colour_bar, blend_styles, mark, refresh_legend
from resgrid.plot.workspace import draw_robot
from resgrid.scene.scene import Scene

MODES: dict[ControlMode, tuple[str, Any, str]] = {
    ControlMode.STREAMLINE: ("#0072B2", "-", "follows its streamline"),
    ControlMode.PUSHED: ("#CC79A7", "-", "is pushed"),
    ControlMode.SLIDING: ("#D55E00", "-", "slides along an obstacle"),
    ControlMode.STICKING: (FAILURE, "-", "touches an obstacle and sticks"),
    ControlMode.FOLLOWING: ("#E69F00", "-", "follows the equipotential along an obstacle"),
    ControlMode.JAM: (FAILURE, "-", "is jammed: the force lies along the streamline"),
    ControlMode.LEARNING: ("#000000", "-", "learns what it touched"),
    ControlMode.RETREATING: ("#000000", (0, (2, 1)), "goes back the way it came"),
    ControlMode.RECOVERING: ("#009E73", "-", "leaves an obstacle cell"),
    ControlMode.DITHERING: ("#56B4E9", (0, (1, 1)), "shakes itself loose"),
    ControlMode.WAITING: (FAILURE, (0, (1, 1)), "waits for the grid to settle"),
    ControlMode.ARRIVED: ("#0072B2", "-", "has arrived"),
    ControlMode.HOMING: ("#0072B2", (0, (4, 1)), "goes straight to the goal in its cell"),
}
"""Colour, line style and description of the robot's motion for every control mode."""

LEARNT = "#D55E00"
FORCE = "#B2182B"
_HIDDEN_CELLS = "#e3bcbc"
_FORCE_LENGTH = 0.12
"""Length of the arrow of the largest contact force, as a fraction of the width of the axes."""

_MOST_ARROWS = 8
"""Largest number of contact forces in the picture of a run; of more forces, evenly spaced ones are drawn."""
_FAINT = 1e-4
"""Limit between the linear and the logarithmic part of the colour scale of changes of the potential.

It is a fraction of the upper limit of the scale, which is the 99.5th percentile of the magnitudes of the changes at all
times. The scale is linear for smaller changes of both signs.
"""


def draw_run(run: Run, *, title: str = "", caption: str = "") -> Figure:
    """Draw a run (simulated motion under control) in the workspace and, if it has two axes, in configuration space.

    The workspace shows poses and contact forces, the configuration space the path.  The colours of the path show the
    control modes; learnt obstacle cells are circled.  `title`, `caption`: texts above the figure.  Returns the figure.
    """
    flat = run.space.ndim == 2
    height = panel_height(PAGE / 2 - 0.6, panel_aspect(run)) + 0.4 + caption_height(caption)
    figure = new_figure(PAGE, height)
    left = figure.add_subplot(1, 2, 1) if flat else figure.add_subplot()
    draw_robot(without_rests(run.configuration), scene_of(run), left)
    count = len(run.contacts.step)
    some = np.unique(np.linspace(0, count - 1, min(count, _MOST_ARROWS)).astype(np.int64))
    draw_forces(run.contacts, some, left, label="contact force")
    refresh_legend(left)
    if flat:
        draw_configurations(run, figure.add_subplot(1, 2, 2))
    add_title(figure, title, caption)
    return figure


def draw_runs(runs: Sequence[Run], *, title: str = "", caption: str = "") -> Figure:
    """Draw runs (simulated motions under control) of one scene at several weights k of the Dirichlet field.

    The panels show paths of the reference point in the workspace, and paths in configuration space.  `title`,
    `caption`: texts above the figure.  Returns the figure.
    """
    runs = sorted(runs, key=lambda run: run.field.k)
    figure = new_figure(PAGE, panel_height(PAGE / 2 - 0.6, 1.0) + 0.5 + caption_height(caption))
    left, right = figure.subplots(1, 2)
    scene = scene_of(runs[0])
    draw_robot(runs[0].configuration[:1], scene, left, ghosts=1)
    draw_configurations(runs[0], right, path=False)
    for run, style in zip(runs, blend_styles([run.field.k for run in runs]), strict=True):
        style |= {"solid_capstyle": "butt"}
        label = f"k = {run.field.k:g}" + (
            "" if run.ending is TerminationReason.ARRIVED else f" ({run.ending})"
        ).replace("_", " ")
        path = without_rests(run.configuration)
        tip = scene.robot.reference_point(path)
        left.plot(*tip.T, zorder=6, label=label, **style)
        for shift in seam_shifts(run.space):
            right.plot(*(path + shift).T, zorder=4, label=label, **style)
    for axes in (left, right):
        refresh_legend(axes)
    add_title(figure, title, caption)
    return figure


def scene_of(run: Run) -> Scene:
    """Return the scene of a run; raise InputError if the run was created from a field without a scene."""
    if run.scene is None:
        raise InputError("this run has no scene, so its workspace is unknown; create it by simulation(scene)")
    return run.scene


def panel_aspect(run: Run) -> float:
    """Return height over width of a panel of a run's picture: height over width of the grid, or 1.

    The result is 1 unless the space has two axes and they are positions in the plane, as for a point or a disc.
    """
    flat = run.space.ndim == 2 and scene_of(run).robot.moves_in_workspace
    return plane_of(run.space).aspect if flat else 1.0


def draw_forces(contacts: ContactLog, rows: NDArray[np.int64], axes: Axes, **style: Any) -> list[Artist]:
    """Draw arrows of the contact forces on the robot; return the artists, an empty list if `rows` is empty.

    The largest force in the whole log has an arrow of 12 % of the width of the axes.  `contacts`: log of contacts;
    `rows` (n,): indices of the contacts to draw; `style`: options of matplotlib's quiver.
    """
    if not len(rows):
        return []
    left, right = axes.get_xlim()
    scale = _FORCE_LENGTH * (right - left) / float(np.hypot(*contacts.force.T).max())
    arrows = axes.quiver(
        *contacts.point[rows].T, *(contacts.force[rows] * scale).T, color=FORCE, angles="xy", scale_units="xy",
        scale=1.0, width=0.006, zorder=9, **style,
    )  # fmt: skip
    return [arrows]


def draw_configurations(run: Run, axes: Axes, *, path: bool = True) -> None:
    """Draw a run in a configuration space of two axes, with known, hidden and learnt obstacle cells.

    Hidden obstacles are missing from the robot's map; learnt cells were added to the map after a contact.  `axes`: axes
    to draw on; `path`: whether to draw the path, in the colours of its control modes, and circles around learnt cells.
    """
    if run.space.ndim != 2:
        raise InputError(f"this picture needs a configuration space of two axes, but this run has {run.space.ndim}")
    learnt = run.learnt
    scene = scene_of(run)
    plant = plant_of(scene)
    known = run.space.with_cells(np.where(learnt, np.uint8(Cell.FREE), run.space.cell))
    obstacle = known.cell == Cell.OBSTACLE
    virtual = None
    if (bare := scene.robot.bare()) != scene.robot:
        touched = bare.occupancy(scene.axes, plant.obstacles[: plant.known], "conservative")
        virtual = plant.self_blocked & obstacle & ~touched
    draw_space(known, axes, virtual=virtual)
    hidden = (plant.true_space(known).cell == Cell.OBSTACLE) & ~obstacle
    paint(plane_of(known), axes, (hidden, _HIDDEN_CELLS, "hidden obstacle"))
    if path:
        _draw_path(run, axes)
        if learnt.any():
            draw_lessons(run.space.centre(np.argwhere(learnt)), axes)
    axes.set_title("Configuration space", fontsize=TEXT)
    refresh_legend(axes)


def without_rests(configuration: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the first row of `configuration` (n, ndim) and all rows that differ from the row before; (m, ndim)."""
    keep = np.ones(len(configuration), dtype=np.bool_)
    keep[1:] = np.any(np.diff(configuration, axis=0) != 0.0, axis=1)
    return configuration[keep]


def _draw_path(run: Run, axes: Axes) -> None:
    """Draw the path of a run in the colours of its control modes, with copies across periodic seams, and its ends."""
    path, space = run.configuration, run.space
    own = [(shift, space.from_world(path + shift)) for shift in seam_shifts(space)]
    copies = [shift for shift, at in own if np.any(np.all((at >= space.lower) & (at <= space.upper), axis=-1))]
    for shift in copies:
        axes.plot(*(path + shift).T, color="white", linewidth=3.0, zorder=3.8)
    steps = np.stack([path[:-1], path[1:]], axis=1)
    moves = np.any(steps[:, 0] != steps[:, 1], axis=1)
    for mode, (colour, line, _) in MODES.items():
        chosen = steps[moves & (run.mode[:-1] == mode)]
        if len(chosen):
            lines = list(np.concatenate([chosen + shift for shift in copies]))
            axes.add_collection(LineCollection(lines, colors=colour, linestyles=[line], linewidths=1.7, zorder=4.2))
            axes.plot([], [], color=colour, linestyle=line, linewidth=1.7, label=mode.name.lower())
    taught = wrapped(path[[lesson.step for lesson in run.lessons]], space)
    if len(taught):
        axes.scatter(taught[:, 0], taught[:, 1], s=12, marker="D", color="black", zorder=5, label="learning")
    ends = wrapped(path[[0, -1]], space)
    mark(ends[:1], axes, "start")
    if run.ending is TerminationReason.ARRIVED:
        mark(ends[1:], axes, "end", "")
    else:
        mark(ends[1:], axes, "failure", str(run.ending).replace("_", " "))


def draw_lessons(centres: NDArray[np.float64], axes: Axes) -> Any:
    """Draw circles around learnt obstacle cells, which a contact added to the map; return the artist.

    `centres` (c, 2): centres of the cells in world coordinates.
    """
    return axes.scatter(
        centres[:, 0], centres[:, 1], s=9 if len(centres) < 60 else 5, marker="o", facecolor="none", edgecolor=LEARNT,
        linewidth=0.6, zorder=3, label="learnt cell",
    )  # fmt: skip


def draw_velocities(
    field: Field, point: ArrayLike, force: ArrayLike, admittance: ArrayLike, ax: Axes | None = None
) -> Axes:
    """Draw the velocities of harmonic control at a contact: figure 14 of Connolly & Grupen (1992).

    Parameters
    ----------
    field : Field
        Field of two axes.
    point, force : array_like of float, shape (2,)
        Configuration in world coordinates, and the generalised force of a contact at this configuration.
    admittance : array_like of float, shape (2, 2)
        Matrix that maps the force to a velocity.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Axes with the equipotential and the streamline at the point, the force ``F``, the nominal velocity ``V0``, the
        response ``A F`` of the admittance ``A``, ``V = V0 + A F``, and the velocity along the equipotential.

    Raises
    ------
    InputError
        If the space does not have two axes, or `make_controller` rejects a value.

    Examples
    --------
    >>> field = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.5).field
    >>> ax = rg.plot.draw_velocities(field, (0.7, 6.0), force=(0.1, 0.2), admittance=np.eye(2))
    """
    plane = plane_of(field.space)
    at, push = np.asarray(point, dtype=np.float64), checked_force(force, 2, "the force")
    controller = make_controller(field, admittance=admittance)
    nominal = controller.nominal(at).velocity
    response = controller.admittance @ push
    axes = axes_or_new(ax, plane.aspect)
    shading = shading_of(field)
    draw_shading(plane, shading, shading.values, axes).set_alpha(0.35)
    draw_cells(plane, axes)
    height = np.ma.masked_invalid(shading.values)
    level = shading.values[tuple(field.space.locate(at))]
    axes.contour(*plane.centres, height, levels=[level], colors="black", linewidths=1.6, zorder=3)
    axes.plot([], [], color="black", linewidth=1.6, label="equipotential of the robot")
    path = streamline(field, at)
    axes.plot(*path.points.T, color="black", linewidth=1.2, linestyle=(0, (4, 2)), zorder=4, label="streamline")
    scale = 0.22 * float((field.space.upper - field.space.lower).max()) / controller.speed
    along = following_velocity(nominal, push)
    _arrow(axes, at, nominal * scale, PATHS[3], "nominal velocity $V_0$")
    _arrow(axes, at, push * (0.8 * scale * controller.speed / float(np.linalg.norm(push))), FAILURE, "force $F$")
    _arrow(axes, at + nominal * scale, response * scale, PATHS[2], "response $AF$")
    _arrow(axes, at, (nominal + response) * scale, PATHS[4], "$V = V_0 + AF$")
    _arrow(axes, at, along * scale, PATHS[0], r"along the equipotential, $v_\phi$")
    axes.scatter(at[:1], at[1:], s=26, color="black", zorder=8, label="robot")
    finish(plane, axes)
    return axes


def _arrow(axes: Axes, tail: NDArray[np.float64], vector: NDArray[np.float64], colour: str, label: str) -> None:
    """Draw an arrow; `tail` (2,): start; `vector` (2,): direction and length, both in the units of the axes."""
    axes.quiver(
        tail[:1], tail[1:], vector[:1], vector[1:], color=colour, angles="xy", scale_units="xy", scale=1.0,
        width=0.011, zorder=7, label=label,
    )  # fmt: skip


def draw_dirichlet_fraction(dirichlet: Field, neumann: Field, k: float, ax: Axes | None = None) -> Axes:
    """Draw the fraction of the Dirichlet gradient in the gradient of a blend, cell by cell.

    The fraction is ``|k grad phi_D| / (|k grad phi_D| + |(1 - k) grad phi_N|)``.  It differs from the weight k, because
    the gradients of the two fields differ in magnitude.

    Parameters
    ----------
    dirichlet, neumann : Field
        Fields of the same space with two axes.
    k : float
        Weight of the Dirichlet field, 0 to 1.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If the space does not have two axes, the fields do not belong together, or k is out of range.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), k=0.5)
    >>> ax = rg.plot.draw_dirichlet_fraction(planner.obstacle_field, planner.open_field, k=0.5)
    """
    plane = plane_of(dirichlet.space)
    axes = axes_or_new(ax, plane.aspect)
    share = np.where(dirichlet.space.goal_connected, dirichlet_fraction(dirichlet, neumann, k), np.nan)
    image = draw_image(plane, share, axes, cmap="PuOr_r", vmin=0.0, vmax=1.0, zorder=0.5)
    inside = np.ma.masked_invalid(share)
    if inside.count() and inside.min() < 0.5 < inside.max():
        axes.contour(*plane.centres, inside, levels=[0.5], colors="black", linewidths=0.8, zorder=1.5)
        axes.plot([], [], color="black", linewidth=0.8, label="both equal")
    draw_cells(plane, axes)
    finish(plane, axes)
    add_colour_bar(image, axes, rf"fraction of the Dirichlet gradient, $k$ = {k:g}")
    return axes


def draw_wavefront(front: Wavefront, *, shown: Sequence[int] | None = None) -> Figure:
    """Draw the spread of a map change through the grid, in one panel per time; return the figure.

    `shown`: indices of the times, counted from 0, by default at most six, evenly spaced.
    """
    plane_of(front.after)
    count = len(front.cells)
    rows = np.unique(np.linspace(0, count - 1, min(count, 6)).astype(int)) if shown is None else np.asarray(shown)
    if rows.dtype.kind not in "iu" or rows.ndim != 1 or not len(rows) or not np.all((rows >= 0) & (rows < count)):
        raise InputError(f"shown = {shown!r} must hold indices of the wavefront's times, 0 to {count - 1}")
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
    """Draw a wavefront at one time: change of the potential, obstacle and goal cells, and the new obstacle.

    `row`: index of the time in the wavefront; `axes`: axes to draw on.  Returns the image of the change.
    """
    plane = plane_of(front.after)
    image = draw_change(front, row, axes)
    draw_cells(plane, axes)
    new = (front.after.cell == Cell.OBSTACLE) & (front.before.cell != Cell.OBSTACLE)
    paint(plane, axes, (new, HIDDEN, "new obstacle"))
    finish(plane, axes, columns=0)
    return image


def draw_change(front: Wavefront, row: int, axes: Axes) -> AxesImage:
    """Draw the change of the potential since the map changed, with the time in the title; return the image.

    The change is the normalised potential minus the normalised potential before the map changed.
    `row`: index of the time in the wavefront; `axes`: axes to draw on.
    """
    changes = np.abs(front.potential - front.first)
    finite = changes[np.isfinite(changes)]
    limit = max(float(np.quantile(finite, 0.995)), 1e-12) if len(finite) else 1.0
    scale = SymLogNorm(limit * _FAINT, vmin=-limit, vmax=limit)
    change = front.potential[row] - front.first
    when, left = f"{front.cells[row]:.3g} cells crossed since the map changed", f"{front.distance[row]:.2g}"
    axes.set_title(f"{when}\n$\\phi$ within {left} of its settled values", fontsize=SMALL)
    return draw_image(plane_of(front.after), change, axes, cmap="RdBu_r", norm=scale, zorder=0.5)


def add_change_bar(image: AxesImage, axes: Axes) -> None:
    """Add the colour bar of a wavefront's image, with ticks at 0 and at the four largest powers of ten, of both signs.

    `image`: image with the symmetric logarithmic colour scale of `draw_change`; `axes`: axes of the image.
    """
    add_colour_bar(image, axes, r"change of $\phi$")
    largest = int(np.floor(np.log10(image.norm.vmax or 1.0)))
    decades = 10.0 ** np.arange(largest - 3, largest + 1)
    assert image.colorbar is not None
    image.colorbar.set_ticks([*-decades[::-1], 0.0, *decades])
