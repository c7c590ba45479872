"""``resgrid compile``: write the SPICE deck of a scene's chip, also for other subcommands."""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid.cli.options import CommandInput, dialect_option, output_option, subcommand, with_source
from resgrid.cli.scenes import Job, element_counts, open_job, report_ignored
from resgrid.cli.terminal import finish, say, stage, verbosity
from resgrid.errors import InputError
from resgrid.spice.dialects import DECK_SUFFIXES

if TYPE_CHECKING:
    from resgrid.spice.write.files import Form, WrittenDeck


@subcommand(
    "compile",
    examples=(
        "resgrid compile rooms.toml -o rooms.cir",
        "resgrid compile rooms.toml --boundary neumann --dialect xyce -o rooms.cir",
        "resgrid compile lesson.toml --form cells -o lesson.cir",
    ),
)
@with_source()
@output_option(
    "Deck file; also writes FILE.json (expected voltages), FILE.DIALECT (simulator commands), for ngspice FILE.verify "
    "(prints PASS or FAIL), and with --form cells FILE.chip and FILE.pattern."
)
@dialect_option()
@click.option(
    "--form", type=click.Choice(("flat", "cells")), default="flat",
    help="One line per element (flat), or an array of tiles with the scene as a pattern of switches (cells).",
)  # fmt: skip
def command(source: CommandInput, output: str | None, dialect: str, form: Form) -> int:
    """Compile SCENE into a resistor netlist and write it as a SPICE deck.

    The deck describes the chip of the [chip] table in both forms. Keys that an array of tiles cannot represent are
    errors.

    Without -o, or with -o -, only the flat deck is printed.
    """
    from resgrid.spice.write.flat import flatten

    printed = output in (None, "-")
    if printed and form == "cells":
        raise InputError("--form cells writes three files (deck, chip and pattern); name the deck with -o FILE.cir")
    if not printed and Path(str(output)).suffix.lower() not in DECK_SUFFIXES:
        raise InputError(f"-o {output}: the name of a deck must end in {', '.join(DECK_SUFFIXES)}")
    job = open_job(source)
    if form == "cells":
        _require_tiles(job.scene.chip)
    name, wiring = job.problem.only_wiring()
    ignored = report_ignored(job, "circuit" if form == "flat" else "tiles")
    if printed and not verbosity().json:
        deck = flatten(job.compile(wiring), dialect=dialect, title=_title(job, name))
        click.echo(deck.text, nl=False)
        return 0
    assumed: dict[str, float] = {}
    if form == "cells":
        job, assumed = _assume_switches(job, wiring.boundary)
    op = job.solve(wiring)
    data: dict[str, Any] = {"chip": name, "dialect": dialect, **element_counts(op.netlist), **ignored}
    if output is not None:
        written = write_deck(output, job, name, op, dialect, form)
        more = {"companion": written.companion, "chip": written.chip, "pattern": written.pattern}
        data |= {"form": form, "deck": written.path, "sidecar": written.sidecar, "commands": written.commands}
        data |= {f"{key}_file" if key in data else key: path for key, path in more.items() if path is not None}
        data["sha256"] = written.sha256
        if form == "cells":
            data["assumed"] = assumed
        others = [path for path in (written.sidecar, written.commands, *more.values()) if path is not None]
        say(f"wrote {written.path} ({data['resistors']:,} resistors), {', '.join(map(str, others))}")
    finish(data)
    return 0


def _require_tiles(chip: rg.Chip) -> None:
    """Raise InputError, which names the keys, for a chip with keys that an array of tiles cannot represent.

    A tile is the circuit of one cell (node, resistors, switches), which the array repeats.
    """
    from resgrid.chip.build import READING, keys_not_held

    own, source = set(keys_not_held(chip, "tiles")), "chip.process" + (" and chip.corner" if chip.corner else "")
    keys = [
        f"chip.{key}" if key in own or chip.process is None else f"chip.{key} of {source}"
        for key in keys_not_held(chip.with_process(), "tiles")
        if key not in READING
    ]
    if keys:
        raise InputError(
            f"an array of tiles cannot represent {', '.join(keys)}: use --form flat, or remove them from [chip]"
        )


def _assume_switches(job: Job, boundary: str) -> tuple[Job, dict[str, float]]:
    """Return a job whose chip has all switches of an array of tiles, and the assumed resistances in ohms, by key.

    A tile is the circuit of one cell (node, resistors, switches), which the array repeats.  The dict has a key of the
    scene for each switch that the scene does not describe, such as ``chip.goal_switch_on``.  `boundary`: boundary
    condition at obstacles, which determines the switches.
    """
    from resgrid.spice.write.tiles import with_tile_switches

    chip = with_tile_switches(job.scene.chip, boundary)
    assumed = {f"chip.{key}": ohms for key, ohms in vars(chip).items() if ohms != getattr(job.scene.chip, key)}
    if assumed:
        values = ", ".join(f"{key} = {ohms:g}" for key, ohms in assumed.items())
        say(f"[chip] does not describe all switches of the tiles; assumed, in ohms: {values}")
    return Job(replace(job.scene, chip=chip), job.space, job.threads), assumed


def write_deck(
    target: str | Path, job: Job, name: str, op: rg.OperatingPoint, dialect: str, form: Form = "flat"
) -> WrittenDeck:
    """Write a chip's deck with its sidecar, simulator commands and self-check deck; return the names of these files.

    With the self-check deck, ngspice compares its results with the expected ones; for other dialects it is not written.

    `target`: name of the deck; `job`: scene with chip and space; `name`: name of the circuit, for the title; `op`:
    operating point of the circuit; `dialect`: SPICE dialect; `form`: "flat", or "cells" for an array of tiles (circuits
    of one cell that the array repeats).
    """
    source = Path(job.scene.source or "-")
    with stage("write the deck", seconds=5e-6 * len(op.netlist.conductance)):
        return rg.write_spice(
            op,
            target,
            dialect,
            title=_title(job, name),
            form=form,
            chip=job.scene.chip,
            scene_sha256=sha256(source.read_bytes()).hexdigest() if source.is_file() else None,
        )


def _title(job: Job, name: str) -> str | None:
    leak = f", leak {job.scene.leak:g}" if job.scene.leak else ""
    return f"{job.scene.title}, {name.replace('_', ' ')}{leak}" if job.scene.title else None
