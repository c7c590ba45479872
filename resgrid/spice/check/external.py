"""Decks that someone else wrote, held against a simulator: as they stand, where that is safe, otherwise as read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from resgrid.errors import InputError
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.check.inclusion import gather_includes
from resgrid.spice.parsed import ParsedDeck, ngspice_name
from resgrid.spice.run.ngspice import refuse_commands
from resgrid.spice.subject import subject_of
from resgrid.spice.write.expected import Expected, expect

_TAKES_FILES = "ngspice"
_ANALYSIS = re.compile(
    rb"\.(?:op|tran|ac|dc|noise|tf|pz|sens|disto|four|fourier|meas|measure|print|plot|probe|save|step|sp|pss|end)\b",
    re.IGNORECASE,
)


@dataclass(frozen=True, eq=False)
class Runnable:
    """What a simulator is given for someone else's deck.

    `data`: with one analysis, the operating point; `as_written`: whether it is the deck itself; otherwise it is what
    was read, written anew and flat; `why`: why not, empty if it is; `files`: what it includes, by places in the
    folder it is run in; `place`: its own place there.
    """

    data: bytes
    as_written: bool
    why: str
    files: Mapping[str, bytes] = field(default_factory=dict)
    place: str = "deck.cir"


def runnable(deck: ParsedDeck, data: bytes, *, root: Path | None = None, engine: str = "ngspice") -> Runnable:
    """Make a deck safe to run, with its operating point as the only analysis.

    Only the lines of its analyses and outputs are taken out; everything else is run byte for byte, in the files that
    hold it.
    """
    path = Path(deck.path).resolve()
    root = path.parent if root is None else root.resolve()
    try:
        files = _safe_files(deck, path, data, root, engine)
    except InputError as error:
        return rewritten(deck, str(error))
    if not files:
        return Runnable(_only_operating_point(data), True, "")
    bare = {place: b"\n".join(_without_analyses(content.split(b"\n"))) for place, content in files.items()}
    return Runnable(_only_operating_point(data), True, "", bare, path.relative_to(root).as_posix())


def rewritten(deck: ParsedDeck, why: str) -> Runnable:
    """What was read of a deck, written anew."""
    from resgrid.spice.write.flat import flatten

    text = flatten(deck.netlist(), title=f"{deck.title or deck.path}, as read").text
    return Runnable(_only_operating_point(text.encode("ascii")), False, why)


def _safe_files(deck: ParsedDeck, path: Path, data: bytes, root: Path, engine: str) -> dict[str, bytes]:
    """What a deck includes."""
    if deck.dialect != "ngspice":
        raise InputError(f"it is written for {deck.dialect}, and only ngspice is run here")
    refuse_commands(data, deck.path, models=True, includes=len(deck.files) > 1)
    if len(deck.files) == 1:
        return {}
    if engine != _TAKES_FILES:
        raise InputError(f"it includes other files, which the engine {engine} cannot be given")
    if not path.is_relative_to(root):
        raise InputError(f"it includes other files, and lies outside {str(root)!r}")
    return gather_includes(path, data, root)


def _only_operating_point(data: bytes) -> bytes:
    """Every analysis and output is left out, the first line, the title, never."""
    rows = data.split(b"\n")
    title = rows[0] if rows[0].strip() else b"* untitled"
    return b"\n".join([title, *_without_analyses(rows[1:]), b".options klu", b".op", b".end", b""])


def _without_analyses(rows: Iterable[bytes]) -> Iterator[bytes]:
    """Lines that ask for nothing; a comment takes the place of one that does."""
    dropping = False
    for row in rows:
        word = row.lstrip()
        if word and not word.startswith((b"*", b"+")):
            dropping = _ANALYSIS.match(word) is not None
        yield b"*" if dropping and word else row


def expected_of(deck: ParsedDeck, point: OperatingPoint, *, as_written: bool) -> Expected:
    """What a simulator should find in a deck, by the names it gives; as `expect` otherwise."""
    from resgrid.spice.write.flat import flatten

    if not as_written:
        return expect(flatten(point.netlist), point)
    nodes = np.flatnonzero(np.isfinite(point.voltage))[1:]
    voltage = {deck.node_names[node].lower(): float(point.voltage[node]) for node in nodes.tolist()}
    amps = point.source_current[: len(deck.source_volts)]
    names = map(ngspice_name, deck.element_names["voltage source"])
    return Expected.of(point, voltage, dict(zip(names, amps.tolist(), strict=True)))


def places_of(deck: ParsedDeck, names: Iterator[str]) -> dict[str, str]:
    """Where some nodes, by their folded names, first occur in a deck."""
    wanted = set(names)
    subject = subject_of(deck)
    number = {name.lower(): i for i, name in enumerate(deck.node_names) if name.lower() in wanted}
    return {name: subject.place_of_nodes(np.array([node])) for name, node in number.items()}
