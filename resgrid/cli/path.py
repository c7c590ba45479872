"""``resgrid path``: the way from every start to a goal."""

from __future__ import annotations

import click

from resgrid.cli.failures import NEGATIVE
from resgrid.cli.heeded import tell_unheeded
from resgrid.cli.job import open_job
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.paths import plan_routes, require_starts, route_data, route_line, unit_of
from resgrid.cli.report import Report
from resgrid.cli.route_files import Motion, check_motion, check_target, refine, write_routes
from resgrid.errors import InputError


@click.command("path", short_help="Follow the current from starts to a goal.")
@with_scene()
@output_option("Write the paths to FILE.csv, .json, .npz, or .yaml (for ROS); - prints CSV.")
@click.option("--queries", metavar="FILE", type=click.Path(), help="Starts and goals from a MovingAI .scen file.")
@click.option("--limit", metavar="N", type=click.IntRange(min=1), help="Only the first N queries.")
@click.option("--shorten", is_flag=True, help="Straighten paths by lines that meet free cells only.")
@click.option("--keep-clearance", metavar="C", type=float, default=0.0, help="Distance that these lines keep.")
@click.option(
    "--speed", metavar="V,...",
    help="Time the paths: greatest speed (of an arm, of every joint), or one number for each coordinate.",
)  # fmt: skip
@click.option("--acceleration", metavar="A,...", help="Greatest acceleration, likewise.")
@click.option("--rate", metavar="HZ", type=float, help="Write a timed path so often a second.")
@with_report
def command(
    choice: SceneChoice,
    output: str | None,
    queries: str | None,
    limit: int | None,
    shorten: bool,
    keep_clearance: float,
    speed: str | None,
    acceleration: str | None,
    rate: float | None,
    report: Report,
) -> int:
    """Follow the current from every start of SCENE to a goal, for every k; every path is certified.

    A path that is shortened or timed is written in coordinates that are continuous across periodic seams, with columns
    for its times and rates. Exits with 1 if some start has no path.
    """
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; choose one")
    motion = Motion(shorten, keep_clearance, _limits("--speed", speed), _limits("--acceleration", acceleration), rate)
    if output is not None and queries is None:
        check_target(output)
    job = open_job(choice, report, require_goal=queries is None)
    told = tell_unheeded(job, "grid", report)
    if queries is not None:
        if motion.shorten or motion.speed:
            raise InputError("--queries answers with lengths alone: leave out --shorten and --speed")
        from resgrid.cli.queries import answer_queries

        return answer_queries(job, queries, limit, output, report, told)
    require_starts(job)
    check_motion(motion, job, output)
    plan = refine(plan_routes(job, report), motion)
    if output is not None:
        write_routes(output, plan.routes, job)
        if output != "-":
            report.say(f"wrote {output}")
    if output != "-":
        unit = unit_of(job.space)
        data = {"scene": job.scene.title, "paths": [route_data(route) for route in plan.routes], **told}
        report.finish(data, [route_line(route, unit) for route in plan.routes], written=output is not None)
    return 0 if plan.complete else NEGATIVE


def _limits(option: str, text: str | None) -> tuple[float, ...]:
    try:
        return () if text is None else tuple(float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"{option} {text!r}: expected a number, or one for each axis with commas") from None
