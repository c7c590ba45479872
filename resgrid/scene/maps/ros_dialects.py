"""Conversion of the pixels of a ROS map to occupancies, as by the reader of each dialect.

Sources read: ros-navigation/navigation2, ``nav2_map_server/src/map_io.cpp``, on main since pull request 5071 of 2025
(``nav2``), and from Dashing to Jazzy (``nav2-jazzy``), both with pictures by GraphicsMagick with 16-bit quanta;
ros-planning/navigation, ``map_server/src/image_loader.cpp`` of Noetic since 1.17.1 (``ros1``, pictures by SDL_image),
where earlier versions cut off ``99 * ratio`` in mode ``scale``.  With ``p`` the darkness of a pixel from 0 to 1 (its
lightness if ``negate``), high ``p`` is occupied (100), low ``p`` is free (0), other values unknown (-1).  The readers
differ in:

=====================  ============================  ============================  ===========================
property               ``nav2``                      ``nav2-jazzy``                ``ros1``
=====================  ============================  ============================  ===========================
darkness               ``1 - grey / 255`` of the     ``1 - mean / 65535`` of       ``(255 - mean) / 255``,
                       8-bit luma, single precision  16-bit channels               mean of 8-bit channels
occupied, free         ``p >= occupied_thresh``,     ``p > occupied_thresh``,      as ``nav2-jazzy``
                       ``p <= free_thresh``          ``p < free_thresh``
both (thresholds in    free                          occupied                      occupied
any order)
opacity, trinary       unknown unless opaque         averaged with the colours     averaged with the colours
opacity, scale         unknown unless opaque         unknown unless opaque         where between the
                                                                                   thresholds: unknown if 0
                                                                                   (three channels: the third
                                                                                   stands for opacity)
between, scale         ``100 * ratio``, half away    ``100 * ratio``, half to      ``1 + 98 * ratio``, cut off
                       from zero                     even
raw                    the grey; above 100 unknown   the mean, rounded; above      the mean, cut off, as a
                                                     100 unknown                   signed byte
a raw cell above 100   unknown                       unknown                       255 unknown, others
                                                                                   occupied (costmap_2d)
opacity of grey PNGs   as of colours                 taken as opaque               as of colours
a palette              its colours                   its colours                   the numbers of its colours
``negate`` and raw     ignored                       ignored                       negated too
``negate``             number or truth value         number or truth value         number
``mode``               any case                      any case                      lower case
=====================  ============================  ============================  ===========================
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from resgrid.scene.maps.pictures import PixelRaster
from resgrid.scene.maps.ros_header import Dialect, RosHeader

OCCUPIED, FREE, UNKNOWN = 100, 0, -1
"""Values of occupied, free and unknown cells in the ROS message ``nav_msgs/OccupancyGrid``."""

QUANTUM = 65535
"""Channel value of white and of full opacity in GraphicsMagick."""

ROWS_PER_BLOCK = 64
"""Number of rows of a colour picture that are converted at once; limits the memory of intermediate values."""


def occupancies(raster: PixelRaster, header: RosHeader, dialect: Dialect) -> NDArray[np.int8]:
    """Return the occupancies (height, width) of a picture by the rules of a dialect, top row first.

    An occupancy is a percentage from 0 (free) to 100 (occupied), or -1 (unknown); with mode ``raw`` of ROS 1, any
    signed byte.  `raster`: the picture; `header`: keys of the ``map.yaml``; `dialect`: ROS map reader whose rules
    apply.
    """
    convert = CONVERTERS[dialect]
    if raster.values.shape[2] == 1:  # each grey value is converted once
        every = np.arange(raster.maxval + 1, dtype=np.uint16).reshape(1, -1, 1)
        return np.asarray(convert(PixelRaster(every, raster.maxval), header)[0][raster.values[..., 0]])
    result = np.empty(raster.values.shape[:2], dtype=np.int8)
    for first in range(0, len(result), ROWS_PER_BLOCK):
        rows = slice(first, first + ROWS_PER_BLOCK)
        result[rows] = convert(raster.part(rows, slice(None)), header)
    return result


class PixelConverter(Protocol):
    """Type of a function that converts a picture to occupancies by the rules of one ROS map reader."""

    def __call__(self, raster: PixelRaster, header: RosHeader) -> NDArray[np.int8]:
        """Return the occupancies (height, width) of a picture, top row first, -1 (unknown) to 100.

        In mode ``raw`` of ROS 1, any signed byte is possible.  `raster`: the picture; `header`: keys of the
        ``map.yaml``.
        """


def _as_nav2(raster: PixelRaster, header: RosHeader) -> NDArray[np.int8]:
    grey = _grey_bytes(raster)
    if header.mode == "raw":
        return np.where(grey <= OCCUPIED, grey, UNKNOWN).astype(np.int8)
    p = grey.astype(np.float32) / np.float32(255)
    if not header.negate:
        p = np.float32(1) - p
    free, occupied = np.float32(header.free_thresh), np.float32(header.occupied_thresh)
    result = np.full(p.shape, UNKNOWN, dtype=np.int8)
    result[p >= occupied] = OCCUPIED
    result[p <= free] = FREE
    if header.mode == "scale":
        between = (p > free) & (p < occupied)
        width = np.float32(header.occupied_thresh - header.free_thresh)
        ratio = (p[between] - free) / width * np.float32(100)
        result[between] = np.floor(ratio.astype(np.float64) + 0.5).astype(np.int8)
    if raster.has_alpha:
        result[raster.values[..., -1] < raster.maxval] = UNKNOWN
    return result


def _grey_bytes(raster: PixelRaster) -> NDArray[np.int64]:
    """Return the grey values (height, width) of GraphicsMagick, 0 to 255.

    A grey value is the 16-bit ITU-R 601 luma, rounded and then truncated to 8 bits.
    """
    quanta = _quanta(raster)
    if quanta.shape[2] <= 2:
        return quanta[..., 0] // 257
    luma = 500 + 299 * quanta[..., 0] + 587 * quanta[..., 1] + 114 * quanta[..., 2]
    return luma // 1000 // 257


def _as_nav2_jazzy(raster: PixelRaster, header: RosHeader) -> NDArray[np.int8]:
    quanta = _quanta(raster)
    colour = quanta[..., :-1] if raster.has_alpha else quanta
    if colour.shape[2] == 1:
        colour = colour[..., [0, 0, 0]]
    # GraphicsMagick stores PNGs of grey and opacity as a palette, and Color objects from a palette are opaque.
    has_opacity = raster.has_alpha and not raster.is_grey_alpha
    opacity = quanta[..., -1] if has_opacity else np.full(colour.shape[:2], QUANTUM)
    total, count = colour.sum(axis=2), 3
    if header.mode == "trinary" and raster.has_alpha:
        total, count = total + opacity, 4
    shade = total / float(count) / QUANTUM
    if header.mode == "raw":
        percent = np.floor(shade * 255 + 0.5)
        return np.where(percent <= OCCUPIED, percent, UNKNOWN).astype(np.int8)
    p = shade if header.negate else 1.0 - shade
    result = np.full(p.shape, UNKNOWN, dtype=np.int8)
    if header.mode == "scale" and header.free_thresh < header.occupied_thresh:
        result = np.rint(np.clip(_scaled(p, header), 0, 1) * 100.0).astype(np.int8)
    result = _strictly_thresholded(result, p, header)
    if header.mode == "scale":
        result[opacity != QUANTUM] = UNKNOWN
    return result


def _as_ros1(raster: PixelRaster, header: RosHeader) -> NDArray[np.int8]:
    channels, has_alpha = raster.bytes, raster.has_alpha
    if raster.numbers is not None:
        channels, has_alpha = raster.numbers[..., np.newaxis].astype(np.int32), False
    if channels.shape[2] == 2:
        channels = channels[..., [0, 0, 0, 1]]
    count = channels.shape[2]
    averaged = count if header.mode == "trinary" or not has_alpha else count - 1
    mean = channels[..., :averaged].sum(axis=2) / averaged
    if header.negate:
        mean = 255 - mean
    if header.mode == "raw":
        return np.asarray(mean.astype(np.uint8).view(np.int8))
    p = (255 - mean) / 255.0
    result = np.full(p.shape, UNKNOWN, dtype=np.int8)
    if header.mode == "scale" and header.free_thresh < header.occupied_thresh:
        visible = np.ones(mean.shape, dtype=bool) if count == 1 else channels[..., -1] >= 1
        result = np.where(visible, np.clip(1 + 98 * _scaled(p, header), 1, 99).astype(np.int8), result)
    return _strictly_thresholded(result, p, header)


CONVERTERS: Mapping[Dialect, PixelConverter] = {"nav2": _as_nav2, "nav2-jazzy": _as_nav2_jazzy, "ros1": _as_ros1}


def _quanta(raster: PixelRaster) -> NDArray[np.int64]:
    return (raster.values.astype(np.int64) * QUANTUM + raster.maxval // 2) // raster.maxval


def _scaled(p: NDArray[np.float64], header: RosHeader) -> NDArray[np.float64]:
    """Return the darkness `p` (0 to 1), rescaled linearly between the thresholds of the header.

    The result is 0 at ``free_thresh`` and 1 at ``occupied_thresh``; it has the shape of `p`.
    """
    return np.asarray((p - header.free_thresh) / (header.occupied_thresh - header.free_thresh))


def _strictly_thresholded(result: NDArray[np.int8], p: NDArray[np.float64], header: RosHeader) -> NDArray[np.int8]:
    result[p < header.free_thresh] = FREE
    result[p > header.occupied_thresh] = OCCUPIED
    return result
