"""Reading a deck: from a file to a `ParsedDeck`."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import IO

from resgrid.errors import InputError
from resgrid.spice.parsed import ParsedDeck
from resgrid.spice.read.assemble import assemble_deck
from resgrid.spice.read.collect import Collector
from resgrid.spice.read.diagnostics import Journal
from resgrid.spice.read.files import Library, Source, read_bytes
from resgrid.spice.read.plain import LEAST_BYTES
from resgrid.spice.read.rules import guess_dialect, rules_named

_HEAD = 4096
_STATED = re.compile(rb'"dialect": "([a-z]+)"')


def read_spice(
    path: str | os.PathLike[str] | IO[str] | IO[bytes],
    *,
    dialect: str = "auto",
    root: str | os.PathLike[str] | None = None,
    max_elements: int | None = None,
) -> ParsedDeck:
    r"""Read a resistive deck.

    Resistors, independent sources, capacitors (open), inductors (shorts) and switches with a known control voltage are
    read, in subcircuits with parameters too; everything else is refused with its place.

    Parameters
    ----------
    path : path-like or text file
        The deck.
    dialect : {"auto", "ngspice", "ltspice", "xyce", "hspice"}
        Whose rules to read it by; ``"auto"`` asks the deck's sidecar, then its text for signs; ngspice without.
    root : path-like, optional
        Folder below which files may be included; by default the deck's own.  Links are resolved before.
    max_elements : int, optional
        How many elements subcircuits may be expanded to; by default 500,000, or 5,000 a line if that is more, and at
        most 20 million.

    Returns
    -------
    ParsedDeck

    Raises
    ------
    InputError
        If it cannot be read or understood; up to 20 errors, a line each, with file, line and column.
    BudgetError
        If it grows too large when its subcircuits are expanded.

    Examples
    --------
    >>> import io
    >>> deck = read_spice(io.StringIO("divider\nV1 in 0 2\nR1 in out 1k\nR2 out gnd 1k\n"))
    >>> deck.title, deck.node_names, deck.resistance.tolist()
    ('divider', ('0', 'in', 'out'), [1000.0, 1000.0])
    """
    return read_with(path, dialect=dialect, root=root, max_elements=max_elements)


def read_with(
    path: str | os.PathLike[str] | IO[str] | IO[bytes],
    *,
    dialect: str = "auto",
    root: str | os.PathLike[str] | None = None,
    max_elements: int | None = None,
    least_bytes: int = LEAST_BYTES,
) -> ParsedDeck:
    """Read a deck as `read_spice`; files of at least so many bytes go through the compiled loops."""
    if dialect != "auto":
        rules_named(dialect)
    library, source = _open(path, root)
    rules = rules_named(_stated_dialect(source) or guess_dialect(source.data) if dialect == "auto" else dialect)
    collector = Collector(library, rules, Journal(), quick=len(source.data) >= least_bytes)
    try:
        collector.deck(source)
        return assemble_deck(collector, source, max_elements)
    except RecursionError:
        raise InputError(f"{source.name}: something in it is nested too deeply to be read") from None


def _open(
    path: str | os.PathLike[str] | IO[str] | IO[bytes], root: str | os.PathLike[str] | None
) -> tuple[Library, Source]:
    folder = None if root is None else _folder(root)
    if not isinstance(path, str | os.PathLike):
        content = path.read()
        data = content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content
        name = getattr(path, "name", None)
        library = Library(folder)
        return library, library.add(name if isinstance(name, str) else "<text>", None, data)
    name = os.fspath(path)
    data = read_bytes(Path(name), name)
    resolved = Path(name).resolve()
    library = Library(resolved.parent if folder is None else folder)
    return library, library.add(name, resolved, data)


def _folder(root: str | os.PathLike[str]) -> Path:
    try:
        folder = Path(root).resolve()
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"the root {os.fspath(root)!r} cannot be used: {error}") from None
    if not folder.is_dir():
        raise InputError(f"the root {os.fspath(root)!r} is no folder")
    return folder


def _stated_dialect(source: Source) -> str | None:
    """Dialect in the sidecar of a deck, if there is one that says it."""
    if source.path is None:
        return None
    try:
        with source.path.with_name(source.path.name + ".json").open("rb") as sidecar:
            found = _STATED.search(sidecar.read(_HEAD))
    except OSError:
        return None
    return found.group(1).decode() if found is not None else None
