"""Decks on the command line: recognised, read, solved, described."""

from __future__ import annotations

import sys
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import resgrid as rg
from resgrid.cli.terminal import compute, detail, say, stage
from resgrid.errors import CircuitError, InputError
from resgrid.spice.dialects import DECK_SUFFIXES

if TYPE_CHECKING:
    from resgrid.cli.options import CommandInput
    from resgrid.spice.circuit import Circuit

_READ_SECONDS, _SOLVE_SECONDS = 3e-8, 6e-6
"""Rough time a byte of a deck and a resistor take, in seconds, for the bar."""

_NOTES = 20


def is_deck(source: CommandInput) -> bool:
    """Whether a file is a circuit and no scene: by the end of its name, or by the sidecar beside it.

    What is piped in is one if its dialect is told.
    """
    from resgrid.spice.read.deck import is_network

    if source.file == "-":
        return source.dialect != "auto"
    path = Path(source.file)
    if path.suffix.lower() in DECK_SUFFIXES or is_network(source.file):
        return True
    return path.name != "" and path.with_name(path.name + ".json").is_file()


def refuse_scene_options(source: CommandInput) -> None:
    """Decks have no goals, boundaries and maps."""
    if source.changes or source.map_options:
        raise InputError(f"{source.file} is a deck: options that change a scene do nothing to it; remove them")


def open_deck(source: CommandInput, *, names: bool = True) -> Circuit:
    """Read a deck, or a network as if it were one; with ``names``, names that are given twice are noted."""
    refuse_scene_options(source)
    path = Path(source.file)
    size = path.stat().st_size if path.is_file() else 0
    with stage("read the deck", seconds=0.5 + _READ_SECONDS * size):
        circuit = sys.stdin.buffer if source.file == "-" else path
        deck = rg.read_spice(circuit, dialect=source.dialect, root=source.root)
    if names:
        from resgrid.spice.check.erc import repeated_names

        deck = replace(deck, notes=(*deck.notes, *repeated_names(deck)))
    _say_notes(deck)
    return deck


def _say_notes(deck: Circuit) -> None:
    """What the reader noted: warnings always, the rest on request."""
    warnings = [note for note in deck.notes if note.severity != "info"]
    for note in warnings[:_NOTES]:
        say(f"{note.severity}: {note}")
    if len(warnings) > _NOTES:
        say(f"and {len(warnings) - _NOTES:,} more; --json lists them all")
    for note in deck.notes:
        if note.severity == "info":
            detail(str(note))


def solve_deck(deck: Circuit, method: str = "auto") -> rg.OperatingPoint:
    """Solve a deck; as `resgrid.solve`, but where there is no answer the message names the lines at fault."""
    try:
        with stage("assemble it"):
            netlist = deck.netlist()
        seconds = 0.5 + _SOLVE_SECONDS * len(netlist.conductance)
        op: rg.OperatingPoint = compute("solve the deck", partial(rg.solve, method=method), netlist, seconds=seconds)
        return op
    except CircuitError as error:
        errors = [finding for finding in rg.check_erc(deck) if finding.severity == "error"]
        lines = (f"{finding.place}: {finding.message}; {finding.remedy}" for finding in errors[:_NOTES])
        raise CircuitError("\n".join(lines) or str(error)) from error


def deck_data(deck: Circuit) -> dict[str, Any]:
    """What a deck holds, as ``--json`` gives it."""
    return {
        "source": deck.path,
        "title": deck.title,
        "dialect": deck.dialect,
        "files": list(deck.files),
        "nodes": deck.node_count,
        **{f"{kind.replace(' ', '_')}s": len(ends) for kind, ends in deck.ends.items()},
        "subcircuits": list(deck.subcircuits),
        "temperature": deck.temperature,
        "options": dict(deck.options),
        "notes": [asdict(note) for note in deck.notes],
    }
