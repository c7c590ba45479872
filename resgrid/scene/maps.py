"""Map files: which formats there are, and which reader and options belong to each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from resgrid.errors import InputError
from resgrid.scene import movingai, plain, ros
from resgrid.scene.files import read_bytes
from resgrid.scene.map_data import MapData

Reader = Callable[..., MapData]


@dataclass(frozen=True)
class MapFormat:
    """A kind of map file: how its files end, and the options its reader takes."""

    suffixes: tuple[str, ...]
    options: tuple[str, ...]


PICTURES = (".png", ".pgm", ".pnm", ".ppm", ".pbm", ".bmp", ".gif", ".tif", ".tiff")
PLACING = ("spacing", "origin", "unit")
FORMATS: Mapping[str, MapFormat] = {
    "ros": MapFormat((".yaml", ".yml"), ("dialect", "unknown", "lethal")),
    "movingai": MapFormat((".map",), ("passable",)),
    "image": MapFormat(PICTURES, ("threshold", *PLACING)),
    "epic": MapFormat((), PLACING),
    "npy": MapFormat((".npy",), PLACING),
}
MAP_OPTIONS = ("format", *dict.fromkeys(option for entry in FORMATS.values() for option in entry.options))
_MAGIC = (
    (b"\x93NUMPY", "npy"),
    (b"type ", "movingai"),
    (b"\x89PNG", "image"),
    (b"P2", "image"),
    (b"P5", "image"),
    (b"BM", "image"),
    (b"GIF8", "image"),
)


def read_map(path: Path, table: Mapping[str, Any]) -> MapData:
    """Read a map file."""
    name = table.get("format", "auto")
    name = guess_format(path) if name == "auto" else name
    options = {key: value for key, value in table.items() if key not in ("file", "format")}
    for key in options:
        if key not in FORMATS[name].options:
            known = FORMATS[name].options
            near = get_close_matches(key, known, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"it takes {', '.join(known)}"
            raise InputError(f"{path}: map.{key}: a map of format {name!r} takes no such option; {hint}")
    return _reader(name)(path, **options)


def guess_format(path: Path) -> str:
    """The format of a map file, by the end of its name or else by its first bytes."""
    for name, entry in FORMATS.items():
        if path.suffix.lower() in entry.suffixes:
            return name
    start = read_bytes(path)[:16]
    for magic, name in _MAGIC:
        if start.startswith(magic):
            return name
    known = ", ".join(suffix for entry in FORMATS.values() for suffix in entry.suffixes)
    raise InputError(f"{path}: this is no known kind of map; scenes end in .toml, maps in {known}, or give the format")


def _reader(name: str) -> Reader:
    readers: Mapping[str, Reader] = {
        "ros": ros.read_ros,
        "movingai": movingai.read_movingai,
        "image": plain.read_grey,
        "epic": plain.read_epic,
        "npy": plain.read_npy,
    }
    return readers[name]
