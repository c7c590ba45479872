"""Maps in space of which parts can be read: voxel maps, OctoMaps and point clouds as lists of cubes.

Only the cells of the part that a scene needs become an array, whatever the size of the file's bounding box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import NDArray

from resgrid._internal.memory import require_grid_memory
from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.robots.solids import Angle, Length, SpacePoint, rigid_pose
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.movingai import open_voxel_list
from resgrid.scene.maps.preparation import Window, axes_of_window, no_unknown_cells, whole_window
from resgrid.scene.maps.size_advice import smaller_map
from resgrid.scene.solids.octree import MIDDLE, read_octree
from resgrid.scene.solids.point_clouds import cloud_cells

_BYTES_PER_VOXEL = 4
"""Estimated memory for the cells of a part of a map, in bytes per voxel."""

_BYTES_PER_POINT = 120
"""Estimated memory for finding the voxels of a point cloud, in bytes per point."""

_LARGE = 64
"""Smallest volume, in voxels, of a cube that is written to the array of cells on its own.

All smaller cubes of equal size are written together.
"""

_SUGGESTED = 100
"""Number of voxels along the longest side of a point cloud at the voxel width that an error message suggests."""


@dataclass(frozen=True, eq=False)
class VoxelParts:
    """A map in space of which parts can be read.

    `path`: the file; `axes`: axes of the whole map; `occupied` (n, 4): cubes of obstacles as first voxel (x, y, z) and
    width, in voxels from the map's lower corner; `free` (m, 4): cubes of free space, None for a format in which all
    voxels that are not occupied are free; `unknown`: whether voxels in neither list are "obstacle" or "free"; `frame`:
    transformation from map coordinates to the world.
    """

    path: Path
    axes: tuple[Axis, ...]
    occupied: NDArray[np.int32]
    free: NDArray[np.int32] | None = None
    unknown: str = "obstacle"
    frame: Frame = field(default_factory=Frame)

    def known(self) -> Window:
        """Return the ranges (first, end), one per axis, of the smallest box with all known voxels: ``crop = "known"``.

        The axes of a map with unknown voxels end at its outermost known voxels, so this box is the whole map.  Raises
        InputError for a format without unknown voxels, for which this option of a map has no meaning.
        """
        if self.free is None:
            raise no_unknown_cells(3)
        return whole_window(self.axes)

    def cells(self, window: Window) -> MapCells:
        """Return the cells of a part of the map; raise BudgetError if they would not fit in memory.

        `window`: for x, y and z the index of the first cell, and of the cell after the last one.
        """
        size = tuple(end - first for first, end in window)
        known = None if self.free is None else whole_window(self.axes)
        require_grid_memory(size, str(self.path), _BYTES_PER_VOXEL, lambda ratio: smaller_map(size, ratio, known))
        begin = [first for first, _ in window]
        cell = np.full(size, Cell.FREE, dtype=np.uint8)
        unseen = None
        if self.free is not None:
            unseen = np.ones(size, dtype=bool)
            _fill(unseen, self.free, begin, 0)
            _fill(unseen, self.occupied, begin, 0)
            if self.unknown == "obstacle":
                cell[unseen] = Cell.OBSTACLE
        _fill(cell, self.occupied, begin, Cell.OBSTACLE)
        return MapCells(axes_of_window(self.axes, window), cell, self.frame, None, unseen)


def read_voxels(path: Path) -> MapCells:
    """Return the cells of a MovingAI voxel map; voxels are 1 x 1 x 1, in units of ``cell``."""
    source = open_voxels(path)
    return source.cells(whole_window(source.axes))


def open_voxels(path: Path) -> VoxelParts:
    """Return a MovingAI voxel map of which parts can be read."""
    sizes, voxels = open_voxel_list(path)
    axes = tuple(Axis(name, 0.0, float(size), size, unit="cell") for name, size in zip("xyz", sizes, strict=True))
    return VoxelParts(path, axes, _units(voxels))


def read_octomap_cells(
    path: Path,
    unknown: Literal["obstacle", "free"] = "obstacle",
    occupied: Annotated[float, Gt(0), Lt(1)] = 0.5,
) -> MapCells:
    """Return the cells of an OctoMap within the bounding box of its known voxels, in metres.

    Parameters
    ----------
    unknown
        Treatment of cells of unknown occupancy: obstacle or free.
    occupied
        Smallest probability of occupancy at which a voxel is occupied, for ``.ot`` files; ``.bt`` files contain no
        probabilities.
    """
    source = open_octomap(path, unknown, occupied)
    return source.cells(whole_window(source.axes))


def open_octomap(path: Path, unknown: str = "obstacle", occupied: float = 0.5) -> VoxelParts:
    """Return an OctoMap of which parts can be read.

    `unknown`: whether unknown voxels are "obstacle" or "free"; `occupied`: smallest probability of occupancy at which a
    voxel of an ``.ot`` file is occupied.
    """
    tree = read_octree(path, occupied)
    first, last = tree.bounds
    axes = _cubic_axes(first - MIDDLE, last - MIDDLE, tree.resolution)
    corner = np.append(first, 0).astype(np.int32)
    return VoxelParts(path, axes, tree.occupied - corner, tree.free - corner, unknown)


def read_cloud_cells(
    path: Path,
    spacing: Length | None = None,
    scale: Length = 1.0,
    position: SpacePoint = (0.0, 0.0, 0.0),
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0),
) -> MapCells:
    """Return the cells of a point cloud: voxels that contain a point are obstacles, all others are free.

    Corners of voxels are multiples of their width; the map is the bounding box of the obstacles, in metres.

    Parameters
    ----------
    spacing
        Width of a voxel.
    scale
        Factor that converts the lengths of the file to metres, such as 0.001 for millimetres.
    position
        Position of the file's origin.
    rotation
        Roll, pitch and yaw of the file's axes in radians, as in URDF; [1.5708, 0, 0] for files whose y points up.
    """
    source = open_cloud(path, spacing, scale, position, rotation)
    return source.cells(whole_window(source.axes))


def open_cloud(
    path: Path,
    spacing: float | None = None,
    scale: float = 1.0,
    position: SpacePoint = (0.0, 0.0, 0.0),
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> VoxelParts:
    """Return a point cloud as a map of which parts can be read; raise InputError without `spacing`.

    `spacing`: width of a voxel in metres; `scale`: factor from lengths of the file to metres; `position`: position of
    the file's origin in metres; `rotation`: roll, pitch and yaw of the file's axes in radians.
    """
    pose = rigid_pose(position, rotation) * [scale, scale, scale, 1.0]
    if spacing is None:
        raise _no_spacing(path, pose)
    cells = cloud_cells(path, spacing, pose, _BYTES_PER_POINT)
    first, last = cells.min(axis=0), cells.max(axis=0) + 1
    cells -= first
    return VoxelParts(path, _cubic_axes(first, last, spacing), _units(cells.astype(np.int32)))


def _no_spacing(path: Path, pose: NDArray[np.float64]) -> InputError:
    """Return the InputError for a point cloud without a given voxel width; the message suggests a width.

    `pose` (4, 4): transformation from coordinates of the file to metres in the map.
    """
    extent = np.ptp(cloud_cells(path, 1e-3, pose, _BYTES_PER_POINT), axis=0).max() * 1e-3
    suggested = max(float(f"{extent / _SUGGESTED:.1g}"), 1e-3)
    return InputError(
        f"{path}: a point cloud has no voxels of its own; give their width, such as spacing = {suggested:g} (--spacing "
        f"{suggested:g}) for an extent of {extent:.3g}"
    )


def _units(voxels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return voxels (n, 3) as cubes of width 1, shape (n, 4)."""
    return np.column_stack([voxels, np.ones(len(voxels), dtype=np.int32)])


def _cubic_axes(first: NDArray[np.integer], last: NDArray[np.integer], width: float) -> tuple[Axis, ...]:
    """Return axes x, y and z in metres of a grid of cubic voxels.

    `first`, `last` (3,): lower and upper border of the grid, in voxel widths from the origin; `width`: width of a voxel
    in metres.
    """
    return tuple(
        Axis(name, low * width, high * width, high - low)
        for name, low, high in zip("xyz", first.tolist(), last.tolist(), strict=True)
    )


def _fill(out: NDArray[Any], cubes: NDArray[np.int32], begin: Sequence[int], value: int) -> None:
    """Set the cells in cubes to `value`, in place.

    `out`: cells of a window, changed in place; `begin`: first voxel of this window in the map, along x, y and z;
    `cubes` (n, 4): first voxel (x, y, z) in the map and width, in voxels; parts outside the window are ignored.
    """
    low = cubes[:, :3] - np.array(begin, dtype=np.int32)
    high = np.minimum(low + cubes[:, 3:], np.array(out.shape, dtype=np.int32))
    np.maximum(low, 0, out=low)
    size = high - low
    meets = (size > 0).all(axis=1)
    low, size = low[meets], size[meets]
    is_large = size.prod(axis=1, dtype=np.int64) >= _LARGE
    for x, y, z, a, b, c in np.column_stack([low[is_large], size[is_large]]).tolist():
        out[x : x + a, y : y + b, z : z + c] = value
    low, size = low[~is_large], size[~is_large]
    number = size @ np.array([_LARGE**2, _LARGE, 1], dtype=np.int32)
    for kind in np.flatnonzero(np.bincount(number, minlength=1)).tolist():
        own = low[number == kind]
        for offset in np.ndindex(kind // _LARGE**2, kind // _LARGE % _LARGE, kind % _LARGE):
            out[tuple((own + np.array(offset, dtype=np.int32)).T)] = value
