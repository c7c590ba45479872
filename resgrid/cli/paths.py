"""Paths for every start and every blend of a scene, and how they are told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from resgrid.cli.job import Chip, Job, blend_fields, place_of, solve_chip, start_cell
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.planning.fields import Field
    from resgrid.planning.streamline import ShortPath
    from resgrid.planning.streamline import Streamline
    from resgrid.planning.timing import Trajectory
    from resgrid.scene import Scene
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

    `start`: world coordinates; `field`: number of the field it was traced in, and certified against; None where there
    is none to trace; `k`: of that field; `short`: its shortcut, where one was asked for and it reached a goal;
    `motion`: when it is where, where speeds were given.
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
    scene = job.scene
    chips: dict[str, Chip] = {}
    if scene.drive == "start":
        _check_start_drive(scene)
        return _start_driven(job, report, chips)
    fields = blend_fields(job, chips, report)
    routes = []
    with report.stage("follow the current", steps=len(fields) * len(scene.starts)) as progress:
        for index in range(len(fields)):
            for number in range(len(scene.starts)):
                routes.append(_route(job, fields, index, number))
                progress.advance()
    return Plan(chips, fields, routes)


def _check_start_drive(scene: Scene) -> None:
    if any(scene.k):
        raise InputError(
            f"k = {', '.join(f'{k:g}' for k in scene.k)} asks for a Dirichlet field, and drive = 'start' serves one "
            "start of a Neumann field only: use --drive uniform, or --k 0"
        )


def _start_driven(job: Job, report: Report, chips: dict[str, Chip]) -> Plan:
    """Each start is tied to the supply in turn, by a chip of its own."""
    from resgrid.planning.fields import field_of
    from resgrid.planning.trace import undriven
    from resgrid.space import Cell

    fields: list[Field] = []
    routes = []
    for number in range(len(job.scene.starts)):
        cell = start_cell(job, number)
        if job.space.cell[cell] != Cell.FREE or not job.space.goal_connected[cell]:
            path = undriven(job.space, job.scene.starts[number], job.scene.edge)
            routes.append(_placed(job, number, path, None, 0.0))
            continue
        chip = solve_chip(job, report, "neumann", number, ideal=True)
        chips[chip.name] = chip
        fields.append(field_of(chip.point))
        routes.append(_route(job, fields, -1, number))
    return Plan(chips, fields, routes)


def _route(job: Job, fields: list[Field], index: int, number: int) -> Route:
    from resgrid.planning.certify import certify
    from resgrid.planning.trace import streamline

    field = fields[index]
    path = streamline(field, job.scene.starts[number])
    certify(path, field)
    return _placed(job, number, path, index % len(fields), field.k)


def _placed(job: Job, number: int, path: Streamline, field: int | None, k: float) -> Route:
    return Route(path, job.scene.starts[number], field, k)


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
        "certified": route.field is not None,
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
