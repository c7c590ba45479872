"""Which formats of maps there are, which reader and options belong to each, and how a map was read, for people."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.files import read_bytes
from resgrid.scene.maps.arrays import MapCells, placed_axes, read_npy
from resgrid.scene.maps.movingai import PASSABLE, read_movingai
from resgrid.scene.maps.pictures import THRESHOLD, read_epic, read_grey
from resgrid.scene.maps.ros import UNKNOWN, occupancy_grid, read_ros, ros_greys
from resgrid.scene.messages import suggestion


@dataclass(frozen=True)
class MapFormat:
    """A kind of map file: its reader, how its files end, how they begin, and the options it takes.

    A reader gives the cells of a map, or, where the file says where they lie or what they cost, all of it.
    """

    read: Callable[..., NDArray[np.uint8] | MapCells]
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...]
    options: tuple[str, ...]


PLACING = ("spacing", "origin", "unit")
FORMATS: dict[str, MapFormat] = {
    "ros": MapFormat(read_ros, (".yaml", ".yml"), (), ("dialect", "unknown", "lethal", "least_conductivity")),
    "movingai": MapFormat(read_movingai, (".map",), (b"type ",), ("passable",)),
    "image": MapFormat(
        read_grey,
        (".png", ".pgm", ".pnm", ".ppm", ".pbm", ".bmp", ".gif", ".tif", ".tiff"),
        (b"\x89PNG", b"P2", b"P5", b"BM", b"GIF8"),
        ("threshold", *PLACING),
    ),
    "epic": MapFormat(read_epic, (), (), PLACING),
    "npy": MapFormat(read_npy, (".npy",), (b"\x93NUMPY",), PLACING),
}
_MAGIC = max(len(magic) for entry in FORMATS.values() for magic in entry.magic)
COMMON = ("file", "format", "periodic", "headings")
"""Keys of a ``[map]`` table that no reader sees."""


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
    placing = {key: options.pop(key) for key in PLACING if key in options}
    found = FORMATS[name].read(path, **options)
    cells = found if isinstance(found, MapCells) else MapCells(placed_axes(found.shape, **placing), found)
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


def describe_map(table: Mapping[str, Any]) -> dict[str, Any]:
    """How a map was read: which way its rows run, and what its greys and letters mean."""
    file = Path(table["file"])
    name = format_of(file, table)
    described: dict[str, Any] = {"file": str(file), "format": name}
    if name == "ros":
        options = {key: table[key] for key in ("dialect", "lethal") if key in table}
        described["greys"] = _runs(ros_greys(file, **options))
        described["unknown_cells"] = int((occupancy_grid(file, table.get("dialect", "nav2")) == UNKNOWN).sum())
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
