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
a cell of raw above 100   255 unknown, all others occupied (costmap_2d's     unknown
                          ``interpretValue`` of the byte, lethal from 100)
``negate`` and raw        negated too                                        ignored
``negate``                a whole number                                     a whole number or a truth value
========================  =================================================  =======================================
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from resgrid.axis import Axis
from resgrid.errors import InputError
from resgrid.files import read_text
from resgrid.frame import Frame
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.pictures import Raster, read_raster
from resgrid.scene.messages import complaint, report
from resgrid.scene.table import problems_of
from resgrid.space import Cell

Dialect = Literal["nav2", "ros1"]
OCCUPIED, FREE, UNKNOWN = 100, 0, -1
WORDS = {"true": 1, "yes": 1, "on": 1, "y": 1, "false": 0, "no": 0, "off": 0, "n": 0}
QUANTUM = 65535
BYTES_PER_PIXEL = 96
"""Memory of a picture while it is turned into occupancies."""


def _no_truth(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(f"must be a number, got {value}")
    return value


_Number = Annotated[float, BeforeValidator(_no_truth)]
_Threshold = Annotated[_Number, Ge(0), Le(1)]


class RosHeader(BaseModel):
    """What a ``map.yaml`` says; keys that neither reader knows are ignored, as they do.

    `image`: the picture; `resolution`: width of a pixel, in metres; `origin`: pose of the lower-left corner of the
    lower-left pixel: x and y in metres, yaw in radians, anticlockwise; `negate`: whether light means occupied;
    `occupied_thresh, free_thresh`: thresholds of the darkness; `mode`: what a grey value means.
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    image: Annotated[str, Len(1)]
    resolution: Annotated[_Number, Gt(0)]
    origin: list[_Number]
    negate: bool
    free_thresh: _Threshold
    occupied_thresh: _Threshold
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    @field_validator("origin", mode="before")
    @classmethod
    def _is_pose(cls, origin: Any, info: ValidationInfo) -> Any:
        count = len(origin) if isinstance(origin, list) else 0
        if count < 3 or (count > 3 and info.context == "nav2"):
            raise ValueError("must be a list of three numbers [x, y, yaw]")
        return origin[:3]

    @field_validator("negate", mode="before")
    @classmethod
    def _is_truth(cls, value: Any, info: ValidationInfo) -> bool:
        if isinstance(value, int) and (info.context == "nav2" or not isinstance(value, bool)):
            return value != 0
        if info.context == "nav2" and isinstance(value, str) and value.lower() in WORDS:
            return bool(WORDS[value.lower()])
        raise ValueError("must be " + ("0 or 1" if info.context == "ros1" else "0, 1, true or false"))

    @model_validator(mode="after")
    def _is_ordered(self) -> RosHeader:
        if self.free_thresh >= self.occupied_thresh:
            raise ValueError(f"free_thresh: {self.free_thresh} must lie below occupied_thresh = {self.occupied_thresh}")
        return self

    def scaled(self, occupied: NDArray[np.float64]) -> NDArray[np.float64]:
        """Darkness, 0 at the threshold of free cells and 1 at that of occupied ones."""
        return np.asarray((occupied - self.free_thresh) / (self.occupied_thresh - self.free_thresh))


def read_ros(
    path: Path,
    dialect: Dialect = "nav2",
    unknown: Literal["obstacle", "free"] = "obstacle",
    lethal: Annotated[int, Ge(1), Le(100)] | None = None,
    least_conductivity: Annotated[float, Gt(0), Le(1)] | None = None,
) -> MapCells:
    """Read a ROS map.

    Parameters
    ----------
    dialect
        Whose reader is meant.
    unknown
        What cells of unknown occupancy are. Raw values above 100 are unknown to Nav2; of ROS 1 255 is, and 101 to 254
        are obstacles, as costmap_2d takes what map_server sends.
    lethal
        Occupancy from which a cell is an obstacle; by default that of ``occupied_thresh``.
    least_conductivity
        Values below lethal as cost; an occupancy p conducts this to the power of p / lethal.
    """
    header = _read_header(path, dialect)
    occupancy = _occupancy(path, header, dialect)
    occupied = _is_occupied(occupancy, header, lethal)
    cell = np.where(occupied, Cell.OBSTACLE, Cell.FREE).astype(np.uint8)
    cell[occupancy == UNKNOWN] = Cell.OBSTACLE if unknown == "obstacle" else Cell.FREE
    conductivity = None
    if least_conductivity is not None:
        share = np.clip(occupancy, 0, None) / _lethal(header, lethal)
        conductivity = np.ascontiguousarray(np.where(occupied, 1.0, least_conductivity**share).T)
    axes, frame = _place(header, cell.shape)
    return MapCells(axes, np.ascontiguousarray(cell.T), frame, conductivity)


def ros_greys(path: Path, dialect: Dialect = "nav2", lethal: int | None = None) -> list[str]:
    """What each grey value of an opaque picture means in a ROS map."""
    header = _read_header(path, dialect)
    occupancy = _CONVERTERS[dialect](Raster(np.arange(256, dtype=np.uint16).reshape(1, 256, 1), 255), header)
    words = np.where(_is_occupied(occupancy, header, lethal), "obstacle", "free")
    return [str(word) for word in np.where(occupancy == UNKNOWN, "unknown", words)[0]]


def _is_occupied(occupancy: NDArray[np.int8], header: RosHeader, lethal: int | None) -> NDArray[np.bool_]:
    return occupancy.view(np.uint8) >= _lethal(header, lethal)


def _lethal(header: RosHeader, lethal: int | None) -> int:
    """The least occupancy of an obstacle."""
    return max(1, int(np.ceil(100 * header.occupied_thresh))) if lethal is None else lethal


def occupancy_grid(file: str | os.PathLike[str], dialect: Dialect = "nav2") -> NDArray[np.int8]:
    r"""Occupancies of a ROS map, as the reader of a dialect publishes them.

    Parameters
    ----------
    file : path-like
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

    Examples
    --------
    >>> from pathlib import Path
    >>> from PIL import Image
    >>> Image.fromarray(np.array([[254, 254, 254], [254, 0, 254]], np.uint8)).save("map.pgm")
    >>> keys = "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\norigin: [0, 0, 0]\n"
    >>> size = Path("map.yaml").write_text("image: map.pgm\nresolution: 0.1\n" + keys)
    >>> rg.occupancy_grid("map.yaml")
    array([[  0, 100,   0],
           [  0,   0,   0]], dtype=int8)
    """
    return _occupancy(Path(file), _read_header(Path(file), dialect), dialect)


def _read_header(path: Path, dialect: Dialect) -> RosHeader:
    try:
        return RosHeader.model_validate(_load_yaml(path), context=dialect)
    except ValidationError as error:
        raise InputError(report([(each["loc"], complaint(each)) for each in problems_of(error)], str(path))) from None


def _occupancy(path: Path, header: RosHeader, dialect: Dialect) -> NDArray[np.int8]:
    raster = read_raster(path.parent / header.image, BYTES_PER_PIXEL)
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
        shown = np.ones(mean.shape, dtype=bool) if count == 1 else channels[..., -1] >= 1
        result = np.where(shown, np.clip(99 * header.scaled(occupied), 0, 99).astype(np.int8), result)
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
        result = np.rint(np.clip(header.scaled(occupied), 0, 1) * 100.0).astype(np.int8)
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
            f"{path}: a map's YAML holds keys and values (image: ..., resolution: ...), not a {type(table).__name__}"
        )
    return table
