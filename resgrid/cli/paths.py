"""Paths for every start and every blend of a scene, and how they are reported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from resgrid.cli.report import stage
from resgrid.cli.scenes import Job, place_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from resgrid.io.paths import Route
    from resgrid.nodal.operating_point import OperatingPoint
    from resgrid.planning.fields import Field
    from resgrid.space import ConfigurationSpace


@dataclass(frozen=True, eq=False)
class Plan:
    """The solved circuits of a scene by name, the fields that flow, and the routes."""

    operating_points: Mapping[str, OperatingPoint]
    fields: list[Field]
    routes: list[Route]

    @property
    def complete(self) -> bool:
        """Whether every route ends in a goal."""
        return all(route.reached for route in self.routes)


def plan_routes(job: Job) -> Plan:
    """Follow the current from every start, in every field that the scene asks for; each route is certified."""
    from resgrid.io.paths import Route
    from resgrid.planning.certify import certify
    from resgrid.planning.trace import streamline

    solution = job.solution()
    routes = []
    with stage("follow the current", steps=len(solution.tasks)) as progress:
        for field, number in solution.tasks:
            path = streamline(field, job.scene.starts[number])
            certify(path)
            routes.append(Route(path, job.scene.starts[number], field))
            progress.advance()
    return Plan(solution.operating_points, [field for field in solution.fields if field.is_flowing], routes)


def route_line(route: Route, space: ConfigurationSpace) -> str:
    """A route in one line, for people."""
    from resgrid.io.paths import ADVICE

    units = {axis.unit for axis in space.axes}
    unit = f" {units.pop()}" if len(units) == 1 else ""
    path = route.streamline
    head = f"start {place_of(route.start)}, k = {route.field.k:g}: "
    if not route.reached:
        return f"{head}{path.outcome}: {ADVICE[path.outcome]}"
    clearance = f", clearance {path.clearance:.4g}{unit}" if path.clearance < float("inf") else ""
    shorter = f", shortened to {route.short.length:.6g}{unit}" if route.short is not None else ""
    time = f", {route.motion.duration:.4g} s" if route.motion is not None else ""
    size = f"{len(path.cells)} cells"
    return f"{head}reached goal {path.goal}, length {path.length:.6g}{unit}{clearance}, {size}{shorter}{time}"
