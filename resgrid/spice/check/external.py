"""Safe simulator input for decks that resgrid did not write, and the expected results by the simulator's names.

A deck that is safe to run is left unchanged except for its analyses; any other deck is written again from the circuit.
ngspice looks for an included file in the folder it runs in and in the folder of the including file, wherever these
names lead.  The included files are therefore resolved first, by the same rule but only below a root folder, and copied
to the same relative paths.  A name that is not plainly a path below that folder is rejected, and so is a line that
could run a command.
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
    """Input of a simulator for a deck that resgrid did not write.

    `data`: content of the deck, with the operating point as its only analysis; `why`: empty if `data` is the original
    deck except for analyses, otherwise the reason why `data` is a flat deck written from the circuit; `files`: content
    of the included files by their paths relative to the simulator's working folder; `place`: path of the deck relative
    to this folder.
    """

    data: bytes
    why: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    place: str = "deck.cir"


def runnable(deck: Circuit, data: bytes | None, *, root: Path | None, engine: str) -> Runnable:
    """Return a safe simulator input for a deck, with the operating point as the only analysis.

    Lines of analyses and outputs are replaced by comments; all other lines are kept byte for byte, in their own files.
    A deck that is not safe to run, that the engine cannot run, or that has no file is replaced by a flat deck of the
    circuit.  `data`: content of the deck's file, None without a file; `root`: folder that must contain all included
    files, None for the deck's own folder; `engine`: program that simulates, "ngspice" or "eecircuit".
    """
    path = Path(deck.path).resolve()
    root = path.parent if root is None else root.resolve()
    try:
        if data is None:
            raise InputError(f"the file {deck.path} does not exist")
        files = _safe_files(deck, path, data, root, engine)
    except InputError as error:
        return Runnable(rewritten(deck), str(error))
    if not files:
        return Runnable(_only_operating_point(data))
    bare = {place: b"\n".join(_without_analyses(content.split(b"\n"))) for place, content in files.items()}
    return Runnable(_only_operating_point(data), "", bare, path.relative_to(root).as_posix())


def rewritten(deck: Circuit) -> bytes:
    """Return the content of a flat ngspice deck of a circuit, with an operating point as its only analysis."""
    text = flatten(deck.netlist(), dialect=SIMULATED, title=f"{deck.title or deck.path}, as read").text
    return _only_operating_point(text.encode("ascii"))


def _safe_files(deck: Circuit, path: Path, data: bytes, root: Path, engine: str) -> dict[str, bytes]:
    """Return the content of all included files, by path relative to `root`; raise InputError for an unsafe deck.

    Without included files the result is empty.  A deck is also rejected if it is written for another dialect, or if the
    engine cannot read included files.  `deck, path, data`: circuit, path and content of the deck; `root`: folder that
    must contain the included files; `engine`: program that simulates, "ngspice" or "eecircuit".
    """
    if not deck.is_deck:
        raise InputError("it is not a deck, and no simulator reads it")
    if deck.dialect != SIMULATED:
        raise InputError(f"it is written for {deck.dialect}, and only {SIMULATED} is run here")
    refuse_commands(data, deck.path, models=True, includes=len(deck.files) > 1)
    if len(deck.files) == 1:
        return {}
    if engine != _TAKES_FILES:
        raise InputError(f"it includes other files, which the engine {engine} cannot read")
    if not path.is_relative_to(root):
        raise InputError(f"it includes other files, and lies outside {str(root)!r}")
    return _gather_includes(path, data, root)


def _only_operating_point(data: bytes) -> bytes:
    """Return the content of a deck with all analyses and outputs replaced by one operating point.

    The first line is kept as the title, or replaced by a comment if it is blank.  `data`: content of the deck.
    """
    rows = data.split(b"\n")
    title = rows[0] if rows[0].strip() else b"* untitled"
    return b"\n".join([title, *_without_analyses(rows[1:]), b".options klu", b".op", b".end", b""])


def _without_analyses(rows: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the lines `rows` of a deck, with the comment ``*`` in place of each line of an analysis or output."""
    dropping = False
    for row in rows:
        word = row.lstrip()
        if word and not word.startswith((b"*", b"+")):
            dropping = _ANALYSIS.match(word) is not None
        yield b"*" if dropping and word else row


def _gather_includes(deck: Path, data: bytes, root: Path) -> dict[str, bytes]:
    """Return the content of every file that a simulator may include, by path relative to `root`.

    `deck, data`: path and content of the deck, which is not part of the result; `root`: folder that must contain all
    files.  Raises InputError for a file that could run commands or lies outside `root`, and for more than 200 files.
    """
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
                    raise InputError(f"{deck} includes more than {MAX_FILES} files")
                files[place] = deck_bytes(other, str(other))
                refuse_commands(b"\n" + files[place], place, models=True, includes=True)
                todo.append((other, files[place]))
    return files


def _names(path: Path, data: bytes) -> Iterator[str]:
    """Yield the names of the files that a file of a deck includes.

    Raises InputError for a name that is not a plain relative path, and for a carriage return inside a line.  `path`:
    path of the file, for messages; `data`: content of the file.
    """
    lone = _LONE_RETURN.search(data)
    if lone is not None:
        number = data.count(b"\n", 0, lone.start()) + 1
        raise InputError(f"{path.name}, line {number}: a carriage return stands inside the line")
    for line in _INCLUDING.finditer(data):
        match = _NAME.match(data, line.end())
        name = "" if match is None else next(group for group in match.groups() if group is not None).decode("latin-1")
        if not _is_plain(name):
            number = data.count(b"\n", 0, line.start(1)) + 1
            raise InputError(f"{path.name}, line {number}: {name!r} is not a plain name of a file in the deck's folder")
        yield name


def _is_plain(name: str) -> bool:
    """Return whether a file name is a relative path of harmless words between slashes, shorter than 256 characters.

    A harmless word consists of letters, digits and ``_.+,@=#%-``, and after the first character also of blanks.  At
    most 8 (`MAX_ASCENT`) leading words may be ``..``, other words may not.
    """
    words = name.split("/")
    steps = next((i for i, word in enumerate(words) if word != ".."), len(words))
    rest = words[steps:]
    plain = all(_WORD.fullmatch(word) and word != ".." for word in rest)
    return plain and bool(rest) and steps <= MAX_ASCENT and len(name) < 256


def _places(name: str, path: Path, root: Path) -> Iterator[Path]:
    """Yield the existing files that an included name can mean: in the including file's folder, and in `root`.

    `name`: the name; `path`: path of the including file; `root`: folder that must contain all included files.  Raises
    InputError for a file outside `root` and for a symbolic link.
    """
    for folder in dict.fromkeys((path.parent, root)):
        place = Path(os.path.normpath(folder / name))
        if not place.exists():
            continue
        if not place.is_relative_to(root):
            if folder == root and path.parent != root:
                continue  # the file is not copied either, so the simulator does not find it there
            raise InputError(f"{name!r} lies outside {str(root)!r}")
        if place.resolve() != place:
            raise InputError(f"{name!r} is a symbolic link, or lies below one")
        yield place


def expected_of(deck: Circuit, op: OperatingPoint, *, as_written: bool) -> Expected:
    """Return the expected voltages and source currents of a deck by the names that the simulator uses.

    `deck`: the circuit that was read; `op`: operating point of the circuit; `as_written`: True if the simulator runs
    the file of the deck itself, so that the names are those of the file in lower case; False if it runs a deck written
    from the circuit, so that the names are those of the written deck.
    """
    if not as_written:
        return expect(flatten(op.netlist, dialect=SIMULATED), op)
    nodes = np.flatnonzero(np.isfinite(op.voltage))[1:]
    voltage = {deck.node_names[node].lower(): float(op.voltage[node]) for node in nodes.tolist()}
    amps = op.source_current[: len(deck.source_volts)].tolist()
    names = map(ngspice_name, deck.element_names["voltage source"])
    return Expected.of(op, voltage, dict(zip(names, amps, strict=True)))


def place_of(deck: Circuit, name: str) -> str:
    """Return the place (``file:line: ``) of the first element at a node of a deck, an empty string for an unknown node.

    `name`: name of the node in lower case.
    """
    numbers = [number for number, spelt in enumerate(deck.node_names) if spelt.lower() == name]
    return f"{deck.place_of_nodes(np.array(numbers))}: " if numbers else ""
