"""The record of a board or layout: a JSON file that lists parts, sources, and expected voltages.

The record of ``grid.kicad_pcb`` is ``grid.record.json`` in the same folder.  It describes the circuit that the file is
meant to realise, so that a netlist from an independent tool can be compared with it.
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from resgrid._internal.files import read_text, write_text
from resgrid._internal.values import frozen
from resgrid.errors import InputError

SCHEMA = 1
"""Version number of the file format of records."""

SUFFIX = ".record.json"
"""Suffix of a record's file name, which replaces the suffix of the board or layout."""

GROUND = "0"
"""Name of the net of ground in records, boards and SPICE netlists."""

PartType = Literal["resistor", "jumper", "connector", "test_pad", "hole"]
"""Types of parts in a record."""

_ENCODE = json.JSONEncoder(sort_keys=True, allow_nan=False).encode
"""Function that returns a value as JSON on one line, with sorted keys."""

_STRICT = {"strict": True, "extra": "forbid"}
"""Settings with which pydantic validates a record: no conversion between types, and no unknown keys."""


@dataclass(frozen=True)
class Part:
    """A part of a board or layout.

    Attributes
    ----------
    reference : str
        Unique name of the part, such as ``"R17"``.
    type : {"resistor", "jumper", "connector", "test_pad", "hole"}
        Type of the part.
    value : float or None
        Resistance in ohms of a resistor as bought (E96 value) or drawn; None for other parts.
    nets : tuple of str
        Net of each pad or terminal, in the order of the pads' numbers.
    closed : tuple of int
        Numbers of the pads of a jumper, counted from 1, that solder joins in this scene; empty for an open jumper and
        for other parts.

    Examples
    --------
    >>> rg.hardware.Part("R17", "resistor", 10_000.0, ("n_3_4", "n_3_5")).nets
    ('n_3_4', 'n_3_5')
    """

    __pydantic_config__ = _STRICT
    reference: str
    type: PartType
    value: float | None
    nets: tuple[str, ...]
    closed: tuple[int, ...] = ()


@dataclass(frozen=True)
class Supply:
    """A voltage source outside a board or layout.

    Attributes
    ----------
    name : str
        Name of the source.
    positive, negative : str
        Nets of its terminals.
    volts : float
        Voltage of `positive` above `negative`.

    Examples
    --------
    >>> rg.hardware.Supply("obstacle", "obstacle", "0", 1.0).volts
    1.0
    """

    __pydantic_config__ = _STRICT
    name: str
    positive: str
    negative: str
    volts: float


@frozen
@dataclass(frozen=True)
class HardwareRecord:
    """Record of the circuit that a board or layout realises.

    Attributes
    ----------
    kind : {"board", "layout"}
        Kind of the file.
    variant : {"fixed", "jumpers"} or None
        Variant of a board: for one scene, or for every scene of its size; None for a layout.
    file : str
        Name of the board or layout, in the folder of the record.
    scene_hash : str
        SHA-256 of the cells, conductances and options from which the file was made.
    process : str or None
        Name of the process of a layout, such as ``"ihp-sg13g2:rppd"``; None for a board.
    parts : tuple of Part
        All parts.
    sources : tuple of Supply
        Voltage sources outside the board or layout.
    voltages : mapping of str to float
        Expected voltage of each net with a resistor or a bond pad, in volts against net ``"0"``: the solution of
        `resgrid.solve` for exactly the values of `parts`.
    nodes : mapping of str to tuple of int
        Cell (column, row) of each net that belongs to a cell; rails have no entry.

    Examples
    --------
    >>> Part, Supply = rg.hardware.Part, rg.hardware.Supply
    >>> record = rg.hardware.HardwareRecord(
    ...     "board", "fixed", "grid.kicad_pcb", "",
    ...     parts=(Part("R1", "resistor", 1e4, ("top", "n_0_0")), Part("R2", "resistor", 1e4, ("n_0_0", "0"))),
    ...     sources=(Supply("top", "top", "0", 1.0),), voltages={"top": 1.0, "n_0_0": 0.5}, nodes={"n_0_0": (0, 0)},
    ... )
    >>> record.part["R2"].nets
    ('n_0_0', '0')
    """

    __pydantic_config__ = _STRICT
    kind: Literal["board", "layout"]
    variant: Literal["fixed", "jumpers"] | None
    file: str
    scene_hash: str
    process: str | None = None
    parts: tuple[Part, ...] = ()
    sources: tuple[Supply, ...] = ()
    voltages: Mapping[str, float] = field(default_factory=dict)
    nodes: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    @property
    def part(self) -> dict[str, Part]:
        """Every part by its reference."""
        return {part.reference: part for part in self.parts}


def record_path(file: str | os.PathLike[str]) -> Path:
    """Return the path of the record of a board or layout: ``grid.record.json`` for ``grid.kicad_pcb``."""
    return Path(file).with_suffix(SUFFIX)


def write_record(file: str | os.PathLike[str], record: HardwareRecord) -> Path:
    """Write the record of a board or layout, and return the path of the record.

    Parameters
    ----------
    file : str or path
        The board or layout; the record has its name with the suffix ``.record.json``.
    record : HardwareRecord
        The record.

    Raises
    ------
    InputError
        If the record contradicts itself or cannot be written.
    """
    path = record_path(file)
    _require_consistency(record, f"cannot write {path}")
    return write_text(path, format_record(record))


def format_record(record: HardwareRecord) -> str:
    """Return the text of a record: JSON with sorted keys, and one part, source, voltage or cell of a net per line.

    Numbers are exact: reading them gives the same floating-point numbers.
    """
    data = {each.name: getattr(record, each.name) for each in fields(record)} | {
        "schema": SCHEMA,
        "parts": [vars(part) for part in sorted(record.parts, key=lambda part: natural_order(part.reference))],
        "sources": [vars(source) for source in sorted(record.sources, key=lambda source: source.name)],
    }
    return "{\n" + ",\n".join(f"{json.dumps(key)}: {_value_text(data[key])}" for key in sorted(data)) + "\n}\n"


def _value_text(value: Any) -> str:
    """Return a value of a record as JSON, with a line for each entry of a list or mapping."""
    if isinstance(value, Mapping) and value:
        entries = (f"{json.dumps(key)}: {_line(value[key])}" for key in sorted(value, key=natural_order))
        return "{\n" + ",\n".join(entries) + "\n}"
    if isinstance(value, list) and value:
        return "[\n" + ",\n".join(map(_line, value)) + "\n]"
    return _line(value)


def _line(value: Any) -> str:
    """Return a value as JSON on one line, with sorted keys."""
    return _ENCODE(value)


def natural_order(name: str) -> tuple[tuple[str, int], ...]:
    """Return a sort key for names that compares the numbers in them by value: R2 comes before R10."""
    return tuple((text, int(digits or -1)) for text, digits in re.findall(r"(\D*)(\d*)", name))


def read_record(file: str | os.PathLike[str]) -> HardwareRecord:
    """Return the validated record of a board or layout.

    Parameters
    ----------
    file : str or path
        The board or layout, or its record.

    Raises
    ------
    InputError
        If the record is absent, damaged, or contradicts itself.

    Examples
    --------
    >>> rg.hardware.read_record("grid.kicad_pcb")
    Traceback (most recent call last):
        ...
    resgrid.errors.InputError: grid.kicad_pcb: its record grid.record.json is absent from the folder; write the ...
    """
    given = Path(file)
    path = given if given.name.endswith(SUFFIX) else record_path(given)
    if not path.exists():
        raise InputError(
            f"{given}: its record {path.name} is absent from the folder; "
            "write the board with 'resgrid board' or the layout with 'resgrid layout' again"
        )
    record = _parse(read_text(path), path)
    _require_consistency(record, f"the record {path} is damaged")
    return record


def _parse(text: str, path: Path) -> HardwareRecord:
    """Return the record that a JSON text contains; raise InputError with the first problem.

    `path`: file of the text, for messages.
    """
    from pydantic import TypeAdapter, ValidationError

    try:
        data = json.loads(text)
        if not isinstance(data, dict) or data.pop("schema", None) != SCHEMA:
            raise ValueError(f'it is not an object with "schema": {SCHEMA}')
        return TypeAdapter(HardwareRecord).validate_json(json.dumps(data, allow_nan=False))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        problem = f" at {'.'.join(map(str, first['loc']))}: {first['msg']}"
    except (ValueError, RecursionError) as error:
        problem = f": {error}"
    raise InputError(f"the record {path} is damaged{problem}; write the board or layout again")


def _require_consistency(record: HardwareRecord, words: str) -> None:
    """Raise InputError if a record contradicts itself; `words`: beginning of the error message."""
    problem = next(_contradictions(record), None)
    if problem is not None:
        raise InputError(f"{words}: {problem}; write the board or layout again")


def _contradictions(record: HardwareRecord) -> Iterator[str]:
    """Yield a message for every contradiction inside a record.

    Examples are two parts of one reference, a resistor without a positive value, and a source on an unknown net.
    """
    for reference, count in Counter(part.reference for part in record.parts).items():
        if count > 1:
            yield f"{count} parts have the reference {reference}"
    for part in record.parts:
        if part.type == "resistor" and not (part.value is not None and 0 < part.value < float("inf")):
            yield f"resistor {part.reference} has the value {part.value}, which is not a positive number of ohms"
        if part.type == "resistor" and len(part.nets) != 2:
            yield f"resistor {part.reference} has {len(part.nets)} nets instead of 2"
        if any(not 1 <= pad <= len(part.nets) for pad in part.closed):
            yield f"{part.reference} joins pads {list(part.closed)}, but has pads 1 to {len(part.nets)}"
    known = {net for part in record.parts for net in part.nets}
    for source in record.sources:
        for net in (source.positive, source.negative):
            if net not in known and net != GROUND:
                yield f"source {source.name} is on net {net}, which no part touches"
    for net in record.voltages:
        if net not in known and net != GROUND:
            yield f"net {net} has a voltage, and no part touches the net"
