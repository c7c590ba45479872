"""``resgrid convert``: a scene, a map or a deck into a deck of any dialect, an edge list or a graph."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid.cli.decks import is_deck, open_deck, solve_deck
from resgrid.cli.options import CommandInput, dialect_option, output_option, verb, with_source
from resgrid.cli.scenes import element_counts, open_job, report_ignored
from resgrid.cli.terminal import finish, say, stage
from resgrid.errors import InputError
from resgrid.spice.dialects import DECK_SUFFIXES, OWN_SUFFIXES

if TYPE_CHECKING:
    from collections.abc import Mapping


@verb(
    "convert",
    examples=(
        "resgrid convert theirs.sp -o ours.cir --dialect xyce",
        "resgrid convert rooms.toml -o rooms.graphml",
    ),
)
@with_source("SCENE|DECK")
@output_option("What to write; the end of its name says which.", required=True)
@dialect_option(None)
@click.option("--bare", is_flag=True, help="Write the deck alone, unsolved, without sidecar and companions.")
def command(source: CommandInput, output: str, dialect: str | None, bare: bool) -> int:
    """Turn SCENE, or a DECK or a network in any of these forms, into FILE.

    FILE.cir (.sp, .spice, .ckt, .net, .cdl; .scs for Spectre) is a flat deck, beside it the sidecar with the expected
    voltages; FILE.txt an edge list (two nodes and a resistance a line); FILE.graphml and FILE.json (node-link) are
    graphs for networkx and others; FILE.npz holds the netlist's arrays. -o - prints the deck alone. All of these are
    read, too, and so are Circuitscape configurations (.ini). In JSON, "nodes" and kinds of elements count what was
    read, and "left_out" how many of each kind FILE does not hold.
    """
    from resgrid.io.networks import NETWORK_SUFFIXES, left_out

    suffix = Path(output).suffix.lower()
    known = (*DECK_SUFFIXES, *NETWORK_SUFFIXES)
    if output != "-" and suffix not in known:
        raise InputError(f"-o {output}: it must end in {', '.join(known)}")
    is_network = output != "-" and suffix in NETWORK_SUFFIXES
    if is_network and (dialect is not None or bare):
        raise InputError(f"-o {output}: this is no deck, so it has no dialect and no sidecar; leave the option out")
    alone = bare or output == "-"
    netlist, title, op, ignored = _circuit(source, solve=not (alone or is_network))
    data: dict[str, Any] = {"file": output, **element_counts(netlist)}
    missing: Mapping[str, int] = {}
    if is_network:
        missing = left_out(netlist, output)
        with stage("write it", seconds=5e-6 * data["resistors"]):
            rg.save(netlist, output)
    else:
        data["dialect"] = dialect or OWN_SUFFIXES.get(suffix, "ngspice")
        with stage("write it", seconds=5e-6 * data["resistors"]):
            written, missing = _write_deck(netlist, title, None if alone else op, output, data["dialect"])
            data |= written
    if missing:
        kinds = ", ".join(f"{kind}s ({count:,})" for kind, count in missing.items())
        why = f"{output} has no place for them" if is_network else "a simulator would fail on them"
        say(f"left out, for {why}: {kinds}")
    data["left_out"] = {f"{kind.replace(' ', '_')}s": count for kind, count in missing.items()}
    finish(data | ignored, written=output)
    return 0


def _circuit(
    source: CommandInput, *, solve: bool
) -> tuple[rg.Netlist, str | None, rg.OperatingPoint | None, dict[str, list[str]]]:
    """Return the netlist, its title, its solution if asked for, and the ignored keys of a scene."""
    if not is_deck(source):
        job = open_job(source)
        ignored = report_ignored(job, "circuit")
        op = job.solve(job.problem.only_wiring()[1])
        return op.netlist, job.scene.title, op, ignored
    deck = open_deck(source)
    if not solve:
        return deck.netlist(), deck.title, None, {}
    op = solve_deck(deck)
    return op.netlist, deck.title, op, {}


def _write_deck(
    netlist: rg.Netlist, title: str | None, op: rg.OperatingPoint | None, output: str, dialect: str
) -> tuple[dict[str, Any], Mapping[str, int]]:
    """Write a deck with its sidecar, or without a solution the deck alone; what it does not hold of the circuit."""
    if op is None:
        from resgrid._internal.files import write_text
        from resgrid.spice.write.flat import flatten

        deck = flatten(netlist, dialect=dialect, title=title)
        click.echo(deck.text, nl=False) if output == "-" else write_text(output, deck.text)
        return {}, deck.missing

    written = rg.write_spice(op, output, dialect, title=title)
    beside = {"sidecar": written.sidecar, "commands": written.commands, "sha256": written.sha256}
    return beside, written.left_out
