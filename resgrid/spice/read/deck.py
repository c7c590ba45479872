"""Reading a circuit: from a file to a `Circuit`."""

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
_LOOKED_AT = 65536
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

    Of a deck, resistors (those with ``I0 tanh(V/V0)`` in the form that is written here, too), independent sources,
    capacitors (open), inductors (shorts) and switches with a known control voltage are read, in subcircuits with
    parameters too; everything else is refused with its place.

    Files that end in ``.ini`` are Circuitscape's configurations in advanced mode; ``.graphml``, node-link ``.json`` and
    ``.npz`` hold whole netlists; ``.csv``, ``.tsv`` and a ``.txt`` that looks like one are lists of edges, a line
    ``node node ohms`` (or siemens, if a heading says ``conductance``); ground is the node ``ground``.

    Parameters
    ----------
    file : path-like or text file
        The circuit.
    dialect : {"auto", "ngspice", "ltspice", "xyce", "hspice", "spectre"}
        Whose rules to read a deck by; ``"auto"`` asks the deck's sidecar, then the end of its name and its text for
        signs; ngspice without.
    root : path-like, optional
        Folder below which files may be included; by default the deck's own.  Links are resolved before.
    max_elements : int, optional
        How many elements subcircuits may be expanded to; by default 500,000, or 5,000 a line if that is more, and at
        most 20 million.
    measure : {"resistance", "conductance"}, optional
        What the numbers of an edge list and of its grounds are, where no heading says; by default resistances.
    sources : path-like, optional
        Of an edge list: lines ``node amperes``, currents fed into nodes.
    grounds : path-like, optional
        Of an edge list: lines ``node ohms`` (or siemens) to ground; 0 ohm holds the node at 0 V.

    Returns
    -------
    Circuit

    Raises
    ------
    InputError
        If it cannot be read or understood; up to 20 errors, a line each, with file, line and column.
    BudgetError
        If it grows too large when its subcircuits are expanded.

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
    if not isinstance(file, str | os.PathLike) or not (tables or is_network(file)):
        return read_with(file, dialect=dialect, root=root, max_elements=max_elements)
    name = os.fspath(file)
    suffix = Path(file).suffix.lower()
    if suffix not in (*GRAPH_SUFFIXES, ".ini"):
        return Circuit.of(read_edges(file, sources, grounds, measure, measure).netlist(), name)
    if tables:
        raise InputError(f"{name} names its own sources, grounds and measure; leave those options out")
    netlist = read_graph(file) if suffix != ".ini" else read_circuitscape(file, root=root)[0].netlist()
    return Circuit.of(netlist, name)


def is_network(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a network that is no deck: a graph, arrays, a configuration, or a list of edges."""
    suffix = Path(path).suffix.lower()
    return is_edge_list(path) if suffix == ".txt" else suffix in (".csv", ".tsv", ".ini", *GRAPH_SUFFIXES)


def read_with(
    path: str | os.PathLike[str] | IO[str] | IO[bytes],
    *,
    dialect: str = "auto",
    root: str | os.PathLike[str] | None = None,
    max_elements: int | None = None,
    least_bytes: int = LEAST_BYTES,
    rules: ReadingRules | None = None,
) -> Circuit:
    """Read a deck as `read_spice`; files of at least ``least_bytes`` go through the compiled loops.

    ``rules`` takes the place of the dialect's rules.
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
        raise InputError(f"{source.name}: something in it is nested too deeply to be read") from None


def _open(
    path: str | os.PathLike[str] | IO[str] | IO[bytes], root: str | os.PathLike[str] | None
) -> tuple[Library, SourceFile]:
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
    folder = resolve(Path(root), os.fspath(root))
    if not folder.is_dir():
        raise InputError(f"the root {os.fspath(root)!r} is no folder")
    return folder


def _dialect_of(source: SourceFile) -> str:
    """Dialect that a deck's sidecar states, its name says, or its words show; ngspice without any sign."""
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
