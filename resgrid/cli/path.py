"""``resgrid path``: compute the path from every start to a goal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

import resgrid as rg
from resgrid.cli.arms import check_routes, collides
from resgrid.cli.legs import answer_legs
from resgrid.cli.option_types import NumberRange
from resgrid.cli.options import (
    NUMBERS,
    POSITIVE,
    CommandInput,
    given_options,
    output_option,
    refuse_unused,
    subcommand,
    with_method,
    with_source,
)
from resgrid.cli.paths import answer_queries, plan_routes, route_lines
from resgrid.cli.scenes import open_job, place_of, report_ignored, require_starts
from resgrid.cli.terminal import NEGATIVE, finish, say
from resgrid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from resgrid.cli.scenes import Job
    from resgrid.io.paths import Route
    from resgrid.planning.any_path import AnyPath


@subcommand(
    "path",
    examples=(
        "resgrid path map.yaml --goal 5,0 --start=-5,-4 -o path.yaml",
        "resgrid path rooms.toml --k 0,0.9,1 --shorten --speed 1 --acceleration 2 -o paths.csv",
        "resgrid path arena.map --queries arena.map.scen --limit 10 --json",
    ),
)
@with_source()
@output_option("Paths: FILE.csv, .json, .npz, or .yaml (for ROS); - prints CSV.")
@click.option("--queries", metavar="FILE", type=click.Path(), help="Starts and goals from a MovingAI .scen file.")
@click.option("--limit", metavar="N", type=click.IntRange(min=1), help="Use only the first N queries.")
@click.option("--shorten", is_flag=True, help="Shorten paths by straight lines through free cells.")
@click.option(
    "--keep-clearance",
    metavar="C",
    type=NumberRange(0),
    help="Clearance of these lines.  [default: half of the path's clearance, at least a quarter of a cell]",
)
@click.option(
    "--speed",
    metavar="V,...",
    type=NUMBERS,
    default=(),
    help="Add times to paths: largest speed (for an arm, of every joint), or one number per coordinate. For a robot "
    "from a URDF file, by default its limits.",
)
@click.option(
    "--acceleration", metavar="A,...", type=NUMBERS, default=(), help="Largest acceleration, in the form of --speed."
)
@click.option(
    "--via",
    metavar="X,Y",
    type=NUMBERS,
    multiple=True,
    help="Intermediate place in world coordinates (with --cells: a cell); repeatable, in this order.",
)
@click.option(
    "--approximate",
    is_flag=True,
    help="Without a path to a goal, end at the nearest reachable place (the exit code remains 1).",
)
@click.option(
    "--escape",
    is_flag=True,
    help="Leave the inflated zone on the shortest straight line, which is marked as not certified.",
)
@with_method
@click.option("--rate", metavar="HZ", type=POSITIVE, help="Sampling rate of timed paths, in hertz.")
@click.option(
    "--fixed-joints", is_flag=True,
    help="Write the joints that robot.at names, too, for controllers of all joints of an arm (.yaml).",
)  # fmt: skip
def command(
    source: CommandInput, output: str | None, queries: str | None, limit: int | None, shorten: bool,
    keep_clearance: float | None, speed: tuple[float, ...], acceleration: tuple[float, ...], rate: float | None,
    via: tuple[tuple[float, ...], ...], approximate: bool, escape: bool,
    method: str, ranks: int | None, launcher: str | None, fixed_joints: bool,
) -> int:  # fmt: skip
    """Compute the path along the current from every start of SCENE to a goal, for every k, with a certificate.

    Coordinates are continuous across the seams of periodic axes; timed paths have columns for time and velocity.
    Length and clearance refer to the path in the file. For a start without a path, files contain its outcome; files for
    ROS omit it. Paths of a robot from a URDF file are tested for collisions, and files for ROS hold its joint
    trajectories. Exits with 1 if a start has no path or a path collides.
    """
    from resgrid.io.paths import check_fixed_joints, check_routes_file, route_record

    if keep_clearance is not None and not shorten:
        raise InputError("--keep-clearance needs a shortened path: add --shorten, or leave it out")
    if limit is not None and queries is None:
        raise InputError("--limit needs queries: add --queries, or leave it out")
    if via or approximate or escape:
        has_times = bool(speed or acceleration) or rate is not None
        is_petsc = method != "auto" or ranks is not None or launcher is not None
        if has_times or shorten or fixed_joints or queries is not None or is_petsc:
            raise InputError(
                "--via, --approximate and --escape give paths of several legs: leave out --shorten, --speed, "
                "--acceleration, --rate, --fixed-joints, --queries, --method, --ranks and --launcher"
            )
        in_cells = bool(click.get_current_context().params["cells"])
        return answer_legs(source, output, via, in_cells=in_cells, approximate=approximate, escape=escape)
    if output is not None and queries is None:
        check_routes_file(output)
    if queries is not None:
        _check_query_options(source)
    job = open_job(source, require_goal=queries is None, method=method, ranks=ranks, launcher=launcher)
    ignored = report_ignored(job, "grid")
    if queries is not None:
        return answer_queries(job, queries, limit, output, ignored)
    timed = _is_timed(job, output, speed, acceleration, rate)
    require_starts(job.scene)
    _check_limits("--speed", speed, job.space)
    _check_limits("--acceleration", acceleration, job.space)
    if output is not None:
        check_routes_file(output, job.space, timed=timed)
    if fixed_joints:
        check_fixed_joints(output, job.space)
    plan = plan_routes(job)
    routes = plan.routes
    if shorten:
        routes = [_shortened(route, keep_clearance) for route in routes]
    _report_speed_masks(job.scene, timed=timed)
    if timed:
        routes = [_timed(route, speed, acceleration, rate, job.scene.mask) for route in routes]
    routes = check_routes(job, routes)
    written = output is not None and _write(routes, output, fixed_joints)
    data = {"scene": job.scene.title, "paths": [route_record(route) for route in routes], **ignored}
    finish(data, route_lines(routes), written=output if written else None)
    return 0 if plan.complete and not collides(routes) else NEGATIVE


def _report_speed_masks(scene: rg.Scene, *, timed: bool) -> None:
    """Print that the speed limits of a scene's masks are ignored, if there are any and the paths get no times.

    `timed`: whether the paths get times (points with times and velocities).
    """
    if not timed and any(mask.kind == "speed" for mask in scene.mask):
        say("ignored: the speed limits of masks, which apply to timed paths; add --speed")


def _check_query_options(source: CommandInput) -> None:
    """Raise InputError for options without effect on the answers to queries, and for goals and starts in `source`."""
    keys = {key.removesuffix("_cell") for key in source.changes}
    names: list[str] = [key for key in ("goal", "start", "goal_tolerance") if key in keys]
    names += given_options("shorten", "speed", "acceleration", "rate", "fixed_joints")
    refuse_unused("--queries only gives lengths of streamlines between the places of the file", names)


def _write(routes: Sequence[Route], output: str, fixed_joints: bool) -> bool:
    """Write routes to a file; return whether the file was written.

    A route is the path of one start at one weight k.  A file for ROS (.yaml) contains only the routes that reach a
    goal, and is not written without such a route.
    """
    from resgrid.io.paths import write_routes

    if Path(output).suffix.lower() == ".yaml":
        missing = [f"{place_of(route.start)}, k = {route.k:g}" for route in routes if not route.reached]
        if len(missing) == len(routes):
            old = "; the file of this name is an older one" if Path(output).exists() else ""
            say(f"{output} is not written, because no path reaches a goal{old}")
            return False
        if missing:
            say(f"{output} has no path from start {', start '.join(missing)}")
    write_routes(routes, output, fixed_joints=fixed_joints)
    return True


def _is_timed(
    job: Job, output: str | None, speed: tuple[float, ...], acceleration: tuple[float, ...], rate: float | None
) -> bool:
    """Return whether paths get times.

    They do with --speed. A robot whose description has velocity limits does not need --speed: its paths also get times
    with --acceleration or --rate, and for an output file of ROS (.yaml). For other robots, --acceleration and --rate
    without --speed raise InputError. `output`: file of the paths; `speed`, `acceleration`, `rate`: values of the
    options, empty or None if they are not given.
    """
    has_limits = job.scene.robot.velocity_limits is not None
    for option, given in (("--acceleration", bool(acceleration)), ("--rate", rate is not None)):
        if given and not speed and not has_limits:
            raise InputError(f"{option} needs a timed path: add --speed, or leave it out")
    is_message = output is not None and Path(output).suffix.lower() == ".yaml"
    return bool(speed) or (has_limits and (is_message or bool(acceleration) or rate is not None))


def _check_limits(option: str, limits: tuple[float, ...], space: rg.ConfigurationSpace) -> None:
    """Raise InputError unless there is one positive limit, or one positive limit per coordinate.

    `option`: name of the option, for the message; `limits`: speeds or accelerations, empty if the option is not given.
    """
    if len(limits) not in (0, 1, space.ndim):
        names = ", ".join(axis.name for axis in space.axes)
        raise InputError(
            f"{option}: got {len(limits)} numbers for {names}; give one number, or one per coordinate, with commas"
        )
    if not all(limit > 0 for limit in limits):
        text = ",".join(f"{limit:g}" for limit in limits)
        raise InputError(f"{option} {text}: a limit must be positive and finite")


def _shortened(route: Route, clearance: float | None) -> Route:
    assert route.streamline is not None
    return replace(route, path=rg.shortcut(route.streamline, clearance=clearance)) if route.reached else route


def _timed(
    route: Route,
    speed: tuple[float, ...],
    acceleration: tuple[float, ...],
    rate: float | None,
    masks: Sequence[rg.Mask],
) -> Route:
    """Return a route (path of one start at one weight k) whose path is replaced by a path with times.

    `speed`, `acceleration`: largest values in axis units per s and s², one for all coordinates or one for each, empty
    for the limits of the robot; `rate`: number of points of the path per second, None for its own points; `masks`:
    masks of the scene, for their speed limits.
    """
    velocity, change = (limits[0] if len(limits) == 1 else limits for limits in (speed, acceleration))
    motion = rg.time_parameterize(
        cast("AnyPath", route.path), velocity_limits=velocity or None, acceleration_limits=change or None, masks=masks
    )
    whole = replace(route, path=motion)
    if rate is None:
        return whole
    sampled = replace(route, path=motion.resampled(rate))
    if sampled.clearance == 0.0 != whole.clearance and route.reached:
        place = f"start {place_of(route.start)}, k = {route.k:g}"
        say(f"{place}: lines between the samples at --rate {rate:g} touch an obstacle; give a higher rate")
    return sampled
