"""``resgrid chip``: is this chip good enough to drive a robot?  A folder with the answer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.check import check_written
from resgrid.cli.chip_report import Section, format_html, format_markdown, shown
from resgrid.cli.chip_study import ANALYSES, Limits, Study, open_study
from resgrid.cli.failures import NEGATIVE, NOT_VERIFIED
from resgrid.cli.options import Source, dialect_option, folder_of, output_option, verb, with_source
from resgrid.cli.report import Report, finish, stage
from resgrid.cli.scenes import say_unheeded
from resgrid.errors import InputError
from resgrid.files import SUMMARY, whole_folder

if TYPE_CHECKING:
    from resgrid.spice.check.agreement import Agreement


@verb(
    "chip",
    short="Ask whether a real chip is good enough; a report with decks.",
    examples=("resgrid chip chip.toml -o report", "resgrid chip chip.toml --only yield --at-least 0.95 --jobs 0"),
)
@with_source()
@output_option("Folder for the report.  [default: out/SCENE_chip]", metavar="DIR")
@click.option("--only", metavar="NAMES", help=f"Some analyses, with commas: {', '.join(ANALYSES)}.")
@click.option(
    "--half-width", metavar="W", default=0.01, show_default=True, help="Stop when the yield is known so well."
)
@click.option("--most", metavar="N", default=2000, show_default=True, help="Chips after which trials stop in any case.")
@click.option("--jobs", metavar="N", default=1, show_default=True, help="Processes that try chips; 0: one per core.")
@click.option(
    "--sweep", metavar="KEY=V,V,...", multiple=True,
    help="Value of the chip to explore, twice: the second is what is paid for.  [default: the offset or mismatch, "
    "and readout.bits]",
)  # fmt: skip
@click.option("--seconds", metavar="S", default=60.0, show_default=True, help="Time for making elements faulty.")
@click.option("--at-least", metavar="SHARE", type=float, help="Exit with 1 if the yield is surely below.")
@click.option("--check/--no-check", "asked", default=None, help="Simulate op.cir, however long it takes; or do not.")
@dialect_option()
def command(
    source: Source,
    output: str | None,
    only: str | None,
    at_least: float | None,
    asked: bool | None,
    dialect: str,
    sweep: tuple[str, ...],
    **limits: Any,
) -> int:
    """Find out what the chip of SCENE, as its [chip] table describes it, does to a robot.

    The folder holds report.md and report.html, one page with every figure, its unit and its definition; pictures;
    summary.json; and decks for the operating point, a transient, noise and temperatures, each with the answer to be
    expected in its sidecar.  A run that was interrupted takes up the counting of yield where it stopped.
    """
    from resgrid.cli.chip_analyses import run_analysis
    from resgrid.io.tables import json_text

    folder = folder_of(output, source, "_chip")
    names = _names(only)
    _check(at_least)
    bounds = Limits(**limits, sweep=tuple(_sweep(text) for text in sweep), checkpoint=folder)
    with whole_folder(folder) as made:
        study = open_study(source, Report(), bounds)
        unheeded = say_unheeded(study.job, "chip")
        sections = [run_analysis(name, study, made, Report()) for name in names]
        decks = _decks(study, made, dialect)
        agreement = check_written(made / "op.cir", study.netlist, asked, folder)
        verdict = _verdict("op.cir", agreement)
        data = _summary(study, sections, decks, verdict) | unheeded
        heading, table = study.title, study.parameters()
        (made / "report.md").write_text(format_markdown(heading, table, sections, decks, verdict), encoding="utf-8")
        (made / "report.html").write_text(format_html(heading, table, sections, decks, verdict), encoding="utf-8")
        (made / SUMMARY).write_text(json_text(data) + "\n", encoding="utf-8")
    study.forget()
    finish({"folder": folder, **data}, _lines(folder, study.title, sections, verdict))
    high = study.results["yield"].overall.high if "yield" in study.results else 1.0
    agrees = True if isinstance(agreement, str) else agreement.agrees
    if agrees is False or (at_least is not None and high < at_least):
        return NEGATIVE
    return NOT_VERIFIED if asked and agrees is None else 0


def _names(only: str | None) -> list[str]:
    if only is None:
        return list(ANALYSES)
    names = [word.strip() for word in only.split(",") if word.strip()]
    unknown = [name for name in names if name not in ANALYSES]
    if unknown or not names:
        raise InputError(f"--only {only}: choose some of {', '.join(ANALYSES)}")
    return [name for name in ANALYSES if name in names]


def _check(at_least: float | None) -> None:
    if at_least is not None and not 0 <= at_least <= 1:
        raise InputError(f"--at-least {at_least}: a share lies between 0 and 1")


def _sweep(text: str) -> tuple[str, tuple[float | int, ...]]:
    from resgrid.scene.quantities import parse_share

    key, equals, words = text.partition("=")
    if not equals or not words.strip():
        raise InputError(f"--sweep {text}: expected KEY=VALUE,VALUE,..., such as readout.bits=8,10,12")
    values = [parse_share(word.strip()) for word in words.split(",")]
    return key.strip(), tuple(int(value) if key.strip().endswith(("bits", "seed")) else value for value in values)


def _decks(study: Study, made: Path, dialect: str) -> dict[str, str]:
    """Write the decks; what each is, by its file."""
    from resgrid.chip.decks import write_chip_decks

    with stage("write the decks"):
        written = write_chip_decks(
            study.ideal, study.chip, made, title=study.title, dialect=dialect, point=study.point,
            settling=study.results.get("settling"),
        )  # fmt: skip
    files = {}
    for name, deck in written.items():
        files[deck.path.name] = _WHAT[name]
        files[deck.commands.name] = f"runs {deck.path.name} in {dialect}"
        files[deck.sidecar.name] = f"what {deck.path.name} should give, and its nodes"
        if deck.companion is not None:
            files[deck.companion.name] = f"makes ngspice check the operating point of {deck.path.name}: PASS or FAIL"
    return files


_WHAT = {
    "op": "the chip, for its operating point",
    "transient": "the same chip at rest, whose supplies are switched on",
    "noise": "the same chip, for the noise at its noisiest cell",
    "temperature": "the same chip with temperature coefficients, for several temperatures",
}


def _verdict(name: str, agreement: Agreement | str) -> str:
    """What the simulator said of a deck, or why it was not asked."""
    if isinstance(agreement, str):
        return f"{name} was {agreement}."
    if agreement.agrees is None:
        return f"{name} is not verified, for {agreement.remark}."
    words = "agrees" if agreement.agrees else "DISAGREES"
    return (
        f"{agreement.simulator} {agreement.version} {words} with {name}'s expected voltages: the largest difference is "
        f"{shown(agreement.max_abs_error, 'V')}."
    )


def _summary(study: Study, sections: list[Section], decks: dict[str, str], verdict: str) -> dict[str, Any]:
    pictures = {name: what for section in sections for name, what in section.pictures}
    reports = {"report.md": "the report", "report.html": "the report for a browser", SUMMARY: "this summary as JSON"}
    return {
        "title": study.title,
        "scene": study.job.scene.source,
        "shape": study.job.space.shape,
        "boundary": study.job.scene.boundary,
        "chip": study.description(),
        "analyses": {section.name: section.data for section in sections},
        "check": verdict,
        "files": {**reports, **pictures, **decks},
    }


def _lines(folder: Path, title: str, sections: list[Section], verdict: str) -> list[str]:
    lines = [title]
    for section in sections:
        lines += [f"  {section.title.lower()}: {line}" for line in section.text[:1]]
    return [*lines, verdict, f"report in {folder / 'report.md'}"]
