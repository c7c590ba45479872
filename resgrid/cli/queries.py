"""Benchmark queries: each has a goal of its own, hence a chip of its own."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any

from resgrid.cli.failures import NEGATIVE
from resgrid.cli.job import Job, size_of, solution_of
from resgrid.cli.output import emit_text, json_text
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.scene import Query


def answer_queries(
    job: Job, file: str, limit: int | None, output: str | None, report: Report, told: dict[str, list[str]]
) -> int:
    """Answer the queries of a MovingAI scenario file on one map."""
    from resgrid.scene import read_queries

    if output not in (None, "-") and not str(output).endswith(".json"):
        raise InputError(f"-o {output}: answers to queries are written as .json")
    queries = list(islice(read_queries(file), limit))
    quiet = Report(quiet=True)
    answers = []
    with report.stage(f"answer {len(queries)} queries", steps=len(queries)) as progress:
        for query in queries:
            answers.extend(_answer(job, query, file, quiet))
            progress.advance()
    data = {"scene": job.scene.title, "queries": file, "paths": answers, **told}
    if output is not None:
        emit_text(output, json_text(data) + "\n")
    reached = sum(answer["outcome"] == "reached" for answer in answers)
    if output != "-":
        report.finish(data, [f"{reached} of {len(answers)} paths reach their goal"])
    return 0 if reached == len(answers) else NEGATIVE


def _answer(job: Job, query: Query, file: str, quiet: Report) -> list[dict[str, Any]]:
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
    posed = Job(job.scene, job.space.with_cells(cell))
    answers = []
    for field in solution_of(posed, quiet).fields:
        path = streamline(field, cell=query.start)
        certify(path)
        figures = {"outcome": str(path.outcome), "k": field.k, "length": path.length, "clearance": path.clearance}
        answers.append({**figures, **common})
    return answers
