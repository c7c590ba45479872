"""``resgrid path``: the way from every start to a goal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

import resgrid as rg
from resgrid.cli.options import NUMBERS, POSITIVE, Amount, CommandInput, output_option, verb, with_method, with_source
from resgrid.cli.paths import answer_queries, plan_routes, route_lines
from resgrid.cli.scenes import open_job, place_of, report_ignored, require_starts
from resgrid.cli.terminal import NEGATIVE, finish, say
from resgrid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from resgrid.io.paths import Route
    from resgrid.planning.streamline import AnyPath


@verb(
    "path",
    examples=(
        "resgrid path map.yaml --goal 5,0 --start=-5,-4 -o path.yaml",
        "resgrid path rooms.toml --k 0,0.9,1 --shorten --speed 1 --acceleration 2 -o paths.csv",
        "resgrid path arena.map --queries arena.map.scen --limit 10 --json",
    ),
)
@with_source()
@output_option("Write the paths to FILE.csv, .json, .npz, or .yaml (for ROS); - prints CSV.")
@click.option("--queries", metavar="FILE", type=click.Path(), help="Starts and goals from a MovingAI .scen file.")
@click.option("--limit", metavar="N", type=click.IntRange(min=1), help="Only the first N queries.")
@click.option("--shorten", is_flag=True, help="Straighten paths by lines that meet free cells only.")
@click.option(
    "--keep-clearance",
    metavar="C",
    type=Amount(0),
    help="Distance that these lines keep.  [default: half of the path's, at least a quarter of a cell]",
)
@click.option(
    "--speed",
    metavar="V,...",
    type=NUMBERS,
    default=(),
    help="Time the paths: greatest speed (of an arm, of every joint), or one number for each coordinate.",
)
@click.option("--acceleration", metavar="A,...", type=NUMBERS, default=(), help="Greatest acceleration, likewise.")
@with_method
@click.option("--rate", metavar="HZ", type=POSITIVE, help="Write a timed path so often a second.")
def command(
    source: CommandInput, output: str | None, queries: str | None, limit: int | None, shorten: bool,
    keep_clearance: float | None, speed: tuple[float, ...], acceleration: tuple[float, ...], rate: float | None,
    method: str, ranks: int | None, launcher: str | None,
) -> int:  # fmt: skip
    """Follow the current from every start of SCENE to a goal, for every k; every path is certified.

    Paths are written in coordinates that are continuous across periodic seams; timed ones have columns for times and
    rates. The figures are those of the path that is written. A start without a path has its outcome in the file, and no
    message for ROS. Exits with 1 if some start has no path.
    """
    from resgrid.io.paths import check_routes_file, route_record

    if acceleration and not speed:
        raise InputError("--acceleration times a path only together with --speed")
    if rate is not None and not speed:
        raise InputError("--rate samples a timed path: give --speed too")
    if keep_clearance is not None and not shorten:
        raise InputError("--keep-clearance is for shortcuts: give --shorten too")
    if limit is not None and queries is None:
        raise InputError("--limit counts queries: give --queries too")
    if output is not None and queries is None:
        check_routes_file(output)
    job = open_job(source, require_goal=queries is None, method=method, ranks=ranks, launcher=launcher)
    ignored = report_ignored(job, "grid")
    if queries is not None:
        if shorten or speed:
            raise InputError("--queries answers with lengths alone: leave out --shorten and --speed")
        return answer_queries(job, queries, limit, output, ignored)
    require_starts(job.scene)
    _check_limits("--speed", speed, job.space)
    _check_limits("--acceleration", acceleration, job.space)
    if output is not None:
        check_routes_file(output, job.space, timed=bool(speed))
    plan = plan_routes(job)
    routes = plan.routes
    if shorten:
        routes = [_shortened(route, keep_clearance) for route in routes]
    if speed:
        routes = [_timed(route, speed, acceleration, rate) for route in routes]
    written = output is not None and _write(routes, output)
    data = {"scene": job.scene.title, "paths": [route_record(route) for route in routes], **ignored}
    finish(data, route_lines(routes), written=output if written else None)
    return 0 if plan.complete else NEGATIVE


def _write(routes: Sequence[Route], output: str) -> bool:
    """Write routes; for ROS only those that reach a goal, and no file where none does."""
    from resgrid.io.paths import write_routes

    if Path(output).suffix.lower() == ".yaml":
        missing = [f"{place_of(route.start)}, k = {route.k:g}" for route in routes if not route.reached]
        if len(missing) == len(routes):
            old = "; the file of this name is an older one" if Path(output).exists() else ""
            say(f"{output} is not written, for no path reaches a goal{old}")
            return False
        if missing:
            say(f"{output} has no path from start {', start '.join(missing)}")
    write_routes(routes, output)
    return True


def _check_limits(option: str, limits: tuple[float, ...], space: rg.ConfigurationSpace) -> None:
    """Refuse limits that are not one for the robot, or one for each coordinate."""
    if len(limits) not in (0, 1, space.ndim):
        names = ", ".join(axis.name for axis in space.axes)
        raise InputError(f"{option}: {len(limits)} numbers for {names}; give one, or one for each with commas")
    if not all(limit > 0 for limit in limits):
        text = ",".join(f"{limit:g}" for limit in limits)
        raise InputError(f"{option} {text}: a limit is positive and finite")


def _shortened(route: Route, clearance: float | None) -> Route:
    assert route.streamline is not None
    return replace(route, path=rg.shortcut(route.streamline, clearance=clearance)) if route.reached else route


def _timed(route: Route, speed: tuple[float, ...], acceleration: tuple[float, ...], rate: float | None) -> Route:
    """A route with its times, at `rate` samples a second if that is given."""
    velocity, change = (limits[0] if len(limits) == 1 else limits for limits in (speed, acceleration))
    motion = rg.time_parameterize(
        cast("AnyPath", route.path), velocity_limits=velocity, acceleration_limits=change or None
    )
    whole = replace(route, path=motion)
    if rate is None:
        return whole
    sampled = replace(route, path=motion.resampled(rate))
    if sampled.clearance == 0.0 != whole.clearance and route.reached:
        place = f"start {place_of(route.start)}, k = {route.k:g}"
        say(f"{place}: straight lines between samples at --rate {rate:g} meet an obstacle; give a higher rate")
    return sampled
