"""``resgrid compile``: the deck of a scene's chip."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.heeded import assume_switches, require_tiles, tell_unheeded
from resgrid.cli.job import Chip, Job, compile_chip, is_ideal, only_boundary, open_job, solve_chip
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.spice.write.files import Form, WrittenDeck

dialect_option = click.option(
    "--dialect", default="ngspice", show_default=True, metavar="NAME", help="SPICE dialect of the deck."
)
form_option = click.option(
    "--form",
    type=click.Choice(("flat", "cells")),
    default="flat",
    show_default=True,
    help="One line per element, or an array of tiles with the scene as a pattern of switches.",
)


@click.command("compile", short_help="Write a scene's chip as a SPICE deck.")
@with_scene()
@output_option(
    "The deck; beside it FILE.json (expected voltages), FILE.DIALECT (commands), for ngspice FILE.verify (prints PASS "
    "or FAIL), and with --form cells FILE.chip and FILE.pattern."
)
@dialect_option
@form_option
@with_report
def command(choice: SceneChoice, output: str | None, dialect: str, form: Form, report: Report) -> int:
    """Compile SCENE into a resistor netlist and write it as a SPICE deck.

    The flat deck is that of the chip as its [chip] table describes it; tiles hold its switches, capacitors and
    mismatch, and what they cannot hold is refused.

    Without -o, or with -o -, the flat deck alone is printed.
    """
    printed = output in (None, "-")
    if printed and form == "cells":
        raise InputError("--form cells makes three files (deck, chip and pattern); name the deck with -o FILE")
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; write the deck to a file")
    job = open_job(choice, report)
    if form == "cells":
        require_tiles(job.scene.chip)
    boundary, start = only_boundary(job)
    told = tell_unheeded(job, "circuit" if form == "flat" else "tiles", report)
    if printed and not report.json:
        click.echo(_deck_text(job, boundary, start, dialect, report), nl=False)
        return 0
    assumed: dict[str, float] = {}
    if form == "cells":
        job, assumed = assume_switches(job, boundary, report)
    chip = solve_chip(job, report, boundary, start)
    data: dict[str, Any] = {"chip": chip.name, "dialect": dialect, **_counts(chip), **told}
    if output is not None:
        written = write_deck(output, job, chip, dialect, report, form)
        data |= {"form": form, "deck": written.path, "sidecar": written.sidecar, "commands": written.commands}
        more = {"companion": written.companion, "chip": written.chip, "pattern": written.pattern}
        data |= {f"{key}_file" if key in data else key: path for key, path in more.items() if path is not None}
        data["sha256"] = written.sha256
        if form == "cells":
            data["assumed"] = assumed
        others = [path for path in (written.sidecar, written.commands, *more.values()) if path is not None]
        report.say(f"wrote {written.path} ({data['resistors']:,} resistors), {', '.join(map(str, others))}")
    report.finish(data, ())
    return 0


def write_deck(
    target: str | Path, job: Job, chip: Chip, dialect: str, report: Report, form: Form = "flat"
) -> WrittenDeck:
    """Write a chip's deck with its sidecar, commands and companion."""
    from resgrid.spice.write.files import write_spice

    with report.stage("write the deck", seconds=5e-6 * len(chip.netlist.conductance)):
        return write_spice(
            chip.point,
            target,
            dialect,
            title=_title(job, chip.name),
            form=form,
            chip=job.scene.chip,
            scene_sha256=_scene_hash(job),
        )


def _scene_hash(job: Job) -> str | None:
    """SHA-256 of the scene's file, where it has one."""
    source = Path(job.scene.source or "-")
    return sha256(source.read_bytes()).hexdigest() if source.is_file() else None


def _deck_text(job: Job, boundary: str, start: int | None, dialect: str, report: Report) -> str:
    from resgrid.spice.write.flat import flatten

    netlist = compile_chip(job, report, boundary, start)
    if netlist.current_nodes.size and is_ideal(job):
        netlist = solve_chip(job, report, boundary, start).netlist
    return flatten(netlist, dialect=dialect, title=_title(job, boundary)).text


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
