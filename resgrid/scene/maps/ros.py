"""Reader of ROS occupancy maps, ``map.yaml`` and its picture, in several dialects."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.pictures import BYTES_PER_PIXEL, Raster, read_raster
from resgrid.scene.maps.ros_dialects import CONVERTERS, UNKNOWN, occupancies
from resgrid.scene.maps.ros_header import NEWEST, Dialect, RosHeader, picture_of, read_header
from resgrid.scene.messages import unknown_option

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
        Treatment of cells of unknown occupancy: obstacle or free.  Raw values above 100 are unknown in Nav2; in ROS 1,
        255 is unknown, and 101 to 254 are obstacles, as costmap_2d interprets the values of map_server.
    lethal
        Smallest occupancy of an obstacle cell; by default from ``occupied_thresh``.
    least_conductivity
        Conductivity c of a cell just below `lethal`; a cell of occupancy p has the conductivity c ** (p / lethal).  By
        default all free cells have conductivity 1.
    """
    header = read_header(path, dialect)
    occupancy = _occupancy(path, header, dialect, BYTES_PER_PIXEL if least_conductivity is None else COSTS_BYTES)
    occupied = _is_occupied(occupancy, header, lethal)
    unseen = occupancy == UNKNOWN
    cell = np.where(occupied, np.uint8(Cell.OBSTACLE), np.uint8(Cell.FREE))
    cell[unseen] = Cell.OBSTACLE if unknown == "obstacle" else Cell.FREE
    conductivity = None
    if least_conductivity is not None:
        fraction = np.clip(occupancy, 0, None) / _lethal(header, lethal)
        conductivity = np.ascontiguousarray(np.where(occupied, 1.0, least_conductivity**fraction).T)
    axes, frame = _place(header, cell.shape)
    return MapCells(axes, np.ascontiguousarray(cell.T), frame, conductivity, np.ascontiguousarray(unseen.T))


def ros_greys(path: Path, dialect: Dialect = NEWEST, lethal: int | None = None) -> list[str]:
    """Return the meaning of each grey value 0 to 255 of a ROS map: ``obstacle``, ``free`` or ``unknown``.

    `path`: the ``map.yaml``; `dialect`: ROS map reader whose rules apply; `lethal`: smallest occupancy, 1 to 100, of an
    obstacle; None for the threshold in the ``map.yaml``.
    """
    header = read_header(path, dialect)
    occupancy = occupancies(Raster(np.arange(256, dtype=np.uint8).reshape(1, 256, 1), 255), header, dialect)
    words = np.where(_is_occupied(occupancy, header, lethal), "obstacle", "free")
    return [str(word) for word in np.where(occupancy == UNKNOWN, "unknown", words)[0]]


def _is_occupied(occupancy: NDArray[np.int8], header: RosHeader, lethal: int | None) -> NDArray[np.bool_]:
    return occupancy.view(np.uint8) >= _lethal(header, lethal)


def _lethal(header: RosHeader, lethal: int | None) -> int:
    """Return the smallest occupancy of an obstacle cell, from 1 to 100.

    `lethal`: value that the user gives, or None; for None, the result follows from the header's ``occupied_thresh``.
    """
    return max(1, int(np.ceil(100 * header.occupied_thresh))) if lethal is None else lethal


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
        100 occupied, 0 free, -1 unknown; modes ``scale`` and ``raw`` also give values from 1 to 99.  Rows as in
        ``nav_msgs/OccupancyGrid``: row 0 is the bottom row of the picture, so entry ``[j, i]`` is cell ``(i, j)``.

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
    return _occupancy(Path(file), read_header(Path(file), dialect), dialect)


def _occupancy(path: Path, header: RosHeader, dialect: Dialect, pixel: int = BYTES_PER_PIXEL) -> NDArray[np.int8]:
    picture = picture_of(path, header.image)
    raster = read_raster(picture, pixel)
    if dialect == "ros1" and raster.numbers is not None:
        warnings.warn(
            f"{picture}: like map_server of ROS 1, this reader uses the indices of the palette as grey values; save "
            "the picture without a palette",
            stacklevel=2,
        )
    return occupancies(raster, header, dialect)[::-1].copy()


def _place(header: RosHeader, shape: tuple[int, ...]) -> tuple[tuple[Axis, ...], Frame]:
    height, width = shape
    x, y, yaw = header.origin
    frame = Frame(x, y, yaw) if yaw else Frame()
    x, y = (0.0, 0.0) if yaw else (x, y)
    step = header.resolution
    return (Axis("x", x, x + width * step, width), Axis("y", y, y + height * step, height)), frame
