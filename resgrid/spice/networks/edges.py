"""Resistor networks as lists, both ways: edges, and perhaps currents and resistors to ground, a line each."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import GROUND, Netlist
from resgrid.spice.read.files import read_text
from resgrid.spice.write.flat import resistances

Measure = Literal["resistance", "conductance"]
MEASURES = ("resistance", "conductance")

_COMMENT = re.compile(r"[#%].*")
_INTEGRAL = re.compile(r"^(\d+)\.0*$")
"""Whole numbers that are written as decimals."""
_GROUND = "ground"
_WRITABLE = re.compile(r"(?!\d+\.0*$)[^\s,;#%]+")
"""Names that are read as they are written."""


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
class Table:
    """Names and numbers of a file of lines ``name ... name number``.

    `source`: the file, as displayed; `values` (rows,); `measure`: what a heading says the numbers are.
    """

    source: str
    names: list[tuple[str, ...]]
    values: NDArray[np.float64]
    lines: list[int]
    measure: str | None

    def place(self, row: int) -> str:
        """``file:line`` of a row."""
        return f"{self.source}:{self.lines[row]}"

    def siemens(self, measure: str | None, *, shorts: bool = False) -> NDArray[np.float64]:
        """Values as conductances, by the heading or else a measure; 0 ohm is infinite where shorts are meant."""
        if measure not in (None, *MEASURES):
            raise InputError(f"measure = {measure!r} is unknown; it may be one of {', '.join(MEASURES)}")
        stated = self.measure if self.measure in MEASURES else None
        if None not in (measure, stated) and measure != stated:
            raise InputError(f"{self.source}: its heading says {stated}, but measure={measure!r} was asked for")
        chosen = measure or stated or "resistance"
        wrong = np.flatnonzero(self.values < 0 if shorts else self.values <= 0)
        if wrong.size:
            row = int(wrong[0])
            bound = "not be negative" if shorts else "be positive"
            text = f"a {chosen} of {self.values[row]:g} is not admissible; it must {bound}"
            raise InputError(f"{self.place(row)}: {text}")
        with np.errstate(divide="ignore"):
            return self.values if chosen == "conductance" else np.asarray(1.0 / self.values)


def read_edges(
    edges: str | os.PathLike[str],
    sources: str | os.PathLike[str] | None = None,
    grounds: str | os.PathLike[str] | None = None,
    measure: str | None = None,
    ground_measure: str | None = None,
) -> Network:
    """Read a list of edges, and perhaps one of currents into nodes and one of resistors to ground."""
    table = _read_table(edges, 2, "edge")
    number: dict[str, int] = {_GROUND: 0}
    pairs = [(number.setdefault(a, len(number)), number.setdefault(b, len(number))) for a, b in table.names]
    amps, to_ground = np.zeros(len(number)), np.zeros(len(number))
    if sources is not None:
        currents = _read_table(sources, 1, "source")
        np.add.at(amps, _numbers(currents, number), currents.values)
    if grounds is not None:
        ties = _read_table(grounds, 1, "ground")
        np.add.at(to_ground, _numbers(ties, number), ties.siemens(ground_measure, shorts=True))
    nodes = np.array(pairs, dtype=np.int32).reshape(-1, 2)
    return Network(list(number), nodes, table.siemens(measure), amps, to_ground)


def edges_text(netlist: Netlist) -> str:
    """The resistors of a netlist as a list of edges."""
    names = netlist.names_of(range(netlist.node_count))
    for node in np.unique(netlist.resistor_nodes).tolist():
        if node != GROUND and (names[node].lower() == _GROUND or not _WRITABLE.fullmatch(names[node])):
            raise InputError(
                f"an edge list cannot hold a node named {names[node]!r}; write .json, .graphml or .npz instead"
            )
    names[GROUND] = _GROUND
    rows = zip(netlist.resistor_nodes.tolist(), resistances(netlist.conductance).tolist(), strict=True)
    return "".join([f"{names[a]} {names[b]} {ohms!r}\n" for (a, b), ohms in rows])


def is_edge_list(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins as a list of edges does: with a heading, or two nodes and a number."""
    try:
        with Path(path).open("rb") as file:
            text = file.read(4096).decode("latin-1")
    except (OSError, ValueError):
        return False
    first = next(filter(None, map(_words, text.split("\n"))), [])
    return len(first) == 3 and (first[2].lower() in MEASURES or re.fullmatch(r"[-+.\deE]+", first[2]) is not None)


def _read_table(path: str | os.PathLike[str], columns: int, what: str) -> Table:
    """Read lines of names and one number; blanks, commas and semicolons separate, ``#`` and ``%`` begin comments."""
    source = os.fspath(path)
    names: list[tuple[str, ...]] = []
    values: list[float] = []
    lines: list[int] = []
    measure: str | None = None
    for number, line in enumerate(read_text(path).split("\n"), 1):
        words = _words(line)
        if not words:
            continue
        try:
            if len(words) != columns + 1:
                raise ValueError
            values.append(float(words[-1]))
        except ValueError:
            if not names and measure is None and len(words) == columns + 1:
                measure = words[-1].lower()
                continue
            raise InputError(
                f"{source}:{number}: a {what} is {columns} name(s) and a number, unlike {line.strip()[:80]!r}"
            ) from None
        if not np.isfinite(values[-1]):
            raise InputError(f"{source}:{number}: {values[-1]} is no finite number")
        names.append(tuple(_INTEGRAL.sub(r"\1", word) for word in words[:-1]))
        lines.append(number)
    return Table(source, names, np.array(values, dtype=np.float64), lines, measure)


def _words(line: str) -> list[str]:
    return _COMMENT.sub("", line).replace(",", " ").replace(";", " ").split()


def _numbers(table: Table, number: dict[str, int]) -> list[int]:
    """Numbers of a table's nodes."""
    nodes = [number.get(names[0], -1) for names in table.names]
    if -1 in nodes:
        row = nodes.index(-1)
        raise InputError(f"{table.place(row)}: the node {table.names[row][0]!r} is on no edge")
    return nodes
