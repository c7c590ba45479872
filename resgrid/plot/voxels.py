"""Pictures of spaces with axes x, y, z of a point or a ball: the shaded surface of the obstacles, and paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from resgrid._internal.colours import GOAL, SURFACE
from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.any_field import FieldPath
from resgrid.planning.any_path import AnyPath
from resgrid.planning.streamline import Outcome
from resgrid.plot.figures import axes_or_new
from resgrid.plot.plane import cells_with_path
from resgrid.plot.raster import Camera, ImageLayer, render
from resgrid.plot.space_view import SpaceView, subdivided, window_around
from resgrid.plot.style import OBSTACLE, SMALL, add_swatch, mark, refresh_legend, surface_map
from resgrid.robots.voxel_surfaces import (
    DIRECTIONS,
    block_of,
    coarse_axis,
    coarse_cells,
    faces_between,
    is_voxel_world,
    surface_of,
    surface_to_air,
)
from resgrid.scene.maps.preparation import Window, axes_of_window, extent_of_mask

_SIDE = 1500
"""Number of pixels along the longer side of a picture before it is reduced to half this size."""

_HIDDEN = 0.4
"""Fraction of the sample points of the paths that obstacles hide, above which obstacles above the paths are left out.

The sample points divide each segment of a path into `PIECES` pieces.
"""

_CAMERA = Camera(-55.0, 38.0)
"""Default direction of the view (azimuth and elevation in degrees), steeper than for arms, to look into rooms."""

PIECES = 24
"""Number of equal pieces into which each segment of a path is divided; their ends are sample points of the path.

The points decide which parts of the path obstacles hide in the view. On a page with slices they also determine the
lowest, highest and median z coordinate of the path, at which horizontal slices are drawn.
"""


class VoxelView(SpaceView):
    """A view of the obstacles of a space with three axes, seen from the space that is connected to a goal.

    Parameters
    ----------
    space : ConfigurationSpace
        The space.
    camera : Camera
        Direction of the view.
    unknown : ndarray of bool or None
        Mask of obstacle cells of unknown occupancy, which have no surface.
    top : float or None
        Coordinate z, in axis units, above which obstacles are left out; None to show all obstacles.
    also : ndarray of float64, shape (n, 3)
        Points that the picture must contain, in axis units.

    Attributes
    ----------
    solid, air, goal : ndarray of bool
        Masks of the shown cells: obstacles with a surface, cells with a path to a goal, and goals.  The cells of large
        spaces are joined into blocks.
    axes : list of Axis
        Axes x, y and z of the shown cells or blocks.
    box : ndarray of float64, shape (2, 3)
        Lower and upper corner of the shown cells, in axis units.
    cut : ndarray of bool or None
        Mask of the obstacles of the top layer where `top` cuts through obstacles; None without such a cut.
    labels : float
        Width of the border for the axis labels around the picture, in axis units.
    """

    def __init__(
        self,
        space: ConfigurationSpace,
        camera: Camera,
        unknown: NDArray[np.bool_] | None,
        top: float | None,
        also: NDArray[np.float64],
    ) -> None:
        blocked = space.cell == Cell.OBSTACLE
        air = ~blocked & (cells_with_path(space) | (space.cell == Cell.GOAL))
        air = air if air.any() else ~blocked
        window = _part_around(air, np.floor((also - space.lower) / space.spacing).astype(np.int64))
        part, axes = tuple(slice(*ends) for ends in window), axes_of_window(space.axes, window)
        block = block_of(axes)
        solid = blocked[part] if unknown is None else (blocked & ~unknown)[part]
        self.goal = coarse_cells((space.cell == Cell.GOAL)[part], block)
        self.solid, self.air = coarse_cells(solid, block), coarse_cells(air[part], block)
        self.air &= ~self.solid
        self.axes = [coarse_axis(axis, block) for axis in axes]
        self.top = top
        heights = self.axes[2].edges
        if top is not None:
            kept = int(np.clip(np.searchsorted(heights, top - 1e-9 * self.axes[2].spacing), 1, len(heights) - 1))
            last = self.solid[:, :, kept - 1 : kept]
            self.cut = last.copy() if kept < len(heights) - 1 and last.any() else None
            self.solid, self.air, self.goal = (mask[:, :, :kept] for mask in (self.solid, self.air, self.goal))
            self.axes[2] = replace(self.axes[2], upper=float(heights[kept]), cells=kept)
        else:
            self.cut = None
        self.box = np.array([[axis.lower, axis.upper] for axis in self.axes]).T
        corners = np.array(list(product(*self.box.T)))
        self.labels = 0.07 * float(np.ptp(camera.seen(corners)[:, :2], axis=0).max())
        super().__init__(
            camera, window_around(camera.seen(corners)[:, :2], _SIDE, self.labels), 0.05 * self.axes[0].spacing
        )

    def layers(self) -> list[ImageLayer]:
        """Return the images of obstacles, of the section through obstacles at z = `top`, and of goal cells."""
        facing = [(axis, sign) for axis, sign in DIRECTIONS if sign * self.camera.rotation[2, axis] < -1e-9]
        faces = surface_to_air(self.solid, self.air, self.axes, facing)
        height = faces.corners[:, :, 2].mean(axis=1)
        (_, _, low), (_, _, high) = self.box
        colours = surface_map()((height - low) / max(high - low, 1e-300))[:, :3]
        layers = [self._render(faces.triangles, np.tile(faces.plane, 2), np.tile(colours, (2, 1)))]
        if self.cut is not None:
            top = [*self.axes[:2], Axis("z", high - 1.0, high + 1.0, 2)]
            lid = np.concatenate([self.cut, np.zeros_like(self.cut)], axis=2)
            above = faces_between(lid, ~lid, top, [(2, 1)])
            layers.append(self._render(above.triangles, np.zeros(2 * len(above.plane), dtype=np.int64), OBSTACLE))
        goals = surface_of(self.goal, self.axes, facing)
        layers.append(self._render(goals.triangles, np.tile(goals.plane, 2), GOAL, 0.7))
        return layers

    def _render(
        self, triangles: NDArray[np.float64], owner: NDArray[np.int64], colour: str | NDArray[np.float64],
        opacity: float = 1.0,
    ) -> ImageLayer:  # fmt: skip
        return render(triangles, owner, colour, self.camera, self.window, opacity)

    def label_edges(self, axes: Axes) -> None:
        """Draw the edges of the shown box behind the obstacles, and label one edge per axis with the axis's range."""
        corners = np.array(list(product(range(2), repeat=3)))
        for first, second in product(corners, corners):
            if (second - first >= 0).all() and (second - first).sum() == 1:
                ends = self.camera.seen(np.take_along_axis(self.box, np.stack([first, second]), axis=0))
                axes.plot(*ends[:, :2].T, color="#c0c0c0", linewidth=0.5, zorder=1.0)
        middle = self.camera.seen(self.box.mean(axis=0))[:2]
        for number, axis in enumerate(self.axes):
            edges = [
                np.take_along_axis(self.box, np.stack([corner, corner + np.eye(3, dtype=int)[number]]), axis=0)
                for corner in corners
                if not corner[number]
            ]
            seen = [self.camera.seen(edge)[:, :2] for edge in edges]
            outer = max(seen, key=lambda ends: self._outside(ends, middle, number))
            (x, y), (dx, dy) = outer.mean(axis=0), outer[1] - outer[0]
            normal = np.array([dy, -dx]) / max(np.hypot(dx, dy), 1e-300)
            normal *= np.sign(normal @ (outer.mean(axis=0) - middle)) or 1.0
            angle = np.degrees(np.arctan2(dy, dx))
            angle = (angle + 90) % 180 - 90
            text = f"{axis.name} {axis.lower:.4g} to {axis.upper:.4g} {axis.unit}".strip()
            across, up = np.array([x, y]) + 0.45 * self.labels * normal
            axes.text(
                across, up, text, fontsize=SMALL, ha="center", va="center", rotation=angle, rotation_mode="anchor",
                color="#404040",
            )  # fmt: skip

    @staticmethod
    def _outside(ends: NDArray[np.float64], middle: NDArray[np.float64], number: int) -> float:
        """Return the distance by which an edge lies below the middle of the view (axes x, y), or to the left (axis z).

        The distance is negative for an edge above or to the right.

        `ends` (2, 2): ends of the edge in the picture; `middle` (2,): middle of the view; `number`: axis of the edge, 2
        for z.
        """
        x, y = ends.mean(axis=0) - middle
        return float(-x if number == 2 else -y)


def draw_voxels(
    space: ConfigurationSpace,
    paths: Sequence[AnyPath] = (),
    ax: Axes | None = None,
    *,
    azimuth: float = _CAMERA.azimuth,
    elevation: float = _CAMERA.elevation,
    top: float | None = None,
    unknown: NDArray[np.bool_] | None = None,
) -> Axes:
    """Draw the surface of the obstacles of a space with three axes, and paths.

    Only the surface around the cells that are connected to a goal is drawn, from its front: obstacles between the
    camera and the inside of a closed room are transparent.  Where obstacles hide more than 40 % of the paths, those
    above the paths are left out.  Hidden parts of paths are dotted.

    Parameters
    ----------
    space : ConfigurationSpace
        Space with the axes x, y and z of a point or a ball.
    paths : sequence of Streamline, ShortPath or Polyline
        Paths in this space.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default those of a new figure.
    azimuth, elevation : float
        Direction from the space to the camera in degrees, from x towards y, and above the horizontal plane.
    top : float, optional
        Coordinate z, in axis units, above which obstacles are left out; by default obstacles are left out only above
        paths of which they hide more than 40 %.
    unknown : ndarray of bool, optional
        Mask of obstacle cells of unknown occupancy, shape of the space; they have no surface.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If the space does not have the three axes of a point or a ball, or a path belongs to another space.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/voxel_maze.toml"))
    >>> ax = rg.plot.draw_voxels(planner.space, planner.paths())
    """
    if not is_voxel_world(space):
        raise InputError(
            "draw_voxels needs a space with the axes x, y and z of a point or a ball, in one unit; draw(space) shows "
            "slices of other spaces"
        )
    return draw_paths_in_view(
        space, paths, [{"label": "path"}] * len(paths), ax, Camera(azimuth, elevation), top, unknown
    )


def draw_paths_in_view(
    space: ConfigurationSpace,
    paths: Sequence[AnyPath],
    styles: Sequence[Mapping[str, Any]],
    ax: Axes | None,
    camera: Camera = _CAMERA,
    top: float | None = None,
    unknown: NDArray[np.bool_] | None = None,
) -> Axes:
    """Draw the surface of the obstacles of a space with axes x, y and z, and paths; return the axes.

    `styles`: legend entry ``label`` and matplotlib's line options for each path; `ax`: axes to draw on, None for a new
    figure; `camera`: direction of the view; `top`: coordinate z, in axis units, above which obstacles are left out,
    None to leave out obstacles above the paths if obstacles hide more than 40 % of the paths; `unknown`: mask of
    obstacle cells of unknown occupancy, which have no surface; None for no such cells.
    """
    lines = [points_of(path, space) for path in paths]
    dense = [subdivided(line, PIECES) for line in lines]
    points = np.concatenate([*dense, np.empty((0, 3))])
    view = VoxelView(space, camera, unknown, top, points)
    layers = view.layers()
    if top is None and len(points) and view.hidden(points, layers).mean() > _HIDDEN:
        top = float(points[:, 2].max()) + space.axes[2].spacing
        view = VoxelView(space, camera, unknown, top, points)
        layers = view.layers()
    window = view.window
    axes = axes_or_new(ax, (window.top - window.bottom) / (window.right - window.left))
    axes.set_axis_off()
    axes.set(xlim=(window.left, window.right), ylim=(window.bottom, window.top), aspect="equal")
    view.label_edges(axes)
    view.show(layers, axes)
    add_swatch(axes, "surface of obstacles", SURFACE[1])
    if view.cut is not None:
        add_swatch(axes, f"obstacles cut at {space.axes[2].name} = {view.box[1, 2]:.4g} {space.axes[2].unit}", OBSTACLE)
    if view.goal.any():
        add_swatch(axes, "goal", GOAL)
    for path, line, drawn, style in zip(paths, lines, dense, styles, strict=True):
        outcome = path.outcome if isinstance(path, FieldPath) else Outcome.REACHED
        first, last = camera.seen(line[[0, -1]])[:, :2]
        if outcome is not Outcome.REACHED:
            mark(first, axes, "failure", outcome.value.replace("_", " "))
            continue
        if len(line) > 1:
            view.draw_line(drawn, axes, layers, **style)
        mark(first, axes, "start")
        mark(last, axes, "end", "goal reached")
    refresh_legend(axes, gap=1.0)
    return axes


def points_of(path: AnyPath, space: ConfigurationSpace) -> NDArray[np.float64]:
    """Return the points (n, 3) of a path in axis units; raise InputError unless the path belongs to the space."""
    if path.space.axes != space.axes:
        raise InputError("the path belongs to another space; draw it with path.space")
    return space.from_world(path.points)


def _part_around(mask: NDArray[np.bool_], cells: NDArray[np.int64]) -> Window:
    """Return the smallest window that contains the True cells of a mask, given cells, and a border of one cell.

    The window is, for each axis, the index of its first cell and of the cell after its last one; it ends at the border
    of the grid, and is the whole grid without such cells.  `mask`: shape of the space; `cells` (n, 3): cell indices.
    """
    marked = extent_of_mask(mask)
    if marked is not None:
        cells = np.concatenate([cells, np.array(marked).T - [[0], [1]]])
    if not len(cells):
        return tuple((0, size) for size in mask.shape)
    first, end = (cells.min(axis=0) - 1).clip(0), np.minimum(cells.max(axis=0) + 2, mask.shape)
    return tuple(zip(first.tolist(), end.tolist(), strict=True))
