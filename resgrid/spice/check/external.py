"""Decks that someone else wrote, held against a simulator: as they stand, where that is safe, otherwise as read.

ngspice looks for a file in the folder it runs in and in that of the file that includes it, wherever these names lead:
so they are followed here first, by the same rule and no further than a root, and copied by their places below it.
Anything that is not plainly a name in that folder is refused, and so is what could run a command.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.errors import InputError
from resgrid.spice.circuit import Circuit
from resgrid.spice.dialects.ngspice import ngspice_name
from resgrid.spice.read.files import MAX_FILES, deck_bytes
from resgrid.spice.run import SIMULATED
from resgrid.spice.run.ngspice import MAX_ASCENT, refuse_commands
from resgrid.spice.write.flat import flatten
from resgrid.spice.write.sidecar import Expected, expect

_TAKES_FILES = "ngspice"
_ANALYSIS = re.compile(
    rb"\.(?:op|tran|ac|dc|noise|tf|pz|sens|disto|four|fourier|meas|measure|print|plot|probe|save|sp|pss|end)\b",
    re.IGNORECASE,
)
_INCLUDING = re.compile(rb"^\s*\.(inc|lib)\w*", re.IGNORECASE | re.MULTILINE)
_NAME = re.compile(rb"[ \t]+(?:\"([^\"\n]*)\"|'([^'\n]*)'|([^\s\"']+))")
_LONE_RETURN = re.compile(rb"\r(?!\n)")
_WORD = re.compile(r"[\w.+,@=#%-][\w.+,@=#% -]*")


@dataclass(frozen=True, eq=False)
class Runnable:
    """What a simulator is given for someone else's deck.

    `data`: with one analysis, the operating point; `why`: why it is not the deck itself, but what was read of it,
    written anew and flat; empty if it is; `files`: what it includes, by places in the folder it is run in; `place`: its
    own place there.
    """

    data: bytes
    why: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    place: str = "deck.cir"


def runnable(deck: Circuit, data: bytes | None, *, root: Path | None, engine: str) -> Runnable:
    """Make a deck safe to run, with its operating point as the only analysis.

    Only the lines of its analyses and outputs are taken out; everything else is run byte for byte, in the files that
    hold it.
    """
    path = Path(deck.path).resolve()
    root = path.parent if root is None else root.resolve()
    try:
        if data is None:
            raise InputError(f"there is no file {deck.path} that could be run")
        files = _safe_files(deck, path, data, root, engine)
    except InputError as error:
        return Runnable(written_anew(deck), str(error))
    if not files:
        return Runnable(_only_operating_point(data))
    bare = {place: b"\n".join(_without_analyses(content.split(b"\n"))) for place, content in files.items()}
    return Runnable(_only_operating_point(data), "", bare, path.relative_to(root).as_posix())


def written_anew(deck: Circuit) -> bytes:
    """What was read of a deck, flat, for the simulator that is run."""
    text = flatten(deck.netlist(), dialect=SIMULATED, title=f"{deck.title or deck.path}, as read").text
    return _only_operating_point(text.encode("ascii"))


def _safe_files(deck: Circuit, path: Path, data: bytes, root: Path, engine: str) -> dict[str, bytes]:
    """What a deck includes."""
    if not deck.is_deck:
        raise InputError("it is no deck, and no simulator reads it")
    if deck.dialect != SIMULATED:
        raise InputError(f"it is written for {deck.dialect}, and only {SIMULATED} is run here")
    refuse_commands(data, deck.path, models=True, includes=len(deck.files) > 1)
    if len(deck.files) == 1:
        return {}
    if engine != _TAKES_FILES:
        raise InputError(f"it includes other files, which the engine {engine} cannot be given")
    if not path.is_relative_to(root):
        raise InputError(f"it includes other files, and lies outside {str(root)!r}")
    return _gather_includes(path, data, root)


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


def _gather_includes(deck: Path, data: bytes, root: Path) -> dict[str, bytes]:
    """Every file that a simulator may read for a deck, by its place below the root; the deck itself is left out."""
    files: dict[str, bytes] = {}
    todo = [(deck, data)]
    while todo:
        path, content = todo.pop()
        for name in _names(path, content):
            for other in _places(name, path, root):
                place = other.relative_to(root).as_posix()
                if place in files or other == deck:
                    continue
                if len(files) >= MAX_FILES:
                    raise InputError(f"{deck}: more than {MAX_FILES} files are included")
                files[place] = deck_bytes(other, str(other))
                refuse_commands(b"\n" + files[place], place, models=True, includes=True)
                todo.append((other, files[place]))
    return files


def _names(path: Path, data: bytes) -> Iterator[str]:
    """Names in the lines that include files, each found to be plain."""
    lone = _LONE_RETURN.search(data)
    if lone is not None:
        number = data.count(b"\n", 0, lone.start()) + 1
        raise InputError(f"{path.name}, line {number}: a carriage return stands inside the line")
    for line in _INCLUDING.finditer(data):
        match = _NAME.match(data, line.end())
        name = "" if match is None else next(group for group in match.groups() if group is not None).decode("latin-1")
        if not _is_plain(name):
            number = data.count(b"\n", 0, line.start(1)) + 1
            raise InputError(f"{path.name}, line {number}: {name!r} is no plain name of a file in the deck's folder")
        yield name


def _is_plain(name: str) -> bool:
    """Whether a name is one of a file below, perhaps after some steps up, and means the same wherever it is read."""
    words = name.split("/")
    steps = next((i for i, word in enumerate(words) if word != ".."), len(words))
    rest = words[steps:]
    plain = all(_WORD.fullmatch(word) and word != ".." for word in rest)
    return plain and bool(rest) and steps <= MAX_ASCENT and len(name) < 256


def _places(name: str, path: Path, root: Path) -> Iterator[Path]:
    """The files that a name may mean: in the folder of the file that includes it, and in the root."""
    for folder in dict.fromkeys((path.parent, root)):
        place = Path(os.path.normpath(folder / name))
        if not place.exists():
            continue
        if not place.is_relative_to(root):
            if folder == root and path.parent != root:
                continue  # not what is meant; nor is it there where the deck is run
            raise InputError(f"{name!r} lies outside {str(root)!r}")
        if place.resolve() != place:
            raise InputError(f"{name!r} is reached by a link")
        yield place


def expected_of(deck: Circuit, op: OperatingPoint, *, as_written: bool) -> Expected:
    """What a simulator should find in a deck, by the names it gives; as `expect` otherwise."""
    if not as_written:
        return expect(flatten(op.netlist, dialect=SIMULATED), op)
    nodes = np.flatnonzero(np.isfinite(op.voltage))[1:]
    voltage = {deck.node_names[node].lower(): float(op.voltage[node]) for node in nodes.tolist()}
    amps = op.source_current[: len(deck.source_volts)].tolist()
    names = map(ngspice_name, deck.element_names["voltage source"])
    return Expected.of(op, voltage, dict(zip(names, amps, strict=True)))


def place_of(deck: Circuit, name: str) -> str:
    """Where a node, by its folded name, first occurs in a deck."""
    numbers = [number for number, spelt in enumerate(deck.node_names) if spelt.lower() == name]
    return f"{deck.place_of_nodes(np.array(numbers))}: " if numbers else ""
