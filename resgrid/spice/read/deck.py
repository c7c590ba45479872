"""`read_spice`: circuits from decks, edge lists, Circuitscape configurations, graphs and arrays."""

from __future__ import annotations

import os
import re
from itertools import chain
from pathlib import Path
from typing import IO

from resgrid.errors import InputError
from resgrid.spice.circuit import Circuit
from resgrid.spice.dialects import DIALECTS, dialect_named
from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.networks.circuitscape import read_circuitscape
from resgrid.spice.networks.edges import is_edge_list, read_edges
from resgrid.spice.networks.graph_files import GRAPH_SUFFIXES, read_graph
from resgrid.spice.read.assemble import assemble_deck
from resgrid.spice.read.collector import Collector
from resgrid.spice.read.commands import Contents
from resgrid.spice.read.diagnostics import Diagnostics
from resgrid.spice.read.files import Library, SourceFile, deck_bytes, resolve
from resgrid.spice.read.plain_cards import LEAST_BYTES

_HEAD = 4096
"""Number of bytes at the beginning of a sidecar that are searched for the name of the dialect."""

_LOOKED_AT = 65536
"""Number of bytes at the beginning, and at the end, of a deck that are searched for text of one dialect only."""

_STATED = re.compile(rb'"dialect": "([a-z]+)"')


def read_spice(
    file: str | os.PathLike[str] | IO[str] | IO[bytes],
    *,
    dialect: str = "auto",
    root: str | os.PathLike[str] | None = None,
    max_elements: int | None = None,
    measure: str | None = None,
    sources: str | os.PathLike[str] | None = None,
    grounds: str | os.PathLike[str] | None = None,
) -> Circuit:
    r"""Read a resistive circuit: a deck, an edge list, a Circuitscape configuration, a graph, or a netlist's arrays.

    A deck may hold resistors, independent sources, capacitors (open), inductors (shorts), switches with a known control
    voltage, nonlinear resistors ``I0 tanh(V/V0)`` in the form of `write_spice`, and subcircuits with parameters.  Other
    elements are errors with their position.

    The suffix decides about other formats.  ``.ini`` is a Circuitscape configuration in advanced mode.  ``.graphml``,
    node-link ``.json`` and ``.npz`` hold whole netlists.  ``.csv`` and ``.tsv`` are edge lists, and ``.txt`` is one if
    it begins with such a line: each line is ``node node ohms``, or siemens below a heading ``conductance``; ground is
    the node ``ground``.

    Parameters
    ----------
    file : path-like or open file
        The circuit: a path, or a deck as a text or binary file object.
    dialect : {"auto", "ngspice", "ltspice", "xyce", "hspice", "spectre"}
        Simulator whose rules apply to a deck; a file with another suffix than those of networks is then read as a deck,
        also a ``.txt`` file.  ``"auto"`` takes the dialect of the deck's sidecar, or else the one that
        its suffix or its text indicates, or else ngspice.
    root : path-like, optional
        Folder that must contain all include files, with links resolved; by default the deck's own folder.  The includes
        of an open file are rejected without `root`.
    max_elements : int, optional
        Maximum number of elements after the expansion of subcircuits.  The default is 500,000, or 5,000 per line if
        that is more, and at most 20 million.
    measure : {"resistance", "conductance"}, optional
        Quantity of the numbers in an edge list and its grounds; by default that of the heading, or else resistance.
    sources : path-like, optional
        For an edge list: file with lines ``node amperes``, positive for a current injected into the node.
    grounds : path-like, optional
        For an edge list: file with lines ``node ohms`` (or siemens) to ground; 0 ohm holds the node at 0 V.

    Returns
    -------
    Circuit
        Circuit as the file states it, with element names, line numbers and remarks.

    Raises
    ------
    InputError
        If the file cannot be read, or has errors.  For a deck, the message lists up to 20 errors, one per line, with
        file, line and column.
    BudgetError
        If the expanded circuit exceeds `max_elements`.

    Examples
    --------
    >>> import io
    >>> deck = rg.read_spice(io.StringIO("divider\nV1 in 0 2\nR1 in out 1k\nR2 out gnd 1k\n"))
    >>> deck.title, deck.node_names, deck.resistance.tolist()
    ('divider', ('0', 'in', 'out'), [1000.0, 1000.0])
    >>> rg.solve(deck).voltage
    array([0., 2., 1.])
    """
    tables = measure is not None or sources is not None or grounds is not None
    if not isinstance(file, str | os.PathLike) or not (tables or is_network(file, dialect)):
        return read_with(file, dialect=dialect, root=root, max_elements=max_elements)
    name = os.fspath(file)
    suffix = Path(file).suffix.lower()
    _refuse_deck_options(name, suffix, dialect, root)
    if suffix not in (*GRAPH_SUFFIXES, ".ini"):
        return Circuit.of(read_edges(file, sources, grounds, measure, measure).netlist(), name)
    if tables:
        raise InputError(f"{name} names its own sources, grounds and measure; leave those options out")
    netlist = read_graph(file) if suffix != ".ini" else read_circuitscape(file, root=root)[0].netlist()
    return Circuit.of(netlist, name)


def is_network(path: str | os.PathLike[str], dialect: str = "auto") -> bool:
    """Return whether a file is a graph, arrays, a Circuitscape configuration or an edge list, and not a deck.

    `dialect`: dialect of the file; any value other than "auto" means that a ``.txt`` file is a deck.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".txt":
        return dialect == "auto" and is_edge_list(path)
    return suffix in (".csv", ".tsv", ".ini", *GRAPH_SUFFIXES)


def _refuse_deck_options(name: str, suffix: str, dialect: str, root: str | os.PathLike[str] | None) -> None:
    """Raise InputError for a dialect or a root of a network, where these have no effect.

    `name`, `suffix`: name of the network's file and its suffix; a Circuitscape configuration (.ini) has a root.
    """
    if dialect != "auto":
        raise InputError(
            f"{name} is a network by its suffix, and has no dialect: remove --read-as (in Python: dialect=), or rename "
            "the file if it is a deck"
        )
    if root is not None and suffix != ".ini":
        raise InputError(f"{name} is a network, and includes no files: remove --root (in Python: root=)")


def read_with(
    path: str | os.PathLike[str] | IO[str] | IO[bytes],
    *,
    dialect: str = "auto",
    root: str | os.PathLike[str] | None = None,
    max_elements: int | None = None,
    least_bytes: int = LEAST_BYTES,
    rules: ReadingRules | None = None,
) -> Circuit:
    """Return the circuit of a deck; raise InputError with all errors of the deck if the deck cannot be read.

    `path`: path or open file; `dialect`: name of the dialect, or "auto" to take it from the sidecar, suffix or text;
    `root`: folder that must contain all included files, None for the deck's folder; `max_elements`: maximum number of
    elements after the expansion of subcircuits, None for a limit that grows with the number of cards; `least_bytes`:
    smallest deck, in bytes, whose lines ``name node node value`` are read in bulk, which is faster; `rules`: reading
    rules in place of those of the dialect, None for those of the dialect.
    """
    if dialect != "auto":
        dialect_named(dialect)
    library, source = _open(path, root)
    if rules is None:
        rules = dialect_named(_dialect_of(source) if dialect == "auto" else dialect).reading
    collector = Collector(library, Contents(rules, Diagnostics()), quick=len(source.data) >= least_bytes)
    try:
        collector.deck(source)
        return assemble_deck(collector, source, max_elements)
    except RecursionError:
        raise InputError(f"{source.name}: its expressions or subcircuits are nested too deeply; flatten them") from None


def _open(
    path: str | os.PathLike[str] | IO[str] | IO[bytes], root: str | os.PathLike[str] | None
) -> tuple[Library, SourceFile]:
    """Return the library of a deck's files, to which included files will be added, and the file of the deck itself.

    `path`: path or open file of the deck; `root`: folder that must contain all included files.  With None, this is the
    folder of the deck; an open file has no folder, so that its includes are rejected.
    """
    folder = None if root is None else _folder(root)
    if not isinstance(path, str | os.PathLike):
        content = path.read()
        data = content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content
        name = getattr(path, "name", None)
        library = Library(folder)
        return library, library.add(name if isinstance(name, str) else "<text>", None, data)
    name = os.fspath(path)
    data = deck_bytes(Path(name), name)
    resolved = Path(name).resolve()
    library = Library(resolved.parent if folder is None else folder)
    return library, library.add(name, resolved, data)


def _folder(root: str | os.PathLike[str]) -> Path:
    """Return the resolved path of a root folder; raise InputError unless it is a folder."""
    folder = resolve(Path(root), os.fspath(root))
    if not folder.is_dir():
        raise InputError(f"the root {os.fspath(root)!r} is not a folder; name an existing one")
    return folder


def _dialect_of(source: SourceFile) -> str:
    """Return the name of the dialect that a deck's sidecar states, or else its file name suffix or text indicates.

    The name is "ngspice" if none of them indicates a dialect.
    """
    suffix = ""
    if source.path is not None:
        suffix = source.path.suffix.lower()
        try:
            with source.path.with_name(source.path.name + ".json").open("rb") as sidecar:
                stated = _STATED.search(sidecar.read(_HEAD))
        except OSError:
            stated = None
        if stated is not None:
            return stated.group(1).decode()
    data = source.data
    text = b"\n" + (data[:_LOOKED_AT] + data[-_LOOKED_AT:] if len(data) > 2 * _LOOKED_AT else data).lower()
    named = (name for name, item in DIALECTS.items() if suffix and item.reading.suffix == suffix)
    signed = (name for name, item in DIALECTS.items() if any(sign in text for sign in item.reading.signs))
    return next(chain(named, signed), "ngspice")
