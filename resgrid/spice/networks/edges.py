"""Parts of a resistor network: edges, sources and grounds, a line each."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.spice.read.files import decode, normalise, read_bytes

Measure = Literal["resistance", "conductance"]
MEASURES = ("resistance", "conductance")

_COMMENT = re.compile(r"[#%].*")
_INTEGRAL = re.compile(r"(\d+)\.0*")
_GROUND = "ground"


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


def is_edge_list(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins as a list of edges does: with a heading, or two nodes and a number."""
    try:
        with Path(path).open("rb") as file:
            text = decode(file.read(4096))
    except (OSError, ValueError):
        return False
    rows = (_words(line) for line in text.split("\n"))
    first = next((words for words in rows if words), [])
    return len(first) == 3 and (first[2].lower() in MEASURES or re.fullmatch(r"[-+.\deE]+", first[2]) is not None)


def read_table(path: str | os.PathLike[str], columns: int, what: str) -> Table:
    """Read lines of names and one number; blanks, commas and semicolons separate, ``#`` and ``%`` begin comments."""
    source = os.fspath(path)
    text = decode(normalise(read_bytes(Path(source), source), source))
    names: list[tuple[str, ...]] = []
    values: list[float] = []
    lines: list[int] = []
    measure: str | None = None
    for number, line in enumerate(text.split("\n"), 1):
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
        names.append(tuple(map(_plain, words[:-1])))
        lines.append(number)
    numbers = np.array(values, dtype=np.float64)
    if not np.all(np.isfinite(numbers)):
        row = int(np.argmin(np.isfinite(numbers)))
        raise InputError(f"{source}:{lines[row]}: {numbers[row]} is no finite number")
    return Table(source, names, numbers, lines, measure)


def read_edges(
    path: str | os.PathLike[str],
    measure: str | None,
    sources: str | os.PathLike[str] | None,
    grounds: str | os.PathLike[str] | None,
) -> Netlist:
    """Read a list of edges, and perhaps one of currents into nodes and one of resistors to ground."""
    table = read_table(path, 2, "edge")
    network = NetworkParts.of_edges(table, _measure(table, measure))
    if sources is not None:
        network.feed(read_table(sources, 1, "source"))
    if grounds is not None:
        ties = read_table(grounds, 1, "ground")
        network.ground(ties, _measure(ties, measure))
    return network.netlist()


def _measure(table: Table, measure: str | None) -> Measure:
    """What the numbers of a table are: what its heading says, or else what was asked for, or resistances."""
    if measure not in (None, *MEASURES):
        raise InputError(f"measure = {measure!r} is unknown; it may be one of {', '.join(MEASURES)}")
    stated = table.measure if table.measure in MEASURES else None
    if measure is not None and stated is not None and measure != stated:
        raise InputError(f"{table.source}: its heading says {stated}, but measure={measure!r} was asked for")
    return "conductance" if (measure or stated) == "conductance" else "resistance"


def _words(line: str) -> list[str]:
    return _COMMENT.sub("", line).replace(",", " ").replace(";", " ").split()


def _plain(word: str) -> str:
    """Whole numbers that are written as decimals, without their decimals."""
    match = _INTEGRAL.fullmatch(word)
    return match.group(1) if match is not None else word


@dataclass(eq=False)
class NetworkParts:
    """A network while its files are being read."""

    number: dict[str, int]
    edges: NDArray[np.int32]
    conductance: NDArray[np.float64]
    amps: NDArray[np.float64]
    to_ground: NDArray[np.float64]

    @classmethod
    def of_edges(cls, table: Table, measure: Measure) -> NetworkParts:
        """Begin with edges."""
        number: dict[str, int] = {_GROUND: 0}
        pairs = [(number.setdefault(a, len(number)), number.setdefault(b, len(number))) for a, b in table.names]
        values = conductances(table, measure, shorts=False)
        edges = np.array(pairs, dtype=np.int32).reshape(-1, 2)
        return cls(number, edges, values, np.zeros(len(number)), np.zeros(len(number)))

    def feed(self, table: Table) -> None:
        """Feed currents into nodes."""
        np.add.at(self.amps, self._nodes(table), table.values)

    def ground(self, table: Table, measure: Measure) -> None:
        """Tie nodes to ground."""
        np.add.at(self.to_ground, self._nodes(table), conductances(table, measure, shorts=True))

    def _nodes(self, table: Table) -> list[int]:
        nodes = [self.number.get(names[0], -1) for names in table.names]
        if -1 in nodes:
            row = nodes.index(-1)
            raise InputError(f"{table.place(row)}: the node {table.names[row][0]!r} is on no edge")
        return nodes

    def netlist(self) -> Netlist:
        """Make the netlist."""
        return grounded_netlist(list(self.number), self.edges, self.conductance, self.amps, self.to_ground)


def conductances(table: Table, measure: Measure, *, shorts: bool) -> NDArray[np.float64]:
    """Values of a table in siemens; 0 ohm is infinite where shorts are meant."""
    wrong = table.values < 0 if shorts else table.values <= 0
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{table.place(row)}: a {measure} of {table.values[row]:g} is not admissible; it must "
            + ("not be negative" if shorts else "be positive")
        )
    if measure == "conductance":
        return table.values
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / table.values)


def grounded_netlist(
    names: Sequence[str],
    edges: NDArray[np.int32],
    conductance: NDArray[np.float64],
    amps: NDArray[np.float64],
    to_ground: NDArray[np.float64],
    element_names: Mapping[str, tuple[str, ...]] | None = None,
) -> Netlist:
    """Make a netlist of a network that is fed with currents and tied to ground.

    Shapes: `amps` (nodes,), `to_ground` (nodes,).
    """
    held, tied, fed = np.flatnonzero(np.isinf(to_ground)), np.isfinite(to_ground) & (to_ground > 0), amps != 0
    tied_nodes, fed_nodes = np.flatnonzero(tied), np.flatnonzero(fed)
    return Netlist(
        node_count=len(names),
        resistor_nodes=np.concatenate([edges, _with_ground(tied_nodes)]),
        conductance=np.concatenate([conductance, to_ground[tied_nodes]]),
        source_nodes=_with_ground(held),
        source_volts=np.zeros(len(held)),
        current_nodes=_with_ground(fed_nodes)[:, ::-1],
        current_amps=amps[fed_nodes],
        node_names=tuple(names),
        element_names=element_names,
    )


def _with_ground(nodes: NDArray[np.int64]) -> NDArray[np.int32]:
    return np.stack([nodes, np.zeros_like(nodes)], axis=1).astype(np.int32)
