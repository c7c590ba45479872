"""Functions of subcommands for arms: counts of proven cells (in space only), and timed, collision-tested paths.

An arm is a robot with a fixed base, in the plane or in space.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import resgrid as rg
from resgrid.cli.terminal import say, stage
from resgrid.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from resgrid.cli.scenes import Job
    from resgrid.io.paths import Route
    from resgrid.planning.any_path import AnyPath

CHECK_STEP = 0.002
"""Largest motion of any point of the robot between two configurations that are tested for collisions, in metres."""

CLEARANCE_STEP = 0.01
"""Largest motion of any point of the robot between two configurations whose clearance is computed, in metres."""


def verdict_data(job: Job) -> dict[str, Any]:
    """Return the numbers of free, colliding and undecided cells of an arm in space as a dictionary for JSON.

    An undecided cell is proven neither free nor colliding. The dictionary is empty for robots that are not from a URDF
    file. Otherwise its only key ``verdicts`` holds a dictionary with the keys ``proven``, ``free_cells``,
    ``collision_cells`` and ``undecided_cells``. With the sampling ``"centre"`` nothing is proven: ``proven`` is false,
    no cell is undecided, and a cell is free if the configuration at its centre is.
    """
    if job.scene.robot.workspace_ndim != 3:
        return {}
    obstacle = int((job.space.cell == rg.Cell.OBSTACLE).sum())
    undecided = 0 if job.space.undecided is None else int(job.space.undecided.sum())
    return {
        "verdicts": {
            "proven": job.space.undecided is not None,
            "free_cells": job.space.cell.size - obstacle,
            "collision_cells": obstacle - undecided,
            "undecided_cells": undecided,
        }
    }


def verdict_lines(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines of text on the numbers of free, colliding and undecided cells; no line without these numbers.

    `data`: dictionary that contains the keys of `verdict_data`, and may contain others.
    """
    verdicts = data.get("verdicts")
    if verdicts is None:
        return
    counts = [verdicts[f"{kind}_cells"] for kind in ("free", "collision", "undecided")]
    free, collision, undecided = (f"{count:,} ({100 * count / sum(counts):.1f} %)" for count in counts)
    if verdicts["proven"]:
        yield f"proven free   {free}: no configuration in them collides"
        yield f"collision     {collision}: a configuration in them collides"
        yield f"undecided     {undecided}: neither is proven; treated as obstacles"
    else:
        yield f"unproven      sampling = 'centre' tests only the centres of cells: {free} free, {collision} collide"
        yield "              a path through free cells can collide; sampling = 'conservative' proves cells"


def check_route(job: Job, route: Route) -> Route:
    """Return a route of an arm with its clearance in metres, and for an arm in space with its first collision.

    A route is the path of one start at one weight k; its clearance is the smallest distance of the robot from obstacles
    along the path: 0 for a path with a collision, infinite without obstacles. Routes that reach no goal are returned
    unchanged, and so are routes of robots without a fixed base, whose clearance in configuration space is already a
    length.
    """
    scene = job.scene
    if scene.robot.base is None or not route.reached:
        return route
    obstacles = [*scene.obstacles, *([] if scene.map is None else [scene.map.obstacles])]
    clearance = rg.planning.workspace_clearance(route.path, obstacles, step=CLEARANCE_STEP)
    if scene.robot.workspace_ndim != 3:
        return replace(route, workspace_clearance=clearance)
    hit = rg.check_collisions(route.path, obstacles, step=CHECK_STEP)
    return replace(route, workspace_clearance=0.0 if hit else clearance, collision=hit, is_tested=True)


def check_routes(job: Job, routes: list[Route]) -> list[Route]:
    """Return routes of an arm with their clearances in metres, and for an arm in space with their first collisions.

    A route is the path of one start at one weight k; its clearance is the smallest distance of the robot from obstacles
    along the path. Routes that reach no goal and routes of robots without a fixed base are returned unchanged.
    """
    if job.scene.robot.base is None:
        return routes
    checked = []
    with stage("test the paths in the workspace", steps=len(routes)) as progress:
        for route in routes:
            checked.append(check_route(job, route))
            progress.advance()
    return checked


def timed_by_robot(job: Job, routes: list[Route]) -> list[Route]:
    """Return routes, shortened and timed within the velocity limits of the scene's robot.

    A route is the path of one start at one weight k. Routes that reach no goal, and all routes of a robot whose
    description has no velocity limits, are returned unchanged. If a joint that moves has no limit, a message is
    printed, and the routes are shortened but get no times.
    """
    if job.scene.robot.velocity_limits is None:
        return routes
    short = [
        replace(route, path=rg.shortcut(route.streamline)) if route.reached and route.streamline else route
        for route in routes
    ]
    try:
        return [
            replace(route, path=rg.time_parameterize(cast("AnyPath", route.path))) if route.reached else route
            for route in short
        ]
    except InputError as error:
        say(f"the paths have no times: {error}")
        return short


def write_trajectories(folder: Path, routes: list[Route]) -> dict[str, str]:
    """Write every timed route that reaches a goal to a YAML, a CSV and a JSON file in `folder`.

    A route is the path of one start at one weight k. The files are named ``trajectory``, or ``trajectory_N`` with the
    index N of the route if there are several routes. Returns the descriptions of the files by file name.
    """
    from resgrid.planning.time_parameterization import Trajectory

    files = {}
    for number, route in enumerate(routes):
        if not isinstance(route.path, Trajectory) or not route.reached:
            continue
        name = "trajectory" if len(routes) == 1 else f"trajectory_{number}"
        for suffix, kind in (
            ("yaml", "as trajectory_msgs/JointTrajectory, for ROS 2"),
            ("csv", "as a table"),
            ("json", "as JSON"),
        ):
            rg.save(route.path, folder / f"{name}.{suffix}")
            files[f"{name}.{suffix}"] = f"the timed path{'' if len(routes) == 1 else f' {number}'} {kind}"
    return files


def collides(routes: list[Route]) -> bool:
    """Return whether a collision was found on any of the routes (paths); none is found on an untested route."""
    return any(route.collision is not None for route in routes)
