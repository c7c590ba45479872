"""Paths for every start and every blend of a scene, or for benchmark queries, and how they are reported."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import resgrid as rg
from resgrid.cli.scenes import Job, place_of, size_of
from resgrid.cli.terminal import NEGATIVE, counted, finish, quietly, say, stage
from resgrid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from resgrid.io.paths import Route
    from resgrid.scene import MovingAIScenario


@dataclass(frozen=True, eq=False)
class Plan:
    """The solved circuits of a scene by name, the fields that flow (one that does not if none does), the routes."""

    operating_points: Mapping[str, rg.OperatingPoint]
    fields: list[rg.Field]
    routes: list[Route]

    @property
    def streamlines(self) -> list[rg.Streamline]:
        """The streamline of every route."""
        return [route.streamline for route in self.routes if route.streamline is not None]

    @property
    def complete(self) -> bool:
        """Whether every route ends in a goal."""
        return all(route.reached for route in self.routes)


def plan_routes(job: Job) -> Plan:
    """Follow the current from every start, in every field that the scene asks for; each route is certified."""
    from resgrid.io.paths import Route
    from resgrid.planning.advice import Advisor

    solution, advisor = job.solution(), Advisor(job.scene)
    for name in solution.flat:
        say(f"the {name} half of the blend is flat: no obstacle, or edge that counts as one, drives it")
    routes = []
    with stage("follow the current", steps=len(solution.tasks)) as progress:
        for field, number in solution.tasks:
            path = rg.streamline(field, job.scene.starts[number])
            rg.certify(path)
            start = job.scene.starts[number]
            routes.append(Route(path, start, certified=True, advice=advisor.reason(path)))
            progress.advance()
    flowing = [field for field in solution.fields if field.is_flowing]
    return Plan(solution.operating_points, flowing or list(solution.fields[:1]), routes)


def route_lines(routes: Sequence[Route]) -> Iterator[str]:
    """Yield one line a route, for people; starts that fail alike for several k have one line."""
    failed: dict[tuple[object, ...], list[Route]] = {}
    for route in routes:
        if not route.reached:
            failed.setdefault(_failure(route), []).append(route)
    for route in routes:
        if route.reached:
            yield _reached_line(route)
        elif failed[_failure(route)][0] is route:
            k = ", ".join(f"{other.k:g}" for other in failed[_failure(route)])
            yield f"start {place_of(route.start)}, k = {k}: {route.outcome}: {route.reason}"


def _failure(route: Route) -> tuple[object, ...]:
    return route.start, route.outcome, route.reason


def _reached_line(route: Route) -> str:
    """The figures of the path that is followed; of a shortened or timed one, then those of its streamline."""
    path = route.streamline
    assert path is not None and path.goal is not None
    regions = path.space.goal_count
    of_several = f" (regions count from 0 to {regions - 1})" if regions > 1 else ""
    head = f"start {place_of(route.start)}, k = {route.k:g}: reached goal {path.goal}{of_several}"
    size = counted(len(path.cells), "cell")
    time = "" if route.duration is None else f", {route.duration:.4g} s"
    figures = _figures(route.length, route.clearance, path)
    if route.path is path:
        return f"{head} at {place_of(path.points[-1])}, {figures}, {size}"
    original = _figures(path.length, path.clearance, path)
    return f"{head} at {place_of(path.points[-1])}, {figures}{time} (streamline: {original}, {size})"


def _figures(length: float, clearance: float | None, path: rg.Streamline) -> str:
    units = {axis.unit for axis in path.space.axes}
    unit = f" {units.pop()}" if len(units) == 1 else ""
    clear = f", clearance {clearance:.4g}{unit}" if clearance is not None and clearance < float("inf") else ""
    return f"length {length:.6g}{unit}{clear}"


def answer_queries(job: Job, file: str, limit: int | None, output: str | None, ignored: dict[str, list[str]]) -> int:
    """Answer the queries of a MovingAI scenario file on one map."""
    from resgrid.io.tables import suffix_of, write

    if output is not None:
        suffix_of(output, ("record",), "answers to queries")
    queries = list(islice(rg.maps.read_movingai_scenarios(file), limit))
    _require_own_map(job, queries, file)
    answers = []
    with stage(f"answer {len(queries)} queries", steps=len(queries)) as progress:
        for query in queries:
            with quietly():
                answers.extend(_answers(job, query, file))
            progress.advance()
    data = {"scene": job.scene.title, "queries": file, "paths": answers, **ignored}
    if output is not None:
        write(output, {"record": lambda: data}, "answers to queries")
    reached = sum(answer["outcome"] == "reached" for answer in answers)
    finish(data, [f"{reached} of {len(answers)} paths reach their goal"], written=output)
    return 0 if reached == len(answers) else NEGATIVE


def _require_own_map(job: Job, queries: Sequence[MovingAIScenario], file: str) -> None:
    """Refuse queries of another map, which may have the same size; a map from a pipe has no name."""
    cells = job.scene.map
    own = None if cells is None else Path(cells.table["file"])
    if own is None or own.suffix.lower() != ".map":
        return
    for query in queries:
        name = PurePosixPath(query.map.replace("\\", "/")).name
        if name != own.name:
            raise InputError(
                f"{file}: these queries are for the map {name!r}, and this is {own.name!r}; give that map, "
                "or rename this one if it is the same"
            )


def _answers(job: Job, query: MovingAIScenario, file: str) -> list[dict[str, Any]]:
    """What becomes of a query, for each k: its goal makes circuits of its own."""
    if job.space.shape != (query.width, query.height):
        own = size_of(job.space.shape)
        raise InputError(f"{file}: these queries are for a map of {query.width} x {query.height} cells, this has {own}")
    common = {"start": query.start, "goal_cell": query.goal, "optimal_length": query.optimal_length}
    if job.space.cell[query.goal] == rg.Cell.OBSTACLE:
        return [{"outcome": "goal_blocked", "k": None, "length": None, **common}]
    cell = job.space.cell.copy()
    cell[cell == rg.Cell.GOAL] = rg.Cell.FREE
    cell[query.goal] = rg.Cell.GOAL
    answers = []
    for field in Job(job.scene, job.space.with_cells(cell)).solution().fields:
        path = rg.streamline(field, cell=query.start)
        rg.certify(path)
        figures = {"outcome": str(path.outcome), "k": field.k, "length": path.length, "clearance": path.clearance}
        answers.append({**figures, **common})
    return answers
