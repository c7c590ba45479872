"""The scenes that come with resgrid, found by their names in every kind of installation."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path


@cache
def shipped_scenes() -> Mapping[str, Path]:
    """Return the files of the shipped scenes by name, such as ``rooms``.

    A wheel holds them inside the package; in a checkout they lie in ``examples/scenes``.
    """
    here = Path(__file__).parent
    for folder in (here / "examples", here.parents[1] / "examples" / "scenes"):
        if folder.is_dir():
            return {file.stem: file for file in sorted(folder.glob("*.toml"))}
    return {}


def shipped_scene(name: str | os.PathLike[str]) -> Path | None:
    """Return the file of the shipped scene that a name without a folder means (``rooms`` or ``rooms.toml``).

    None for other names, and where the current folder has a file of this name, which is meant then.
    """
    given = Path(name)
    if str(name) != given.name or (given.exists() and not given.is_dir()):
        return None
    return shipped_scenes().get(given.name.removesuffix(".toml"))
