"""File names in a scene's document (keys and tables of TOML): test for their presence, conversion to absolute names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


def needs_files(document: Mapping[str, Any]) -> bool:
    """Return whether the document of a scene refers to a map file, or to files of masks, obstacles or a robot.

    `document`: keys and tables of the scene file.
    """
    lists = [document.get(key) for key in ("obstacle", "mask")]
    tables = [document.get("robot"), *(table for some in lists if isinstance(some, list) for table in some)]
    return "map" in document or any("file" in table for table in tables if isinstance(table, Mapping))


def with_absolute_files(raw: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """Return a document in which file names of obstacles, masks and a robot of type ``urdf`` are absolute.

    The name of the map file is unchanged.  `raw`: keys and tables of the document, which may be invalid; `folder`:
    folder to which names are relative.
    """
    robot = raw.get("robot")
    changes: dict[str, Any] = {
        key: [_with_absolute(table, ("file",), folder) for table in raw[key]]
        for key in ("obstacle", "mask")
        if isinstance(raw.get(key), list)
    }
    if isinstance(robot, Mapping) and robot.get("type") == "urdf":
        changes["robot"] = _with_absolute(robot, ("file", "srdf", "packages"), folder)
    return {**raw, **changes}


def _with_absolute(table: Any, keys: tuple[str, ...], folder: Path) -> Any:
    """Return a table in which the file names, or lists of file names, under `keys` are absolute.

    `table`: keys and values; a value that is not a table is returned unchanged, as are the values of other keys;
    `folder`: folder to which names are relative.
    """
    if not isinstance(table, Mapping):
        return table
    return {key: _absolute(value, folder) if key in keys else value for key, value in table.items()}


def _absolute(name: Any, folder: Path) -> Any:
    """Return a file name, or each file name in a list, as an absolute one; other values and empty names unchanged.

    `folder`: folder to which names are relative.
    """
    if isinstance(name, list):
        return [_absolute(entry, folder) for entry in name]
    return str(folder.resolve() / name) if isinstance(name, str) and name else name
