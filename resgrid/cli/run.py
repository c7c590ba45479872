"""``resgrid run``: write paths, pictures and checked decks of a scene or a map to a folder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid._internal.files import SUMMARY, whole_folder
from resgrid.cli.arms import check_routes, collides, timed_by_robot, verdict_data, verdict_lines, write_trajectories
from resgrid.cli.check import agreement_data, agreement_lines, check_written
from resgrid.cli.compile import write_deck
from resgrid.cli.options import CommandInput, dialect_option, folder_of, output_option, subcommand, with_source
from resgrid.cli.paths import Plan, plan_routes, route_lines
from resgrid.cli.plot import draw_all
from resgrid.cli.scenes import Job, is_first_run, open_job, report_ignored, size_of, solution_summary
from resgrid.cli.terminal import NEGATIVE, NOT_VERIFIED, counted, finish, stage

if TYPE_CHECKING:
    from resgrid.spice.check.agreement import Agreement

    Circuits = Mapping[str, rg.OperatingPoint]
    Checks = Mapping[str, Agreement | str]


@subcommand(
    "run",
    examples=(
        "resgrid run rooms.toml",
        "resgrid run map.yaml --goal 5,0 --start=-5,-4 --robot-radius 0.3 -o out/mine",
    ),
)
@with_source()
@output_option("Folder for the results.  [default: out/SCENE]", of_folder=True)
@click.option(
    "--check/--no-check", "asked", default=None,
    help="Simulate the decks in SPICE, or not.  [default: decks that take less than half a minute]",
)  # fmt: skip
@dialect_option()
def command(source: CommandInput, output: str | None, asked: bool | None, dialect: str) -> int:
    """Compile and solve SCENE, compute its paths, draw pictures, write SPICE decks and simulate them.

    All results go to one folder, which is created after all results are complete; an existing folder keeps its other
    files. Paths of a robot from a URDF file are shortened, timed within its velocity limits and tested for collisions.
    Exits with 1 if a start has no path, a path collides, or the simulator disagrees.
    """
    from resgrid.io.paths import check_routes_file
    from resgrid.io.tables import json_text

    folder = folder_of(output, source)
    with whole_folder(folder) as work, _compile_last_kernels():
        job = open_job(source)
        if job.scene.starts:
            check_routes_file("paths.csv", job.space, timed=job.scene.robot.workspace_ndim == 3)
        ignored = report_ignored(job, "grid")
        plan = plan_routes(job)
        plan = replace(plan, routes=check_routes(job, timed_by_robot(job, plan.routes)))
        circuits = {name: _described(job, op) for name, op in plan.operating_points.items()}
        files = _write_all(work, job, plan, circuits, dialect)
        checks = {name: check_written(work / f"{name}.cir", op.netlist, asked, folder) for name, op in circuits.items()}
        data = _summary(job, plan, circuits, files, checks) | ignored
        (work / SUMMARY).write_text(json_text(data) + "\n", encoding="utf-8")
    finish({"folder": folder, **data}, _lines(job, plan, folder, files, checks))
    verdicts = [check.agrees for check in checks.values() if not isinstance(check, str)]
    if not plan.complete or False in verdicts or collides(plan.routes):
        return NEGATIVE
    return NOT_VERIFIED if asked and None in verdicts else 0


@contextmanager
def _compile_last_kernels() -> Iterator[None]:
    """Compile the kernels of the last stages of ``resgrid run``, streamlines and clearances, in a second process.

    The second process runs during the ``with`` block.  The function has no effect if the kernels are cached, or on a
    computer with a single core.
    """
    if not is_first_run() or (os.cpu_count() or 1) < 2:
        yield
        return
    words = [sys.executable, "-Pc", "from resgrid.cli.kernel_warmup import compile_last_stages; compile_last_stages()"]
    none = subprocess.DEVNULL
    with subprocess.Popen(words, stdin=none, stdout=none, stderr=none) as process:
        try:
            yield
        finally:
            process.kill()  # this process has compiled all other kernels itself


def _described(job: Job, op: rg.OperatingPoint) -> rg.OperatingPoint:
    """Return the operating point of the circuit that a deck describes: the chip with its imperfections.

    `op`: operating point of the ideal grid, returned unchanged if the chip has no imperfections.
    """
    found = op.netlist.space_map
    return op if job.is_ideal or found is None else job.solve(found.wiring)


def _write_all(
    work: Path, job: Job, plan: Plan, circuits: Mapping[str, rg.OperatingPoint], dialect: str
) -> dict[str, str]:
    """Write all files except the summary into the folder `work`; return descriptions by file name.

    `circuits`: operating points by the circuit's name (the boundary, or ``neumann_start_N`` if start N drives it), each
    for one deck; `dialect`: SPICE dialect of the decks.
    """
    from resgrid.io.paths import write_routes

    files: dict[str, str] = {}
    with stage("draw the pictures"):
        files |= draw_all(work, job, plan)
    if plan.routes:
        write_routes(plan.routes, work / "paths.csv")
        write_routes(plan.routes, work / "paths.json")
        files |= {"paths.csv": "points of the paths, world coordinates", "paths.json": "the paths with all figures"}
    files |= write_trajectories(work, plan.routes)
    if _has_message(job, plan):
        write_routes(plan.routes, work / "paths.yaml")
        files["paths.yaml"] = "the paths that reach a goal as nav_msgs/Path, for ROS"
    for name, op in circuits.items():
        deck = write_deck(work / f"{name}.cir", job, name, op, dialect)
        files[deck.path.name] = f"the {name.replace('_', ' ')} chip as a SPICE deck"
        files[deck.sidecar.name] = "its nodes, cells and expected voltages"
        files[deck.commands.name] = "commands for the simulator"
        if deck.companion is not None:
            files[deck.companion.name] = "self-check deck: ngspice prints PASS or FAIL"
        rg.save(plan.operating_points[name], work / f"{name}.npz")
        whose = "its" if job.is_ideal else "its ideal grid's"
        files[f"{name}.npz"] = f"{whose} potential, log_drop and cells as arrays"
    files[SUMMARY] = "this summary as JSON"
    return files


def _has_message(job: Job, plan: Plan) -> bool:
    """Return whether a path on a ROS map reaches a goal and can be written as a ``nav_msgs/Path`` message."""
    from resgrid.io.ros_paths import has_poses
    from resgrid.scene.maps.formats import format_of

    table = None if job.scene.map is None else job.scene.map.table
    is_ros = table is not None and format_of(Path(table["file"]), table) == "ros"
    return is_ros and has_poses(job.space) and any(route.reached for route in plan.routes)


def _summary(
    job: Job,
    plan: Plan,
    circuits: Mapping[str, rg.OperatingPoint],
    files: Mapping[str, str],
    checks: Mapping[str, Agreement | str],
) -> dict[str, Any]:
    from resgrid.io.paths import route_record

    chips = []
    for name, op in circuits.items():
        check = checks[name]
        verdict = {"agrees": None, "reason": check} if isinstance(check, str) else agreement_data(check)
        chips.append({**solution_summary(name, op, job.space), "deck": f"{name}.cir", "check": verdict})
    return {
        "title": job.scene.title,
        "scene": job.scene.source,
        "shape": job.space.shape,
        **verdict_data(job),
        "chips": chips,
        "paths": [route_record(route, points=False) for route in plan.routes],
        "files": dict(files),
    }


def _lines(job: Job, plan: Plan, folder: Path, files: Mapping[str, str], checks: Checks) -> Iterator[str]:
    from resgrid.scene.sampling import with_coordinates

    space = job.space
    yield f"{job.scene.title or job.scene.source}: {size_of(space.shape)} cells, {counted(space.goal_count, 'goal')}"
    yield from (f"  {line}" for line in verdict_lines(verdict_data(job)))
    yield "paths"
    if not plan.routes:
        yield f"  none: the scene has no start; add one with {with_coordinates('--start', space.ndim)}"
    yield from (f"  {line}" for line in route_lines(plan.routes))
    yield "decks"
    for name, check in checks.items():
        lines = [check] if isinstance(check, str) else agreement_lines(check)
        yield from (f"  {name}.cir: {line}" if not line.startswith(" ") else f"  {line}" for line in lines)
    yield f"files in {folder}"
    width = max(map(len, files))
    yield from (f"  {name:{width}}  {description}" for name, description in files.items())
