"""``resgrid compile``: the deck of a scene's chip."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.job import Chip, Job, compile_chip, only_boundary, open_job, solve_chip
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from resgrid.spice.writer import WrittenDeck

dialect_option = click.option(
    "--dialect", default="ngspice", show_default=True, metavar="NAME", help="SPICE dialect of the deck."
)


@click.command("compile", short_help="Write a scene's chip as a SPICE deck.")
@with_scene()
@output_option("The deck; FILE.json (expected voltages) and FILE.ngspice (commands) are written beside it.")
@dialect_option
@with_report
def command(choice: SceneChoice, output: str | None, dialect: str, report: Report) -> int:
    """Compile SCENE into a resistor netlist and write it as a flat SPICE deck.

    Without -o, or with -o -, the deck alone is printed.
    """
    printed = output in (None, "-")
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; write the deck to a file")
    job = open_job(choice, report)
    boundary, start = only_boundary(job)
    if printed and not report.json:
        click.echo(_deck_text(job, boundary, start, dialect, report), nl=False)
        return 0
    chip = solve_chip(job, report, boundary, start)
    data: dict[str, Any] = {"chip": chip.name, "dialect": dialect, **_counts(chip)}
    if output is not None:
        written = write_deck(output, job, chip, dialect, report)
        data |= {"deck": written.path, "sidecar": written.sidecar, "commands": written.commands}
        data["sha256"] = written.sha256
        report.say(f"wrote {written.path} ({data['resistors']:,} resistors), {written.sidecar} and {written.commands}")
    report.finish(data, ())
    return 0


def write_deck(target: str | Path, job: Job, chip: Chip, dialect: str, report: Report) -> WrittenDeck:
    """Write a chip's deck with its sidecar and commands.

    Parameters
    ----------
    target : path-like
    job : Job
    chip : Chip
    dialect : str
    report : Report

    Returns
    -------
    WrittenDeck

    Raises
    ------
    InputError
        If the dialect is unknown or a file cannot be written.
    """
    from resgrid.spice.writer import write_spice

    with report.stage("write the deck", seconds=5e-6 * len(chip.netlist.conductance)):
        return write_spice(chip.netlist, target, dialect, title=_title(job, chip.name), operating_point=chip.point)


def _deck_text(job: Job, boundary: str, start: int | None, dialect: str, report: Report) -> str:
    from resgrid.spice.deck import format_deck

    netlist = compile_chip(job, report, boundary, start)
    if netlist.current_nodes.size:
        netlist = solve_chip(job, report, boundary, start).netlist
    return format_deck(netlist, dialect=dialect, title=_title(job, boundary))


def _title(job: Job, chip: str) -> str | None:
    return f"{job.scene.title}, {chip.replace('_', ' ')}" if job.scene.title else None


def _counts(chip: Chip) -> dict[str, int]:
    netlist = chip.netlist
    return {
        "nodes": netlist.node_count,
        "resistors": len(netlist.conductance),
        "voltage_sources": len(netlist.source_volts),
        "current_sources": len(netlist.current_amps),
    }
