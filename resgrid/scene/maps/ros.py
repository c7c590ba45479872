"""Reader of ROS occupancy maps (``map.yaml`` and its picture) in several dialects, whole or in parts."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from resgrid._internal.memory import SMALLER_MAP, require_grid_memory
from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.occupancies import conductivities
from resgrid.scene.maps.pictures import BYTES_PER_PIXEL, DecodedPicture, PixelRaster, open_picture
from resgrid.scene.maps.preparation import Window, axes_of_window, whole_window
from resgrid.scene.maps.ros_dialects import CONVERTERS, UNKNOWN, occupancies as convert
from resgrid.scene.maps.ros_header import NEWEST, Dialect, RosHeader, picture_of, read_header
from resgrid.scene.maps.size_advice import smaller_map
from resgrid.scene.messages import unknown_option

_PIXELS_PER_BLOCK = 1 << 20
"""Number of pixels that are converted at once to find the known part of a map; limits the memory of the search."""

COSTS_BYTES = 40
"""Estimated memory for the conversion of occupancies to conductivities, in bytes per pixel."""


def read_ros(
    path: Path,
    dialect: Dialect = NEWEST,
    unknown: Literal["obstacle", "free"] = "obstacle",
    lethal: Annotated[int, Ge(1), Le(100)] | None = None,
    least_conductivity: Annotated[float, Gt(0), Le(1)] | None = None,
) -> MapCells:
    """Return the cells of a ROS map, read from its ``map.yaml`` and its picture.

    Parameters
    ----------
    dialect
        ROS map reader whose rules apply: nav2 (since 2025), nav2-jazzy (Nav2 from Dashing to Jazzy) or ros1.
    unknown
        Treatment of cells of unknown occupancy: obstacle or free.  In ROS maps of mode raw, values above 100 are
        unknown in Nav2; in ROS 1, 255 is unknown, and 101 to 254 are obstacles, as in costmap_2d.
    lethal
        Smallest occupancy of an obstacle cell; by default from ``occupied_thresh``.
    least_conductivity
        Conductivity c of a cell just below `lethal`; a cell of occupancy p has the conductivity c ** (p / lethal).  By
        default all free cells have conductivity 1.
    """
    source = open_ros(path, dialect, unknown=unknown, lethal=lethal, least_conductivity=least_conductivity)
    return source.cells(whole_window(source.axes))


@dataclass(frozen=True, eq=False)
class RosParts:
    """A ROS map of which parts can be read.

    `path`: the ``map.yaml``; `header`: its keys; `picture`: its picture, of which parts can be converted; `dialect`:
    ROS map reader whose rules apply; `options`: values of ``unknown``, ``lethal`` and ``least_conductivity`` by name,
    as for `read_ros`; `axes`: axes of the whole map; `frame`: transformation from map coordinates to the world.
    """

    path: Path
    header: RosHeader
    picture: PixelRaster | DecodedPicture
    dialect: Dialect
    options: dict[str, Any]
    axes: tuple[Axis, ...]
    frame: Frame

    def known(self) -> Window | None:
        """Return the ranges (first, end) of x and y of the smallest box with all known cells; None without any."""
        height, width = self.picture.shape
        step = max(1, _PIXELS_PER_BLOCK // width)
        rows, columns = np.zeros(height, dtype=bool), np.zeros(width, dtype=bool)
        for first in range(0, height, step):
            is_known = self.occupancies(slice(first, min(first + step, height)), slice(0, width)) != UNKNOWN
            rows[first : first + step] = is_known.any(axis=1)
            columns |= is_known.any(axis=0)
        if not rows.any():
            return None
        (left, right), (top, bottom) = (np.flatnonzero(hits)[[0, -1]].tolist() for hits in (columns, rows))
        return (left, right + 1), (height - 1 - bottom, height - top)

    def cells(self, window: Window) -> MapCells:
        """Return the cells of a part of the map; raise BudgetError if they would not fit in memory.

        `window`: for x and y (upwards) the index of the first cell, and of the cell after the last one.
        """
        (left, right), (low, high) = window
        pixel = BYTES_PER_PIXEL if self.options.get("least_conductivity") is None else COSTS_BYTES
        size = right - left, high - low
        require_grid_memory(size, str(self.path), pixel, lambda ratio: smaller_map(size, ratio, self.known()))
        height, _ = self.picture.shape
        occupancy = self.occupancies(slice(height - high, height - low), slice(left, right))[::-1].copy()
        return _cells(occupancy, self.header, axes_of_window(self.axes, window), self.frame, **self.options)

    def occupancies(self, rows: slice, columns: slice) -> NDArray[np.int8]:
        """Return the occupancies (height, width) of a part of the picture, top row first, 0 to 100 or -1 for unknown.

        In mode ``raw`` of ROS 1, any signed byte is possible.  `rows`, `columns`: part of the picture in pixels, row 0
        at the top.
        """
        return convert(self.picture.part(rows, columns), self.header, self.dialect)


def open_ros(path: Path, dialect: Dialect = NEWEST, **options: Any) -> RosParts:
    """Return a ROS map of which parts can be read.

    `path`: the ``map.yaml``; `dialect`: ROS map reader whose rules apply; `options`: ``unknown``, ``lethal`` and
    ``least_conductivity`` of `read_ros`.
    """
    header = read_header(path, dialect)
    name = picture_of(path, header.image)
    picture = open_picture(name)
    if isinstance(picture, PixelRaster):
        _warn_of_palette(name, picture, dialect)
    else:
        _warn_of_palette(name, picture.part(slice(0, 1), slice(0, 1)), dialect)
    place = place_of_map(header.origin, header.resolution, picture.shape)
    return RosParts(path, header, picture, dialect, options, *place)


def _cells(
    occupancy: NDArray[np.int8],
    header: RosHeader,
    axes: tuple[Axis, ...],
    frame: Frame,
    unknown: str = "obstacle",
    lethal: int | None = None,
    least_conductivity: float | None = None,
) -> MapCells:
    """Return the cells of a ROS map.

    `occupancy` (height, width): in percent, -1 for unknown, bottom row first; `header`: keys of the ``map.yaml``;
    `axes`: axes of the cells in map coordinates; `frame`: transformation from map coordinates to the world; `unknown`:
    treatment of unknown cells, obstacle or free; `lethal`: smallest occupancy of an obstacle, None for the threshold in
    `header`; `least_conductivity`: conductivity just below `lethal`, None for 1 everywhere.
    """
    occupied = _is_occupied(occupancy, header, lethal)
    unseen = occupancy == UNKNOWN
    cell = np.where(occupied, np.uint8(Cell.OBSTACLE), np.uint8(Cell.FREE))
    cell[unseen] = Cell.OBSTACLE if unknown == "obstacle" else Cell.FREE
    conductivity = None
    if least_conductivity is not None:
        conductivity = conductivities(occupancy.T, least_conductivity, _lethal(header, lethal))
    return MapCells(axes, np.ascontiguousarray(cell.T), frame, conductivity, np.ascontiguousarray(unseen.T))


def ros_greys(path: Path, dialect: Dialect = NEWEST, lethal: int | None = None) -> list[str]:
    """Return the meaning of each grey value 0 to 255 of a ROS map: ``obstacle``, ``free`` or ``unknown``.

    `path`: the ``map.yaml``; `dialect`: ROS map reader whose rules apply; `lethal`: smallest occupancy, 1 to 100, of an
    obstacle; None for the threshold in the ``map.yaml``.
    """
    header = read_header(path, dialect)
    occupancy = convert(PixelRaster(np.arange(256, dtype=np.uint8).reshape(1, 256, 1), 255), header, dialect)
    words = np.where(_is_occupied(occupancy, header, lethal), "obstacle", "free")
    return [str(word) for word in np.where(occupancy == UNKNOWN, "unknown", words)[0]]


def _is_occupied(occupancy: NDArray[np.int8], header: RosHeader, lethal: int | None) -> NDArray[np.bool_]:
    return occupancy.view(np.uint8) >= _lethal(header, lethal)


def _lethal(header: RosHeader, lethal: int | None) -> int:
    """Return the smallest occupancy of an obstacle cell, from 1 to 100.

    `lethal`: value that the user gives, or None; for None, the result follows from the header's ``occupied_thresh``.
    """
    percent = round(100 * header.occupied_thresh, 9)  # 100 * 0.55 is slightly above 55
    return max(1, int(np.ceil(percent))) if lethal is None else lethal


def _require_dialect(dialect: str) -> None:
    if dialect not in CONVERTERS:
        raise InputError(f"dialect: {unknown_option(repr(dialect), dialect, ', '.join(CONVERTERS), list(CONVERTERS))}")


def from_occupancy_grid(file: str | os.PathLike[str], dialect: Dialect = NEWEST) -> NDArray[np.int8]:
    r"""Return the occupancies of a ROS map, as its ROS reader publishes them.

    Parameters
    ----------
    file : path-like
        The ``map.yaml``.
    dialect : {"nav2", "nav2-jazzy", "ros1"}
        ROS map reader whose rules apply: Nav2 since 2025, Nav2 from Dashing to Jazzy, or ROS 1.

    Returns
    -------
    ndarray of int8, shape (height, width)
        100 occupied, 0 free, -1 unknown; modes ``scale`` and ``raw`` also give values from 1 to 99, and
        ``raw`` of ROS 1 any signed byte.  Rows as in ``nav_msgs/OccupancyGrid``: row 0 is the bottom row of the
        picture, so entry ``[j, i]`` is cell ``(i, j)``.

    Raises
    ------
    InputError
        If a file, a key or the dialect is invalid.
    BudgetError
        If the picture would not fit in memory.

    Examples
    --------
    >>> from pathlib import Path
    >>> from PIL import Image
    >>> Image.fromarray(np.array([[254, 254, 254], [254, 0, 254]], np.uint8)).save("map.pgm")
    >>> keys = "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\norigin: [0, 0, 0]\n"
    >>> size = Path("map.yaml").write_text("image: map.pgm\nresolution: 0.1\n" + keys)
    >>> rg.maps.from_occupancy_grid("map.yaml")
    array([[  0, 100,   0],
           [  0,   0,   0]], dtype=int8)
    """
    _require_dialect(dialect)
    source = open_ros(Path(file), dialect)
    require_grid_memory(source.picture.shape[::-1], str(source.path), BYTES_PER_PIXEL, SMALLER_MAP)
    return source.occupancies(slice(None), slice(None))[::-1].copy()


def _warn_of_palette(picture: Path, raster: PixelRaster, dialect: Dialect) -> None:
    """Issue a warning if the dialect is "ros1" and the picture has a palette, whose indices then are grey values.

    `picture`: name of the file, for the message; `raster`: the picture, or a part; `dialect`: ROS map reader whose
    rules apply.
    """
    if dialect == "ros1" and raster.numbers is not None:
        warnings.warn(
            f"{picture}: like map_server of ROS 1, this reader uses the indices of the palette as grey values; save "
            "the picture without a palette",
            stacklevel=3,
        )


def place_of_map(origin: Sequence[float], resolution: float, shape: tuple[int, ...]) -> tuple[tuple[Axis, ...], Frame]:
    """Return the axes of a ROS map in map coordinates, and the transformation from map coordinates to the world.

    Without a yaw, map coordinates are world coordinates; otherwise their origin is the lower left corner.  `origin`: x,
    y and yaw of the lower left corner in metres and radians; `resolution`: width of a cell in metres; `shape`: (height,
    width) in cells.
    """
    height, width = shape
    x, y, yaw = origin
    frame = Frame(x, y, yaw) if yaw else Frame()
    x, y = (0.0, 0.0) if yaw else (x, y)
    axes = (("x", x, width), ("y", y, height))
    return tuple(Axis(name, low, low + cells * resolution, cells, unit="m") for name, low, cells in axes), frame
