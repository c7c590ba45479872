"""ROS occupancy maps: ``map.yaml`` and its picture, read as the reader of a dialect reads them."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from resgrid.core.axis import Axis
from resgrid.core.frame import Frame
from resgrid.core.space import Cell
from resgrid.errors import InputError
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.pictures import BYTES_PER_PIXEL, Raster, read_raster
from resgrid.scene.maps.ros_dialects import CONVERTERS, UNKNOWN, occupancies
from resgrid.scene.maps.ros_header import NEWEST, Dialect, RosHeader, picture_of, read_header
from resgrid.scene.messages import unknown as unknown_word

COSTS_BYTES = 40
"""Memory of a pixel while occupancies are turned into conductivities."""


def read_ros(
    path: Path,
    dialect: Dialect = NEWEST,
    unknown: Literal["obstacle", "free"] = "obstacle",
    lethal: Annotated[int, Ge(1), Le(100)] | None = None,
    least_conductivity: Annotated[float, Gt(0), Le(1)] | None = None,
) -> MapCells:
    """Read a ROS map.

    Parameters
    ----------
    dialect
        The reader to follow: nav2 (since 2025), nav2-jazzy (Nav2 from Dashing to Jazzy) or ros1.
    unknown
        Meaning of cells of unknown occupancy. Raw values above 100 are unknown to Nav2; of ROS 1 255 is, and 101 to 254
        are obstacles, as costmap_2d takes the values that map_server sends.
    lethal
        Occupancy from which a cell is an obstacle; by default that of ``occupied_thresh``.
    least_conductivity
        Values below lethal as cost; an occupancy p conducts this to the power of p / lethal.
    """
    header = read_header(path, dialect)
    occupancy = _occupancy(path, header, dialect, BYTES_PER_PIXEL if least_conductivity is None else COSTS_BYTES)
    occupied = _is_occupied(occupancy, header, lethal)
    unseen = occupancy == UNKNOWN
    cell = np.where(occupied, np.uint8(Cell.OBSTACLE), np.uint8(Cell.FREE))
    cell[unseen] = Cell.OBSTACLE if unknown == "obstacle" else Cell.FREE
    conductivity = None
    if least_conductivity is not None:
        share = np.clip(occupancy, 0, None) / _lethal(header, lethal)
        conductivity = np.ascontiguousarray(np.where(occupied, 1.0, least_conductivity**share).T)
    axes, frame = _place(header, cell.shape)
    return MapCells(axes, np.ascontiguousarray(cell.T), frame, conductivity, np.ascontiguousarray(unseen.T))


def ros_greys(path: Path, dialect: Dialect = NEWEST, lethal: int | None = None) -> list[str]:
    """What each grey value of an opaque picture means in a ROS map."""
    header = read_header(path, dialect)
    occupancy = occupancies(Raster(np.arange(256, dtype=np.uint8).reshape(1, 256, 1), 255), header, dialect)
    words = np.where(_is_occupied(occupancy, header, lethal), "obstacle", "free")
    return [str(word) for word in np.where(occupancy == UNKNOWN, "unknown", words)[0]]


def _is_occupied(occupancy: NDArray[np.int8], header: RosHeader, lethal: int | None) -> NDArray[np.bool_]:
    return occupancy.view(np.uint8) >= _lethal(header, lethal)


def _lethal(header: RosHeader, lethal: int | None) -> int:
    """The least occupancy of an obstacle."""
    return max(1, int(np.ceil(100 * header.occupied_thresh))) if lethal is None else lethal


def _require_dialect(dialect: str) -> None:
    if dialect not in CONVERTERS:
        raise InputError(f"dialect: {unknown_word(repr(dialect), dialect, ', '.join(CONVERTERS), list(CONVERTERS))}")


def from_occupancy_grid(file: str | os.PathLike[str], dialect: Dialect = NEWEST) -> NDArray[np.int8]:
    r"""Occupancies of a ROS map, as the reader of a dialect publishes them.

    Parameters
    ----------
    file : path-like
        The ``map.yaml``.
    dialect : {"nav2", "nav2-jazzy", "ros1"}
        The reader to follow: of Nav2 since 2025, of Nav2 from Dashing to Jazzy, or of ROS 1.

    Returns
    -------
    ndarray of int8, shape (height, width)
        100 occupied, 0 free, -1 unknown, between them what the mode says.  Rows as in ``nav_msgs/OccupancyGrid``: row 0
        is the bottom one of the picture, so entry ``[j, i]`` is cell ``(i, j)``.

    Raises
    ------
    InputError
        If a file, a key or the dialect is wrong.
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
            f"{picture}: map_server of ROS 1 takes the numbers of the colours in a palette for greys, and so does this "
            "map; save the picture without a palette",
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
