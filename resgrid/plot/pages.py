"""One figure for a whole scene: potential and paths on the left, currents on the right."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from resgrid.errors import InputError
from resgrid.planning.fields import Field
from resgrid.planning.streamline import Streamline
from resgrid.plot.fields import plot_currents, plot_potential
from resgrid.plot.figures import new_figure, panel_height
from resgrid.plot.paths import plot_streamlines
from resgrid.plot.plane import PICTURES, plane_of
from resgrid.plot.profiles import plot_profile
from resgrid.plot.slices import plot_slices
from resgrid.plot.style import TEXT

_PAGE = 7.4
_WIDE = 0.55


def plot_scene_page(
    field: Field,
    paths: Sequence[Streamline] = (),
    *,
    k: Sequence[float] | None = None,
    title: str = "",
    scale: str = "auto",
) -> Figure:
    """Draw the overview of a scene, whatever its dimension.

    Two axes: obstacles, potential, equipotentials and paths beside the currents (below, where the map is wide).  One
    axis: a profile.  Three axes: slices through the goal.

    Parameters
    ----------
    field : Field
        Of one to three axes.
    paths : sequence of Streamline
        To draw on it.
    k : sequence of float, optional
        Blend of each path.
    title : str
        Above the figure.
    scale : {"auto", "linear", "log"}
        As in `plot_potential`.

    Returns
    -------
    matplotlib.figure.Figure
        17 to 19 cm wide, which a page of two columns bears unscaled.

    Raises
    ------
    InputError
        If the space has four axes; the message says which pictures there are.
    """
    if field.space.ndim > 3:
        raise InputError(
            f"a space of {field.space.ndim} axes has no overview; fix an axis and draw what is left ({PICTURES})"
        )
    if field.space.ndim == 1:
        figure = plot_profile(field, scale=scale, paths=paths).get_figure(root=True)
        assert figure is not None
    elif field.space.ndim == 3:
        figure = plot_slices(field, paths=paths, scale=scale)
    else:
        figure = _plane_page(field, paths, k, scale)
    if title:
        figure.suptitle(title, fontsize=TEXT + 2)
    return figure


def _plane_page(field: Field, paths: Sequence[Streamline], k: Sequence[float] | None, scale: str) -> Figure:
    aspect = plane_of(field.space).aspect
    stacked = aspect < _WIDE
    width = _PAGE if stacked else _PAGE / 2
    height = panel_height(width - 1.1, aspect) + 0.25
    figure = new_figure(_PAGE, 2 * height if stacked else height)
    left, right = figure.subplots(2, 1) if stacked else figure.subplots(1, 2)
    plot_potential(field, left, scale=scale)
    if paths:
        plot_streamlines(paths, field.space, left, k=k)
    left.set_title("Potential and paths" if paths else "Potential", fontsize=TEXT)
    plot_currents(field, right)
    right.set_title("Current", fontsize=TEXT)
    return figure
