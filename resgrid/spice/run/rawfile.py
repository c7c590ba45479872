"""Reader and writer of raw files, the result format of ngspice that waveform viewers open."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.netlist import GROUND
from resgrid.errors import InputError
from resgrid.spice.dialects.ngspice import ngspice_name

_BINARY = b"Binary:\n"
_COUNTED = ("no. variables", "no. points")
FORMS = ("binary", "ascii")
"""Encodings of the numbers in a raw file."""


@dataclass(frozen=True, eq=False)
class RawFile:
    """One plot of a raw file.

    `plot`: name of the analysis, e.g. ``"Operating Point"``; `names` (variables,): e.g. ``v(n_0_0)`` or
    ``i(v_obstacle)``; `kinds` (variables,): e.g. ``"voltage"`` or ``"current"``; `values` (points, variables): in SI
    units.
    """

    plot: str
    names: Sequence[str]
    kinds: Sequence[str]
    values: NDArray[np.float64] | NDArray[np.complex128]


def read_rawfile(data: bytes, source: str = "raw file") -> RawFile:
    """Return the plot of a binary raw file; raise InputError for content other than one plot.

    `data`: content of the file; `source`: name of the file in messages.
    """
    head, separator, body = data.partition(_BINARY)
    if not separator:
        if b"\nValues:\n" in data:
            raise InputError(f"{source} is a text raw file, which rounds its numbers; write a binary one")
        raise InputError(f"{source} ends before its data ({len(data)} bytes)")
    lines = head.decode("utf-8", "replace").split("\n")
    parted = (line.partition(":") for line in lines if not line.startswith("\t"))
    fields = {key.strip().lower(): value.strip() for key, colon, value in parted if colon}
    variables, points = (_count(fields, key, source) for key in _COUNTED)
    complex_numbers = "complex" in fields.get("flags", "").lower()
    dtype = np.dtype("<c16" if complex_numbers else "<f8")
    needed = variables * points * dtype.itemsize
    if len(body) != needed:
        problem = "ends too early" if len(body) < needed else "holds more than one plot"
        raise InputError(f"{source} {problem}: {len(body)} bytes of data, but its header announces {needed}")
    rows = [line.split() for line in lines if line.startswith("\t")]
    if len(rows) != variables or any(len(row) < 3 or row[0] != str(i) for i, row in enumerate(rows)):
        raise InputError(
            f"{source} is damaged: its list of {variables} variables has {len(rows)} lines or is out of order"
        )
    names, kinds = (tuple(row[column] for row in rows) for column in (1, 2))
    values = np.frombuffer(body, dtype=dtype).reshape(points, variables)
    return RawFile(fields.get("plotname", ""), names, kinds, values)


def _count(fields: Mapping[str, str], key: str, source: str) -> int:
    """Return the value of the header's field `key` as an integer; raise InputError if its text is not an integer.

    `fields`: texts of the header's fields by key in lower case, such as ``no. points``; `source`: name of the file in
    messages.
    """
    text = fields.get(key, "")
    if not (text.isascii() and text.isdigit() and len(text) < 12):
        raise InputError(f"{source} is damaged: {key!r} is {text!r}, not a number")
    return int(text)


def raw_of(op: OperatingPoint) -> RawFile:
    """Return the node voltages (V) and source currents (A) of an operating point as one plot, with ngspice's names.

    A name is ``v(n_0_0)`` or ``i(v_obstacle)``.  A current flows into the plus terminal of the source.  Ground and
    undetermined values are left out.
    """
    netlist = op.netlist
    nodes = np.flatnonzero(np.isfinite(op.voltage))
    nodes = nodes[nodes != GROUND]
    sources = np.flatnonzero(np.isfinite(op.source_current))
    given = (netlist.element_names or {}).get("voltage source")
    labels = [given[i] if given else f"v{i + 1}" for i in sources.tolist()]
    names = [f"v({name.lower()})" for name in netlist.names_of(nodes)]
    names += [f"i({ngspice_name(label)})" for label in labels]
    kinds = ["voltage"] * len(nodes) + ["current"] * len(sources)
    values = np.concatenate([op.voltage[nodes], op.source_current[sources]])[np.newaxis]
    return RawFile("Operating Point", names, kinds, values)


def format_raw(raw: RawFile, *, title: str = "resistor network", form: str = "binary") -> bytes:
    """Return the content of a raw file that holds one plot.

    `title`: title of the file; `form`: ``"binary"`` or ``"ascii"``.  Raises InputError for another form.
    """
    if form not in FORMS:
        raise InputError(f"form = {form!r} is not a form of a raw file; choose {' or '.join(FORMS)}")
    points, variables = raw.values.shape
    spaceless = ("".join(name.split()) for name in raw.names)
    rows = (f"\t{i}\t{name}\t{kind}" for i, (name, kind) in enumerate(zip(spaceless, raw.kinds, strict=True)))
    head = [
        f"Title: {' '.join(title.split())}",
        "Date: ",
        f"Plotname: {raw.plot}",
        "Flags: real",
        f"No. Variables: {variables}",
        f"No. Points: {points}",
        "Variables:",
        *rows,
    ]
    if form == "binary":
        text = "\n".join([*head, "Binary:", ""])
        return text.encode("utf-8") + np.ascontiguousarray(raw.values, dtype="<f8").tobytes()
    return "\n".join([*head, "Values:", *_rows(raw.values), ""]).encode("utf-8")


def _rows(values: NDArray[Any]) -> Iterable[str]:
    """Yield the lines of a text raw file that hold the numbers; `values` (points, variables): in SI units."""
    for number, row in enumerate(values.tolist()):
        first, *rest = map(repr, row) if row else ("",)
        yield f" {number}\t{first}"
        yield from (f"\t{value}" for value in rest)
