"""The header of a ROS map, ``map.yaml``: its validation as by the reader of each dialect, and its picture file.

Sources read: ros-navigation/navigation2, ``nav2_map_server/src/map_io.cpp`` and ``map_mode.cpp``; ros-planning/
navigation, ``map_server/src/main.cpp``.  These readers accept thresholds in any order and ignore unknown keys.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path, PureWindowsPath
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, ValidationInfo, field_validator

from resgrid.errors import InputError
from resgrid.scene.messages import problems_of, report, shown, unknown_option

Dialect = Literal["nav2", "nav2-jazzy", "ros1"]
"""ROS map readers: Nav2 since 2025 (``nav2``), Nav2 from Dashing to Jazzy (``nav2-jazzy``), ROS 1 (``ros1``)."""

NEWEST: Dialect = "nav2"
"""Default dialect: the newest ROS map reader."""

MODES = ("trinary", "scale", "raw")


def _number(value: Any) -> float:
    from resgrid.scene.maps.yaml_cpp import double

    if not isinstance(value, str):
        raise ValueError(f"must be a number, got {shown(value)}")
    return double(value)


_Number = Annotated[float, BeforeValidator(_number)]
_Threshold = Annotated[_Number, Ge(0), Le(1)]


class RosHeader(BaseModel):
    """The keys of a ``map.yaml``.

    `image`: file name of the picture; `resolution`: width of a pixel, in metres; `origin`: pose of the lower-left
    corner of the lower-left pixel: x and y in metres, yaw in radians, anticlockwise; `negate`: whether light pixels are
    occupied; `occupied_thresh`, `free_thresh`: darkness, 0 to 1, above which a pixel is occupied and below which it is
    free; `mode`: ``trinary`` (pixels in between are unknown), ``scale`` (in between, the occupancy grows linearly) or
    ``raw`` (grey values are occupancies).
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    image: str
    resolution: Annotated[_Number, Gt(0)]
    origin: list[_Number]
    negate: bool
    free_thresh: _Threshold
    occupied_thresh: _Threshold
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    @field_validator("image", mode="plain")
    @classmethod
    def _is_name(cls, value: Any) -> str:
        if value in (None, ""):
            raise ValueError("must not be empty")
        if not isinstance(value, str):
            raise ValueError(f"must be the name of a picture, got {shown(value)}")
        return value

    @field_validator("origin", mode="before")
    @classmethod
    def _is_pose(cls, origin: Any, info: ValidationInfo) -> Any:
        count = len(origin) if isinstance(origin, list) else 0
        if count < 3 or (count > 3 and info.context != "ros1"):
            raise ValueError(f"must be a list of three numbers [x, y, yaw], got {shown(origin)}")
        return origin[:3]

    @field_validator("negate", mode="before")
    @classmethod
    def _is_truth(cls, value: Any, info: ValidationInfo) -> bool:
        from resgrid.scene.maps.yaml_cpp import truth, whole

        for convert in (whole,) if info.context == "ros1" else (whole, truth):
            try:
                return bool(convert(value if isinstance(value, str) else ""))
            except ValueError:
                continue
        choice = "0 or 1" if info.context == "ros1" else "0, 1, true or false"
        raise ValueError(f"must be {choice}, got {shown(value)}")

    @field_validator("mode", mode="before")
    @classmethod
    def _is_mode(cls, value: Any, info: ValidationInfo) -> Any:
        if info.context == "ros1":
            return value if isinstance(value, str) else "trinary"
        if not isinstance(value, str) or value.lower() not in MODES:
            raise ValueError(unknown_option(shown(value), value, " or ".join(MODES), MODES))
        return value.lower()


def read_header(path: Path, dialect: Dialect) -> RosHeader:
    """Return the keys of a ``map.yaml``, validated by the rules of a dialect; raise InputError for invalid keys."""
    from resgrid.scene.maps.yaml_cpp import read_mapping

    try:
        return RosHeader.model_validate(read_mapping(path, RosHeader.model_fields), context=dialect)
    except ValidationError as error:
        raise InputError(report(problems_of(error), str(path))) from None


def picture_of(path: Path, image: str) -> Path:
    r"""Return the path of a map's picture.

    `path`: the ``map.yaml``; `image`: name of the picture in this file.  Maps from another computer contain paths of
    that computer (``/home/ann/room.pgm``, ``maps\room.pgm``).  If the named file does not exist, but the folder of the
    map contains a file of this name, a warning is issued and the path of this file is returned.  Otherwise the result
    is the path of the named file, which may not exist.
    """
    named = path.parent / image
    if os.path.isfile(named):  # noqa: PTH113  Path.is_file raises for invalid file names
        return named
    windows = PureWindowsPath(image)
    for other in (path.parent.joinpath(*windows.parts), path.parent / windows.name):
        if windows.name and other != named and os.path.isfile(other):  # noqa: PTH113
            warnings.warn(
                f"{path}: image: the file {image!r} does not exist; {other} is read instead, correct the key image",
                stacklevel=2,
            )
            return other
    return named
