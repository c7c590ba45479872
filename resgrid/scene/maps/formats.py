"""The table of map formats with their readers and options, the reading of a map file, and a description of a map."""

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
from resgrid.scene.maps.movingai import PASSABLE, read_movingai
from resgrid.scene.maps.pictures import THRESHOLD, read_epic, read_grey
from resgrid.scene.maps.pnm import MAGICS
from resgrid.scene.maps.preparation import KEYS, LoadedMap, MapSource, Preparation
from resgrid.scene.maps.ros import open_ros, read_ros, ros_greys
from resgrid.scene.maps.ros_header import NEWEST
from resgrid.scene.maps.voxel_parts import (
    open_cloud,
    open_octomap,
    open_voxels,
    read_cloud_cells,
    read_octomap_cells,
    read_voxels,
)
from resgrid.scene.solids.octree import BINARY, FULL
from resgrid.scene.table_models import fields_from


@dataclass(frozen=True)
class MapFormat:
    """A format of map files.

    `read`: reader, which returns the map, or only the cell codes if the format has no position and resolution;
    `suffixes`: suffixes of the files, with the point; `magic`: possible first bytes of the files; `open`: function with
    the options of `read` that returns a map of which parts can be read, None if the whole map must be read.  The
    reader's options are keys of the ``[map]`` table; the reader's type annotations give the ranges of these keys, the
    reader's docstring their descriptions.
    """

    read: Callable[..., NDArray[np.uint8] | MapCells]
    suffixes: tuple[str, ...] = ()
    magic: tuple[bytes, ...] = ()
    open: Callable[..., MapSource] | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Options of the reader by name, as pairs of a type annotation and a pydantic field (default and description).

        For formats without a position, the options of `placed_axes` are included.
        """
        return fields_from(self.read) | ({} if self.is_placed else fields_from(placed_axes))

    @property
    def is_placed(self) -> bool:
        """Whether the reader returns a map with axes; otherwise it returns only the cell codes."""
        return get_type_hints(self.read).get("return") is MapCells


PICTURES = (".png", ".pgm", ".pnm", ".ppm", ".pbm", ".bmp", ".gif", ".tif", ".tiff", ".jpg", ".jpeg")
"""File name suffixes of pictures."""

FORMATS: dict[str, MapFormat] = {
    "ros": MapFormat(read_ros, (".yaml", ".yml"), open=open_ros),
    "movingai": MapFormat(read_movingai, (".map",), (b"type ",)),
    "voxels": MapFormat(read_voxels, (".3dmap",), (b"voxel ",), open_voxels),
    "octomap": MapFormat(read_octomap_cells, (".bt", ".ot"), (FULL, BINARY), open_octomap),
    "point_cloud": MapFormat(read_cloud_cells, (".ply", ".pcd"), (b"ply\n", b"ply\r", b"# .PCD"), open_cloud),
    "image": MapFormat(read_grey, PICTURES, (b"\x89PNG", b"BM", b"GIF8", b"\xff\xd8\xff", *MAGICS)),
    "epic": MapFormat(read_epic),
    "npy": MapFormat(read_npy, (".npy",), (b"\x93NUMPY",)),
}
_HEADER_BYTES = 1 << 16
"""Number of leading bytes of a ``map.yaml`` in which `warn_of_header` searches for the name of a picture."""

_MAGIC = max(len(magic) for entry in FORMATS.values() for magic in entry.magic)
COMMON = ("file", "format", "periodic", "headings")
"""Keys of a ``[map]`` table that apply to all formats, and are not options of a reader."""


def map_options() -> dict[str, Any]:
    """Return the options of all map readers, and of cropping and joining cells: a type and a pydantic field by name.

    The field holds default and description; for an option of readers, the description ends with the formats that have
    this option.
    """
    options = {name: entry.options for name, entry in FORMATS.items()}
    takers = {key: [name for name in options if key in options[name]] for known in options.values() for key in known}
    fields: dict[str, Any] = {}
    for key, names in takers.items():
        hint, field = options[names[0]][key]
        about = str(field.description or key).removesuffix(".")
        fields[key] = hint, Field(field.default, description=f"{about} ({', '.join(names)}).")
    return fields | fields_from(Preparation, KEYS)


def read_map(table: Mapping[str, Any], extent: float = 0.0) -> MapCells:
    """Return the cells of the map file that a ``[map]`` table names, cropped, joined or divided as the table demands.

    `table`: values by key; ``file`` is an absolute path, other keys are ``format``, ``periodic``, options of the
    reader, and options that crop, join or divide cells; `extent`: largest distance from the robot's reference point to
    a point of the robot, in axis units, for the obstacles around a cropped map.
    """
    path = Path(table["file"])
    name = format_of(path, table)
    options = {key: value for key, value in table.items() if key not in (*COMMON, *KEYS)}
    known = FORMATS[name].options
    for key in options:
        if key not in known:
            hint = suggestion(key, known) or f"its options are {', '.join(known)}"
            raise InputError(f"{path}: map.{key}: a map of format {name!r} has no such option; {hint}")
    own = () if FORMATS[name].is_placed else signature(placed_axes).parameters
    placing = {key: options.pop(key) for key in own if key in options}
    try:
        preparation = Preparation.of(table, extent)
        opened = FORMATS[name].open
        if opened is not None and (preparation.crop is not None or preparation.coarsen > 1):
            source = opened(path, **options)
        else:
            found = FORMATS[name].read(path, **options)
            source = LoadedMap(
                found if isinstance(found, MapCells) else MapCells(placed_axes(found.shape, **placing), found)
            )
        cells = preparation.apply(source, table.get("periodic") or ())
    except InputError as error:
        raise InputError(f"{path}: {error}" if str(error).startswith("map.") else str(error)) from None
    except BudgetError:
        raise
    except MemoryError:  # a limit that the memory estimate does not include, such as ulimit -v
        raise BudgetError(
            f"{path}: the memory limit of this process is too small for this map; raise the limit (ulimit -v), or crop "
            "the map to the part that you need"
        ) from None
    return cells.with_table(table)


_BAG = "this is a recording, not a map; use 'resgrid stream'"
_LAYOUT = "this is a board or a layout, not a map; use 'resgrid check'"
_COMMANDS = "these are commands for a simulator; the deck is the file without this suffix"
_NETWORK = "this is a network, not a map; use 'resgrid solve', 'resgrid resistance' or 'resgrid convert'"
_CIRCUITSCAPE = (
    "this is a Circuitscape configuration, not a scene or map; 'resgrid resistance' runs it, and 'resgrid solve', "
    "'info', 'convert' and 'check --rules' read it if its scenario is advanced"
)
_SCHEMATIC = (
    "this is a schematic of LTspice, not a netlist; export its netlist there (View > SPICE Netlist), save it as a file "
    "that ends in .net, and give that file to 'resgrid solve'"
)
_ASCII_GRID = (
    "this is an ESRI ASCII grid, not a map; name it in a Circuitscape configuration (.ini) for 'resgrid resistance', "
    "or save its cells as an array with np.save"
)
_NO_MAPS = {
    ".urdf": 'this is a robot, not a scene; write a scene with [robot], type = "urdf" and file = "..."',
    ".ini": _CIRCUITSCAPE,
    **dict.fromkeys((".graphml", ".tsv"), _NETWORK),
    ".csv": "this is a table, not a map; save the cells as an array with np.save",
    **dict.fromkeys((".verify", ".ngspice", ".ltspice", ".xyce", ".hspice", ".spectre"), _COMMANDS),
    **dict.fromkeys((".bag", ".mcap", ".db3"), _BAG),
    **dict.fromkeys((".gds", ".oas", ".kicad_pcb", ".kicad_pro", ".kicad_sch"), _LAYOUT),
}
"""Suffixes of files that are not maps, with the remedy for the message."""

MAP_SUFFIXES = tuple(suffix for entry in FORMATS.values() for suffix in entry.suffixes)
"""File name suffixes of maps, in lower case."""


class UnknownFormatError(InputError):
    """Error for a file whose suffix and first bytes are those of no scene, map or other known file."""


def format_of(path: Path, table: Mapping[str, Any]) -> str:
    """Return the name of the format of the map file `path`: from its ``[map]`` table, its suffix, or its first bytes.

    `table`: values of the table by key; a value of ``format`` other than ``auto`` has priority.  Raises InputError for
    a file that is not a map of a known format (UnknownFormatError for a file of an unknown kind).
    """
    if table.get("format", "auto") != "auto":
        return str(table["format"])
    for name, entry in FORMATS.items():
        if path.suffix.lower() in entry.suffixes:
            return name
    start = read_bytes(path, first=_MAGIC)
    for name, entry in FORMATS.items():
        if start.startswith(entry.magic):
            return name
    other = _NO_MAPS.get(path.suffix.lower()) or _SCHEMATIC * is_schematic(path) or _ASCII_GRID * _is_grid(path)
    if other:
        raise InputError(f"{path}: {other}")
    raise UnknownFormatError(
        f"{path}: this is not a map of a known format; scenes end in .toml, maps in {', '.join(MAP_SUFFIXES)}; rename "
        "the file, or give its format (--format)"
    )


def is_schematic(path: Path) -> bool:
    """Return whether a file is a schematic of LTspice: its suffix is ``.asc``, and it begins with a version."""
    return path.suffix.lower() == ".asc" and b"version" in _first_word(path)


def _is_grid(path: Path) -> bool:
    """Return whether a file is an ESRI ASCII grid: its suffix is ``.asc``, and it begins with a number of cells."""
    return path.suffix.lower() == ".asc" and _first_word(path) in (b"ncols", b"nrows")


def _first_word(path: Path) -> bytes:
    """Return the first word of a text file in lower case, without the zero bytes of UTF-16."""
    words = read_bytes(path, first=64).replace(b"\0", b"").lower().split()
    return words[0] if words else b""


def warn_of_header(path: Path) -> None:
    """Issue a warning if a picture belongs to a ROS map: a YAML file of the same name in its folder that names it.

    `path`: file of the picture, which is read without this YAML file, and thus without the resolution, origin and
    thresholds of the ROS map.
    """
    for suffix in FORMATS["ros"].suffixes:
        header = path.with_suffix(suffix)
        if header.is_file() and path.name.encode() in read_bytes(header, first=_HEADER_BYTES):
            warnings.warn(
                f"{path} is read as a plain picture, in pixels, with a default threshold; {header} contains its "
                "resolution, origin and thresholds: give that file, or --format image for the picture",
                stacklevel=3,
            )
            return


def describe_map(cells: MapCells) -> dict[str, Any]:
    """Return the description of a map as a dictionary for JSON.

    Keys: ``file``, ``format``, and the given keys that crop, join or divide cells; for pictures ``greys``, ranges of
    grey values as tuples (first, last, meaning) with the meanings obstacle, free, goal or unknown; for ROS maps
    ``greys`` and ``dialect``; for MovingAI maps ``passable`` (letters of free cells); for maps of formats with unknown
    cells ``unknown_cells`` (number) and ``unknown_as`` (obstacle or free).
    """
    table = cells.table
    file = Path(table["file"])
    name = format_of(file, table)
    described: dict[str, Any] = {"file": str(file), "format": name}
    described |= {key: table[key] for key in KEYS if table.get(key) is not None}
    if name == "ros":
        dialect = table.get("dialect", NEWEST)
        described["dialect"] = dialect
        described["greys"] = _runs(ros_greys(file, dialect, table.get("lethal")))
    elif name == "image":
        threshold = table.get("threshold", THRESHOLD)
        described["greys"] = _runs(["obstacle" if grey < threshold else "free" for grey in range(256)])
    elif name == "epic":
        described["greys"] = _runs(["obstacle", *["free"] * 254, "goal"])
    elif name == "movingai":
        described["passable"] = table.get("passable", PASSABLE)
    if cells.unknown is not None:
        described["unknown_cells"] = int(cells.unknown.sum())
        described["unknown_as"] = table.get("unknown", "obstacle")
    return described


def _runs(meanings: Sequence[str]) -> list[tuple[int, int, str]]:
    """Return ranges of consecutive grey values with the same meaning, as tuples (first, last, meaning).

    `meanings`: meaning of each grey value, from 0.
    """
    runs, first = [], 0
    for meaning, group in groupby(meanings):
        last = first + len(list(group)) - 1
        runs.append((first, last, meaning))
        first = last + 1
    return runs
