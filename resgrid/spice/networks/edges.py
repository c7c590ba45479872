"""Reader and writer of edge lists: one resistor per line, with optional lists of currents and grounds."""

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
"""Pattern of decimals in the form that programs print, ``1.000e+00`` or ``1e+06``, in place of a node name.

A decimal of this form whose value is an integer means the node of that number, here ``1`` and ``1000000``.  A word such
as ``1e5``, without a sign in the exponent, is taken as a name.
"""
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)
_DIGITS = "+-.0123456789"
_LONGEST = 20
"""Largest number of digits of an integer that is written as a decimal (``1.000e+00``) and means a node number (``1``);
with more digits, the word is the name of the node.
"""
_GROUND = "ground"
_MATRIX = "%%MatrixMarket"
_HEADINGS = {
    "resistance": re.compile(r"resistances?|ohms?"),
    "conductance": re.compile(r"conductances?|siemens"),
}
"""Patterns of the words in a heading that state a quantity, by the name of the quantity."""
_OTHER_UNIT = re.compile(r"(?i:.*(conduct|siemens|mho|(kilo|mega|milli|micro|[kmgunµμ])_?(ohm|Ω)).*)|.*[kmunµμ][SA]")
"""Pattern of words in a heading whose numbers are not in ohms, siemens or amperes, such as ``kohm`` and ``mS``."""


@dataclass(frozen=True, eq=False)
class Network:
    """Resistors between nodes, currents into nodes, and resistors from nodes to ground.

    `names` (nodes,): names of nodes, ground first; `edges` (n, 2): nodes of the resistors; `conductance` (n,): in S;
    `amps` (nodes,): currents injected into the nodes, in A; `to_ground` (nodes,): conductance to ground in S, infinite
    for nodes at 0 V.
    """

    names: list[str]
    edges: NDArray[np.int32]
    conductance: NDArray[np.float64]
    amps: NDArray[np.float64]
    to_ground: NDArray[np.float64]

    def netlist(self) -> Netlist:
        """Return the network as a netlist; infinite conductances to ground become sources of 0 V."""
        held, driven = np.flatnonzero(np.isinf(self.to_ground)), np.flatnonzero(self.amps)
        resistive = np.flatnonzero(np.isfinite(self.to_ground) & (self.to_ground > 0))
        return Netlist(
            node_count=len(self.names),
            resistor_nodes=np.concatenate([self.edges, _with_ground(resistive)]),
            conductance=np.concatenate([self.conductance, self.to_ground[resistive]]),
            source_nodes=_with_ground(held),
            source_volts=np.zeros(len(held)),
            current_nodes=_with_ground(driven)[:, ::-1],
            current_amps=self.amps[driven],
            node_names=tuple(self.names),
        )


def _with_ground(nodes: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the pairs (node, 0) of a node and ground, shape (n, 2); `nodes` (n,): node numbers."""
    return np.stack([nodes, np.zeros_like(nodes)], axis=1).astype(np.int32)


@dataclass(frozen=True, eq=False)
class EdgeTable:
    """Content of a file whose lines consist of one or two node names and a number.

    `source`: name of the file for messages; `names`: node names of each row; `values` (rows,): number of each row, in
    ohms, S or A; `lines`: line number of each row, counted from 1; `measure`: "resistance" or "conductance" if the
    heading states it, else None.
    """

    source: str
    names: list[tuple[str, ...]]
    values: NDArray[np.float64]
    lines: list[int]
    measure: str | None

    def place(self, row: int) -> str:
        """Return the place ``file:line`` of a row; `row`: index of the row, counted from 0."""
        return f"{self.source}:{self.lines[row]}"

    def siemens(self, measure: str | None, *, shorts: bool = False, absent: bool = False) -> NDArray[np.float64]:
        """Return the values as conductances in S, shape (rows,); infinite for 0 ohm.

        `measure`: quantity of the values, "resistance" or "conductance", None for that of the heading, or resistance
        without a heading.  `shorts`: True allows 0 ohm and 0 S, whatever `absent` is; `absent`: True allows 0 S; if
        both are False, no value may be 0.  Raises InputError for a negative value, a zero that is not allowed, a
        resistance with an overflowing reciprocal, and a heading that contradicts `measure`.
        """
        if measure not in (None, *MEASURES):
            raise InputError(f"measure = {measure!r} is unknown; it may be one of {', '.join(MEASURES)}")
        if None not in (measure, self.measure) and measure != self.measure:
            raise InputError(f"{self.source}: its heading says {self.measure}, but measure={measure!r} is requested")
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
    """Return "not be negative" if `zero` (0 is allowed), else "be positive", for an error message."""
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
    """Return the network of an edge list, with optional lists of injected currents and of resistors to ground.

    Every line of `edges` is one resistor, so that repeated edges are in parallel.  `sources`: file of currents that are
    injected into nodes, in A; `grounds`: file of resistors to ground; `measure, ground_measure`: "resistance" or
    "conductance", the quantity of the values in `edges` and in `grounds`, None for that of the heading (without a
    heading, resistance); `last_counts`: whether the last value of a node in `sources` and in `grounds` is used instead
    of the sum; `absent_edges`: whether edges of 0 S are omitted instead of rejected.
    """
    table = _read_table(edges, 2, "edge")
    number: dict[str, int] = {_GROUND: 0}
    pairs = [(number.setdefault(a, len(number)), number.setdefault(b, len(number))) for a, b in table.names]
    conductance = table.siemens(measure, absent=absent_edges)
    amps, to_ground = np.zeros(len(number)), np.zeros(len(number))
    if sources is not None:
        currents = _read_table(sources, 1, "source")
        _accumulate(amps, _numbers(currents, number), currents.values, last_counts)
    if grounds is not None:
        ties = _read_table(grounds, 1, "ground")
        _accumulate(to_ground, _numbers(ties, number), ties.siemens(ground_measure, shorts=True), last_counts)
    nodes = np.array(pairs, dtype=np.int32).reshape(-1, 2)
    exists = conductance > 0
    return Network(list(number), nodes[exists], conductance[exists], amps, to_ground)


def _accumulate(sums: NDArray[np.float64], nodes: list[int], values: NDArray[np.float64], last_counts: bool) -> None:
    """Add `values` to `sums` at the given nodes in place, or with `last_counts` assign the last value of each node.

    `sums` (nodes,): one number per node; `nodes` (rows,), `values` (rows,): node number and value of each row.
    """
    if last_counts:
        sums[nodes] = values
    else:
        np.add.at(sums, nodes, values)


def edges_text(netlist: Netlist) -> str:
    """Return the resistors of a netlist as the text of an edge list, one line ``node node ohms`` each.

    Raises InputError for a node name that an edge list cannot hold.
    """
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
    """Return whether a node's name is the same after it is written to an edge list and read again."""
    return name.lower() != _GROUND and _words(name) == [name] and _node_name(name) == name


def is_edge_list(path: str | os.PathLike[str]) -> bool:
    """Return whether a file begins like an edge list: a line with two nodes and a number, possibly below a heading.

    `path`: the file, of which the first 4096 bytes are read; the result for an unreadable file is False.  Raises
    InputError for a file with a zero byte.
    """
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
    """Return whether the words of a line are two nodes and a number, and neither a SPICE command nor a comment."""
    return len(words) == 3 and words[0][0] not in ".*" and _NUMBER.fullmatch(words[2]) is not None


def _read_table(path: str | os.PathLike[str], columns: int, entry: str) -> EdgeTable:
    """Return the table of the file `path`, whose lines hold `columns` node names and one number.

    Blanks, commas and semicolons separate words; ``#`` and ``%`` begin comments.  `entry`: the word for a line in
    messages, such as "edge".  Raises InputError for any other line except one heading.
    """
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
                if _measure_of(heading) is None and _OTHER_UNIT.fullmatch(heading):
                    raise InputError(
                        f"{source}:{number}: the unit in the heading {heading!r} is not read; write numbers in ohms, "
                        "siemens or amperes, and 'ohms', 'siemens' or 'amperes' in the heading"
                    )
                continue
            nodes = "two nodes" if columns == 2 else "a node"
            article = "an" if entry[0] in "aeiou" else "a"
            hint = "; if the file is a deck, give its dialect (--read-as, in Python dialect=)" * source.endswith(".txt")
            raise InputError(
                f"{source}:{number}: {line.strip()[:80]!r} is not {article} {entry}; a line has {nodes} and a number"
                f"{hint}"
            )
        values.append(float(words[-1]))
        if not np.isfinite(values[-1]):
            raise InputError(f"{source}:{number}: {words[-1]} is not a finite number")
        names.append(tuple(map(_node_name, words[:-1])))
        lines.append(number)
    return EdgeTable(source, names, np.array(values, dtype=np.float64), lines, _measure_of(heading))


def _measure_of(heading: str | None) -> str | None:
    """Return the quantity that the last word of a heading states: "resistance", "conductance", or None.

    `heading`: the word; None without a heading.
    """
    word = (heading or "").lower()
    return next((measure for measure, form in _HEADINGS.items() if form.fullmatch(word)), None)


def _node_name(word: str) -> str:
    """Return the node name that a word of an edge list means.

    An integer of at most 20 digits in the form of a decimal, such as ``1.000e+00``, means the name ``1``; every other
    word is the name itself.
    """
    if not _DECIMAL.fullmatch(word):
        return word
    value = Decimal(word)
    if value.adjusted() >= _LONGEST or value != value.to_integral_value():
        return word
    return str(int(value))


def _words(line: str) -> list[str]:
    """Return the words of a line, which blanks, commas and semicolons separate, without comment and double quotes."""
    words = _COMMENT.sub("", line).replace(",", " ").replace(";", " ").split()
    return [word[1:-1] if len(word) > 2 and word[0] == word[-1] == '"' else word for word in words]


def _numbers(table: EdgeTable, number: dict[str, int]) -> list[int]:
    """Return the node number of the first name in every row, one integer each; raise InputError without such a node.

    `table`: rows of node names with a number; `number`: node number of every node with an edge, by its name.
    """
    nodes = [number.get(names[0], -1) for names in table.names]
    if -1 in nodes:
        row = nodes.index(-1)
        raise InputError(f"{table.place(row)}: the node {table.names[row][0]!r} is on no edge")
    return nodes
