"""Benchmark queries: each has a goal of its own, hence a chip of its own."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any

from resgrid.cli.failures import NEGATIVE
from resgrid.cli.report import finish, quietly, stage
from resgrid.cli.scenes import Job, size_of
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.scene import Query


def answer_queries(job: Job, file: str, limit: int | None, output: str | None, unheeded: dict[str, list[str]]) -> int:
    """Answer the queries of a MovingAI scenario file on one map."""
    from resgrid.io.tables import suffix_of, write
    from resgrid.scene import read_queries

    if output is not None:
        suffix_of(output, ("record",), "answers to queries")
    queries = list(islice(read_queries(file), limit))
    answers = []
    with stage(f"answer {len(queries)} queries", steps=len(queries)) as progress:
        for query in queries:
            with quietly():
                answers.extend(_answers(job, query, file))
            progress.advance()
    data = {"scene": job.scene.title, "queries": file, "paths": answers, **unheeded}
    if output is not None:
        write(output, {"record": lambda: data}, "answers to queries")
    reached = sum(answer["outcome"] == "reached" for answer in answers)
    finish(data, [f"{reached} of {len(answers)} paths reach their goal"], written=output)
    return 0 if reached == len(answers) else NEGATIVE


def _answers(job: Job, query: Query, file: str) -> list[dict[str, Any]]:
    """What becomes of a query, for each k."""
    from resgrid.planning.certify import certify
    from resgrid.planning.trace import streamline
    from resgrid.space import Cell

    if job.space.shape != (query.width, query.height):
        own = size_of(job.space.shape)
        raise InputError(f"{file}: these queries are for a map of {query.width} x {query.height} cells, this has {own}")
    common = {"start": query.start, "goal_cell": query.goal, "optimal_length": query.optimal_length}
    if job.space.cell[query.goal] == Cell.OBSTACLE:
        return [{"outcome": "goal_blocked", "k": None, "length": None, **common}]
    cell = job.space.cell.copy()
    cell[cell == Cell.GOAL] = Cell.FREE
    cell[query.goal] = Cell.GOAL
    answers = []
    for field in Job(job.scene, job.space.with_cells(cell)).solution().fields:
        path = streamline(field, cell=query.start)
        certify(path)
        figures = {"outcome": str(path.outcome), "k": field.k, "length": path.length, "clearance": path.clearance}
        answers.append({**figures, **common})
    return answers
