"""The sidecar: what a deck may not hold, in JSON beside it.

Hash of the deck and of every block of its lines, of the files beside it and of the sidecar itself, the cell and the
expected voltage of every node, what was left out or renamed, and the versions that made it.
"""

from __future__ import annotations

import hashlib
import json
import math
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from resgrid.errors import InputError
from resgrid.spice.text.texts import Chosen, Texts, names, numbers, weave
from resgrid.spice.write.expected import Expected
from resgrid.spice.write.flat import FlatDeck

SCHEMA = 1
_BLOCK_LINES = 16
_BLOCK_DIGITS = 16
_MAX_BYTES = 2**31
_BLANK = "0" * 64
_OWN = re.compile(rb'(?<="own_sha256": ")[0-9a-f]{64}(?=")')
"""The hash of the sidecar's own text, in which zeros stand in its place."""


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
    blocks: tuple[str, ...]
    dialect: str
    expected: Expected
    parts: Mapping[str, str] = field(default_factory=dict)
    companions: Mapping[str, str] = field(default_factory=dict)
    intact: bool = True


def sidecar_path(deck: Path) -> Path:
    """Where the sidecar of a deck lies: ``room.cir.json`` beside ``room.cir``."""
    if not deck.name:
        raise InputError(f"cannot write a deck as {str(deck)!r}: name a file")
    return deck.with_name(deck.name + ".json")


def format_sidecar(
    deck_name: str,
    deck: FlatDeck,
    expected: Expected,
    *,
    text: str | None = None,
    more: Mapping[str, Any] | None = None,
) -> str:
    """Write a sidecar's JSON, one node a line."""
    data = (deck.text if text is None else text).encode("utf-8")
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
        **(more or {}),
    }
    fields = [f"{json.dumps(key)}: {json.dumps(value, sort_keys=True, allow_nan=False)}" for key, value in head.items()]
    fields.append('"nodes": {\n' + _node_lines(deck, expected) + "\n}")
    blank = "{\n" + ",\n".join(fields) + "\n}\n"
    return blank.replace(_BLANK, hashlib.sha256(blank.encode("utf-8")).hexdigest(), 1)


def read_sidecar(deck: Path) -> Sidecar:
    """Read the sidecar of a deck."""
    path = sidecar_path(deck)
    data, content = _read_json(path)
    blocks = _entry(path, content, "blocks", dict)
    expected = Expected(
        voltage={
            name: _number(path, f"nodes.{name}.voltage", node.get("voltage") if isinstance(node, dict) else None)
            for name, node in _entry(path, content, "nodes", dict).items()
        },
        source_current={
            name: None if value is None else _number(path, f"sources.{name}", value)
            for name, value in _entry(path, content, "sources", dict).items()
        },
        supply=_positive(path, content, "supply"),
        current_scale=_positive(path, content, "current_scale"),
        kcl_residual=_number(path, "kcl_residual", content.get("kcl_residual")),
    )
    lines, hashes = blocks.get("lines"), blocks.get("sha256")
    if not isinstance(lines, int) or lines < 1 or not _is_strings(hashes):
        raise _wrong(path, "blocks", "it must hold a number of lines and a list of hashes")
    own = _OWN.search(data)
    blank = _OWN.sub(_BLANK.encode(), data, count=1)
    return Sidecar(
        path=path,
        sha256=_entry(path, content, "sha256", str),
        block_lines=lines,
        blocks=tuple(hashes),
        dialect=_entry(path, content, "dialect", str),
        expected=expected,
        parts=_hashes(path, content, "files"),
        companions=_hashes(path, content, "companions"),
        intact=own is not None and hashlib.sha256(blank).hexdigest().encode() == own[0],
    )


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
    now = block_hashes(data, size)
    longest = max(len(now), len(sidecar.blocks))
    padded = [[*row, *[""] * (longest - len(row))] for row in (now, sidecar.blocks)]
    ranges: list[tuple[int, int]] = []
    for block in (i for i in range(longest) if padded[0][i] != padded[1][i]):
        first, last = block * size + 1, (block + 1) * size
        if ranges and ranges[-1][1] + 1 == first:
            first = ranges.pop()[0]
        ranges.append((first, last))
    return ranges


def _node_lines(deck: FlatDeck, expected: Expected) -> str:
    voltage = np.fromiter((expected.voltage[name] for name in deck.node_names), np.float64, len(deck.nodes))
    columns: tuple[bytes | Texts | Chosen, ...]
    columns = (b'"', deck.node_texts, b'": {"cell": ', *_cells(deck), b', "voltage": ', numbers(voltage), b"},\n")
    return weave(len(deck.nodes), *columns).decode().removesuffix(",\n")


def _cells(deck: FlatDeck) -> list[Chosen]:
    """Columns that make ``[3, 7]`` of a node's cell, or ``null``."""
    none = np.zeros(len(deck.nodes), dtype=np.int64)
    if deck.netlist.cell_map is None:
        return [names(["null"]).take(none)]
    flat = deck.netlist.cell_of_node()[deck.nodes]
    shape = deck.netlist.cells.space.shape
    columns = []
    for axis, index in enumerate(np.unravel_index(np.maximum(flat, 0), shape)):
        first, otherwise = (", ", "") if axis else ("[", "null")
        table = names([otherwise, *(f"{first}{i}" for i in range(shape[axis]))])
        columns.append(table.take(np.where(flat < 0, none, index + 1)))
    return [*columns, names(["", "]"]).take((flat >= 0).astype(np.int64))]


def _versions() -> dict[str, str]:
    try:
        own = version("resgrid")
    except PackageNotFoundError:
        own = "unknown"
    return {"numpy": np.__version__, "python": platform.python_version(), "resgrid": own}


def _read_json(path: Path) -> tuple[bytes, Mapping[str, Any]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path} is larger than {_MAX_BYTES} bytes, which no sidecar is")
        data = path.read_bytes()
        content = json.loads(data)
    except FileNotFoundError as error:
        raise InputError(
            f"there is no sidecar {path}: write the deck with resgrid, or compare it with a scene instead"
        ) from error
    except OSError as error:
        raise InputError(f"cannot read the sidecar {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"the sidecar {path} is not JSON ({error}); write the deck again") from error
    if not isinstance(content, dict):
        raise _wrong(path, "schema", "the file must hold one object")
    if content.get("schema") != SCHEMA:
        raise _wrong(path, "schema", f"it must be {SCHEMA}, not {content.get('schema')!r}")
    return data, content


def _entry(path: Path, content: Mapping[str, Any], key: str, kind: type[Any]) -> Any:
    if not isinstance(content.get(key), kind):
        raise _wrong(path, key, f"it must be there and be a {kind.__name__}")
    return content[key]


def _hashes(path: Path, content: Mapping[str, Any], key: str) -> Mapping[str, str]:
    found = content.get(key, {})
    if not isinstance(found, dict) or not _is_strings(list(found.values())):
        raise _wrong(path, key, "it must map the names of files to hashes")
    return found


def _number(path: Path, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not _is_finite(value):
        raise _wrong(path, key, f"it must be a finite number, not {value!r}")
    return float(value)


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _positive(path: Path, content: Mapping[str, Any], key: str) -> float:
    value = _number(path, key, content.get(key))
    if value <= 0:
        raise _wrong(path, key, f"it must be positive, not {value!r}")
    return value


def _is_strings(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str) and all(isinstance(item, str) for item in value)


def _wrong(path: Path, key: str, what: str) -> InputError:
    return InputError(f"the sidecar {path} is damaged at {key}: {what}; write the deck again")
