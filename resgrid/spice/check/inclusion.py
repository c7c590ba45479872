"""The files that somebody's deck includes, gathered so that a simulator can be given them as they are.

ngspice looks for a file in the folder it runs in and in that of the file that includes it, wherever these names lead:
so they are followed here first, by the same rule and no further than a root, and copied by their places below it.
Anything that is not plainly a name in that folder is refused, and so is what could run a command.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from resgrid.errors import InputError
from resgrid.spice.read.files import MAX_FILES, read_bytes
from resgrid.spice.run.ngspice import MAX_ASCENT, refuse_commands

_INCLUDING = re.compile(rb"^\s*\.(inc|lib)\w*", re.IGNORECASE | re.MULTILINE)
_NAME = re.compile(rb"[ \t]+(?:\"([^\"\n]*)\"|'([^'\n]*)'|([^\s\"']+))")
_LONE_RETURN = re.compile(rb"\r(?!\n)")
_WORD = re.compile(r"[\w.+,@=#%-][\w.+,@=#% -]*")


def gather_includes(deck: Path, data: bytes, root: Path) -> dict[str, bytes]:
    """Every file that a simulator may read for a deck, by its place below the root; the deck itself is left out."""
    found: dict[str, bytes] = {}
    todo = [(deck, data)]
    while todo:
        path, content = todo.pop()
        for name in _names(path, content):
            for other in _places(name, path, root):
                place = other.relative_to(root).as_posix()
                if place in found or other == deck:
                    continue
                if len(found) >= MAX_FILES:
                    raise InputError(f"{deck}: more than {MAX_FILES} files are included")
                found[place] = read_bytes(other, str(other))
                refuse_commands(b"\n" + found[place], place, models=True, includes=True)
                todo.append((other, found[place]))
    return found


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
