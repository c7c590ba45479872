"""Routes as files: what is asked of them beyond the streamline, and how each format tells it."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resgrid.cli.job import Job
from resgrid.cli.output import emit_file, emit_text, json_text
from resgrid.cli.paths import Plan, Route, route_data
from resgrid.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SUFFIXES = (".csv", ".json", ".npz", ".yaml")

_HEAD = ("path", "k", "outcome")
_TAKEN = {".csv": set(_HEAD), ".npz": {"points", "cells"}}
"""Names that a format keeps for itself."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """What the command line asks of every route.

    `shorten`: straighten it by shortcuts; `clearance`: that shortcuts keep; `speed, acceleration`: limits, one for
    the robot or one for each coordinate; empty for none; `rate`: samples a second.
    """

    shorten: bool
    clearance: float
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    rate: float | None

    def __post_init__(self) -> None:
        if self.acceleration and not self.speed:
            raise InputError("--acceleration times a path only together with --speed")
        if self.rate is not None and not self.speed:
            raise InputError("--rate samples a timed path: give --speed too")
        if self.rate is not None and not 0 < self.rate < inf:
            raise InputError(f"--rate {self.rate:g}: a number of samples a second is positive and finite")
        if not 0 <= self.clearance < inf:
            raise InputError(f"--keep-clearance {self.clearance:g}: a distance is at least 0 and finite")
        if self.clearance and not self.shorten:
            raise InputError("--keep-clearance is for shortcuts: give --shorten too")


def refine(plan: Plan, motion: Motion) -> Plan:
    """Shorten and time the routes of a plan, as far as it is asked for."""
    if not motion.shorten and not motion.speed:
        return plan
    return dataclasses.replace(plan, routes=[_refined(route, motion) for route in plan.routes])


def _refined(route: Route, motion: Motion) -> Route:
    from resgrid.planning.shortcut import shorten
    from resgrid.planning.timing import time_path

    path = route.streamline
    if motion.shorten and route.reached:
        route = dataclasses.replace(route, short=shorten(path, clearance=motion.clearance))
    if motion.speed:
        timed = time_path(
            route.short or path,
            velocity_limits=_each(motion.speed),
            acceleration_limits=_each(motion.acceleration) if motion.acceleration else None,
        )
        if motion.rate is not None:
            timed = timed.resampled(motion.rate)
        route = dataclasses.replace(route, motion=timed)
    return route


def _each(limits: tuple[float, ...]) -> float | tuple[float, ...]:
    return limits[0] if len(limits) == 1 else limits


def check_motion(motion: Motion, job: Job, target: str | None) -> None:
    """Refuse limits and columns that do not fit the axes, before anything is computed."""
    from resgrid.planning.export import other_columns, require_names

    for option, limits in (("--speed", motion.speed), ("--acceleration", motion.acceleration)):
        if len(limits) not in (0, 1, job.space.ndim):
            names = ", ".join(axis.name for axis in job.space.axes)
            raise InputError(f"{option}: {len(limits)} numbers for {names}; give one, or one for each with commas")
        if not all(0 < limit < inf for limit in limits):
            raise InputError(f"{option} {','.join(f'{limit:g}' for limit in limits)}: a limit is positive and finite")
    if target is None:
        return
    suffix = ".csv" if target == "-" else Path(target).suffix.lower()
    if suffix != ".yaml":
        others = other_columns(job.space.axes, job.scene.robot, timed=bool(motion.speed))
        require_names(job.space.axes, others | _TAKEN.get(suffix, set()))


def check_target(target: str) -> None:
    """Refuse a file that no format is known for, before anything is computed."""
    suffix = Path(target).suffix.lower()
    if target != "-" and suffix not in SUFFIXES:
        raise InputError(
            f"-o {target}: paths are written as .csv, .json, .npz or .yaml, and this name ends in none of these"
        )


def write_routes(target: str, routes: Sequence[Route], job: Job) -> None:
    """Write routes as the target's suffix says: ``.json``, ``.npz``, ``.yaml`` (ROS) or ``.csv`` (also ``-``)."""
    check_target(target)
    suffix = Path(target).suffix.lower()
    if target == "-" or suffix == ".csv":
        emit_text(target, csv_text(routes, job))
    elif suffix == ".json":
        emit_text(target, json_text({"paths": [_with_columns(route, job) for route in routes]}) + "\n")
    elif suffix == ".yaml":
        emit_text(target, plans_text(routes, job))
    else:
        emit_file(target, suffix, lambda path: _write_npz(path, routes, job))


def csv_text(routes: Sequence[Route], job: Job) -> str:
    """Routes as a table, one point a line, in world coordinates."""
    import csv

    tables = [_columns(route, job) for route in routes]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*_HEAD, *(tables[0] if tables else ())])
    for number, (route, columns) in enumerate(zip(routes, tables, strict=True)):
        head = (number, repr(route.k), str(route.streamline.outcome))
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        table.writerows((*head, *map(repr, row)) for row in rows)
    return text.getvalue()


def plans_text(routes: Sequence[Route], job: Job) -> str:
    """Routes as ``nav_msgs/Path`` messages, one document each; a route that reaches no goal has no poses."""
    from resgrid.planning.export import require_plan, ros_plan

    require_plan(job.space, job.scene.robot)
    documents = []
    for route in routes:
        if route.reached:
            way = route.motion or route.short or route.streamline
            documents.append(ros_plan(way))
        else:
            documents.append('header:\n  stamp: {sec: 0, nanosec: 0}\n  frame_id: "map"\nposes: []\n')
    return "---\n".join(documents)


def _columns(route: Route, job: Job) -> dict[str, NDArray[np.float64]]:
    """Columns of a route: a streamline's points as they are; shortened or timed ones continuous across seams."""
    from resgrid.planning.export import path_columns

    way = route.motion or route.short or route.streamline
    columns = path_columns(way)
    if way is route.streamline:
        columns |= {axis.name: way.points[:, number] for number, axis in enumerate(job.space.axes)}
    return columns


def _with_columns(route: Route, job: Job) -> dict[str, Any]:
    data = route_data(route)
    columns = _columns(route, job)
    if route.motion is None and route.short is None:
        columns = {name: column for name, column in columns.items() if name.startswith("tip_")}
    return data | ({"columns": columns} if columns else {})


def _write_npz(path: Path, routes: Sequence[Route], job: Job) -> None:
    import numpy as np

    arrays: dict[str, Any] = {
        "outcome": np.array([str(route.streamline.outcome) for route in routes]),
        "goal": np.array([-1 if route.streamline.goal is None else route.streamline.goal for route in routes]),
        "length": np.array([route.streamline.length for route in routes]),
        "clearance": np.array([route.streamline.clearance for route in routes]),
        "k": np.array([route.k for route in routes]),
        "start": np.array([route.start for route in routes]),
    }
    for number, route in enumerate(routes):
        arrays[f"points_{number}"] = route.streamline.points
        arrays[f"cells_{number}"] = route.streamline.cells
        for name, column in _columns(route, job).items():
            arrays[f"{name}_{number}"] = column
    with path.open("wb") as file:
        np.savez(file, **arrays)
