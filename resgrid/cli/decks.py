"""What the verbs do when they are given a deck instead of a scene: read it, solve it, tell what it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.job import DECK_SUFFIXES, SPECTRE_SUFFIX
from resgrid.errors import CircuitError, InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from resgrid.cli.options import SceneChoice
    from resgrid.cli.report import Report
    from resgrid.nodal.operating_point import OperatingPoint
    from resgrid.spice.parsed import ParsedDeck

_READ_SECONDS, _SOLVE_SECONDS = 3e-8, 6e-6
"""Rough time a byte of a deck and a resistor take, in seconds, for the bar."""

_NOTES = 20

read_as_option = click.option(
    "--read-as",
    metavar="DIALECT",
    default="auto",
    show_default=True,
    help="Deck: ngspice, ltspice, xyce or hspice, where the deck does not show it.",
)
root_option = click.option(
    "--root", metavar="FOLDER", type=click.Path(), help="Deck: where its includes may lie; by default its own folder."
)


@dataclass(frozen=True, eq=False)
class SolvedDeck:
    """A deck and its operating point."""

    deck: ParsedDeck
    point: OperatingPoint


def is_deck(source: str) -> bool:
    """Whether a file is a circuit and no scene: by the end of its name, or by the sidecar beside it."""
    path = Path(source)
    suffix = path.suffix.lower()
    if suffix in (*DECK_SUFFIXES, SPECTRE_SUFFIX) or is_network(source):
        return True
    return source != "-" and path.name != "" and path.with_name(path.name + ".json").is_file()


def is_network(source: str) -> bool:
    """Whether a file is a network that is no deck: a graph, arrays, a configuration, or a list of edges."""
    from resgrid.spice.networks.edges import is_edge_list
    from resgrid.spice.networks.graphs import NETWORK_SUFFIXES

    suffix = Path(source).suffix.lower()
    return is_edge_list(source) if suffix == ".txt" else suffix in (*NETWORK_SUFFIXES, ".ini")


def refuse_scene_options(choice: SceneChoice) -> None:
    """Decks have no goals, boundaries and maps."""
    if choice.changes or choice.map_options:
        raise InputError(f"{choice.source} is a deck: options that change a scene do nothing to it; remove them")


def open_deck(choice: SceneChoice, read_as: str, root: str | None, report: Report) -> ParsedDeck:
    """Read a deck, or a network as if it were one."""
    from resgrid.spice.networks.read import network_deck
    from resgrid.spice.read.deck import read_spice

    refuse_scene_options(choice)
    path = Path(choice.source)
    if path.suffix.lower() == SPECTRE_SUFFIX:
        raise InputError(
            f"{path}: decks for Spectre are written and not read; convert the deck or scene it was made of"
        )
    size = path.stat().st_size if path.is_file() else 0
    with report.stage("read the deck", seconds=0.5 + _READ_SECONDS * size):
        if is_network(choice.source):
            return network_deck(path, root=root)
        deck = read_spice(path, dialect=read_as, root=root)
    tell_notes(deck, report)
    return deck


def tell_notes(deck: ParsedDeck, report: Report) -> None:
    """Say what the reader noted: warnings always, the rest on request."""
    warnings = [note for note in deck.notes if note.severity != "info"]
    for note in warnings[:_NOTES]:
        report.say(f"{note.severity}: {note}")
    if len(warnings) > _NOTES:
        report.say(f"and {len(warnings) - _NOTES:,} more; --json lists them all")
    for note in deck.notes:
        if note.severity == "info":
            report.detail(str(note))


def solve_deck(deck: ParsedDeck, report: Report) -> SolvedDeck:
    """Solve a deck; as `resgrid.solve`, but where there is no answer the message names the lines at fault."""
    try:
        return _solved(deck, report)
    except CircuitError as error:
        raise CircuitError(_lines_at_fault(deck) or str(error)) from error


def _lines_at_fault(deck: ParsedDeck) -> str:
    """Errors that the rules find, one a line; empty if they find none."""
    from resgrid.spice.check.rules import check_rules

    errors = [finding for finding in check_rules(deck) if finding.severity == "error"]
    return "\n".join(f"{finding.place}: {finding.message}; {finding.remedy}" for finding in errors[:_NOTES])


def _solved(deck: ParsedDeck, report: Report) -> SolvedDeck:
    from resgrid.nodal.solve import solve

    with report.stage("assemble it"):
        netlist = deck.netlist()
    estimate = 0.5 + _SOLVE_SECONDS * len(netlist.conductance)
    point: OperatingPoint = report.compute("solve the deck", solve, netlist, seconds=estimate)
    return SolvedDeck(deck, point)


def deck_data(deck: ParsedDeck) -> dict[str, Any]:
    """What a deck holds, as ``--json`` gives it."""
    kinds = {kind: len(names) for kind, names in deck.element_names.items()}
    return {
        "source": deck.path,
        "title": deck.title,
        "dialect": deck.dialect,
        "files": list(deck.files),
        "nodes": len(deck.node_names),
        "resistors": kinds.get("resistor", 0),
        "voltage_sources": kinds.get("voltage source", 0),
        "current_sources": kinds.get("current source", 0),
        "capacitors": kinds.get("capacitor", 0),
        "subcircuits": list(deck.subcircuits),
        "temperature": deck.temperature,
        "options": dict(deck.options),
        "notes": [
            {"severity": n.severity, "file": n.file, "line": n.line, "column": n.column, "text": n.text}
            for n in deck.notes
        ],
    }


def solution_data(solved: SolvedDeck, count: int) -> dict[str, Any]:
    """What the meters of a solved deck read, as ``--json`` gives it."""
    from resgrid.spice.balance import power_balance
    from resgrid.spice.ir_drop import ir_drop

    point, netlist = solved.point, solved.point.netlist
    drops, balance = ir_drop(point), power_balance(point)
    worst = drops.worst(count)
    return {
        "kcl_residual": point.kcl_residual,
        "power": point.power,
        "power_delivered": balance.delivered,
        "power_imbalance": balance.imbalance,
        "floating_nodes": netlist.names_of(point.floating),
        "worst_drops": [
            {
                "node": name,
                "voltage": float(point.voltage[i]),
                "supply": float(drops.supply[i]),
                "drop": float(drops.drop[i]),
            }
            for name, i in zip(netlist.names_of(worst), worst.tolist(), strict=True)
        ],
        "supplies": _supplies(solved, count),
        "solver": point.method,
        "seconds": dict(point.seconds),
    }


def _supplies(solved: SolvedDeck, count: int) -> list[dict[str, Any]]:
    """The sources that deliver most, the first ``count`` of them."""
    import numpy as np

    point, netlist = solved.point, solved.point.netlist
    amps = np.nan_to_num(np.abs(point.source_current), nan=np.inf)
    order = np.argsort(-amps, kind="stable")[:count]
    names = (netlist.element_names or {}).get("voltage source", ())
    return [
        {"name": names[i], "volts": float(netlist.source_volts[i]), "amps": float(point.source_current[i])}
        for i in order.tolist()
    ]


def solution_lines(data: dict[str, Any]) -> Iterable[str]:
    """A solved deck for people: what it holds, and its worst drops."""
    yield f"{data['title'] or data['source']} ({data['dialect']})"
    yield f"  nodes               {data['nodes']:,}"
    yield (
        f"  elements            {data['resistors']:,} resistors, {data['voltage_sources']:,} voltage sources, "
        f"{data['current_sources']:,} current sources, {data['capacitors']:,} capacitors"
    )
    yield f"  KCL residual        {data['kcl_residual']:.1e} of the current through the node"
    delivered = data["power_delivered"]
    if math.isfinite(delivered):
        yield f"  power               {data['power']:.6g} W dissipated, {delivered:.6g} W delivered"
    else:
        yield f"  power               {data['power']:.6g} W dissipated; delivered in loops of sources: undetermined"
    if data["floating_nodes"]:
        names = data["floating_nodes"]
        more = f" and {len(names) - 5:,} more" if len(names) > 5 else ""
        yield f"  floating            {', '.join(names[:5])}{more}: no voltage"
    yield f"  solver              {data['solver']}"
    worst = data["worst_drops"]
    if worst:
        width = max(len("worst drops"), *(len(row["node"]) for row in worst))
        yield f"  {'worst drops':{width}}  {'voltage':>14}  {'supply':>9}  {'drop':>12}"
        for row in worst:
            yield f"  {row['node']:{width}}  {row['voltage']:12.9g} V  {row['supply']:7.6g} V  {row['drop']:10.6g} V"
