"""Solve one problem by all contenders in turn, and return rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.contest import MET, Arena, Run, arena, prepare, run_once
from benchmarks.peers import PEERS
from benchmarks.problems import Equations, Problem
from benchmarks.rows import RATIO, Row, Scale, Spread
from benchmarks.timing import repeated, spread, timed

RTOL = 1e-8
SLOW = 4.0
"""A peer whose time exceeds the fastest time by this factor runs only once."""
PREPARATION = 300.0
LARGEST_FILL = {2: 5_000_000, 3: 400_000}
"""Number of unknowns, by dimension, above which direct peers are omitted: their factors would not fit in memory."""


def compare(problem: Problem, scale: Scale, peers: Sequence[str] = tuple(PEERS)) -> list[Row]:
    """Return the rows of a problem: times and ratios of all contenders; work, iterations and stages of resgrid."""
    with arena(problem, ["resgrid", *_allowed(problem, peers)]) as ring:
        runs = alternate(ring, scale)
        products = product_seconds(ring.system, scale.rounds)
    runs |= {name: [Run(failure="left out: its factors would not fit")] for name in peers if name not in runs}
    rows = ratio_rows(problem.name, runs)
    return rows + work_rows(problem.name, runs["resgrid"], products)


def _allowed(problem: Problem, peers: Sequence[str]) -> list[str]:
    dimension = 3 if problem.kind == "boxes" else 2
    unknowns = problem.size**3 if dimension == 3 else problem.size**2 if problem.kind == "rectangles" else 0
    return [name for name in peers if not (PEERS[name].direct and unknowns > LARGEST_FILL[dimension])]


def alternate(ring: Arena, scale: Scale) -> dict[str, list[Run]]:
    """Run rounds in which every contender solves once; a first run of resgrid compiles its kernels."""
    runs: dict[str, list[Run]] = {}
    for name in ring.contenders:
        failure = prepare(ring, name, PREPARATION)
        if name == "resgrid" and not failure:
            failure = run_once(ring, name, rtol=RTOL, limit=PREPARATION).failure
        runs[name] = [Run(failure=failure)] if failure else []
    for done in range(scale.rounds):
        peers = [run for name, past in runs.items() if name != "resgrid" for run in past if not run.failure]
        fastest = min((run.total for run in peers), default=0.0)
        for name, past in runs.items():
            slow = done >= 1 and name != "resgrid" and past[-1].total > SLOW * fastest
            if not (slow or (past and past[-1].failure)):
                past.append(run_once(ring, name, rtol=RTOL, limit=scale.limit))
    return runs


def ratio_rows(problem: str, runs: Mapping[str, list[Run]]) -> list[Row]:
    """Return the times of all contenders divided by the time of resgrid in the same round."""
    own = runs["resgrid"]
    rows = [_contender_row(problem, name, past, own) for name, past in runs.items()]
    return sorted(rows, key=lambda row: np.inf if row.value is None else row.value.median)


def _contender_row(problem: str, name: str, past: list[Run], own: list[Run]) -> Row:
    title = PEERS[name].title if name in PEERS else name
    failure = next((run.failure for run in past if run.failure), "" if past else "no run")
    if failure:
        return Row(problem, None, None, RATIO, title, failure)
    seconds = spread([run.total for run in past])
    both = [(run, ours) for run, ours in zip(past, own, strict=False) if not ours.failure]
    value = spread([run.total / ours.total for run, ours in both]) if both else None
    return Row(problem, seconds.median, value, RATIO, title, _remarks(past))


def _remarks(past: list[Run]) -> str:
    worst = max(run.residual for run in past)
    parts = [past[-1].method] if past[-1].method else []
    parts += [f"{past[-1].iterations} iterations"] if past[-1].iterations is not None else []
    parts += [] if worst <= MET * RTOL else [f"residual {worst:.1e} only"]
    return ", ".join([*parts, f"{len(past)} runs"])


def best_peer(rows: Sequence[Row]) -> Row | None:
    """Return the fastest peer that reached the residual."""
    able = [row for row in rows if row.unit == RATIO and row.contender != "resgrid" and row.value]
    able = [row for row in able if "residual" not in row.note]
    return min(able, key=lambda row: row.value.median if row.value else np.inf, default=None)


def product_seconds(system: Equations, rounds: int) -> float:
    """Return the median time of one matrix-vector product in double precision on one thread, in seconds."""
    x = np.random.default_rng(0).random(len(system.rhs))
    ten = repeated(lambda: system.matrix @ x)
    ten()
    return spread([timed(ten) / 10 for _ in range(max(rounds, 3))]).median


def work_rows(problem: str, own: list[Run], product: float) -> list[Row]:
    """Return resgrid's solve phase in products, its iterations, and its setup time divided by its solve time."""
    if not own or own[-1].failure:
        return []
    solve = spread([run.work for run in own])
    work = spread([run.work / product for run in own])
    rows = [Row(f"{problem}: solve phase", solve.median, work, "products", note=own[-1].method)]
    if own[-1].iterations is not None:
        count = float(own[-1].iterations)
        rows.append(Row(f"{problem}: iterations", None, Spread(count, count, count), "iterations"))
    setup = spread([_setup(run) for run in own])
    share = spread([_setup(run) / run.work for run in own])
    rows.append(Row(f"{problem}: setup", setup.median, share, "x solve phase", note=_stages(own)))
    return rows


def _setup(run: Run) -> float:
    return run.seconds.get("setup", run.seconds.get("factor", np.nan))


def _stages(own: list[Run]) -> str:
    names = own[-1].seconds
    return ", ".join(f"{name} {np.median([run.seconds[name] for run in own]):.3g}" for name in names) + " s"
