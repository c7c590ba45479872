"""Section: time of a direction-safe solution relative to a normwise solution, in alternating runs."""

from __future__ import annotations

from benchmarks.comparison import PREPARATION, RTOL
from benchmarks.contest import Arena, Run, arena, run_once
from benchmarks.problems import Problem
from benchmarks.rows import Row, Scale
from benchmarks.timing import spread


def direction(scale: Scale) -> list[Row]:
    """Compare direction-safe and normwise solutions in the plane, in a volume and in mazes."""
    flat, deep = {"tiny": (32, 8), "quick": (512, 64), "full": (1024, 128)}[scale.name]
    problems = [
        problem
        for boundary in ("dirichlet", "neumann")
        for problem in (
            Problem("rectangles", flat, boundary, scale.seed + flat),
            Problem("boxes", deep, boundary, scale.seed + deep),
            Problem("maze", flat, boundary, scale.seed + flat, 3),
        )
    ]
    return [_row(problem, scale) for problem in problems]


def _row(problem: Problem, scale: Scale) -> Row:
    name = f"{problem.name}: direction-safe"
    with arena(problem, ["resgrid"]) as ring:
        _pair(ring, PREPARATION)
        pairs = [_pair(ring, scale.limit) for _ in range(scale.rounds)]
    failure = next((run.failure for pair in pairs for run in pair if run.failure), "")
    if failure:
        return Row(name, None, None, "x normwise", note=failure)
    value = spread([safe.total / normwise.total for safe, normwise in pairs])
    note = f"{pairs[-1][0].method}; normwise {pairs[-1][1].method}"
    return Row(name, spread([safe.total for safe, _ in pairs]).median, value, "x normwise", note=note)


def _pair(ring: Arena, limit: float) -> tuple[Run, Run]:
    safe = run_once(ring, "resgrid", rtol=RTOL, limit=limit, accuracy="direction")
    return safe, run_once(ring, "resgrid", rtol=RTOL, limit=limit)
