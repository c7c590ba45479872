"""``resgrid chip``: a report on the effect of a chip's imperfections on a robot, in one folder."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid._internal.files import SUMMARY, whole_folder
from resgrid.chip import ANALYSES
from resgrid.cli.check import check_written
from resgrid.cli.option_types import NumberRange, Suggested, fraction_below
from resgrid.cli.options import (
    POSITIVE,
    CommandInput,
    dialect_option,
    folder_of,
    output_option,
    subcommand,
    with_source,
)
from resgrid.cli.scenes import Job, open_job, report_ignored
from resgrid.cli.terminal import NEGATIVE, NOT_VERIFIED, compute, finish, stage
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.chip.report import Effort, Section
    from resgrid.chip.study_analyses import Study
    from resgrid.spice.check.agreement import Agreement


class Names(Suggested):
    """Type of an option that consists of names of analyses, separated by commas."""

    def __init__(self) -> None:
        super().__init__("names", *ANALYSES)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Return the named analyses in the order of the report; raise click's BadParameter for unknown names."""
        names = {word.strip() for word in value.split(",") if word.strip()}
        if not names or names - set(ANALYSES):
            self.fail(f"{value!r}: give names out of {', '.join(ANALYSES)}, separated by commas", param, ctx)
        return tuple(name for name in ANALYSES if name in names)


@subcommand(
    "chip",
    examples=(
        "resgrid chip chip.toml -o report",
        "resgrid chip chip.toml --only yield --at-least 0.95 --executor processes",
    ),
)
@with_source()
@output_option("Folder for the report.  [default: out/SCENE_chip]", of_folder=True)
@click.option(
    "--only", metavar="NAMES", type=Names(), default=",".join(ANALYSES), help="Analyses to run, separated by commas."
)
@click.option(
    "--half-width", metavar="W", type=fraction_below(0.5), default=0.01,
    help="Half width of the yield's confidence interval at which trials stop.",
)  # fmt: skip
@click.option("--most", metavar="N", type=click.IntRange(1), default=2000, help="Largest number of simulated chips.")
@click.option(
    "--executor", metavar="NAME", type=Suggested("name", "processes", "dask://", "mpi", "parsl:"),
    help="Workers for the trials: processes[:N], dask://HOST:PORT, mpi or parsl:FILE.",
)  # fmt: skip
@click.option(
    "--sweep", metavar="KEY=V,V,...", multiple=True,
    help="Key of the chip and values to sweep; give it twice, the second for the costly parameter.  [default: the "
    "offset or mismatch, and readout.bits]",
)  # fmt: skip
@click.option("--seconds", metavar="S", type=POSITIVE, default=60.0, help="Time for fault simulation, in seconds.")
@click.option(
    "--at-least", metavar="FRACTION", type=NumberRange(0, 1),
    help="Exit with 1 if the yield's confidence interval lies below this fraction.",
)  # fmt: skip
@click.option(
    "--check/--no-check", "asked", default=None,
    help="Simulate op.cir in SPICE, or not.  [default: only if it takes less than half a minute]",
)  # fmt: skip
@dialect_option()
def command(
    source: CommandInput, output: str | None, only: tuple[str, ...], half_width: float, most: int,
    executor: str | None, sweep: tuple[str, ...], seconds: float, at_least: float | None,
    asked: bool | None, dialect: str,
) -> int:  # fmt: skip
    """Analyse the effect of the imperfections in the [chip] table of SCENE on a robot's paths.

    The folder contains a report with all figures of merit, their units and definitions (report.md, report.html);
    pictures; summary.json; decks for the operating point, a transient, noise and temperatures, with expected results in
    their sidecars; and one line per simulated chip (yield.jsonl, sweep.jsonl). An interrupted run continues from
    the lines that it has written next to the folder.
    """
    from resgrid.chip.decks import described_files
    from resgrid.chip.report import Effort, checkpoints_beside
    from resgrid.chip.report_markdown import report_markdown
    from resgrid.io.tables import html_page, json_text

    folder = folder_of(output, source, "_chip")
    if len(sweep) not in (0, 2):
        raise InputError(f"a sweep has two keys: give --sweep twice, or not at all, instead of {len(sweep)} times")
    for option, given, name in (("--sweep", sweep, "sweep"), ("--at-least", at_least is not None, "yield")):
        if given and name not in only:
            raise InputError(f"{option} needs the analysis {name}: add {name} to --only, or leave {option} out")
    effort = Effort(half_width, most, seconds, tuple(_sweep(text) for text in sweep))
    with rg.open_executor(executor) if executor else nullcontext() as workers, whole_folder(folder) as work:
        job = open_job(source)
        study = _open(job)
        effort = replace(effort, executor=workers, checkpoints=checkpoints_beside(folder, study, effort.sweep))
        ignored = report_ignored(job, "chip")
        sections = [_analyse(name, study, effort, work) for name in only]
        with stage("write the decks"):
            decks = described_files(study.write_decks(work, dialect=dialect), dialect)
        agreement = check_written(work / "op.cir", study.netlist, asked, folder)
        verdict = _verdict("op.cir", agreement)
        lines = {f"{name}.jsonl": path for name, path in effort.checkpoints.items() if name in only and path.exists()}
        files = dict.fromkeys(lines, "one line for every simulated chip") | decks
        data = _summary(study, job, sections, files, verdict) | ignored
        text = report_markdown(study, sections, decks, verdict)
        (work / "report.md").write_text(text, encoding="utf-8")
        (work / "report.html").write_text(html_page(study.title, text), encoding="utf-8")
        (work / SUMMARY).write_text(json_text(data) + "\n", encoding="utf-8")
        for name, path in lines.items():
            path.replace(work / name)
    answers = [f"  {section.name}: {section.text[0]}" for section in sections]
    finish({"folder": folder, **data}, [study.title, *answers, verdict, f"report in {folder / 'report.md'}"])
    high = next((section.data["yield_high"]["value"] for section in sections if section.name == "yield"), 1.0)
    agrees = True if isinstance(agreement, str) else agreement.agrees
    if agrees is False or (at_least is not None and high < at_least):
        return NEGATIVE
    return NOT_VERIFIED if asked and agrees is None else 0


def _sweep(text: str) -> tuple[str, tuple[float | int, ...]]:
    from resgrid.scene.quantities import parse_fraction

    key, equals, words = text.partition("=")
    if not equals or not words.strip():
        raise InputError(f"--sweep {text}: expected KEY=VALUE,VALUE,..., such as readout.bits=8,10,12")
    try:
        values = [parse_fraction(word.strip()) for word in words.split(",")]
    except InputError as error:
        raise InputError(f"--sweep {text}: {error}") from None
    return key.strip(), tuple(int(value) if key.strip().endswith(("bits", "seed")) else value for value in values)


def _open(job: Job) -> Study:
    with stage("build the chip"):
        chip = rg.study(job.scene, space=job.space)
    nodes = chip.netlist.node_count
    compute("solve the chip", lambda: chip.op, seconds=0.5 + 3e-8 * nodes**1.5)
    return chip


def _analyse(name: str, study: Study, effort: Effort, work: Path) -> Section:
    """Run the analysis `name`, write its pictures as PNG files to the folder `work`, and return its report section.

    `study`: the chip to analyse; `effort`: limits of the numbers of trials and of the computing time.
    """
    from resgrid.chip.report import report_section, seconds_needed
    from resgrid.plot.figures import save_figure
    from resgrid.plot.pictures import draw

    with stage(name, seconds=seconds_needed(name, study, effort)) as progress:
        section = report_section(name, study, replace(effort, progress=progress.count))
    for picture in section.pictures:
        save_figure(draw(picture.value, **picture.options), work / f"{picture.name}.png")
    return section


def _verdict(name: str, agreement: Agreement | str) -> str:
    """Return a sentence on the simulation of a deck: its result, or the reason why it was not simulated.

    `name`: name of the deck; `agreement`: comparison with the simulation, or the reason as text.
    """
    from resgrid.chip.figures_of_merit import formatted

    if isinstance(agreement, str):
        return f"{name} was {agreement}."
    if agreement.agrees is None:
        return f"{name} is not verified: {agreement.remark}."
    words = "agrees" if agreement.agrees else "DISAGREES"
    return (
        f"{agreement.simulator} {agreement.version} {words} with {name}'s expected voltages: the largest difference is "
        f"{formatted(agreement.max_abs_error, 'V')}."
    )


def _summary(study: Study, job: Job, sections: list[Section], files: dict[str, str], verdict: str) -> dict[str, Any]:
    pictures = {f"{picture.name}.png": picture.caption for section in sections for picture in section.pictures}
    reports = {"report.md": "the report", "report.html": "the report for a browser", SUMMARY: "this summary as JSON"}
    return {
        "title": study.title,
        "scene": job.scene.source,
        "shape": job.space.shape,
        "boundary": job.scene.boundary,
        "chip": asdict(job.scene.chip),
        "analyses": {section.name: section.data for section in sections},
        "check": verdict,
        "files": {**reports, **pictures, **files},
    }
