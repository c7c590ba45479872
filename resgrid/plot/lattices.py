"""Pictures of lattices: the potential at the sites (places of the nodes) with paths, and the resistors of a netlist."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.hexagonal_lattice import HexagonalLattice
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.planning.any_field import FieldPath
from resgrid.planning.lattice_fields import LatticeField
from resgrid.plot.images import draw_shading
from resgrid.plot.panels import Panel, draw_panels
from resgrid.plot.paths import end_of_first, path_layer
from resgrid.plot.plane import draw_image
from resgrid.plot.shading import Scale, Shading, shading_of
from resgrid.plot.style import PATHS

_MOST_STEPS = 40
"""Largest number of sites (places of nodes) along an axis of the lattice for which the resistors are drawn."""


def draw_lattice_field(
    field: LatticeField,
    ax: Axes | None = None,
    *,
    scale: Scale = "auto",
    axis: int | None = None,
    indices: Sequence[int] | None = None,
    paths: Sequence[FieldPath] = (),
    k: Sequence[float] | None = None,
) -> Axes | Figure:
    """Draw the potential at the sites of a lattice; return the axes, or the figure of a space with three axes.

    A site (place of a node) is drawn as a hexagon in a hexagonal lattice, otherwise as its cell.  Plane lattices of at
    most 40 sites along an axis also show their resistors.  `ax`: axes to draw on, by default those of a new figure;
    `scale`: "linear", "log" (logarithm of the drop) or "auto" ("log" if the drop spans two orders of magnitude or
    more); `axis`: number of the space's axis normal to the slices of a space with three axes, None for one slice for
    each pair of axes; `indices`: cell indices of the slices along `axis`, by default at most six; `paths`: paths to
    draw; `k`: weight k of the Dirichlet field of each path, None for paths of one field.
    """
    shading = shading_of(field, scale)
    shows_steps = field.space.ndim == 2 and max(field.lattice.shape) <= _MOST_STEPS

    def potential(panel: Panel) -> tuple[ScalarMappable, str]:
        assert panel.plane is not None
        if isinstance(field.lattice, HexagonalLattice):
            image: ScalarMappable = _draw_hexagons(field.lattice, shading, panel)
        else:
            contours = not panel.cut and not shows_steps
            image = draw_shading(panel.plane, shading, panel.of(shading.values), panel.axes, contours=contours)
        panel.draw_cells()
        if shows_steps:
            starts, ends = _joined_sites(field)
            _draw_steps(starts, ends, panel)
        return image, shading.label

    layers = [potential, path_layer(paths, k)] if paths else [potential]
    return draw_panels(field.space, ax, *layers, axis=axis, indices=indices, through=end_of_first(paths))


def draw_lattice_netlist(netlist: Netlist, ax: Axes | None = None) -> Axes:
    """Draw the resistors between the sites of a lattice in the plane; return the axes.

    Rings mark the nodes with a contact with the obstacle rail.  `ax`: axes to draw on, by default those of a new
    figure.  Raise InputError for a netlist without a lattice, and for a lattice in space or of more than 40 sites along
    an axis.
    """
    found = netlist.lattice_map
    if found is None or found.space.ndim != 2 or max(found.lattice.shape) > _MOST_STEPS:
        size = "" if found is None else " x ".join(map(str, found.lattice.shape))
        raise InputError(
            f"a picture of the resistors needs a plane lattice of at most {_MOST_STEPS} sites a side, not {size}; draw "
            "its field (rg.planning.lattice_field), or use fewer cells"
        )
    lattice = found.lattice
    step = found.resistor_step.astype(np.int64)
    between = step >= 0
    starts = lattice.points_of(found.resistor_site[between])
    ends = starts + lattice.steps[step[between]]
    tied = lattice.points_of(np.unique(found.resistor_site[~between]))

    def resistors(panel: Panel) -> None:
        panel.draw_cells()
        _draw_steps(starts, ends, panel, label="resistor")
        if len(tied):
            x, y = panel.seen(tied).T
            panel.axes.scatter(
                x, y, s=26, facecolor="none", edgecolor=PATHS[0], linewidth=0.9, zorder=3.6,
                label="contact with the obstacle rail",
            )  # fmt: skip

    picture = draw_panels(found.space, ax, resistors)
    assert isinstance(picture, Axes)
    return picture


def _joined_sites(field: LatticeField) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the starts and the ends, (n, ndim) each, in axis units, of all resistors in which a current flows."""
    starts, ends = [], []
    for step, direction in enumerate(field.step_direction):
        points = field.lattice.points(np.argwhere(direction != 0))
        starts.append(points)
        ends.append(points + field.lattice.steps[step])
    return np.concatenate(starts), np.concatenate(ends)


def _draw_steps(
    starts: NDArray[np.float64], ends: NDArray[np.float64], panel: Panel, label: str = "resistor with current"
) -> None:
    """Draw segments from `starts` to `ends` (n, ndim), in axis units, and dots at both ends of each segment.

    `label`: legend entry of the segments.
    """
    segments = np.stack([panel.seen(starts), panel.seen(ends)], axis=1)
    lines = LineCollection(list(segments), colors="#00000070", linewidths=0.6, zorder=2.6, label=label)
    panel.axes.add_collection(lines, autolim=False)
    x, y = np.unique(panel.seen(np.concatenate([starts, ends])).round(9), axis=0).T
    panel.axes.scatter(x, y, s=3.0, color="black", linewidth=0, zorder=2.7)


def _draw_hexagons(lattice: HexagonalLattice, shading: Shading, panel: Panel) -> PolyCollection:
    """Draw the values at the sites as hexagons, clipped to the grid; return the collection.

    Below the hexagons, every free cell has the colour of one of its sites, so that no free part remains white.
    `shading`: values at the sites and their colour scale.
    """
    assert panel.plane is not None
    below = np.full(lattice.space.shape, np.nan)
    below[lattice.site_cells] = shading.values
    draw_image(panel.plane, below, panel.axes, cmap=shading.colours, vmin=shading.lower, vmax=shading.upper, zorder=0.4)
    index = np.argwhere(np.isfinite(shading.values) & (lattice.at_sites(lattice.space.cell) != Cell.OBSTACLE))
    points = lattice.points(index)
    corners = points[:, np.newaxis] + _hexagon(lattice)
    polygons = panel.seen(corners.reshape(-1, 2)).reshape(-1, 6, 2)
    drawn = PolyCollection(
        list(polygons), array=shading.values[tuple(index.T)], cmap=shading.colours, edgecolors="face", linewidths=0.2,
        zorder=0.5,
    )  # fmt: skip
    drawn.set_clim(shading.lower, shading.upper)
    panel.axes.add_collection(drawn, autolim=False)
    drawn.set_clip_path(Polygon(panel.plane.corners, transform=panel.axes.transData))
    return drawn


def _hexagon(lattice: HexagonalLattice) -> NDArray[np.float64]:
    """Return the corners (6, 2) of the Voronoi cell of a site, anticlockwise, relative to the site, in axis units."""
    half, row = lattice.pitch / 2.0, lattice.row
    tip = row / 2.0 + half**2 / (2.0 * row)
    side = row - tip
    return np.array([(half, side), (0.0, tip), (-half, side), (-half, -side), (0.0, -tip), (half, -side)])
