"""``resgrid convert``: a scene, a map or a deck into a deck of any dialect, an edge list or a graph."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.decks import is_deck, open_deck, read_as_option, root_option, solve_deck
from resgrid.cli.heeded import tell_unheeded
from resgrid.cli.job import DECK_SUFFIXES, SPECTRE_SUFFIX, Chip, only_boundary, open_job, solve_chip
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.netlist import Netlist
    from resgrid.nodal.operating_point import OperatingPoint


@click.command("convert", short_help="Turn a scene, map or deck into a deck, an edge list or a graph.")
@with_scene(metavar="SCENE|DECK")
@output_option("What to write; the end of its name says which.", required=True)
@click.option("--dialect", metavar="NAME", help="Of a deck: ngspice, ltspice, xyce, hspice or spectre.")
@click.option("--bare", is_flag=True, help="Write the deck alone, unsolved, without sidecar and companions.")
@read_as_option
@root_option
@with_report
def command(
    choice: SceneChoice,
    output: str,
    dialect: str | None,
    bare: bool,
    read_as: str,
    root: str | None,
    report: Report,
) -> int:
    """Turn SCENE, or a DECK or a network in any of these forms, into FILE.

    FILE.cir (.sp, .spice, .ckt, .net, .cdl; .scs for Spectre) is a flat deck, beside it the sidecar with the expected
    voltages; FILE.txt an edge list (two nodes and a resistance a line); FILE.graphml and FILE.json (node-link) are
    graphs for networkx and others; FILE.npz holds the netlist's arrays. -o - prints the deck alone. All of these are
    read, too, but for Spectre, which is written only, and so are Circuitscape configurations (.ini).
    """
    from resgrid.spice.networks.graphs import NETWORK_SUFFIXES

    suffix = Path(output).suffix.lower()
    known = (*DECK_SUFFIXES, SPECTRE_SUFFIX, *NETWORK_SUFFIXES)
    if output != "-" and suffix not in known:
        raise InputError(f"-o {output}: it must end in {', '.join(known)}")
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; write the deck to a file")
    if suffix in NETWORK_SUFFIXES and (dialect is not None or bare):
        raise InputError(f"-o {output}: this is no deck, so it has no dialect and no sidecar; leave the option out")
    if output != "-" and _same_file(output, choice.source):
        raise InputError(f"-o {output}: this is the input; name another file")
    name = dialect or ("spectre" if suffix == SPECTRE_SUFFIX else "ngspice")
    wants_sidecar = not bare and output != "-" and suffix not in NETWORK_SUFFIXES
    netlist, title, point, told = _circuit(choice, read_as, root, report, solve=wants_sidecar)
    data = _written(netlist, title, point if wants_sidecar else None, output, name, report) | told
    if output != "-":
        report.say(f"wrote {output}")
        report.finish(data, ())
    return 0


def _same_file(a: str, b: str) -> bool:
    return Path(a).exists() and Path(b).exists() and Path(a).samefile(b)


def _circuit(
    choice: SceneChoice, read_as: str, root: str | None, report: Report, *, solve: bool
) -> tuple[Netlist, str | None, OperatingPoint | None, dict[str, list[str]]]:
    """The netlist, its title, where it is wanted its solution, and what was not heeded of a scene."""
    if not is_deck(choice.source):
        job = open_job(choice, report)
        told = tell_unheeded(job, "circuit", report)
        chip: Chip = solve_chip(job, report, *only_boundary(job))
        return chip.netlist, job.scene.title, chip.point, told
    deck = open_deck(choice, read_as, root, report)
    if solve:
        solved = solve_deck(deck, report)
        return solved.point.netlist, deck.title, solved.point, {}
    return deck.netlist(), deck.title, None, {}


def _written(
    netlist: Netlist, title: str | None, point: OperatingPoint | None, output: str, dialect: str, report: Report
) -> dict[str, Any]:
    from resgrid.spice.networks.graphs import NETWORK_SUFFIXES, write_network

    counts = {
        "nodes": netlist.node_count,
        "resistors": len(netlist.conductance),
        "voltage_sources": len(netlist.source_volts),
        "current_sources": len(netlist.current_amps),
    }
    suffix = Path(output).suffix.lower()
    left_out = _left_out(netlist, suffix) if output != "-" else []
    if left_out:
        report.say(f"left out, for {output} has no place for them: {', '.join(left_out)}")
    with report.stage("write it", seconds=5e-6 * counts["resistors"]):
        if output == "-" or (point is None and suffix not in NETWORK_SUFFIXES):
            _write_bare(netlist, title, output, dialect)
            return {"file": output, "dialect": dialect, **counts}
        if suffix in NETWORK_SUFFIXES:
            write_network(netlist, output)
            return {"file": output, **counts}
        from resgrid.spice.write.files import write_spice

        written = write_spice(netlist if point is None else point, output, dialect, title=title)
    files = {"sidecar": written.sidecar, "commands": written.commands, "sha256": written.sha256}
    return {"file": output, "dialect": dialect, **counts, **files}


def _left_out(netlist: Netlist, suffix: str) -> list[str]:
    """What an edge list has no place for, for people."""
    if suffix != ".txt":
        return []
    kinds = {
        "sources": len(netlist.source_volts) + len(netlist.current_amps),
        "capacitors": len(netlist.capacitance),
        "nonlinear resistors": len(netlist.nonlinear_current),
    }
    found = [f"{kind} ({count:,})" for kind, count in kinds.items() if count]
    return found if netlist.tc1 is None and netlist.tc2 is None else [*found, "temperature coefficients"]


def _write_bare(netlist: Netlist, title: str | None, output: str, dialect: str) -> None:
    from resgrid.cli.output import emit_text
    from resgrid.spice.write.flat import flatten

    emit_text(output, flatten(netlist, dialect=dialect, title=title).text)
