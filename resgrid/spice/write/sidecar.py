"""The sidecar of a deck: a JSON file with hashes, the cells of nodes and the reference results.

It holds the hashes of the deck, of every block of its lines, of the accompanying files and of the sidecar itself; the
cell and the expected voltage of every node; omitted and renamed nodes; and the versions of the software.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveInt, ValidationError

from resgrid._internal.files import read_bytes
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.errors import InputError
from resgrid.spice.circuit import some
from resgrid.spice.dialects import dialect_named
from resgrid.spice.write.flat import FlatDeck

SCHEMA = 1
"""Version of the sidecar's format."""
_BLOCK_LINES = 16
"""Number of lines in each block of a deck that has its own hash, which locates altered lines."""
_BLOCK_DIGITS = 16
"""Number of hexadecimal digits of a block's hash that a sidecar contains."""
_MAX_BYTES = 2**31
"""Largest sidecar that is read, in bytes."""
BLANK = "0" * 64
"""Text in place of the sidecar's own hash while this hash is computed."""
_CONDUCTANCE_FRACTION = 1e-3
"""Lower limit of the scale of current errors, as a fraction of the largest conductance times the supply voltage.

Where this product is much larger than the source currents, the rounding error of source currents is about 1e-13 of the
product (measured with ngspice 39 and 46).  The tolerance of 1e-9 of the scale is then ten times the rounding error.
"""

_OWN = re.compile(rb'(?<="own_sha256": ")[0-9a-f]{64}(?=")')
"""Regular expression for the sidecar's own hash in its text."""


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected node voltages and source currents of a deck, with the scales of their tolerances.

    `voltage`: voltage of every node except ground by name, in volts; `source_current`: current into the plus terminal
    of every voltage source by name, in amperes, None if it is undetermined; `supply`: scale of voltage errors, the
    largest voltage difference in the circuit, in volts (1 if all voltages are 0); `current_scale`: scale of current
    errors, in amperes: the largest source current, but at least 1e-3 times the largest conductance times `supply`;
    `kcl_residual`: largest violation of Kirchhoff's current law, relative to the current through the same node.
    """

    voltage: Mapping[str, float]
    source_current: Mapping[str, float | None]
    supply: float
    current_scale: float
    kcl_residual: float

    @staticmethod
    def of(op: OperatingPoint, voltage: Mapping[str, float], source_current: Mapping[str, float]) -> Expected:
        """Return the expected results of a deck; their scales are computed from an operating point.

        `op`: operating point of the circuit; `voltage`: expected voltages in volts by node name; `source_current`:
        expected currents in amperes by name of the voltage source, not finite if undetermined.
        """
        netlist = op.netlist
        ends = np.concatenate([netlist.resistor_nodes, netlist.nonlinear_nodes])
        volts = op.voltage[ends if ends.size else netlist.source_nodes]
        volts = volts[np.isfinite(volts)]
        supply = (np.ptp(volts) if volts.size else 0.0) or np.max(np.abs(volts), initial=0.0) or 1.0
        drawn = np.nanmax(np.abs(op.source_current), initial=0.0)
        scale = max(drawn, _CONDUCTANCE_FRACTION * supply * np.max(netlist.conductance, initial=0.0)) or 1.0
        return Expected(
            voltage=voltage,
            source_current={name: amps if np.isfinite(amps) else None for name, amps in source_current.items()},
            supply=float(supply),
            current_scale=float(scale),
            kcl_residual=op.kcl_residual if np.isfinite(op.kcl_residual) else 0.0,
        )


def expect(deck: FlatDeck, op: OperatingPoint) -> Expected:
    """Return the expected results of a deck, by the deck's names.

    `op`: operating point of the netlist that the deck was written from.  Raises InputError for the operating point of
    another netlist, and for a node of the deck without a voltage.
    """
    if not op.is_of(deck.netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    voltage = op.voltage[deck.nodes]
    if not np.isfinite(voltage).all():
        name = deck.node_names[int(np.flatnonzero(~np.isfinite(voltage))[0])]
        raise InputError(f"the operating point has no voltage for node {name}; solve this netlist first")
    current = op.source_current[deck.sources].tolist()
    return Expected.of(
        op,
        dict(zip(deck.node_names, voltage.tolist(), strict=True)),
        dict(zip(deck.source_names, current, strict=True)),
    )


def digest(data: bytes) -> str:
    """Return the SHA-256 of bytes as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Blocks(BaseModel):
    """Hashes of the blocks of a deck, which are groups of consecutive lines.

    `lines`: number of lines per block; `sha256`: first 16 hexadecimal digits of the SHA-256 of every block.
    """

    lines: PositiveInt
    sha256: list[str]


class _Node(BaseModel):
    """The entry of a node in a sidecar; only its expected `voltage`, in volts, is read."""

    voltage: FiniteFloat


class Sidecar(BaseModel):
    """Content of a sidecar, without the keys that are only informative.

    `path`: path of the sidecar; `intact`: whether the file is unaltered according to its own hash; `schema_`: version
    of the format; `sha256`: hash of the deck, hexadecimal; `dialect`: name of the deck's dialect; `blocks`: hashes of
    the deck's groups of lines; `nodes, sources, supply, current_scale, kcl_residual`: expected results, which
    `expected` returns as one object; `files`: hashes of the files that the deck includes, by file name, empty for a
    flat deck; `companions`: hashes of the files that include the deck, by file name.
    """

    model_config = ConfigDict(strict=True, frozen=True)
    path: Path = Path()
    intact: bool = False
    schema_: Literal[1] = Field(alias="schema")
    sha256: str
    dialect: str
    blocks: _Blocks
    nodes: dict[str, _Node]
    sources: dict[str, FiniteFloat | None]
    supply: PositiveNumber
    current_scale: PositiveNumber
    kcl_residual: FiniteFloat
    files: dict[str, str] = {}
    companions: dict[str, str] = {}

    @property
    def expected(self) -> Expected:
        """Expected node voltages and source currents of the deck, with the scales of their errors."""
        voltage = {name: node.voltage for name, node in self.nodes.items()}
        return Expected(voltage, self.sources, self.supply, self.current_scale, self.kcl_residual)


def sidecar_path(deck: Path) -> Path:
    """Return the path of a deck's sidecar: ``room.cir.json`` for ``room.cir``."""
    if not deck.name:
        raise InputError(f"cannot write a deck as {str(deck)!r}: give the name of a file")
    return deck.with_name(deck.name + ".json")


def format_sidecar(deck_name: str, deck: FlatDeck, expected: Expected, more: Mapping[str, Any]) -> str:
    """Return the text of a sidecar, one node per line.

    `deck_name`: file name of the deck; `deck`: the deck; `expected`: expected results; `more`: further keys of the JSON
    object with their values, such as versions and hashes.
    """
    data = deck.text.encode("utf-8")
    head = {
        "schema": SCHEMA,
        "own_sha256": BLANK,
        "deck": deck_name,
        "sha256": digest(data),
        "dialect": deck.dialect.name,
        "title": deck.title,
        "supply": expected.supply,
        "current_scale": expected.current_scale,
        "kcl_residual": expected.kcl_residual,
        "versions": {"numpy": np.__version__, "python": platform.python_version(), "resgrid": _own_version()},
        "left_out": deck.left_out,
        "renamed": {"elements": dict(deck.renamed_elements), "nodes": dict(deck.renamed_nodes)},
        "blocks": {"lines": _BLOCK_LINES, "sha256": block_hashes(data, _BLOCK_LINES)},
        "sources": dict(expected.source_current),
        **more,
    }
    return format_hashed(head, {"nodes": _node_lines(deck, expected)})


def format_hashed(head: Mapping[str, Any], tables: Mapping[str, Iterable[str]]) -> str:
    """Return a JSON object as text, with its own hash in place of the first `BLANK`.

    `head`: keys and values, one per line, of which one value is `BLANK`; `tables`: further objects by key, each as
    lines ``"name": value`` of JSON without commas at the end.
    """
    fields = [f"{json.dumps(key)}: {json.dumps(value, sort_keys=True, allow_nan=False)}" for key, value in head.items()]
    fields += [f'"{key}": {{\n' + ",\n".join(lines) + "\n}" for key, lines in tables.items()]
    blank = "{\n" + ",\n".join(fields) + "\n}\n"
    return blank.replace(BLANK, digest(blank.encode()), 1)


def is_intact(data: bytes) -> bool:
    """Return whether the content of a sidecar agrees with its own hash."""
    own = _OWN.search(data)
    blank = _OWN.sub(BLANK.encode(), data, count=1)
    return own is not None and digest(blank).encode() == own[0]


def _node_lines(deck: FlatDeck, expected: Expected) -> Iterator[str]:
    """Yield one JSON line per node: index of its cell along each axis (null without one), expected voltage in volts."""
    cells = ["null"] * len(deck.nodes)
    if deck.netlist.space_map is not None:
        flat = deck.netlist.cell_of_node()[deck.nodes]
        own = np.flatnonzero(flat >= 0)
        coordinates = np.transpose(np.unravel_index(flat[own], deck.netlist.space_map.space.shape))
        for node, cell in zip(own.tolist(), coordinates.tolist(), strict=True):
            cells[node] = str(cell)
    for name, cell in zip(deck.node_names, cells, strict=True):
        yield f'"{name}": {{"cell": {cell}, "voltage": {expected.voltage[name]!r}}}'


def _own_version() -> str:
    """Return the version of resgrid, ``"unknown"`` if it is not installed as a package."""
    try:
        return version("resgrid")
    except PackageNotFoundError:
        return "unknown"


def read_sidecar(deck: Path) -> Sidecar:
    """Return the validated content of a deck's sidecar; raise InputError if the sidecar is damaged.

    `deck`: path of the deck.
    """
    path = sidecar_path(deck)
    data = read_bytes(path, _MAX_BYTES)
    try:
        return Sidecar.model_validate_json(data).model_copy(update={"path": path, "intact": is_intact(data)})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key, problem = ".".join(map(str, first["loc"])), first["msg"].partition(" or instance")[0]
        where = f" at {key}" if key else ""
        raise InputError(f"the sidecar {path} is damaged{where}: {problem}; write the deck again") from error


def block_hashes(data: bytes, lines: int) -> list[str]:
    """Return the first 16 hexadecimal digits of the SHA-256 of every block (group of lines) of a text.

    `data`: the text as bytes; `lines`: number of lines per block.
    """
    rows = data.split(b"\n")
    blocks = (b"\n".join(rows[start : start + lines]) for start in range(0, len(rows), lines))
    return [digest(block)[:_BLOCK_DIGITS] for block in blocks]


def altered_lines(data: bytes, sidecar: Sidecar) -> list[tuple[int, int]]:
    """Return the ranges of lines, (first, last) counted from 1, in which a deck differs from the deck that was written.

    The ranges consist of whole blocks (groups of lines with one hash).  `data`: content of the deck; `sidecar`: its
    sidecar.
    """
    size = sidecar.blocks.lines
    ranges: list[tuple[int, int]] = []
    for block, (now, then) in enumerate(zip_longest(block_hashes(data, size), sidecar.blocks.sha256)):
        if now == then:
            continue
        first, last = block * size + 1, (block + 1) * size
        if ranges and ranges[-1][1] + 1 == first:
            first = ranges.pop()[0]
        ranges.append((first, last))
    return ranges


def altered_files(data: bytes, sidecar: Sidecar) -> list[str]:
    """Return a message for each file that differs from the written one: the deck, its sidecar and further files.

    `data`: content of the deck; `sidecar`: its sidecar, which lists the further files.  A further file that is absent
    gives no message.
    """
    name = sidecar.path.name
    problems = []
    if digest(data) != sidecar.sha256:
        ranges = altered_lines(data, sidecar)
        shown = some([f"{first}-{last}" for first, last in ranges], len(ranges))
        where = f"lines {shown} differ" if ranges else "the hash in the sidecar differs, although no line does,"
        problems.append(f"{where} from the deck that resgrid wrote (SHA-256 in {name})")
    if not sidecar.intact:
        problems.append(f"{name} differs from what resgrid wrote (its own SHA-256)")
    for other, sha256 in {**sidecar.files, **sidecar.companions}.items():
        path = sidecar.path.with_name(Path(other).name)
        if path.is_file() and digest(path.read_bytes()) != sha256:
            problems.append(f"{path.name} differs from what resgrid wrote (SHA-256 in {name})")
    return problems


def with_parts(deck: Path, data: bytes, sidecar: Sidecar) -> bytes:
    """Return the content of a deck in tile form with the files that it includes inserted.

    `deck, data`: path and content of the main file; `sidecar`: its sidecar, which lists the included files.  Raises
    InputError if an included file cannot be read.
    """
    include = dialect_named(sidecar.dialect).include
    for name in sidecar.files:
        part = deck.with_name(Path(name).name)
        try:
            content = part.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {part}, a part of the deck {deck.name}: {error.strerror}") from error
        data = data.replace(include.format(file=name).encode(), content.rstrip(b"\n"), 1)
    return data
