"""``resgrid convert``: a scene, a map or a deck into a deck of any dialect, an edge list or a graph."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.decks import is_deck, open_deck, read_as_option, root_option, solve_deck
from resgrid.cli.heeded import tell_unheeded
from resgrid.cli.job import DECK_SUFFIXES, Chip, only_boundary, open_job, solve_chip
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.report import Report
from resgrid.errors import InputError
from resgrid.files import atomic_path

if TYPE_CHECKING:
    from resgrid.netlist import Netlist
    from resgrid.nodal.operating_point import OperatingPoint

GRAPHS = (".txt", ".graphml", ".json", ".npz")
_SPECTRE = ".scs"


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
    """Turn SCENE or DECK into FILE.

    FILE.cir (.sp, .spice, .ckt, .net, .cdl; .scs for Spectre) is a flat deck, beside it the sidecar with the expected
    voltages; FILE.txt an edge list (two nodes and a resistance a line); FILE.graphml and FILE.json (node-link) are
    graphs for networkx and others; FILE.npz holds the netlist's arrays. -o - prints the deck alone.
    """
    suffix = Path(output).suffix.lower()
    if output != "-" and suffix not in (*DECK_SUFFIXES, _SPECTRE, *GRAPHS):
        raise InputError(f"-o {output}: it must end in {', '.join((*DECK_SUFFIXES, _SPECTRE, *GRAPHS))}")
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; write the deck to a file")
    if suffix in GRAPHS and (dialect is not None or bare):
        raise InputError(f"-o {output}: this is no deck, so it has no dialect and no sidecar; leave the option out")
    if output != "-" and _same_file(output, choice.source):
        raise InputError(f"-o {output}: this is the input; name another file")
    name = dialect or ("spectre" if suffix == _SPECTRE else "ngspice")
    wants_sidecar = not bare and output != "-" and suffix not in GRAPHS
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
        if output == "-" or (point is None and suffix not in GRAPHS):
            _write_bare(netlist, title, output, dialect)
            return {"file": output, "dialect": dialect, **counts}
        if suffix in GRAPHS:
            with atomic_path(output) as temporary:
                _write_graph(netlist, suffix, temporary)
            return {"file": output, **counts}
        from resgrid.spice.writer import write_spice

        written = write_spice(netlist, output, dialect, title=title, operating_point=point)
    files = {"sidecar": written.sidecar, "commands": written.commands, "sha256": written.sha256}
    return {"file": output, "dialect": dialect, **counts, **files}


def _left_out(netlist: Netlist, suffix: str) -> list[str]:
    """What an edge list or a graph has no place for, for people."""
    kinds = {
        "sources": len(netlist.source_volts) + len(netlist.current_amps),
        "capacitors": len(netlist.capacitance),
        "nonlinear resistors": len(netlist.nonlinear_current),
    }
    found = [f"{kind} ({count:,})" for kind, count in kinds.items() if count and suffix == ".txt"]
    coefficients = netlist.tc1 is not None or netlist.tc2 is not None
    return [*found, *(["temperature coefficients"] if coefficients and suffix in (".txt", ".graphml", ".json") else [])]


def _write_bare(netlist: Netlist, title: str | None, output: str, dialect: str) -> None:
    from resgrid.cli.output import emit_text
    from resgrid.spice.deck import format_deck

    emit_text(output, format_deck(netlist, dialect=dialect, title=title))


def _write_graph(netlist: Netlist, suffix: str, path: Path) -> None:
    if suffix == ".txt":
        _write_edges(netlist, path)
    elif suffix == ".npz":
        _write_arrays(netlist, path)
    else:
        import networkx as nx

        graph = netlist.to_networkx()
        for *_, data in graph.edges(data=True):
            data["nodes"] = " ".join(map(str, data["nodes"])) if suffix == ".graphml" else list(data["nodes"])
        if suffix == ".graphml":
            nx.write_graphml(graph, path)
        else:
            path.write_text(json.dumps(nx.node_link_data(graph, edges="edges")) + "\n", encoding="utf-8")


def _write_edges(netlist: Netlist, path: Path) -> None:
    """Names of the two nodes and the resistance of every resistor; what an edge list cannot hold is refused."""
    from resgrid.spice.deck import resistances

    names = ["_".join(name.split()) for name in netlist.names_of(range(netlist.node_count))]
    ends = netlist.resistor_nodes.tolist()
    rows = zip(ends, resistances(netlist.conductance).tolist(), strict=True)
    path.write_text("".join([f"{names[a]} {names[b]} {ohms!r}\n" for (a, b), ohms in rows]), encoding="utf-8")


def _write_arrays(netlist: Netlist, path: Path) -> None:
    import numpy as np

    arrays: dict[str, Any] = {
        name: getattr(netlist, name)
        for name in (
            "resistor_nodes",
            "conductance",
            "source_nodes",
            "source_volts",
            "current_nodes",
            "current_amps",
            "capacitor_nodes",
            "capacitance",
            "nonlinear_nodes",
            "nonlinear_current",
            "nonlinear_voltage",
            "tc1",
            "tc2",
        )
        if getattr(netlist, name) is not None
    }
    arrays["node_names"] = np.array(netlist.names_of(np.arange(netlist.node_count)))
    for kind, names in (netlist.element_names or {}).items():
        arrays[f"{kind.replace(' ', '_')}_names"] = np.array(names, dtype=np.str_)
    with path.open("wb") as file:
        np.savez(file, **arrays)
