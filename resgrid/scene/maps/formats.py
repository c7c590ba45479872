"""Which formats of maps there are, which reader and options belong to each, and how a map was read, for people."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from inspect import signature
from itertools import groupby
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from resgrid._internal.files import read_bytes
from resgrid.errors import BudgetError, InputError, suggestion
from resgrid.scene.maps.arrays import MapCells, placed_axes, read_npy
from resgrid.scene.maps.movingai import PASSABLE, read_movingai, read_voxels
from resgrid.scene.maps.pictures import THRESHOLD, read_epic, read_grey
from resgrid.scene.maps.pnm import MAGICS
from resgrid.scene.maps.ros import read_ros, ros_greys
from resgrid.scene.maps.ros_header import NEWEST
from resgrid.scene.table_models import fields_from


@dataclass(frozen=True)
class MapFormat:
    """A kind of map file: its reader, how its files end, and how they begin.

    A reader gives all of a map, or, where the file does not say where its cells lie, these alone.  Its options are keys
    of the ``[map]`` table: annotations say their ranges, its docstring what they mean.
    """

    read: Callable[..., NDArray[np.uint8] | MapCells]
    suffixes: tuple[str, ...] = ()
    magic: tuple[bytes, ...] = ()

    @property
    def options(self) -> dict[str, Any]:
        """The options of the reader, and of `placed_axes` if they are needed, as fields of a table."""
        is_placed = get_type_hints(self.read).get("return") is MapCells
        return fields_from(self.read) | ({} if is_placed else fields_from(placed_axes))


PICTURES = (".png", ".pgm", ".pnm", ".ppm", ".pbm", ".bmp", ".gif", ".tif", ".tiff", ".jpg", ".jpeg")
"""How names of pictures end."""

FORMATS: dict[str, MapFormat] = {
    "ros": MapFormat(read_ros, (".yaml", ".yml")),
    "movingai": MapFormat(read_movingai, (".map",), (b"type ",)),
    "voxels": MapFormat(read_voxels, (".3dmap",), (b"voxel ",)),
    "image": MapFormat(read_grey, PICTURES, (b"\x89PNG", b"BM", b"GIF8", b"\xff\xd8\xff", *MAGICS)),
    "epic": MapFormat(read_epic),
    "npy": MapFormat(read_npy, (".npy",), (b"\x93NUMPY",)),
}
_HEADER_BYTES = 1 << 16
"""The part of a header in which the name of the picture is looked for."""

_MAGIC = max(len(magic) for entry in FORMATS.values() for magic in entry.magic)
COMMON = ("file", "format", "periodic", "headings")
"""Keys of a ``[map]`` table that no reader sees."""


def map_options() -> dict[str, Any]:
    """The options of all readers as fields of a table, each with the formats that take it."""
    options = {name: entry.options for name, entry in FORMATS.items()}
    takers = {key: [name for name in options if key in options[name]] for known in options.values() for key in known}
    fields: dict[str, Any] = {}
    for key, names in takers.items():
        hint, field = options[names[0]][key]
        about = str(field.description or key).removesuffix(".")
        fields[key] = hint, Field(field.default, description=f"{about} ({', '.join(names)}).")
    return fields


def read_map(table: Mapping[str, Any]) -> MapCells:
    """Read a map file as its ``[map]`` table says; ``file`` is an absolute path."""
    path = Path(table["file"])
    name = format_of(path, table)
    options = {key: value for key, value in table.items() if key not in COMMON}
    known = FORMATS[name].options
    for key in options:
        if key not in known:
            hint = suggestion(key, known) or f"it takes {', '.join(known)}"
            raise InputError(f"{path}: map.{key}: a map of format {name!r} takes no such option; {hint}")
    placing = {key: options.pop(key) for key in signature(placed_axes).parameters if key in options}
    try:
        found = FORMATS[name].read(path, **options)
        cells = found if isinstance(found, MapCells) else MapCells(placed_axes(found.shape, **placing), found)
    except BudgetError:
        raise
    except MemoryError:  # beyond a limit that the estimate does not know, such as that of ulimit -v
        raise BudgetError(
            f"{path}: the memory that this process may take is too small for this map; raise its limit (ulimit -v), "
            "or cut the map to the part that you need"
        ) from None
    return cells.read_by(table)


def format_of(path: Path, table: Mapping[str, Any]) -> str:
    """The format of a map file: as its table says, by the end of its name, or by its first bytes."""
    if table.get("format", "auto") != "auto":
        return str(table["format"])
    for name, entry in FORMATS.items():
        if path.suffix.lower() in entry.suffixes:
            return name
    start = read_bytes(path, first=_MAGIC)
    for name, entry in FORMATS.items():
        if start.startswith(entry.magic):
            return name
    known = ", ".join(suffix for entry in FORMATS.values() for suffix in entry.suffixes)
    raise InputError(f"{path}: this is no known kind of map; scenes end in .toml, maps in {known}, or give the format")


def warn_of_header(path: Path) -> None:
    """Warn that a picture is read as it stands though the header of a ROS map that names it lies in the same folder."""
    for suffix in FORMATS["ros"].suffixes:
        header = path.with_suffix(suffix)
        if header.is_file() and path.name.encode() in read_bytes(header, first=_HEADER_BYTES):
            warnings.warn(
                f"{path} is read as a plain picture, in pixels, by its brightness alone; {header} holds its "
                "resolution, origin and thresholds: give that file (--format image says that the picture is meant)",
                stacklevel=3,
            )
            return


def describe_map(cells: MapCells) -> dict[str, Any]:
    """Describe how a map was read: its format, the reader that was followed, the meaning of greys and letters."""
    table = cells.table
    file = Path(table["file"])
    name = format_of(file, table)
    described: dict[str, Any] = {"file": str(file), "format": name}
    if name == "ros":
        dialect = table.get("dialect", NEWEST)
        described["dialect"] = dialect
        described["greys"] = _runs(ros_greys(file, dialect, table.get("lethal")))
        described["unknown_cells"] = 0 if cells.unknown is None else int(cells.unknown.sum())
        described["unknown_as"] = table.get("unknown", "obstacle")
    elif name == "image":
        threshold = table.get("threshold", THRESHOLD)
        described["greys"] = _runs(["obstacle" if grey < threshold else "free" for grey in range(256)])
    elif name == "epic":
        described["greys"] = _runs(["obstacle", *["free"] * 254, "goal"])
    elif name == "movingai":
        described["passable"] = table.get("passable", PASSABLE)
    return described


def _runs(meanings: Sequence[str]) -> list[tuple[int, int, str]]:
    """Neighbouring grey values of one meaning together: first, last, meaning."""
    runs, first = [], 0
    for meaning, group in groupby(meanings):
        last = first + len(list(group)) - 1
        runs.append((first, last, meaning))
        first = last + 1
    return runs
