"""Resistor networks as lists, both ways: edges, and perhaps currents and resistors to ground, a line each."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from decimal import Decimal
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import InputError
from resgrid.spice.read.files import decode, normalise, read_text
from resgrid.spice.write.flat import resistances

Measure = Literal["resistance", "conductance"]
MEASURES = ("resistance", "conductance")

_COMMENT = re.compile(r"[#%].*")
_DECIMAL = re.compile(r"[-+]?(\d+\.\d*|\.\d+|\d+(?=[eE][-+]))([eE][-+]?\d{1,3})?", re.ASCII)
"""Decimals as programs print them, ``1.000e+00`` or ``1e+06``; a plain ``1e5`` stays a name."""
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)
_DIGITS = "+-.0123456789"
_LONGEST = 20
"""Most digits of a node's number."""
_GROUND = "ground"
_MATRIX = "%%MatrixMarket"
_HEADINGS = {
    "resistance": re.compile(r"resistances?|ohms?"),
    "conductance": re.compile(r"conductances?|siemens"),
}
"""Headings that state the quantity of a column."""


@dataclass(frozen=True, eq=False)
class Network:
    """Resistors between nodes that are fed with currents and tied to ground.

    `names` (nodes,): ground first; `edges` (n, 2) and `conductance` (n,) in S; `amps` (nodes,): currents into nodes;
    `to_ground` (nodes,): siemens, infinite where a node is held at 0 V.
    """

    names: list[str]
    edges: NDArray[np.int32]
    conductance: NDArray[np.float64]
    amps: NDArray[np.float64]
    to_ground: NDArray[np.float64]

    def netlist(self) -> Netlist:
        """Make the netlist."""
        held, fed = np.flatnonzero(np.isinf(self.to_ground)), np.flatnonzero(self.amps)
        tied = np.flatnonzero(np.isfinite(self.to_ground) & (self.to_ground > 0))
        return Netlist(
            node_count=len(self.names),
            resistor_nodes=np.concatenate([self.edges, _with_ground(tied)]),
            conductance=np.concatenate([self.conductance, self.to_ground[tied]]),
            source_nodes=_with_ground(held),
            source_volts=np.zeros(len(held)),
            current_nodes=_with_ground(fed)[:, ::-1],
            current_amps=self.amps[fed],
            node_names=tuple(self.names),
        )


def _with_ground(nodes: NDArray[np.int64]) -> NDArray[np.int32]:
    return np.stack([nodes, np.zeros_like(nodes)], axis=1).astype(np.int32)


@dataclass(frozen=True, eq=False)
class EdgeTable:
    """Names and numbers of a file of lines ``name ... name number``.

    `source`: the file, as displayed; `values` (rows,); `measure`: the quantity that the heading states.
    """

    source: str
    names: list[tuple[str, ...]]
    values: NDArray[np.float64]
    lines: list[int]
    measure: str | None

    def place(self, row: int) -> str:
        """``file:line`` of a row."""
        return f"{self.source}:{self.lines[row]}"

    def siemens(self, measure: str | None, *, shorts: bool = False, absent: bool = False) -> NDArray[np.float64]:
        """Return the values as conductances, by the heading or else by a measure.

        With `shorts` 0 ohm is infinite, and 0 S is no connection; with `absent` 0 S is no connection, too.
        """
        if measure not in (None, *MEASURES):
            raise InputError(f"measure = {measure!r} is unknown; it may be one of {', '.join(MEASURES)}")
        if None not in (measure, self.measure) and measure != self.measure:
            raise InputError(f"{self.source}: its heading says {self.measure}, but measure={measure!r} was asked for")
        chosen = measure or self.measure or "resistance"
        zero = shorts or (absent and chosen == "conductance")
        wrong = np.flatnonzero(self.values < 0 if zero else self.values <= 0)
        if wrong.size:
            row = int(wrong[0])
            text = f"a {chosen} of {self.values[row]:g} is not admissible; it must {_bound(zero)}"
            raise InputError(f"{self.place(row)}: {text}")
        if chosen == "conductance":
            return self.values
        with np.errstate(divide="ignore", over="ignore"):
            siemens = np.asarray(1.0 / self.values)
        small = np.flatnonzero(np.isinf(siemens) & (self.values != 0))
        if small.size:
            row = int(small[0])
            raise InputError(
                f"{self.place(row)}: a resistance of {self.values[row]:g} is too small; its inverse overflows"
            )
        return siemens


def _bound(zero: bool) -> str:
    return "not be negative" if zero else "be positive"


def read_edges(
    edges: str | os.PathLike[str],
    sources: str | os.PathLike[str] | None = None,
    grounds: str | os.PathLike[str] | None = None,
    measure: str | None = None,
    ground_measure: str | None = None,
    *,
    last_counts: bool = False,
    absent_edges: bool = False,
) -> Network:
    """Read a list of edges, and optional lists of currents into nodes and of resistors to ground.

    Every line is one resistor, so that repeated edges are in parallel.  Lines of one node add up, unless `last_counts`;
    with `absent_edges` an edge of 0 S is left out.
    """
    table = _read_table(edges, 2, "edge")
    number: dict[str, int] = {_GROUND: 0}
    pairs = [(number.setdefault(a, len(number)), number.setdefault(b, len(number))) for a, b in table.names]
    conductance = table.siemens(measure, absent=absent_edges)
    amps, to_ground = np.zeros(len(number)), np.zeros(len(number))
    if sources is not None:
        currents = _read_table(sources, 1, "source")
        _enter(amps, _numbers(currents, number), currents.values, last_counts)
    if grounds is not None:
        ties = _read_table(grounds, 1, "ground")
        _enter(to_ground, _numbers(ties, number), ties.siemens(ground_measure, shorts=True), last_counts)
    nodes = np.array(pairs, dtype=np.int32).reshape(-1, 2)
    exists = conductance > 0
    return Network(list(number), nodes[exists], conductance[exists], amps, to_ground)


def _enter(sums: NDArray[np.float64], nodes: list[int], values: NDArray[np.float64], last_counts: bool) -> None:
    """Add the values of a list to their nodes, or let the last value of a node stand."""
    if last_counts:
        sums[nodes] = values
    else:
        np.add.at(sums, nodes, values)


def edges_text(netlist: Netlist) -> str:
    """Return the resistors of a netlist as a list of edges."""
    names = netlist.names_of(range(netlist.node_count))
    for node in np.unique(netlist.resistor_nodes).tolist():
        if node != GROUND and not _is_writable(names[node]):
            raise InputError(
                f"an edge list cannot hold a node named {names[node]!r}; write .json, .graphml or .npz instead"
            )
    names[GROUND] = _GROUND
    rows = zip(netlist.resistor_nodes.tolist(), resistances(netlist.conductance).tolist(), strict=True)
    return "".join([f"{names[a]} {names[b]} {ohms!r}\n" for (a, b), ohms in rows])


def _is_writable(name: str) -> bool:
    """Return whether a node's name is read as it is written."""
    return name.lower() != _GROUND and _words(name) == [name] and _node_name(name) == name


def is_edge_list(path: str | os.PathLike[str]) -> bool:
    """Return whether a file begins like a list of edges: two nodes and a number, perhaps below a heading."""
    try:
        with Path(path).open("rb") as file:
            text = decode(normalise(file.read(4096), os.fspath(path)))
    except InputError:
        raise
    except (OSError, ValueError):
        return False
    first, second = (*islice(filter(None, map(_words, text.split("\n"))), 2), [], [])[:2]
    return _is_edge(first) or (len(first) == 3 and (_measure_of(first[2]) in MEASURES or _is_edge(second)))


def _is_edge(words: list[str]) -> bool:
    return len(words) == 3 and words[0][0] not in ".*" and _NUMBER.fullmatch(words[2]) is not None


def _read_table(path: str | os.PathLike[str], columns: int, what: str) -> EdgeTable:
    """Read lines of names and one number; blanks, commas and semicolons separate, ``#`` and ``%`` begin comments."""
    source = os.fspath(path)
    names: list[tuple[str, ...]] = []
    values: list[float] = []
    lines: list[int] = []
    heading: str | None = None
    text = read_text(path)
    if text.startswith(_MATRIX):
        raise InputError(f"{source} is a Matrix Market file; write its entries as lines 'node node number'")
    for number, line in enumerate(text.split("\n"), 1):
        words = _words(line)
        if not words:
            continue
        if len(words) != columns + 1 or not _NUMBER.fullmatch(words[-1]):
            if not names and heading is None and len(words) == columns + 1 and words[-1][0] not in _DIGITS:
                heading = words[-1]
                continue
            nodes = "two nodes" if columns == 2 else "a node"
            article = "an" if what[0] in "aeiou" else "a"
            raise InputError(
                f"{source}:{number}: {line.strip()[:80]!r} is not {article} {what}; a line has {nodes} and a number"
            )
        values.append(float(words[-1]))
        if not np.isfinite(values[-1]):
            raise InputError(f"{source}:{number}: {words[-1]} is not a finite number")
        names.append(tuple(map(_node_name, words[:-1])))
        lines.append(number)
    return EdgeTable(source, names, np.array(values, dtype=np.float64), lines, _measure_of(heading))


def _measure_of(heading: str | None) -> str | None:
    """Return the quantity that a heading states."""
    word = (heading or "").lower()
    return next((measure for measure, form in _HEADINGS.items() if form.fullmatch(word)), None)


def _node_name(word: str) -> str:
    """Return the name of a node; whole numbers that are printed as decimals are written without a point."""
    if not _DECIMAL.fullmatch(word):
        return word
    value = Decimal(word)
    if value.adjusted() >= _LONGEST or value != value.to_integral_value():
        return word
    return str(int(value))


def _words(line: str) -> list[str]:
    words = _COMMENT.sub("", line).replace(",", " ").replace(";", " ").split()
    return [word[1:-1] if len(word) > 2 and word[0] == word[-1] == '"' else word for word in words]


def _numbers(table: EdgeTable, number: dict[str, int]) -> list[int]:
    """Numbers of a table's nodes."""
    nodes = [number.get(names[0], -1) for names in table.names]
    if -1 in nodes:
        row = nodes.index(-1)
        raise InputError(f"{table.place(row)}: the node {table.names[row][0]!r} is on no edge")
    return nodes
