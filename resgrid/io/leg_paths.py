"""Writers of paths of several legs: tables, records, arrays, and messages for ROS."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from resgrid.errors import InputError
from resgrid.io.paths import path_columns
from resgrid.io.ros_paths import require_plane, to_ros_path
from resgrid.io.tables import Views, require_names, write
from resgrid.planning.legs import LegPath
from resgrid.planning.streamline import Outcome

_COLUMNS = ("path", "outcome", "leg", "kind", "certified")
"""Names of the columns of a table of paths of several legs, in addition to the coordinates of the points."""


def write_leg_path(path: LegPath, file: str | os.PathLike[str], *, heading: float | None = None) -> Path:
    """Write a path of several legs in the format that the file's suffix selects, and return the file.

    `file`: ``.csv``, ``.json``, ``.npz``, or ``.yaml`` for a ``nav_msgs/Path`` message; `heading`: heading of the last
    pose in the message in radians, for a robot without a heading of its own; None for the direction of motion.
    """
    return write_leg_paths([path], file, headings=[heading])


def write_leg_paths(
    paths: Sequence[LegPath], file: str | os.PathLike[str], *, headings: Sequence[float | None] | None = None
) -> Path:
    """Write several paths of several legs to one file, and return the file.

    `file`: ``.csv``, ``.json``, ``.npz``, or ``.yaml`` for one ``nav_msgs/Path`` message per path; `headings`: for each
    path the heading of the last pose of its message in radians, for a robot without a heading of its own; None, for a
    path or for all, means the direction of motion.
    """
    wanted = [None] * len(paths) if headings is None else list(headings)
    views: Views = {
        "table": lambda: _table(paths),
        "record": lambda: {"paths": [leg_record(path) for path in paths]},
        "arrays": lambda: _arrays(paths),
        "message": lambda: _messages(paths, wanted),
    }
    return write(file, views, "a path of several legs")


def leg_record(path: LegPath) -> dict[str, Any]:
    """Return outcome, lengths, legs and points of a path of several legs as a dictionary for JSON.

    Keys: ``outcome``, ``start``, ``length`` in axis units, ``certified``; ``approximate`` and ``distance`` (whether the
    path ends at the nearest reachable place, and then its distance from the goal in axis units, else None); ``legs``:
    ``kind``, ``certified``, ``length`` and ``clearance`` in axis units (None for an escape) and ``end`` (last point, in
    world coordinates) of each leg; ``points`` and ``leg_of_points`` (index of the leg of each point); ``message``:
    reason, only if no goal is reached.
    """
    record: dict[str, Any] = {
        "outcome": str(path.outcome),
        "start": list(path.start),
        "length": path.length,
        "certified": path.certified,
        "approximate": path.distance is not None,
        "distance": path.distance,
        "legs": [
            {
                "kind": leg.kind,
                "certified": leg.certified,
                "length": float(np.linalg.norm(np.diff(leg.path.line, axis=0), axis=1).sum()),
                "clearance": getattr(leg.path, "clearance", None),
                "end": leg.path.points[-1],
            }
            for leg in path.legs
        ],
        "points": path.points,
        "leg_of_points": path.leg_of_points,
    }
    if path.reason is not None:
        record["message"] = path.reason
    return record


def _columns(path: LegPath) -> dict[str, Any]:
    require_names(path.space.axes, _COLUMNS)
    number = path.leg_of_points
    kinds = np.array([str(leg.kind) for leg in path.legs] or ["none"])
    proofs = np.array([leg.certified for leg in path.legs] or [True])
    own = {"leg": number, "kind": kinds[number], "certified": proofs[number].astype(int)}
    return own | path_columns(path.line)


def _table(paths: Sequence[LegPath]) -> dict[str, list[Any]]:
    table: dict[str, list[Any]] = {}
    for number, path in enumerate(paths):
        columns = _columns(path)
        count = len(path.points)
        for name, values in {"path": [number] * count, "outcome": [str(path.outcome)] * count, **columns}.items():
            table.setdefault(name, []).extend(np.asarray(values).tolist())
    return table


def _arrays(paths: Sequence[LegPath]) -> dict[str, Any]:
    arrays: dict[str, Any] = {
        "outcome": [str(path.outcome) for path in paths],
        "distance": [np.nan if path.distance is None else path.distance for path in paths],
    }
    for number, path in enumerate(paths):
        arrays |= {f"{name}_{number}": np.asarray(values) for name, values in _columns(path).items()}
    return arrays


def _messages(paths: Sequence[LegPath], headings: Sequence[float | None]) -> str:
    """Return YAML text with one ``nav_msgs/Path`` per path that reaches a goal or ends at the nearest reachable place.

    Other paths are left out; InputError is raised if no path remains. A comment before each message contains the
    outcome and the legs that are not certified. `headings`: for each path the heading of the last pose in radians, None
    for the direction of motion.
    """
    texts = []
    for path, heading in zip(paths, headings, strict=True):
        require_plane(path.space)
        if path.outcome is not Outcome.REACHED and path.distance is None:
            continue
        away = "" if path.distance is None else f", ends {path.distance:.6g} from the goal"
        open_legs = [str(number) for number, leg in enumerate(path.legs) if not leg.certified]
        proof = f", not certified: leg {', '.join(open_legs)}" if open_legs else ""
        texts.append(f"# {path.outcome}{away}{proof}\n{to_ros_path(path.line, heading=heading)}")
    if not texts:
        raise InputError(
            "no path reaches a goal, and a nav_msgs/Path message cannot hold an outcome; write .csv, .json or .npz"
        )
    return "---\n".join(texts)
