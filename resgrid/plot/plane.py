"""Axes and cell images of a picture of a space with two axes, or of a plane slice of a space with more axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.image import AxesImage
from matplotlib.patches import Polygon
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from resgrid._internal.colours import GOAL
from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.frame import Frame
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.plot.style import OBSTACLE, UNDECIDED, UNKNOWN, UNREACHABLE, add_swatch, axis_label, dress, refresh_legend

MOST_CELLS = 1024
"""Largest number of cells along an axis for which every cell is drawn; larger grids are drawn as means over blocks."""

_VISIBLE = 0.015
"""Size of a goal below which a ring is drawn around the goal, as a fraction of the picture's longer side."""
_SMALL_PART = 0.6
"""Fraction of the grid's width and height; if free cells and goals extend over less, the picture is cropped to them."""
_MOST_RINGS = 30
"""Largest number of small goals for which rings are drawn; with more small goals there are no rings."""


Mask = tuple[NDArray[np.bool_], str, str]
"""Mask of cells (shape of the plane or space), the colour of the cells, and their legend entry."""


@dataclass(frozen=True, eq=False)
class PicturePlane:
    """Two axes, their cells, and their place in the picture.

    The coordinates of the picture are matplotlib's data coordinates: world coordinates, or axis units in a slice.
    `x`, `y`: horizontal and vertical axis; `cell` (x.cells, y.cells): `Cell` codes; `kinds`: masks (x.cells,
    y.cells) of the kinds of cells that are painted, with colours and legend entries; `frame`: transformation from axis
    units to coordinates of the picture; `of_map`: whether the coordinates of the picture are those of a map that is
    rotated or moved in the world.
    """

    x: Axis
    y: Axis
    cell: NDArray[np.uint8]
    kinds: list[Mask]
    frame: Frame
    of_map: bool = False

    @property
    def aspect(self) -> float:
        """Height over width of the picture, dimensionless; 1 if the two axes have different units."""
        if self.x.unit != self.y.unit:
            return 1.0
        width, height = np.ptp(self.view, axis=0)
        return float(height / width)

    @cached_property
    def window(self) -> tuple[slice, slice]:
        """Index ranges of the cells in the picture, along x and y.

        The ranges cover the grid, or only the bounding box of free cells and goals with a margin if this box extends
        over less than 60 % of both the width and the height of the grid.
        """
        inside = self.cell != Cell.OBSTACLE
        slices = []
        for axis, size in enumerate(self.cell.shape):
            used = np.flatnonzero(inside.any(axis=1 - axis))
            first, last = (int(used[0]), int(used[-1]) + 1) if used.size else (0, size)
            margin = max((last - first) // 12, 2)
            slices.append(slice(max(first - margin, 0), min(last + margin, size)))
        shown = max((part.stop - part.start) / size for part, size in zip(slices, self.cell.shape, strict=True))
        return (slices[0], slices[1]) if shown < _SMALL_PART else (slice(0, len(inside)), slice(0, inside.shape[1]))

    @property
    def view(self) -> NDArray[np.float64]:
        """Corners of the window, shape (4, 2), in coordinates of the picture (data coordinates, not pixels).

        The order is anticlockwise in the axes x, y, from the lower corner of both axes.
        """
        return self._corners(*self.window)

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corners of the whole grid, shape (4, 2), in coordinates of the picture (data coordinates, not pixels).

        The order is anticlockwise in the axes x, y: (lower, lower), (upper, lower), (upper, upper), (lower, upper).
        """
        return self._corners(slice(0, self.x.cells), slice(0, self.y.cells))

    def _corners(self, across: slice, up: slice) -> NDArray[np.float64]:
        """Return the corners (4, 2) of a block of cells, in coordinates of the picture.

        The order in the axes x, y is (lower, lower), (upper, lower), (upper, upper), (lower, upper).  `across`, `up`:
        index ranges of the block along x and y.
        """
        (left, right), (bottom, top) = (
            axis.edges[[part.start, part.stop]] for axis, part in ((self.x, across), (self.y, up))
        )
        return self.frame.to_world([(left, bottom), (right, bottom), (right, top), (left, top)])

    @property
    def centres(self) -> NDArray[np.float64]:
        """Coordinates of the cell centres in the picture, shape (2, x.cells, y.cells); the first index is x or y."""
        own = np.stack(np.meshgrid(self.x.centres, self.y.centres, indexing="ij"), axis=-1)
        return np.moveaxis(self.frame.to_world(own), -1, 0)

    @property
    def cells_shown(self) -> int:
        """Number of cells along the longer side of the window, that is, of the cropped picture."""
        return max(int(part.stop - part.start) for part in self.window)


Cut = tuple[tuple[int, int], ...]
"""Slice of a space: numbers of the axes normal to the slice, with the cell index along each of them, ascending."""


def sliced(values: NDArray[Any], cut: Cut) -> NDArray[Any]:
    """Return the values of the cells of a slice, one dimension per axis in the slice.

    `values`: one value per cell, shape of the space; `cut`: normal axes with their cell indices, empty for all cells.
    """
    where: list[int | slice] = [slice(None)] * values.ndim
    for normal, index in cut:
        where[normal] = index
    return np.asarray(values[tuple(where)])


def plane_of(space: ConfigurationSpace, cut: Cut = ()) -> PicturePlane:
    """Return the plane of a space with two axes, or of a slice of a space with three or four axes.

    `cut`: normal axes with their cell indices; empty for a space with two axes.
    """
    if cut:
        normals = [normal for normal, _ in cut]
        x, y = (axis for number, axis in enumerate(space.axes) if number not in normals)
        kinds = [(sliced(where, cut), colour, label) for where, colour, label in space_kinds(space)]
        return PicturePlane(x, y, sliced(space.cell, cut), kinds, Frame(), not space.frame.is_world)
    if space.ndim != 2:
        raise InputError(
            f"this picture needs a space of two axes, but this space has {space.ndim}; draw(field) shows one to four"
        )
    x, y = space.axes
    robot = space.robot
    grown = robot is not None and robot.moves_in_workspace and any(part.area for part in robot.shapes_at((0.0, 0.0)))
    obstacle = "obstacle, grown by the robot" if grown else "obstacle"
    return PicturePlane(x, y, space.cell, space_kinds(space, obstacle), space.frame)


def cells_with_path(space: ConfigurationSpace) -> NDArray[np.bool_]:
    """Return the mask of cells with a path to a goal, shape of the space; all True if the space has no goal cell."""
    return space.goal_connected if (space.cell == Cell.GOAL).any() else np.ones(space.shape, dtype=np.bool_)


def kinds_of(cell: NDArray[np.uint8], connected: NDArray[np.bool_], obstacle: str = "obstacle") -> list[Mask]:
    """Return three masks of cells, each as a tuple with the colour and the legend entry of the cells.

    The masks are those of obstacles, goals, and free cells without a path to a goal.  `cell`: `Cell` codes;
    `connected`: mask of cells with a path to a goal, same shape; `obstacle`: legend entry of obstacles.
    """
    return [
        (cell == Cell.OBSTACLE, OBSTACLE, obstacle),
        (cell == Cell.GOAL, GOAL, "goal"),
        ((cell == Cell.FREE) & ~connected, UNREACHABLE, "no path to a goal"),
    ]


def space_kinds(space: ConfigurationSpace, obstacle: str = "obstacle") -> list[Mask]:
    """Return the masks of the kinds of cells of a space that are painted, with colours and legend entries.

    If the space has a mask of undecided cells (neither proven free nor proven to contain a collision), these cells have
    a kind of their own, and the legend entries state numbers of cells of the whole space.  `obstacle`: legend entry of
    obstacles in a space without such a mask.
    """
    kinds = kinds_of(space.cell, cells_with_path(space), obstacle)
    if space.undecided is None:
        return kinds
    (blocked, colour, _), goal, (enclosed, pale, _) = kinds
    proven: list[Mask] = [
        (blocked & ~space.undecided, colour, "contains a collision"),
        (space.undecided, UNDECIDED, "undecided"),
        goal,
        (enclosed, pale, "proven free, no path to a goal"),
    ]
    return [(where, colour, _counted(label, where)) for where, colour, label in proven]


def free_label(space: ConfigurationSpace) -> str:
    """Return the legend entry of free cells: with a count if the free cells of the space are proven to be free."""
    if space.undecided is None:
        return "free"
    return _counted("proven free", (space.cell == Cell.FREE) & cells_with_path(space))


def _counted(label: str, where: NDArray[np.bool_]) -> str:
    """Return a legend entry with the number of cells in a mask and their fraction of all cells in percent."""
    percent = 100 * float(where.mean())
    return f"{label}: {int(where.sum()):,} ({f'{percent:.1f}' if percent >= 1 else f'{percent:.2g}'} %)"


def unknown_cells(cell: NDArray[np.uint8], unknown: NDArray[np.bool_] | None) -> list[Mask]:
    """Return a list with one tuple: mask of obstacle cells of unknown occupancy, its colour and its legend entry.

    The list is empty if `unknown` is None.  `cell`: `Cell` codes; `unknown`: mask of cells of unknown occupancy, same
    shape.
    """
    return [] if unknown is None else [((cell == Cell.OBSTACLE) & unknown, UNKNOWN, "unknown")]


def draw_image(plane: PicturePlane, values: NDArray[Any], axes: Axes, **style: Any) -> AxesImage:
    """Draw one value or colour per cell, first axis to the right, second axis upwards; return the image.

    With more than 1024 cells along an axis, means over blocks of cells are drawn.

    `values`: shape (plane.x.cells, plane.y.cells), NaN for transparent cells, or (plane.x.cells, plane.y.cells, 4) for
    RGBA colours from 0 to 255; `style`: options of matplotlib's imshow.
    """
    block = block_size(values.shape, MOST_CELLS)
    coloured = values.ndim == 3
    pixels = block_colours(values, block) if coloured else np.ma.masked_invalid(block_means(values, block))
    across, up = (
        (axis.lower, axis.lower + count * block * axis.spacing)
        for axis, count in zip((plane.x, plane.y), pixels.shape, strict=False)
    )
    extent, aspect = (*across, *up), axes.get_aspect()
    image = axes.imshow(pixels.swapaxes(0, 1), origin="lower", extent=extent, aspect=aspect, **style)
    if not plane.frame.is_world:
        turned = Affine2D().rotate(plane.frame.yaw).translate(plane.frame.x, plane.frame.y)
        image.set_transform(turned + axes.transData)
    return image


def draw_cells(plane: PicturePlane, axes: Axes) -> None:
    """Draw obstacles, goals and free cells without a path to a goal above an image, with legend entries."""
    paint(plane, axes, *plane.kinds, order=2.0)
    _ring_small_goals(plane, axes)


def paint(plane: PicturePlane, axes: Axes, *masks: Mask, order: float = 2.2) -> None:
    """Paint masks of cells above an image, each in its colour; masks with at least one cell get a legend entry.

    `masks`: mask (plane.x.cells, plane.y.cells), colour and legend entry of each; `order`: drawing order of matplotlib
    (zorder).
    """
    present = [mask for mask in masks if mask[0].any()]
    if not present:
        return
    pixels = np.zeros((*plane.cell.shape, 4), dtype=np.uint8)
    for where, colour, label in present:
        pixels[where] = np.round(255 * np.array(to_rgba(colour)))
        add_swatch(axes, label, colour)
    draw_image(plane, pixels, axes, zorder=order)


def _small_goals(plane: PicturePlane) -> NDArray[np.int64]:
    """Return the cell index ranges of the n goals that need a ring because they are small, shape (n, 2, 2).

    The second index selects first cell or end (exclusive), the third one the axis.  A goal is small if its longer side
    is below 1.5 % of the picture's longer side; if more than 30 goals are small, n is 0.
    """
    from scipy.ndimage import find_objects

    boxes = find_objects(label_regions(plane.cell == Cell.GOAL, (False, False)))
    ends = np.array([[[part.start, part.stop] for part in box] for box in boxes if box], dtype=np.int64)
    ends = ends.reshape(-1, 2, 2).swapaxes(1, 2)
    is_small = np.array(np.ptp(ends, axis=1).max(axis=1) < _VISIBLE * plane.cells_shown)
    return np.asarray(ends[is_small] if is_small.sum() <= _MOST_RINGS else ends[:0])


def _in_picture(plane: PicturePlane, cells: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the picture coordinates (n, 2) of points.

    `cells` (n, 2): positions of the points from the lower corner of the grid, in cell widths.
    """
    return plane.frame.to_world((plane.x.lower, plane.y.lower) + cells * (plane.x.spacing, plane.y.spacing))


def _ring_small_goals(plane: PicturePlane, axes: Axes) -> None:
    """Draw a ring around each goal below 1.5 % of the picture's longer side; no rings if more than 30 are so small."""
    boxes = _small_goals(plane)
    if not len(boxes):
        return
    centres = _in_picture(plane, boxes.mean(axis=1))
    for width, colour in ((2.6, "white"), (1.4, GOAL)):
        axes.scatter(
            centres[:, 0], centres[:, 1], s=70, marker="o", facecolor="none", edgecolor=colour, linewidth=width,
            zorder=3.5,
        )  # fmt: skip


def at_small_goals(plane: PicturePlane, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a copy of picture coordinates (n, 2), in which points in a ringed goal are moved to the ring's centre."""
    moved = points.copy()
    own = (plane.frame.from_world(points) - (plane.x.lower, plane.y.lower)) / (plane.x.spacing, plane.y.spacing)
    for box in _small_goals(plane):
        near = np.all((own >= box[0] - 0.01) & (own <= box[1] + 0.01), axis=1)
        moved[near] = _in_picture(plane, box.mean(axis=0)[np.newaxis])
    return moved


def finish(plane: PicturePlane, axes: Axes, points: Sequence[NDArray[np.float64]] = (), columns: int = 3) -> None:
    """Set limits, labels and legend of a picture.

    `points`: arrays (n, 2) of picture coordinates that the limits must contain; `columns`: number of legend columns, 0
    for no legend.  Both axes have the same scale if they have the same unit.
    """
    shown = np.concatenate([plane.view, *points])
    (left, bottom), (right, top) = shown.min(axis=0), shown.max(axis=0)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal" if plane.x.unit == plane.y.unit else "auto")
    if not plane.frame.is_world:
        axes.add_patch(Polygon(plane.corners, fill=False, edgecolor=OBSTACLE, linewidth=0.6, zorder=2.5))
    axes.set_xlabel(axis_label(plane.x, world=not plane.frame.is_world, of_map=plane.of_map))
    axes.set_ylabel(axis_label(plane.y, world=not plane.frame.is_world, of_map=plane.of_map))
    dress(axes)
    if columns:
        refresh_legend(axes, columns)


def seam_shifts(space: ConfigurationSpace) -> list[NDArray[np.float64]]:
    """Return the shifts (ndim,) in world coordinates of the copies of a path that are drawn because it crosses seams.

    The list holds all combinations of -2 to 2 periods along the periodic axes; it includes the zero shift.
    """
    turns = [range(-2, 3) if ring else range(1) for ring in space.periodic]
    return list(space.frame.turned_to_world(np.array(list(product(*turns))) * (space.upper - space.lower)))


def wrapped(points: NDArray[np.float64], space: ConfigurationSpace) -> NDArray[np.float64]:
    """Return points (n, ndim) in world coordinates, shifted into the grid by whole periods along the periodic axes."""
    own, extent = space.from_world(points), space.upper - space.lower
    return space.to_world(np.where(space.periodic, space.lower + np.mod(own - space.lower, extent), own))


def block_size(shape: tuple[int, ...], most: int) -> int:
    """Return the side of square blocks, in cells, such that there are at most `most` blocks along each of two axes.

    `shape`: number of cells along each of the axes.
    """
    return -(-max(shape[:2]) // most)


def block_means(values: NDArray[np.float64], block: int) -> NDArray[np.float64]:
    """Return the means over square blocks of cells; NaN only for blocks without a finite value.

    `values` (n, m): value per cell, NaN in cells without a value; `block`: side of a block in cells.  The result has
    the shape (ceil(n / block), ceil(m / block)).
    """
    if block == 1:
        return values
    known = np.isfinite(values)
    count = _block_sums(known.astype(np.float64), block)
    total = _block_sums(np.where(known, values, 0.0), block)
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)


def block_colours(colours: NDArray[np.uint8], block: int) -> NDArray[np.uint8]:
    """Return the mean colours over square blocks of cells, weighted by opacity.

    `colours` (n, m, 4): RGBA from 0 to 255; `block`: side of a block in cells.  The result has the shape (ceil(n /
    block), ceil(m / block), 4).
    """
    if block == 1:
        return colours
    opacity = colours[..., 3:].astype(np.float32)
    blended = _block_sums(np.concatenate([colours[..., :3] * opacity, opacity], axis=-1), block)
    blended[..., :3] /= np.maximum(blended[..., 3:], 1.0)
    blended[..., 3] /= block**2
    return np.round(blended).astype(np.uint8)


def _block_sums(values: NDArray[Any], block: int) -> NDArray[Any]:
    """Return the sums of values over square blocks of `block` x `block` cells along the first two dimensions."""
    for axis in (0, 1):
        values = np.add.reduceat(values, np.arange(0, values.shape[axis], block), axis=axis)
    return values
