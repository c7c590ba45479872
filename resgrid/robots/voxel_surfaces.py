"""Surfaces of sets of cells in space, as rectangles, and coarser grids of blocks of cells, for pictures and 3-D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis
from resgrid.core.space import ConfigurationSpace

DIRECTIONS = tuple((axis, sign) for axis in range(3) for sign in (-1, 1))
"""Directions of faces: number of the axis, and -1 or 1 for the lower or the upper face of a solid cell."""

_CLOSED = 0.5
"""Smallest fraction of solid cells, in the outermost layer at a side of the grid, for which the side is closed.

Cells at a closed side have no face to the outside; at other sides every solid cell of the layer has a face to it.
"""

_MOST_CELLS = 200
"""Largest number of drawn cells along an axis; larger grids are drawn in blocks of cells."""


def is_voxel_world(space: ConfigurationSpace) -> bool:
    """Return whether a space has three axes of one unit, none periodic, that are positions (of a point or a ball)."""
    units = {axis.unit for axis in space.axes}
    moves = space.robot is None or space.robot.moves_in_workspace
    return space.ndim == 3 and moves and len(units) == 1 and not any(space.periodic)


class Faces(NamedTuple):
    """Rectangles in space between solid cells and cells of air (cells towards which solid cells have a drawn face).

    `corners` (n, 4, 3): corners of the rectangles, anticlockwise seen from the air, in axis units; `plane` (n,): number
    of the plane and direction, equal for rectangles that lie in one plane and face the same direction.
    """

    corners: NDArray[np.float64]
    plane: NDArray[np.int64]

    @property
    def triangles(self) -> NDArray[np.float64]:
        """Corners of two triangles per face, shape (2 n, 3, 3): all first triangles, then all second ones."""
        return np.concatenate([self.corners[:, [0, 1, 2]], self.corners[:, [0, 2, 3]]])


def faces_between(
    solid: NDArray[np.bool_],
    air: NDArray[np.bool_],
    axes: Sequence[Axis],
    directions: Sequence[tuple[int, int]] = DIRECTIONS,
    *,
    merge: bool = False,
) -> Faces:
    """Return the faces of solid cells that border on air (cells towards which solid cells have a drawn face).

    `solid`, `air`: masks of the cells of a grid with three axes; `axes`: axes of the grid; `directions`: faces of solid
    cells that are considered, each as number of the axis and -1 (lower face) or 1 (upper face); `merge`: True merges
    adjacent faces of a row along x (along y for faces normal to x) into one rectangle, False keeps one per cell.
    """
    edges = [axis.edges for axis in axes]
    corners, planes = [np.empty((0, 4, 3))], [np.empty(0, dtype=np.int64)]
    for axis, sign in directions:
        before, after = ([slice(None)] * 3 for _ in range(2))
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        own, other = (before, after) if sign > 0 else (after, before)
        meets = solid[tuple(own)] & air[tuple(other)]  # index i: the face between the cells i and i + 1
        along = 1 if axis == 0 else 0
        index = _rows(meets, along) if merge else np.argwhere(meets)[:, :, np.newaxis] + np.arange(2)
        index[:, axis] = index[:, axis, :1] + 1
        corners.append(_rectangles(index, edges, axis, sign))
        planes.append(6 * index[:, axis, 0] + 2 * axis + (sign > 0))
    return Faces(np.concatenate(corners), np.concatenate(planes))


def _rows(mask: NDArray[np.bool_], along: int) -> NDArray[np.int64]:
    """Return the first cell and the end (exclusive) along each axis of every row of True cells, shape (n, 3, 2).

    `along`: number of the axis of the rows.
    """
    flips = np.diff(mask.astype(np.int8), axis=along, prepend=0, append=0)
    rest = [number for number in range(3) if number != along]
    starts, ends = (np.argwhere(np.transpose(flips == step, (*rest, along))) for step in (1, -1))
    index = np.empty((len(starts), 3, 2), dtype=np.int64)
    for place, number in enumerate(rest):
        index[:, number] = starts[:, place, np.newaxis] + [0, 1]
    index[:, along, 0], index[:, along, 1] = starts[:, 2], ends[:, 2]
    return index


def _rectangles(
    index: NDArray[np.int64], edges: Sequence[NDArray[np.float64]], axis: int, sign: int
) -> NDArray[np.float64]:
    """Return the corners (n, 4, 3) of rectangles normal to an axis, anticlockwise seen from the air.

    `index` (n, 3, 2): numbers of the first and the last border along each axis, along `axis` only the first is used;
    `edges`: coordinates of the borders between cells along each axis; `axis`: number of the axis; `sign`: 1 if the air
    lies at larger coordinates, else -1.
    """
    u, v = ((axis + 1) % 3, (axis + 2) % 3) if sign > 0 else ((axis + 2) % 3, (axis + 1) % 3)
    corners = np.empty((len(index), 4, 3))
    corners[:, :, axis] = edges[axis][index[:, axis, 0], np.newaxis]
    corners[:, :, u] = edges[u][index[:, u]][:, [0, 1, 1, 0]]
    corners[:, :, v] = edges[v][index[:, v]][:, [0, 0, 1, 1]]
    return corners


def coarse_cells(mask: NDArray[np.bool_], block: int) -> NDArray[np.bool_]:
    """Return the mask of blocks of cells that contain at least one marked cell; one entry per block.

    `block`: number of cells along each axis that form one block; blocks at the upper border may be smaller.
    """
    if block == 1:
        return mask
    for axis in range(mask.ndim):
        mask = np.logical_or.reduceat(mask, np.arange(0, mask.shape[axis], block), axis=axis)
    return mask


def coarse_axis(axis: Axis, block: int) -> Axis:
    """Return the axis whose cells are blocks of `block` cells of an axis, beginning at its lower end.

    The last block may extend beyond the upper end.
    """
    cells = -(-axis.cells // block)
    return replace(axis, upper=axis.lower + cells * block * axis.spacing, cells=cells)


def block_of(axes: Sequence[Axis]) -> int:
    """Return the number of cells, along each axis, that are drawn as one block; 1 for at most 200 cells per axis."""
    return -(-max(axis.cells for axis in axes) // _MOST_CELLS)


def surface_to_air(
    solid: NDArray[np.bool_], air: NDArray[np.bool_], axes: Sequence[Axis],
    directions: Sequence[tuple[int, int]] = DIRECTIONS, *, merge: bool = False,
) -> Faces:  # fmt: skip
    """Return the faces of solid cells that border on air, also at sides of the grid that few solid cells reach.

    Air are the cells towards which solid cells have a drawn face.  At a side of the grid where less than half of the
    outermost layer is solid, the solid cells of this layer have faces to the outside, too.
    `solid`, `air`: masks of the cells of a grid; `axes`: axes of the grid, three; `directions`: faces of solid cells
    that are considered, each as number of the axis and -1 (lower face) or 1 (upper face); `merge`: True merges adjacent
    faces of a row along x (along y for faces normal to x) into one rectangle, False keeps one per cell.
    """
    return faces_between(*_with_open_sides(solid, air), _wider(axes), directions, merge=merge)


def surface_of(
    mask: NDArray[np.bool_], axes: Sequence[Axis], directions: Sequence[tuple[int, int]] = DIRECTIONS, *,
    merge: bool = False,
) -> Faces:  # fmt: skip
    """Return the faces of marked cells that border on unmarked cells or lie at a side of the grid.

    `mask`: marked cells of a grid; `axes`: the three axes of the grid; `directions`: faces of marked cells that are
    considered, each as number of the axis and -1 (lower face) or 1 (upper face); `merge`: True merges adjacent faces of
    a row along x (along y for faces normal to x) into one rectangle, False keeps one per cell.
    """
    padded = np.pad(mask, 1)
    return faces_between(padded, ~padded, _wider(axes), directions, merge=merge)


def _with_open_sides(solid: NDArray[np.bool_], air: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the masks of solid cells and of air with one more layer of cells on every side.

    At a side where less than half of the outermost cells are solid, the new layer is air, so that these solid cells
    have a face to the outside.  At other sides the new layer is neither solid nor air.
    """
    solid, air = np.pad(solid, 1), np.pad(air, 1)
    for axis in range(3):
        for own, beyond in ((1, 0), (-2, -1)):
            side = np.take(solid, own, axis=axis)
            if side[1:-1, 1:-1].mean() < _CLOSED:
                np.moveaxis(air, axis, 0)[beyond] = True
    return solid, air


def _wider(axes: Sequence[Axis]) -> list[Axis]:
    """Return the axes, each lengthened by one cell at both ends."""
    return [
        replace(axis, lower=axis.lower - axis.spacing, upper=axis.upper + axis.spacing, cells=axis.cells + 2)
        for axis in axes
    ]
