"""``resgrid path``: the way from every start to a goal."""

from __future__ import annotations

import click

from resgrid.cli.failures import NEGATIVE
from resgrid.cli.job import open_job
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.paths import plan_routes, require_starts, route_data, route_line, unit_of, write_routes
from resgrid.cli.report import Report
from resgrid.errors import InputError


@click.command("path", short_help="Follow the current from starts to a goal.")
@with_scene()
@output_option("Write the paths to FILE.csv, .json or .npz; - prints CSV.")
@click.option("--queries", metavar="FILE", type=click.Path(), help="Starts and goals from a MovingAI .scen file.")
@click.option("--limit", metavar="N", type=click.IntRange(min=1), help="Only the first N queries.")
@with_report
def command(choice: SceneChoice, output: str | None, queries: str | None, limit: int | None, report: Report) -> int:
    """Follow the current from every start of SCENE to a goal, for every k; every path is certified.

    Exits with 1 if some start has no path.
    """
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; choose one")
    job = open_job(choice, report, require_goal=queries is None)
    if queries is not None:
        from resgrid.cli.queries import answer_queries

        return answer_queries(job, queries, limit, output, report)
    require_starts(job)
    plan = plan_routes(job, report)
    if output is not None:
        write_routes(output, plan.routes, [axis.name for axis in job.space.axes])
        if output != "-":
            report.say(f"wrote {output}")
    if output != "-":
        unit = unit_of(job.space)
        data = {"scene": job.scene.title, "paths": [route_data(route) for route in plan.routes]}
        report.finish(data, [route_line(route, unit) for route in plan.routes])
    return 0 if plan.complete else NEGATIVE
