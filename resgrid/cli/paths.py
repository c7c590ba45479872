"""Computation and report of paths for subcommands: all starts and blends of a scene, or MovingAI queries."""

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
    from resgrid.planning.any_field import AnyField, FieldPath
    from resgrid.scene import MovingAIScenario


@dataclass(frozen=True, eq=False)
class Plan:
    """The results of planning a scene.

    `operating_points`: solved circuits by name, such as "dirichlet"; `fields`: all fields with current, or, if no field
    has current, the first field; empty without fields; `routes`: one path for each start and each weight k.
    """

    operating_points: Mapping[str, rg.OperatingPoint]
    fields: list[AnyField]
    routes: list[Route]

    @property
    def streamlines(self) -> list[FieldPath]:
        """Streamlines or node paths of all routes (paths of one start at one weight k) that have a streamline."""
        return [route.streamline for route in self.routes if route.streamline is not None]

    @property
    def complete(self) -> bool:
        """Whether all routes (paths of one start at one weight k) end in a goal."""
        return all(route.reached for route in self.routes)


def plan_routes(job: Job) -> Plan:
    """Solve the circuits of a scene, and return them with the fields and the certified paths.

    There is one path for each start and each weight k; if starts drive the grid, one for each start.
    """
    from resgrid.io.paths import Route
    from resgrid.planning.advice import Advisor
    from resgrid.planning.any_field import path_of
    from resgrid.scene.tolerances import goal_heading

    solution, advisor = job.solution(), Advisor(job.scene)
    for name in solution.flat:
        say(
            f"the {name} field of the blend is zero, because there is no obstacle and no obstacle edge that drives it; "
            "the blend consists of the other field"
        )
    routes = []
    with stage("follow the current", steps=len(solution.tasks)) as progress:
        for field, number in solution.tasks:
            path = path_of(field, job.scene.starts[number])
            rg.certify(path)
            start = job.scene.starts[number]
            heading = goal_heading(job.scene, path.points[-1]) if path.goal is not None else None
            routes.append(Route(path, start, certified=True, advice=advisor.reason(path), heading=heading))
            progress.advance()
    flowing = [field for field in solution.fields if field.is_flowing]
    return Plan(solution.operating_points, flowing or list(solution.fields[:1]), routes)


def route_lines(routes: Sequence[Route]) -> Iterator[str]:
    """Yield one line of text per route (path of one start at one weight k).

    Failures of one start with the same reason at several weights k share one line.
    """
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
    """Return the line of text for a route (path of one start at one weight k) that reaches a goal.

    The line contains length and clearance of the path and, if the path was shortened or timed, also those of the
    streamline from which it was made.
    """
    path = route.streamline
    assert path is not None and path.goal is not None
    regions = path.space.goal_count
    of_several = f" (regions count from 0 to {regions - 1})" if regions > 1 else ""
    head = f"start {place_of(route.start)}, k = {route.k:g}: reached goal {path.goal}{of_several}"
    size = counted(len(path.cells), "cell")
    time = "" if route.duration is None else f", {route.duration:.4g} s"
    time += _workspace_text(route)
    figures = _figures(route.length, route.clearance, path)
    if route.path is path:
        return f"{head} at {place_of(path.points[-1])}, {figures}{time}, {size}"
    original = _figures(path.length, path.clearance, path)
    return f"{head} at {place_of(path.points[-1])}, {figures}{time} (streamline: {original}, {size})"


def _workspace_text(route: Route) -> str:
    """Return the smallest distance of an arm from a collision, or its first collision, as the end of a line of text.

    The text is empty for a route that was not tested for collisions and has no known, finite distance.
    """
    distance = route.workspace_clearance
    hit = route.collision
    if hit is not None:
        bodies = " and ".join(hit.names or ())
        return f", but {bodies} collide at {place_of(hit.configuration.tolist())}"
    tested = ", no collision" * route.is_tested
    return tested if distance is None or distance == float("inf") else f"{tested}, {distance:.4g} m from contact"


def _figures(length: float, clearance: float | None, path: FieldPath) -> str:
    units = {axis.unit for axis in path.space.axes}
    unit = f" {units.pop()}" if len(units) == 1 else ""
    clear = f", clearance {clearance:.4g}{unit}" if clearance is not None and clearance < float("inf") else ""
    return f"length {length:.6g}{unit}{clear}"


def answer_queries(job: Job, file: str, limit: int | None, output: str | None, ignored: dict[str, list[str]]) -> int:
    """Compute and report the paths for the queries of a MovingAI scenario file; return the exit code.

    The exit code is 0 if all paths reach their goal, otherwise 1.  `job`: scene and space; `file`: scenario file;
    `limit`: largest number of queries, None for all; `output`: JSON file, None for none; `ignored`: list of the scene
    keys without effect under the key ``ignored``, for JSON.
    """
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
    """Raise InputError for queries of another map than that of the job.

    The names of the files are compared, and only for MovingAI maps (.map): a map from a pipe has no such name.  `file`:
    scenario file, for the message.
    """
    cells = job.scene.map
    own = None if cells is None else Path(cells.table["file"])
    if own is None or own.suffix.lower() != ".map":
        return
    for query in queries:
        name = PurePosixPath(query.map.replace("\\", "/")).name
        if name != own.name:
            raise InputError(
                f"{file}: these queries are for the map {name!r}, not for {own.name!r}; give that map, or rename this "
                "map if it is the same"
            )


def _answers(job: Job, query: MovingAIScenario, file: str) -> list[dict[str, Any]]:
    """Return the JSON data of the paths for one query, one dictionary per weight k.

    Keys: ``outcome``, ``k``, ``length`` and ``clearance`` (in axis units), ``start`` and ``goal_cell`` (cell indices),
    and ``optimal_length`` (of the scenario file, in cells).  The circuits are solved with the query's goal as the only
    goal.  For a goal in an obstacle there is one dictionary, with None for ``k`` and ``length``, without ``clearance``.
    `file`: scenario file, for messages.
    """
    from resgrid.planning.any_field import path_of

    if job.space.shape != (query.width, query.height):
        own = size_of(job.space.shape)
        raise InputError(
            f"{file}: these queries are for a map of {query.width} x {query.height} cells, but the map has {own}; give "
            "the map of the queries"
        )
    common = {"start": query.start, "goal_cell": query.goal, "optimal_length": query.optimal_length}
    if job.space.cell[query.goal] == rg.Cell.OBSTACLE:
        return [{"outcome": "goal_blocked", "k": None, "length": None, **common}]
    cell = job.space.cell.copy()
    cell[cell == rg.Cell.GOAL] = rg.Cell.FREE
    cell[query.goal] = rg.Cell.GOAL
    answers = []
    for field in Job(job.scene, job.space.with_cells(cell)).solution().fields:
        path = path_of(field, cell=query.start)
        rg.certify(path)
        figures = {"outcome": str(path.outcome), "k": field.k, "length": path.length, "clearance": path.clearance}
        answers.append({**figures, **common})
    return answers
