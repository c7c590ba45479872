"""Files of the scenes that are part of the distribution, by name, for wheels and checkouts."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path


@cache
def shipped_scenes() -> Mapping[str, Path]:
    """Return the files of the shipped scenes by name, such as ``rooms``; empty if the files are missing.

    A wheel holds the files inside the package; in a checkout they lie in ``examples/scenes``.
    """
    here = Path(__file__).parent
    for folder in (here / "examples", here.parents[1] / "examples" / "scenes"):
        if folder.is_dir():
            return {file.stem: file for file in sorted(folder.glob("*.toml"))}
    return {}


def shipped_scene(name: str | os.PathLike[str]) -> Path | None:
    """Return the file of the shipped scene with a name (``rooms`` or ``rooms.toml``), or None.

    The result is None for other names, for names with a folder, and if the current folder has a file of this name.
    """
    given = Path(name)
    if str(name) != given.name or (given.exists() and not given.is_dir()):
        return None
    return shipped_scenes().get(given.name.removesuffix(".toml"))
