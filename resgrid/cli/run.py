"""``resgrid run``: the main job, from a scene or a map to a folder of paths, pictures and checked decks."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.check import agreement_data, agreement_lines, check_unasked
from resgrid.cli.compile import dialect_option, write_deck
from resgrid.cli.failures import NEGATIVE, NOT_VERIFIED
from resgrid.cli.folder import SUMMARY, whole_folder
from resgrid.cli.heeded import tell_unheeded
from resgrid.cli.job import Chip, Job, is_ideal, open_job, size_of, solution_summary, solve_chip
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.output import json_text
from resgrid.cli.paths import Plan, plan_routes, route_data, route_line, unit_of
from resgrid.cli.pictures import draw_all
from resgrid.cli.report import Report
from resgrid.cli.route_files import write_routes
from resgrid.cli.solve import write_field
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.spice.check.comparison import Agreement


@click.command("run", short_help="Do it all: paths, pictures, and decks checked in SPICE.")
@with_scene()
@output_option("Folder for the results.  [default: out/SCENE]", metavar="DIR")
@click.option(
    "--check/--no-check", "wanted", default=None, help="Simulate the decks, however long it takes; or do not."
)
@dialect_option
@with_report
def command(choice: SceneChoice, output: str | None, wanted: bool | None, dialect: str, report: Report) -> int:
    """Take SCENE the whole way: compile, solve, follow the current, draw, write decks and have them simulated.

    Everything goes into one folder, which is there when the work is done and not before; a folder that exists keeps
    its other files. Decks that ngspice would need more than half a minute for are simulated with --check only. Exits
    with 1 if a start has no path or the simulator disagrees.
    """
    if output == "-":
        raise InputError("-o -: the results are many files; name a folder")
    folder = Path(output or Path("out") / _stem(choice.source))
    with whole_folder(folder) as made:
        job = open_job(choice, report)
        told = tell_unheeded(job, "grid", report)
        plan = plan_routes(job, report)
        circuits = {name: _real(job, chip, report) for name, chip in plan.chips.items()}
        files = _write_all(made, job, plan, circuits, dialect, report)
        checks = {
            name: check_unasked(made / f"{name}.cir", chip.netlist, wanted, folder, report)
            for name, chip in circuits.items()
        }
        data = _summary(job, plan, circuits, files, checks) | told
        (made / SUMMARY).write_text(json_text(data) + "\n", encoding="utf-8")
    report.finish({"folder": folder, **data}, _lines(job, plan, folder, files, checks))
    verdicts = [check.agrees for check in checks.values() if not isinstance(check, str)]
    if not plan.complete or False in verdicts:
        return NEGATIVE
    return NOT_VERIFIED if wanted and None in verdicts else 0


def _stem(source: str) -> str:
    name = "scene" if source == "-" else Path(source).stem
    return re.sub(r"[^\w.-]+", "_", name).strip(".") or "scene"


def _real(job: Job, chip: Chip, report: Report) -> Chip:
    """The chip that the scene describes, of which decks are written, in the place of its ideal grid."""
    return chip if is_ideal(job) else solve_chip(job, report, chip.boundary, chip.start)


def _write_all(
    made: Path, job: Job, plan: Plan, circuits: Mapping[str, Chip], dialect: str, report: Report
) -> dict[str, str]:
    """Write everything but the summary; what each file is, by its name."""
    files: dict[str, str] = {}
    with report.stage("draw the pictures"):
        files |= draw_all(made, job, plan)
    if plan.routes:
        write_routes(str(made / "paths.csv"), plan.routes, job)
        write_routes(str(made / "paths.json"), plan.routes, job)
        files |= {"paths.csv": "points of the paths, world coordinates", "paths.json": "the paths with all figures"}
    for name, chip in circuits.items():
        deck = write_deck(made / f"{name}.cir", job, chip, dialect, report)
        files[deck.path.name] = f"the {name.replace('_', ' ')} chip as a SPICE deck"
        files[deck.sidecar.name] = "its nodes, cells and expected voltages"
        files[deck.commands.name] = "commands for the simulator"
        if deck.companion is not None:
            files[deck.companion.name] = "makes ngspice print PASS or FAIL"
        write_field(made / f"{name}.npz", plan.chips[name].point)
        whose = "its" if is_ideal(job) else "its ideal grid's"
        files[f"{name}.npz"] = f"{whose} potential, log_drop and cells as arrays"
    files[SUMMARY] = "this summary as JSON"
    return files


def _summary(
    job: Job, plan: Plan, circuits: Mapping[str, Chip], files: Mapping[str, str], checks: Mapping[str, Agreement | str]
) -> dict[str, Any]:
    chips = []
    for name, chip in circuits.items():
        check = checks[name]
        verdict = {"agrees": None, "reason": check} if isinstance(check, str) else agreement_data(check)
        chips.append({**solution_summary(chip, job.space), "deck": f"{name}.cir", "check": verdict})
    return {
        "title": job.scene.title,
        "scene": job.scene.source,
        "shape": job.space.shape,
        "chips": chips,
        "paths": [route_data(route, points=False) for route in plan.routes],
        "files": dict(files),
    }


def _lines(
    job: Job, plan: Plan, folder: Path, files: Mapping[str, str], checks: Mapping[str, Agreement | str]
) -> Iterator[str]:
    space = job.space
    goals = "1 goal" if space.goal_count == 1 else f"{space.goal_count} goals"
    yield f"{job.scene.title or job.scene.source}: {size_of(space.shape)} cells, {goals}"
    yield "paths"
    if not plan.routes:
        yield "  none: the scene has no start; add one with --start X,Y"
    for route in plan.routes:
        yield f"  {route_line(route, unit_of(space))}"
    yield "decks"
    for name, check in checks.items():
        lines = [check] if isinstance(check, str) else agreement_lines(check)
        yield from (f"  {name}.cir: {line}" if not line.startswith(" ") else f"  {line}" for line in lines)
    yield f"files in {folder}"
    width = max(map(len, files))
    yield from (f"  {name:{width}}  {what}" for name, what in files.items())
