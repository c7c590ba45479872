"""How a map was read, for people: which way its rows run, and what its greys and letters mean."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Any

from resgrid.scene.maps import guess_format
from resgrid.scene.movingai import PASSABLE
from resgrid.scene.plain import THRESHOLD
from resgrid.scene.ros import UNKNOWN, occupancy_grid, ros_greys
from resgrid.scene.scene import Scene

_ROS_OPTIONS = ("dialect", "lethal")


def describe_map(scene: Scene) -> dict[str, Any]:
    """How the map of a scene was read."""
    assert scene.map is not None
    table = scene.map.table
    file = Path(table["file"])
    name = format_of(scene)
    told: dict[str, Any] = {"file": str(file), "format": name}
    if name == "ros":
        dialect = table.get("dialect", "nav2")
        told["greys"] = _runs(ros_greys(file, **{key: table[key] for key in _ROS_OPTIONS if key in table}))
        told["unknown_cells"] = int((occupancy_grid(file, dialect) == UNKNOWN).sum())
        told["unknown_as"] = table.get("unknown", "obstacle")
    elif name == "image":
        threshold = table.get("threshold", THRESHOLD)
        told["greys"] = _runs(["obstacle" if grey < threshold else "free" for grey in range(256)])
    elif name == "epic":
        told["greys"] = _runs(["obstacle", *["free"] * 254, "goal"])
    elif name == "movingai":
        told["passable"] = table.get("passable", PASSABLE)
    return told


def format_of(scene: Scene) -> str:
    """The format that the map of a scene was read in, a key of `FORMATS`."""
    assert scene.map is not None
    name = str(scene.map.table.get("format", "auto"))
    return guess_format(Path(scene.map.table["file"])) if name == "auto" else name


def _runs(words: list[str]) -> list[tuple[int, int, str]]:
    """Neighbouring grey values of one meaning together: first, last, meaning."""
    runs, first = [], 0
    for word, group in groupby(words):
        last = first + len(list(group)) - 1
        runs.append((first, last, word))
        first = last + 1
    return runs
