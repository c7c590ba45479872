"""Nav2 masks (ROS maps of keep-out or speed zones): their values at points and in the cells of a rotated grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil, cos, sin
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.memory import BYTES_PER_CELL, SMALLER_MAP, require_grid_memory
from resgrid.core.axis import Axis, rounding
from resgrid.core.frame import Frame
from resgrid.scene.maps.ros import open_ros
from resgrid.scene.maps.ros_dialects import OCCUPIED, UNKNOWN
from resgrid.scene.maps.ros_header import Dialect


@dataclass(frozen=True, eq=False)
class MaskGrid:
    """The pixels of a mask (a ROS map that marks areas, such as keep-out zones) with their position in the world.

    `values` (width, height): occupancies from 0 to 100, -1 for unknown; first index along x, second along y, upwards;
    `axes`: axes of the pixels in map coordinates; `frame`: transformation from map coordinates to the world.
    """

    values: NDArray[np.int8]
    axes: tuple[Axis, ...]
    frame: Frame

    @property
    def spacing(self) -> float:
        """Width of a pixel in metres."""
        return self.axes[0].spacing

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the coordinates (..., 2) of points in pixel widths, from the lower corner of the mask.

        `points` (..., 2): in world coordinates.
        """
        lower = [axis.lower for axis in self.axes]
        return np.asarray((self.frame.from_world(points) - lower) / self.spacing)

    def at(self, points: NDArray[np.float64]) -> NDArray[np.int8]:
        """Return the occupancies (n,) of the pixels at points (n, 2) in world coordinates, -1 outside the mask."""
        return self._values_of(np.floor(self.pixels(points)).astype(np.int64))

    def _values_of(self, index: NDArray[np.int64]) -> NDArray[np.int8]:
        """Return the occupancies of pixels, -1 outside the mask.

        `index` (..., 2): column and row of each pixel, from below.
        """
        inside = np.all((index >= 0) & (index < self.values.shape), axis=-1)
        found = np.full(inside.shape, UNKNOWN, dtype=np.int8)
        found[inside] = self.values[tuple(index[inside].T)]
        return found

    def largest_in(self, axes: Sequence[Axis], frame: Frame, *, centres: bool) -> NDArray[np.int8]:
        """Return the largest occupancy of the pixels that overlap each cell of a plane grid, -1 without known pixels.

        `axes`: the two axes of the grid; `frame`: transformation from axis units to the world; `centres`: whether only
        the pixel at each cell's centre counts, as in Nav2; otherwise all that overlap the cell do.  The result has the
        shape of the grid.  A pixel and a cell overlap if no side of either separates them; if they only touch, they do
        not overlap.
        """
        plane = Frame(frame.x, frame.y, frame.yaw)
        result = np.empty(tuple(axis.cells for axis in axes), dtype=np.int8)
        turn = frame.yaw - self.frame.yaw
        c, s = cos(turn), sin(turn)
        half = np.array([axis.spacing for axis in axes]) / self.spacing / 2
        if centres:
            half = np.zeros(2)
        slack = float(rounding(self.axes, np.abs(plane.reach(axes)) + self.frame.reach(self.axes)).max()) * 8
        box = np.array([half[0] * abs(c) + half[1] * abs(s), half[0] * abs(s) + half[1] * abs(c)])
        apart = box + 0.5 - slack  # distance of centres at which a pixel's sides separate, per axis of the mask
        across = half + 0.5 * (abs(c) + abs(s)) - slack  # and at which a cell's sides do
        count = [ceil(2 * width) + 1 for width in box]
        for column, x in enumerate(axes[0].centres):
            middle = self.pixels(plane.to_world(np.column_stack([np.full(axes[1].cells, x), axes[1].centres])))
            if centres:
                result[column] = self._values_of(np.floor(middle).astype(np.int64))
                continue
            first = np.floor(middle - box + slack).astype(np.int64)
            best = np.full(len(middle), UNKNOWN, dtype=np.int8)
            for offset in product(*(range(number) for number in count)):
                pixel = first + offset
                gap = middle - (pixel + 0.5)
                along = np.abs(gap @ np.array([[c, -s], [s, c]]))
                meets = np.all(np.abs(gap) < apart, axis=1) & np.all(along < across, axis=1)
                best = np.maximum(best, np.where(meets, self._values_of(pixel), np.int8(UNKNOWN)))
            result[column] = best
        return result


def read_mask(file: str, dialect: Dialect) -> MaskGrid:
    """Return the pixels of a mask; `file`: its ``map.yaml``; `dialect`: ROS map reader whose rules apply.

    In ROS 1, with mode ``raw``, pixels of 101 to 254 are occupied and have the occupancy 100, as in costmap_2d.
    """
    source = open_ros(Path(file), dialect)
    height, width = source.picture.shape
    require_grid_memory((width, height), file, BYTES_PER_CELL, SMALLER_MAP)
    rows = source.occupancies(slice(None), slice(None))[::-1]
    rows = np.where((rows.view(np.uint8) > OCCUPIED) & (rows != UNKNOWN), np.int8(OCCUPIED), rows)
    return MaskGrid(np.ascontiguousarray(rows.T), source.axes, source.frame)
