"""Paths for every start and every blend of a scene, and how they are reported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from resgrid.cli.report import stage
from resgrid.cli.scenes import Chip, Job, blend_fields, place_of, solve_chip, start_cell
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.io.paths import Route
    from resgrid.planning.field import Field
    from resgrid.scene import Scene
    from resgrid.space import ConfigurationSpace


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


def plan_routes(job: Job) -> Plan:
    """Follow the current from every start, in every field that the scene asks for; each route is certified."""
    scene = job.scene
    chips: dict[str, Chip] = {}
    if scene.drive == "start":
        _check_start_drive(scene)
        return _start_driven(job, chips)
    fields = blend_fields(job, chips)
    routes = []
    with stage("follow the current", steps=len(fields) * len(scene.starts)) as progress:
        for field in fields:
            for number in range(len(scene.starts)):
                routes.append(_route(job, field, number))
                progress.advance()
    return Plan(chips, fields, routes)


def _check_start_drive(scene: Scene) -> None:
    if any(scene.k):
        raise InputError(
            f"k = {', '.join(f'{k:g}' for k in scene.k)} asks for a Dirichlet field, and drive = 'start' serves one "
            "start of a Neumann field only: use --drive uniform, or --k 0"
        )


def _start_driven(job: Job, chips: dict[str, Chip]) -> Plan:
    """Each start is tied to the supply in turn, by a chip of its own."""
    from resgrid.io.paths import Route
    from resgrid.planning.field import field_of
    from resgrid.planning.trace import undriven
    from resgrid.space import Cell

    fields: list[Field] = []
    routes = []
    for number in range(len(job.scene.starts)):
        cell = start_cell(job, number)
        if job.space.cell[cell] != Cell.FREE or not job.space.goal_connected[cell]:
            path = undriven(job.space, job.scene.starts[number], job.scene.edge)
            routes.append(Route(path, job.scene.starts[number], None, 0.0))
            continue
        chip = solve_chip(job, "neumann", number, ideal=True)
        chips[chip.name] = chip
        fields.append(field_of(chip.point))
        routes.append(_route(job, fields[-1], number))
    return Plan(chips, fields, routes)


def _route(job: Job, field: Field, number: int) -> Route:
    from resgrid.io.paths import Route
    from resgrid.planning.certify import certify
    from resgrid.planning.trace import streamline

    start = job.scene.starts[number]
    path = streamline(field, start)
    certify(path, field)
    return Route(path, start, field, field.k)


def route_line(route: Route, space: ConfigurationSpace) -> str:
    """A route in one line, for people."""
    from resgrid.io.paths import ADVICE

    units = {axis.unit for axis in space.axes}
    unit = f" {units.pop()}" if len(units) == 1 else ""
    path = route.streamline
    head = f"start {place_of(route.start)}, k = {route.k:g}: "
    if not route.reached:
        return f"{head}{path.outcome}: {ADVICE[str(path.outcome)]}"
    clearance = f", clearance {path.clearance:.4g}{unit}" if path.clearance < float("inf") else ""
    shorter = f", shortened to {route.short.length:.6g}{unit}" if route.short is not None else ""
    time = f", {route.motion.duration:.4g} s" if route.motion is not None else ""
    size = f"{len(path.cells)} cells"
    return f"{head}reached goal {path.goal}, length {path.length:.6g}{unit}{clearance}, {size}{shorter}{time}"
