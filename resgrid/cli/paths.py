"""Paths for every start and every blend of a scene, and how they are told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from resgrid.cli.job import Chip, Job, chip_of, place_of, solution_of
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.planning.fields import Field
    from resgrid.planning.streamline import ShortPath, Streamline
    from resgrid.planning.timing import Trajectory
    from resgrid.space import ConfigurationSpace

ADVICE = {
    "reached": "",
    "no_path": "obstacles part it from every goal: open a way, make the robot smaller, or refine the grid",
    "no_current": "the current here is too small to tell a direction: use --drive uniform",
    "start_blocked": "the start lies in an obstacle: move it, make the robot smaller, or refine the grid",
    "goal_blocked": "no free cell touches a goal: move the goal or open a way to it",
}


@dataclass(frozen=True, eq=False)
class Route:
    """A streamline on its way through the world.

    `start`: world coordinates; `field`: number of the field it was traced in; None where nothing flows; `k`: of that
    field; `short`: its shortcut, where one was asked for and it reached a goal; `motion`: when it is where, where
    speeds were given.
    """

    streamline: Streamline
    start: tuple[float, ...]
    field: int | None
    k: float
    short: ShortPath | None = None
    motion: Trajectory | None = None

    @property
    def reached(self) -> bool:
        """Whether it ends in a goal."""
        return str(self.streamline.outcome) == "reached"


@dataclass(frozen=True, eq=False)
class Plan:
    """The chips, fields and routes of a scene."""

    chips: dict[str, Chip]
    fields: list[Field]
    routes: list[Route]

    @property
    def complete(self) -> bool:
        """Whether every route ends in a goal."""
        return all(route.reached for route in self.routes)


def plan_routes(job: Job, report: Report) -> Plan:
    """Follow the current from every start, in every field that the scene asks for; each route is certified."""
    from resgrid.planning.certify import certify
    from resgrid.planning.trace import streamline

    solution = solution_of(job, report)
    chips = {name: chip_of(name, op) for name, op in solution.operating_points.items()}
    fields = [field for field in solution.fields if field.is_flowing]
    routes = []
    with report.stage("follow the current", steps=len(solution.tasks)) as progress:
        for field, number in solution.tasks:
            path = streamline(field, job.scene.starts[number])
            certify(path)
            index = fields.index(field) if field in fields else None
            routes.append(Route(path, job.scene.starts[number], index, field.k))
            progress.advance()
    return Plan(chips, fields, routes)


def require_starts(job: Job) -> None:
    """Refuse a scene without a start."""
    if not job.scene.starts:
        where = job.scene.source or "scene"
        raise InputError(f"{where}: there is no start; add starts = [[...]] to the scene, or say --start X,Y")


def route_data(route: Route, *, points: bool = True) -> dict[str, Any]:
    """A route as ``--json`` gives it; points in world coordinates."""
    path = route.streamline
    data: dict[str, Any] = {
        "outcome": str(path.outcome),
        "goal": path.goal,
        "length": path.length,
        "clearance": path.clearance,
        "log_duration": path.log_duration,
        "start": list(route.start),
        "k": route.k,
        "certified": True,
    }
    if not route.reached:
        data["message"] = ADVICE[str(path.outcome)]
    if points:
        data |= {"points": path.points, "cells": path.cells}
    if route.short is not None:
        data["short"] = {"length": route.short.length, "clearance": route.short.clearance}
    if route.motion is not None:
        data["duration"] = route.motion.duration
    return data


def route_line(route: Route, unit: str) -> str:
    """A route in one line, for people."""
    path = route.streamline
    head = f"start {place_of(route.start)}, k = {route.k:g}: "
    if not route.reached:
        return f"{head}{path.outcome}: {ADVICE[str(path.outcome)]}"
    clearance = f", clearance {path.clearance:.4g}{unit}" if path.clearance < float("inf") else ""
    shorter = f", shortened to {route.short.length:.6g}{unit}" if route.short is not None else ""
    time = f", {route.motion.duration:.4g} s" if route.motion is not None else ""
    size = f"{len(path.cells)} cells"
    return f"{head}reached goal {path.goal}, length {path.length:.6g}{unit}{clearance}, {size}{shorter}{time}"


def unit_of(space: ConfigurationSpace) -> str:
    """The unit of lengths with a blank before it, where all axes share one."""
    units = {axis.unit for axis in space.axes}
    return f" {units.pop()}" if len(units) == 1 else ""
