"""Sections for grids of cells: comparison with peers, and resgrid's work on difficult problems."""

from __future__ import annotations

from benchmarks.comparison import PREPARATION, RTOL, best_peer, compare, product_seconds, work_rows
from benchmarks.contest import Run, arena, run_once
from benchmarks.problems import Problem
from benchmarks.rows import Row, Scale, Spread
from benchmarks.timing import spread

BOUNDARIES = ("dirichlet", "neumann")


def plane(scale: Scale) -> list[Row]:
    """Section: squares of 1024^2 and 2048^2 cells, a fifth of them obstacles, all contenders."""
    sizes = {"tiny": (32,), "quick": (1024,), "full": (1024, 2048)}[scale.name]
    return _compared([Problem("rectangles", n, b, scale.seed + n) for n in sizes for b in BOUNDARIES], scale)


def volume(scale: Scale) -> list[Row]:
    """Section: cubes of 64^3 and 128^3 cells, all contenders."""
    sizes = {"tiny": (8,), "quick": (64,), "full": (64, 128)}[scale.name]
    return _compared([Problem("boxes", n, b, scale.seed + n) for n in sizes for b in BOUNDARIES], scale)


def irregular(scale: Scale) -> list[Row]:
    """Section: netlists without a grid of cells, all contenders."""
    sizes = {"tiny": (1000,), "quick": (100_000,), "full": (100_000, 1_000_000)}[scale.name]
    kinds = ("power grid", "geometric graph", "thinned grid")
    return _compared([Problem(kind, n, seed=scale.seed + n) for n in sizes for kind in kinds], scale)


def mazes(scale: Scale) -> list[Row]:
    """Section: resgrid's work on Neumann mazes of several corridor widths."""
    sizes = {"tiny": (33,), "quick": (512,), "full": (512, 1024)}[scale.name]
    widths = (1, 3) if scale.name == "tiny" else (1, 2, 3, 8, 32)
    problems = [Problem("maze", n, "neumann", scale.seed + n + w, w) for n in sizes for w in widths]
    return [row for problem in problems for row in alone(problem, scale)]


def growth(scale: Scale) -> list[Row]:
    """Section: time per unknown from 256^2 cells on, relative to the smallest grid."""
    last = {"tiny": 6, "quick": 10, "full": 12}[scale.name]
    rows, least = [], 0.0
    for power in range(min(8, last - 1), last + 1):
        problem = Problem("rectangles", 2**power, "neumann", scale.seed + power)
        own, unknowns, _ = _runs(problem, scale)
        failure = next((run.failure for run in own if run.failure), "")
        if failure:
            rows.append(Row(f"{problem.name}: time per unknown", None, None, "x smallest", note=failure))
            continue
        each = spread([run.total / unknowns for run in own])
        least = least or each.median
        value = Spread(each.median / least, each.low / least, each.high / least)
        remark = f"{1e9 * each.median:.0f} ns an unknown, {own[-1].method}"
        rows.append(Row(f"{problem.name}: time per unknown", each.median * unknowns, value, "x smallest", note=remark))
    return rows


def alone(problem: Problem, scale: Scale) -> list[Row]:
    """Return resgrid's time and work on a problem."""
    own, _, product = _runs(problem, scale)
    failure = next((run.failure for run in own if run.failure), "")
    if failure:
        return [Row(f"{problem.name}: solve phase", None, None, "products", note=failure)]
    return work_rows(problem.name, own, product)


def _runs(problem: Problem, scale: Scale) -> tuple[list[Run], int, float]:
    """Return resgrid's runs on a problem, its number of unknowns, and the seconds of a product."""
    with arena(problem, ["resgrid"]) as ring:
        first = run_once(ring, "resgrid", rtol=RTOL, limit=PREPARATION)
        if first.failure:
            return [first], len(ring.system.rhs), 1.0
        runs = [run_once(ring, "resgrid", rtol=RTOL, limit=scale.limit) for _ in range(scale.rounds)]
        return runs, len(ring.system.rhs), product_seconds(ring.system, scale.rounds)


def _compared(problems: list[Problem], scale: Scale) -> list[Row]:
    rows = []
    for problem in problems:
        new = compare(problem, scale)
        best = best_peer(new)
        if best is not None:
            new.append(Row(f"{problem.name}: fastest peer", best.seconds, best.value, best.unit, best.contender))
        rows += new
    return rows
