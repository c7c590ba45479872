"""Functions of subcommands that accept decks in place of scenes: recognise, read, solve and describe a deck."""

from __future__ import annotations

import io
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import resgrid as rg
from resgrid.cli.streams import STANDARD_INPUT, standard_input
from resgrid.cli.terminal import compute, detail, say, stage
from resgrid.errors import CircuitError, InputError
from resgrid.spice.dialects import DECK_SUFFIXES

if TYPE_CHECKING:
    from resgrid.cli.options import CommandInput
    from resgrid.spice.circuit import Circuit

_READ_SECONDS, _SOLVE_SECONDS = 3e-8, 6e-6
"""Approximate time for reading a byte of a deck, and for solving per resistor, in seconds, for the progress bar."""

_MAX_NOTES = 20
"""Largest number of warnings of a deck's reader, or of electrical errors, that are printed."""


def is_deck(source: CommandInput) -> bool:
    """Return whether an input is a circuit instead of a scene.

    A file is a circuit if its suffix is that of a deck, if it is a network (edge list, graph or Circuitscape
    configuration), or if the file has a sidecar (``FILE.json``).  With the option ``--read-as``, standard input and
    every file except scenes (``.toml``, shipped scenes and links) are circuits.
    """
    from resgrid.scene.shipped import shipped_scene
    from resgrid.spice.read.deck import is_network

    if source.file == "-":
        return source.dialect != "auto"
    path = Path(source.file)
    if path.suffix.lower() in DECK_SUFFIXES or is_network(source.file, source.dialect):
        return True
    if source.dialect != "auto":
        return path.suffix.lower() != ".toml" and "://" not in source.file and shipped_scene(source.file) is None
    return path.name != "" and path.with_name(path.name + ".json").is_file()


def refuse_scene_options(source: CommandInput, kind: str = "deck") -> None:
    """Raise InputError if options of scenes or maps are given together with an input of another kind.

    `kind`: the kind of the input in the message.
    """
    if source.changes or source.map_options:
        raise InputError(f"{source.name} is a {kind}: options for keys of scenes and maps have no effect; remove them")


def refuse_deck_options(source: CommandInput, kind: str) -> None:
    """Raise InputError if ``--read-as`` or ``--root`` is given with an input that is not a deck; `kind`: its kind."""
    if source.dialect != "auto" or source.root is not None:
        raise InputError(f"{source.name} is {kind}, not a deck: --read-as and --root are for decks; remove them")


class _NamedStream(io.BytesIO):
    """The content of standard input, with the name that messages state."""

    name = STANDARD_INPUT


def open_deck(source: CommandInput, *, names: bool = True) -> Circuit:
    """Return the circuit of a deck or a network, and print the notes (warnings and remarks) of its reader.

    `source`: the input with its options; `names`: whether the circuit gets a note for every name that several elements
    have.
    """
    refuse_scene_options(source)
    path = Path(source.file)
    if path.is_file():
        _refuse_schematic(path)
    size = path.stat().st_size if path.is_file() else 0
    with stage("read the deck", seconds=0.5 + _READ_SECONDS * size):
        circuit = _NamedStream(standard_input().read()) if source.file == "-" else path
        deck = rg.read_spice(circuit, dialect=source.dialect, root=source.root)
    if names:
        from resgrid.spice.check.erc import repeated_names

        deck = replace(deck, notes=(*deck.notes, *repeated_names(deck)))
    _say_notes(deck)
    return deck


def _refuse_schematic(path: Path) -> None:
    """Raise InputError, with a remedy, for a schematic of LTspice that ``--read-as`` declares to be a deck."""
    from resgrid.scene.maps.formats import format_of, is_schematic

    if is_schematic(path):
        format_of(path, {})


def _say_notes(deck: Circuit) -> None:
    """Print the notes of a deck's reader: warnings always, remarks only with the option ``--verbose``."""
    warnings = [note for note in deck.notes if note.severity != "info"]
    for note in warnings[:_MAX_NOTES]:
        say(f"{note.severity}: {note}")
    if len(warnings) > _MAX_NOTES:
        say(f"and {len(warnings) - _MAX_NOTES:,} more; --json lists all notes")
    for note in deck.notes:
        if note.severity == "info":
            detail(str(note))


def solve_deck(deck: Circuit, method: str = "auto", threads: int = 1) -> rg.OperatingPoint:
    """Return the operating point of a deck.

    `method`: solution method, "auto", "direct" or "multigrid"; `threads`: largest number of threads.  Raises
    CircuitError, whose message lists the lines of electrical errors, if the circuit has no solution.
    """
    try:
        with stage("assemble the equations"):
            netlist = deck.netlist()
        seconds = 0.5 + _SOLVE_SECONDS * len(netlist.conductance)
        work = partial(rg.solve, method=method, threads=threads)
        op: rg.OperatingPoint = compute("solve the deck", work, netlist, seconds=seconds)
        return op
    except CircuitError as error:
        errors = [finding for finding in rg.check_erc(deck) if finding.severity == "error"]
        lines = (f"{finding.place}: {finding.message}; {finding.remedy}" for finding in errors[:_MAX_NOTES])
        raise CircuitError("\n".join(lines) or str(error)) from error


def deck_data(deck: Circuit) -> dict[str, Any]:
    """Return the description of a deck as a dictionary for JSON.

    Keys: ``source`` (path), ``title``, ``dialect``, ``files`` (names of the deck and its included files), ``nodes`` and
    the plural of every kind of element (counts), ``subcircuits`` (names), ``temperature`` (degrees Celsius),
    ``options`` (values by name) and ``notes`` of the reader (dictionaries with the fields of `Note`, such as
    ``severity``, ``file``, ``line`` and ``text``).
    """
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
