"""The sidecar: what a deck may not hold, in JSON beside it.

Hash of the deck and of every block of its lines, of the files beside it and of the sidecar itself, the cell and the
expected voltage of every node, what was left out or renamed, and the versions that made it.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveInt, ValidationError

from resgrid.errors import InputError
from resgrid.spice.dialects import dialect_named
from resgrid.spice.write.expected import Expected
from resgrid.spice.write.flat import Deck

SCHEMA = 1
_BLOCK_LINES = 16
_BLOCK_DIGITS = 16
_MAX_BYTES = 2**31
_SHOWN = 5
_BLANK = "0" * 64
_OWN = re.compile(rb'(?<="own_sha256": ")[0-9a-f]{64}(?=")')
"""The hash of the sidecar's own text, in which zeros stand in its place."""

_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Hashes = dict[str, str]


class _Blocks(BaseModel):
    lines: PositiveInt
    sha256: list[str]


class _Node(BaseModel):
    voltage: FiniteFloat


class _Content(BaseModel):
    """What must stand in a sidecar; the other keys are for people."""

    model_config = ConfigDict(strict=True)
    schema_: Literal[1] = Field(alias="schema")
    sha256: str
    dialect: str
    blocks: _Blocks
    nodes: dict[str, _Node]
    sources: dict[str, FiniteFloat | None]
    supply: _Positive
    current_scale: _Positive
    kcl_residual: FiniteFloat
    files: _Hashes = {}
    companions: _Hashes = {}


@dataclass(frozen=True, eq=False)
class Sidecar:
    """What was read from a sidecar.

    `path`: where it lies; `sha256`: hash of the deck, hexadecimal; `block_lines`: number of lines per block;
    `blocks`: beginning of the hash of every block of lines; `dialect`: of the deck; `expected`: what the simulator
    should find; `parts`: files that the deck includes, and their hashes; empty for a flat one; `companions`: files
    that include the deck, and their hashes; `intact`: whether the sidecar is, to the byte, what was written.
    """

    path: Path
    sha256: str
    block_lines: int
    blocks: list[str]
    dialect: str
    expected: Expected
    parts: Mapping[str, str]
    companions: Mapping[str, str]
    intact: bool


def sidecar_path(deck: Path) -> Path:
    """Where the sidecar of a deck lies: ``room.cir.json`` beside ``room.cir``."""
    if not deck.name:
        raise InputError(f"cannot write a deck as {str(deck)!r}: name a file")
    return deck.with_name(deck.name + ".json")


def format_sidecar(deck_name: str, deck: Deck, expected: Expected, more: Mapping[str, Any]) -> str:
    """Write a sidecar's JSON, one node a line."""
    data = deck.text.encode("utf-8")
    head = {
        "schema": SCHEMA,
        "own_sha256": _BLANK,
        "deck": deck_name,
        "sha256": hashlib.sha256(data).hexdigest(),
        "dialect": deck.dialect.name,
        "title": deck.title,
        "supply": expected.supply,
        "current_scale": expected.current_scale,
        "kcl_residual": expected.kcl_residual,
        "versions": _versions(),
        "left_out": deck.left_out,
        "renamed": {"elements": dict(deck.renamed_elements), "nodes": dict(deck.renamed_nodes)},
        "blocks": {"lines": _BLOCK_LINES, "sha256": block_hashes(data, _BLOCK_LINES)},
        "sources": dict(expected.source_current),
        **more,
    }
    fields = [f"{json.dumps(key)}: {json.dumps(value, sort_keys=True, allow_nan=False)}" for key, value in head.items()]
    fields.append('"nodes": {\n' + ",\n".join(_node_lines(deck, expected)) + "\n}")
    blank = "{\n" + ",\n".join(fields) + "\n}\n"
    return blank.replace(_BLANK, hashlib.sha256(blank.encode("utf-8")).hexdigest(), 1)


def _node_lines(deck: Deck, expected: Expected) -> Iterator[str]:
    cells = ["null"] * len(deck.nodes)
    if deck.netlist.cell_map is not None:
        flat = deck.netlist.cell_of_node()[deck.nodes]
        own = np.flatnonzero(flat >= 0)
        coordinates = np.transpose(np.unravel_index(flat[own], deck.netlist.cell_map.space.shape))
        for node, cell in zip(own.tolist(), coordinates.tolist(), strict=True):
            cells[node] = str(cell)
    for name, cell in zip(deck.node_names, cells, strict=True):
        yield f'"{name}": {{"cell": {cell}, "voltage": {expected.voltage[name]!r}}}'


def _versions() -> dict[str, str]:
    try:
        own = version("resgrid")
    except PackageNotFoundError:
        own = "unknown"
    return {"numpy": np.__version__, "python": platform.python_version(), "resgrid": own}


def read_sidecar(deck: Path) -> Sidecar:
    """Read the sidecar of a deck."""
    path = sidecar_path(deck)
    data = _read(path)
    content = _parse(path, data)
    own = _OWN.search(data)
    blank = _OWN.sub(_BLANK.encode(), data, count=1)
    return Sidecar(
        path=path,
        sha256=content.sha256,
        block_lines=content.blocks.lines,
        blocks=content.blocks.sha256,
        dialect=content.dialect,
        expected=Expected(
            voltage={name: node.voltage for name, node in content.nodes.items()},
            source_current=content.sources,
            supply=content.supply,
            current_scale=content.current_scale,
            kcl_residual=content.kcl_residual,
        ),
        parts=content.files,
        companions=content.companions,
        intact=own is not None and hashlib.sha256(blank).hexdigest().encode() == own[0],
    )


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path} is larger than {_MAX_BYTES} bytes, which no sidecar is")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(
            f"there is no sidecar {path}: write the deck with resgrid, or compare it with a scene instead"
        ) from error
    except OSError as error:
        raise InputError(f"cannot read the sidecar {path}: {error.strerror}") from error


def _parse(path: Path, data: bytes) -> _Content:
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"the sidecar {path} is not JSON ({error}); write the deck again") from error
    if not isinstance(content, dict):
        raise InputError(f"the sidecar {path} is damaged: it must hold one object; write the deck again")
    try:
        return _Content.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key, what = ".".join(map(str, first["loc"])), first["msg"].partition(" or instance")[0]
        raise InputError(f"the sidecar {path} is damaged at {key}: {what}; write the deck again") from error


def block_hashes(data: bytes, lines: int) -> list[str]:
    """Beginnings of the SHA-256 of every ``lines`` lines of a text."""
    rows = data.split(b"\n")
    return [
        hashlib.sha256(b"\n".join(rows[start : start + lines])).hexdigest()[:_BLOCK_DIGITS]
        for start in range(0, len(rows), lines)
    ]


def altered_lines(data: bytes, sidecar: Sidecar) -> list[tuple[int, int]]:
    """Ranges of lines, first and last, counted from 1, that differ from the deck that was written."""
    size = sidecar.block_lines
    ranges: list[tuple[int, int]] = []
    for block, (now, then) in enumerate(zip_longest(block_hashes(data, size), sidecar.blocks)):
        if now == then:
            continue
        first, last = block * size + 1, (block + 1) * size
        if ranges and ranges[-1][1] + 1 == first:
            first = ranges.pop()[0]
        ranges.append((first, last))
    return ranges


def altered_files(data: bytes, sidecar: Sidecar) -> list[str]:
    """What differs from what was written, the deck and the files beside it; a companion that is absent is no matter."""
    name = sidecar.path.name
    problems = []
    if hashlib.sha256(data).hexdigest() != sidecar.sha256:
        ranges = altered_lines(data, sidecar)
        shown = ", ".join(f"{first}-{last}" for first, last in ranges[:_SHOWN])
        more = f" and {len(ranges) - _SHOWN} more ranges" if len(ranges) > _SHOWN else ""
        where = f"lines {shown}{more} differ" if ranges else "the hash in the sidecar differs, though no line does,"
        problems.append(f"{where} from the deck that resgrid wrote (SHA-256 in {name})")
    if not sidecar.intact:
        problems.append(f"{name} differs from what resgrid wrote (its own SHA-256)")
    for other, sha256 in {**sidecar.parts, **sidecar.companions}.items():
        path = sidecar.path.with_name(Path(other).name)
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            problems.append(f"{path.name} differs from what resgrid wrote (SHA-256 in {name})")
    return problems


def with_parts(deck: Path, data: bytes, sidecar: Sidecar) -> bytes:
    """A deck with its parts in the place of the lines that include them."""
    include = dialect_named(sidecar.dialect).include
    for name in sidecar.parts:
        part = deck.with_name(Path(name).name)
        try:
            content = part.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {part}, a part of the deck {deck.name}: {error.strerror}") from error
        data = data.replace(include.format(file=name).encode(), content.rstrip(b"\n"), 1)
    return data
