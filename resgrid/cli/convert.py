"""``resgrid convert``: convert a scene, a map or a deck to a deck of any dialect, an edge list or a graph."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid.cli.decks import is_deck, open_deck, solve_deck
from resgrid.cli.options import CommandInput, dialect_option, output_option, subcommand, with_source
from resgrid.cli.scenes import element_counts, open_job, report_ignored
from resgrid.cli.terminal import finish, say, stage
from resgrid.errors import InputError
from resgrid.spice.dialects import DECK_SUFFIXES, OWN_SUFFIXES

if TYPE_CHECKING:
    from collections.abc import Mapping


@subcommand(
    "convert",
    examples=(
        "resgrid convert theirs.sp -o ours.cir --dialect xyce",
        "resgrid convert rooms.toml -o rooms.graphml",
    ),
)
@with_source("SCENE|DECK")
@output_option("Output file; its suffix decides the format.", required=True)
@dialect_option(None)
@click.option("--bare", is_flag=True, help="Write only the deck, unsolved, without sidecar and simulator commands.")
def command(source: CommandInput, output: str, dialect: str | None, bare: bool) -> int:
    """Convert a SCENE, a DECK or a network to FILE.

    FILE.cir (.sp, .spice, .ckt, .net, .cdl; .scs for Spectre) is a flat deck with a sidecar of expected voltages;
    FILE.txt an edge list (two nodes and a resistance per line); FILE.graphml and FILE.json (node-link) are graphs for
    networkx and other programs; FILE.npz has the netlist's arrays. -o - prints only the deck. All of these formats, and
    Circuitscape configurations (.ini), are also inputs. In JSON output, "nodes" and the kinds of elements
    count the input, and "left_out" counts the elements of each kind that FILE cannot represent.
    """
    from resgrid.io.networks import NETWORK_SUFFIXES, left_out

    suffix = Path(output).suffix.lower()
    known = (*DECK_SUFFIXES, *NETWORK_SUFFIXES)
    if output != "-" and suffix not in known:
        raise InputError(f"-o {output}: the name must end in {', '.join(known)}")
    is_network = output != "-" and suffix in NETWORK_SUFFIXES
    if is_network and (dialect is not None or bare):
        raise InputError(
            f"-o {output}: a network has no dialect and no sidecar; leave --dialect and --bare out, or write a deck"
        )
    deck_only = bare or output == "-"
    netlist, title, op, ignored = _circuit(source, solve=not (deck_only or is_network))
    data: dict[str, Any] = {"file": output, **element_counts(netlist)}
    missing: Mapping[str, int] = {}
    if is_network:
        missing = left_out(netlist, output)
        with stage("write the network", seconds=5e-6 * data["resistors"]):
            rg.save(netlist, output)
    else:
        data["dialect"] = dialect or OWN_SUFFIXES.get(suffix, "ngspice")
        with stage("write the deck", seconds=5e-6 * data["resistors"]):
            written, missing = _write_deck(netlist, title, None if deck_only else op, output, data["dialect"])
            data |= written
    if missing:
        kinds = ", ".join(f"{kind}s ({count:,})" for kind, count in missing.items())
        why = f"the format of {output} cannot represent them" if is_network else "a simulator would fail on them"
        say(f"left out, because {why}: {kinds}")
    data["left_out"] = {f"{kind.replace(' ', '_')}s": count for kind, count in missing.items()}
    finish(data | ignored, written=output)
    return 0


def _circuit(
    source: CommandInput, *, solve: bool
) -> tuple[rg.Netlist, str | None, rg.OperatingPoint | None, dict[str, list[str]]]:
    """Return the netlist of an input, its title, its operating point, and the ignored keys of a scene.

    The title is None if the input has none.  The dict has the single key ``ignored`` with the list of the scene keys
    that the conversion does not use, such as ``chip.readout.bits``; it is empty for a deck.  `source`: the input;
    `solve`: whether to solve a deck; otherwise its operating point is None.  A scene is always solved.
    """
    if not is_deck(source):
        job = open_job(source)
        ignored = report_ignored(job, "circuit")
        op = job.solve(job.problem.only_wiring()[1])
        return op.netlist, job.scene.title, op, ignored
    deck = open_deck(source)
    if not solve:
        return deck.netlist(), deck.title, None, {}
    op = solve_deck(deck, threads=source.threads)
    return op.netlist, deck.title, op, {}


def _write_deck(
    netlist: rg.Netlist, title: str | None, op: rg.OperatingPoint | None, output: str, dialect: str
) -> tuple[dict[str, Any], Mapping[str, int]]:
    """Write a deck, with a sidecar if `op` is given; return JSON data, and numbers of the elements left out, by kind.

    The JSON data has the keys ``sidecar``, ``commands`` (names of the files) and ``sha256`` (hash of the deck); it is
    empty without `op`.  `netlist`: the circuit; `title`: first line of the deck, None for a description of the netlist;
    `op`: operating point for the sidecar, None for no sidecar; `output`: name of the deck, ``-`` for standard output;
    `dialect`: SPICE dialect.
    """
    if op is None:
        from resgrid._internal.files import write_text
        from resgrid.spice.write.flat import flatten

        deck = flatten(netlist, dialect=dialect, title=title)
        click.echo(deck.text, nl=False) if output == "-" else write_text(output, deck.text)
        return {}, deck.missing

    written = rg.write_spice(op, output, dialect, title=title)
    files = {"sidecar": written.sidecar, "commands": written.commands, "sha256": written.sha256}
    return files, written.left_out
