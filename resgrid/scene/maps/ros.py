"""ROS occupancy maps: ``map.yaml`` and its picture, as ROS 1's map_server and as Nav2's read them.

Sources read: ros-planning/navigation, ``map_server/src/main.cpp`` and ``image_loader.cpp`` (modes since Jade; pictures
by SDL_image), http://wiki.ros.org/map_server; ros-navigation/navigation2, ``nav2_map_server/src/map_io.cpp`` (Dashing
to Jazzy; GraphicsMagick with 16-bit quanta).  They agree where nothing is subtle: with ``p`` the darkness of a pixel
from 0 to 1 (its lightness if ``negate``), ``p > occupied_thresh`` is occupied (100), ``p < free_thresh`` is free (0),
both strictly, anything else unknown (-1).  They differ in:

========================  =================================================  =======================================
matter                    ``ros1``                                           ``nav2``
========================  =================================================  =======================================
darkness                  ``(255 - mean) / 255``, mean of 8-bit channels     ``1 - mean / 65535`` of 16-bit quanta
alpha, trinary            averaged in with the colours                       the same
alpha, scale              where between the thresholds: unknown if 0         unknown unless opaque, before all else
                          (three channels: the third stands for alpha)
between, scale            ``99 * ratio``, cut off                            ``100 * ratio``, rounded half to even
raw                       the mean, cut off, as a signed byte                the mean, rounded; above 100 unknown
``negate`` and raw        negated too                                        ignored
``negate``                a whole number                                     a whole number or a truth value
========================  =================================================  =======================================
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.files import read_text
from resgrid.frame import Frame
from resgrid.scene.maps.data import MapData
from resgrid.scene.maps.pictures import Raster, read_raster
from resgrid.space import Axis, Cell

OCCUPIED, FREE, UNKNOWN = 100, 0, -1
MODES = ("trinary", "scale", "raw")
DIALECTS = ("nav2", "ros1")
WORDS = {"true": 1, "yes": 1, "on": 1, "y": 1, "false": 0, "no": 0, "off": 0, "n": 0}
QUANTUM = 65535
BYTES_PER_PIXEL = 96
"""Memory of a picture while it is turned into occupancies."""


@dataclass(frozen=True)
class RosHeader:
    """What a ``map.yaml`` says.

    `image`: the picture; `resolution`: width of a pixel, in metres; `origin`: pose of the lower-left corner of the
    lower-left pixel: x and y in metres, yaw in radians, anticlockwise; `negate`: whether light means occupied;
    `occupied_thresh, free_thresh`: thresholds of the darkness, 0 to 1; `mode`: what a grey value means.
    """

    image: Path
    resolution: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


def read_ros(
    path: Path,
    dialect: str = "nav2",
    unknown: str = "obstacle",
    lethal: int | None = None,
    least_conductivity: float | None = None,
) -> MapData:
    """Read a ROS map.

    A cell is an obstacle if its occupancy is at least `lethal`, and free below; negative occupancies follow `unknown`.
    Where a ROS 1 raw map holds bytes above 127, they count as costmap_2d reads them: 255 is unknown, others occupied.
    With `least_conductivity` c, a free cell of occupancy p conducts ``c ** (p / lethal)``.
    """
    header = read_header(path, dialect)
    occupancy = _occupancy(header, dialect)
    occupied = _is_occupied(occupancy, header, lethal)
    cell = np.where(occupied, Cell.OBSTACLE, Cell.FREE).astype(np.uint8)
    cell[occupancy == UNKNOWN] = Cell.OBSTACLE if unknown == "obstacle" else Cell.FREE
    conductivity = None
    if least_conductivity is not None:
        share = np.clip(occupancy, 0, None) / _lethal(header, lethal)
        conductivity = np.ascontiguousarray(np.where(occupied, 1.0, least_conductivity**share).T)
    axes, frame = _place(header, cell.shape)
    return MapData(axes, frame, np.ascontiguousarray(cell.T), conductivity)


def ros_greys(path: Path, dialect: str = "nav2", lethal: int | None = None) -> list[str]:
    """What each grey value of an opaque picture means in a ROS map."""
    header = read_header(path, dialect)
    occupancy = _CONVERTERS[dialect](Raster(np.arange(256, dtype=np.uint16).reshape(1, 256, 1), 255), header)
    words = np.where(_is_occupied(occupancy, header, lethal), "obstacle", "free")
    return [str(word) for word in np.where(occupancy == UNKNOWN, "unknown", words)[0]]


def _is_occupied(occupancy: NDArray[np.int8], header: RosHeader, lethal: int | None) -> NDArray[np.bool_]:
    return occupancy.view(np.uint8) >= _lethal(header, lethal)


def _lethal(header: RosHeader, lethal: int | None) -> int:
    """The least occupancy of an obstacle."""
    return max(1, int(np.ceil(100 * header.occupied_thresh))) if lethal is None else lethal


def occupancy_grid(path: str | os.PathLike[str], dialect: str = "nav2") -> NDArray[np.int8]:
    """Occupancies of a ROS map, as the reader of a dialect publishes them.

    Parameters
    ----------
    path : path-like
        The ``map.yaml``.
    dialect : {"nav2", "ros1"}
        Whose reader is meant.

    Returns
    -------
    ndarray of int8, shape (height, width)
        100 occupied, 0 free, -1 unknown, between them what the mode says.  Rows as in ``nav_msgs/OccupancyGrid``: row 0
        is the bottom one of the picture, so entry ``[j, i]`` is cell ``(i, j)``.

    Raises
    ------
    InputError
        If a file or key is wrong.
    BudgetError
        If the picture would not fit in memory.
    """
    return _occupancy(read_header(Path(path), dialect), dialect)


def read_header(path: Path, dialect: str = "nav2") -> RosHeader:
    """Read a ``map.yaml``; keys that neither reader knows are ignored, as they do."""
    if dialect not in DIALECTS:
        raise InputError(f"dialect = {dialect!r} is unknown; it may be one of {', '.join(DIALECTS)}")
    table = _load_yaml(path)
    image = _required(table, "image", path)
    if not isinstance(image, str) or not image or "\0" in image:
        raise InputError(f"{path}: image: must be the name of a picture, got {_short(image)}")
    header = RosHeader(
        image=path.parent / image,
        resolution=_number(_required(table, "resolution", path), "resolution", path),
        origin=_origin(_required(table, "origin", path), dialect, path),
        negate=_negate(_required(table, "negate", path), dialect, path),
        occupied_thresh=_number(_required(table, "occupied_thresh", path), "occupied_thresh", path),
        free_thresh=_number(_required(table, "free_thresh", path), "free_thresh", path),
        mode=_mode(table.get("mode", "trinary"), path),
    )
    _check(header, path)
    return header


def _occupancy(header: RosHeader, dialect: str) -> NDArray[np.int8]:
    raster = read_raster(header.image, BYTES_PER_PIXEL)
    return _CONVERTERS[dialect](raster, header)[::-1].copy()


def _as_ros1(raster: Raster, header: RosHeader) -> NDArray[np.int8]:
    channels = raster.values.astype(np.int64)
    channels = channels if raster.maxval == 255 else channels * 255 // raster.maxval
    if channels.shape[2] == 2:
        channels = channels[..., [0, 0, 0, 1]]
    count = channels.shape[2]
    averaged = count if header.mode == "trinary" or not raster.has_alpha else count - 1
    mean = channels[..., :averaged].sum(axis=2) / averaged
    if header.negate:
        mean = 255 - mean
    if header.mode == "raw":
        return np.asarray(mean.astype(np.uint8).view(np.int8))
    occupied = (255 - mean) / 255.0
    result = np.full(occupied.shape, UNKNOWN, dtype=np.int8)
    if header.mode == "scale":
        ratio = (occupied - header.free_thresh) / (header.occupied_thresh - header.free_thresh)
        shown = np.ones(mean.shape, dtype=bool) if count == 1 else channels[..., -1] >= 1
        result = np.where(shown, np.clip(99 * ratio, 0, 99).astype(np.int8), result)
    return _thresholded(result, occupied, header)


def _as_nav2(raster: Raster, header: RosHeader) -> NDArray[np.int8]:
    quanta = (raster.values.astype(np.int64) * QUANTUM + raster.maxval // 2) // raster.maxval
    colour = quanta[..., :-1] if raster.has_alpha else quanta
    if colour.shape[2] == 1:
        colour = colour[..., [0, 0, 0]]
    opacity = quanta[..., -1] if raster.has_alpha else np.full(colour.shape[:2], QUANTUM)
    total, count = colour.sum(axis=2), 3
    if header.mode == "trinary" and raster.has_alpha:
        total, count = total + opacity, 4
    shade = total / float(count) / QUANTUM
    if header.mode == "raw":
        percent = np.floor(shade * 255 + 0.5)
        return np.where(percent <= OCCUPIED, percent, UNKNOWN).astype(np.int8)
    occupied = shade if header.negate else 1.0 - shade
    result = np.full(occupied.shape, UNKNOWN, dtype=np.int8)
    if header.mode == "scale":
        ratio = (occupied - header.free_thresh) / (header.occupied_thresh - header.free_thresh)
        result = np.rint(np.clip(ratio, 0, 1) * 100.0).astype(np.int8)
    result = _thresholded(result, occupied, header)
    if header.mode == "scale":
        result[opacity != QUANTUM] = UNKNOWN
    return result


_CONVERTERS = {"nav2": _as_nav2, "ros1": _as_ros1}


def _thresholded(result: NDArray[np.int8], occupied: NDArray[np.float64], header: RosHeader) -> NDArray[np.int8]:
    result[occupied < header.free_thresh] = FREE
    result[occupied > header.occupied_thresh] = OCCUPIED
    return result


def _place(header: RosHeader, shape: tuple[int, ...]) -> tuple[tuple[Axis, ...], Frame]:
    height, width = shape
    x, y, yaw = header.origin
    frame = Frame(x, y, yaw) if yaw else Frame()
    x, y = (0.0, 0.0) if yaw else (x, y)
    step = header.resolution
    return (Axis("x", x, x + width * step, width), Axis("y", y, y + height * step, height)), frame


def _load_yaml(path: Path) -> dict[Any, Any]:
    import yaml

    class Loader(yaml.SafeLoader):
        def flatten_mapping(self, node: Any) -> None:
            """Refuse ``<<``, which yaml-cpp does not know: merging aliases of aliases could fill all memory."""
            for key, _ in node.value:
                if key.tag.endswith(":merge"):
                    problem = "a map merges no keys (<<); write them out"
                    raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)

    try:
        table = yaml.load(read_text(path), Loader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise InputError(f"{path}: {line}this is not YAML ({error.problem})") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{path}: this is not YAML ({type(error).__name__})") from None
    if not isinstance(table, dict):
        raise InputError(
            f"{path}: a map's YAML holds keys and values (image: ..., resolution: ...), not {_short(table)}"
        )
    return table


def _required(table: dict[Any, Any], key: str, path: Path) -> Any:
    if key not in table:
        raise InputError(f"{path}: {key}: this key is missing; the map's readers need it")
    return table[key]


def _number(value: Any, key: str, path: Path) -> float:
    try:
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError
        number = float(value)
        if not isfinite(number):
            raise ValueError
    except (ValueError, OverflowError):
        raise InputError(f"{path}: {key}: must be a finite number, got {_short(value)}") from None
    return number


def _origin(value: Any, dialect: str, path: Path) -> tuple[float, float, float]:
    fits = isinstance(value, list) and (len(value) >= 3 if dialect == "ros1" else len(value) == 3)
    if not fits:
        raise InputError(f"{path}: origin: must be a list of three numbers [x, y, yaw], got {_short(value)}")
    x, y, yaw = (_number(entry, f"origin[{i}]", path) for i, entry in enumerate(value[:3]))
    return x, y, yaw


def _negate(value: Any, dialect: str, path: Path) -> bool:
    if isinstance(value, int) and not isinstance(value, bool):
        return value != 0
    if dialect == "nav2" and isinstance(value, bool):
        return value
    if dialect == "nav2" and isinstance(value, str) and value.lower() in WORDS:
        return bool(WORDS[value.lower()])
    wanted = "0 or 1" if dialect == "ros1" else "0, 1, true or false"
    raise InputError(f"{path}: negate: must be {wanted}, got {_short(value)}")


def _mode(value: Any, path: Path) -> str:
    if value not in MODES:
        raise InputError(f"{path}: mode: {_short(value)} is unknown; it may be one of {', '.join(MODES)}")
    return str(value)


def _check(header: RosHeader, path: Path) -> None:
    if header.resolution <= 0:
        raise InputError(f"{path}: resolution: must be greater than 0 metres per pixel, got {header.resolution}")
    for key in ("occupied_thresh", "free_thresh"):
        if not 0 <= getattr(header, key) <= 1:
            raise InputError(f"{path}: {key}: must lie between 0 and 1, got {getattr(header, key)}")
    if header.free_thresh >= header.occupied_thresh:
        raise InputError(
            f"{path}: free_thresh: {header.free_thresh} must lie below occupied_thresh = {header.occupied_thresh}"
        )


def _short(value: Any) -> str:
    if isinstance(value, str | int | float | bool) or value is None:
        text = repr(value) if not isinstance(value, int) or abs(value) < 1 << 64 else "a very large number"
        return text if len(text) <= 60 else f"{text[:50]}..."
    return f"a {type(value).__name__}"
