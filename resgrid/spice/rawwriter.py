"""Writing raw files, the format in which ngspice leaves its results and that waveform viewers open."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.files import write_bytes
from resgrid.netlist import GROUND
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.parsed import ngspice_name

FORMS = ("binary", "ascii")


@dataclass(frozen=True, eq=False)
class RawVectors:
    """What one plot of a raw file holds.

    `names`: such as ``v(out)`` or ``i(v1)``; `kinds`: ``"voltage"`` or ``"current"``; `values` (points, variables):
    in volts and amperes.
    """

    names: Sequence[str]
    kinds: Sequence[str]
    values: NDArray[np.float64]


def write_raw(
    point: OperatingPoint, path: str | os.PathLike[str], *, title: str = "resistor network", form: str = "binary"
) -> Path:
    """Write an operating point as ngspice would: every node's voltage, every voltage source's current.

    Names are spelt as ngspice spells them, in lower case; nodes that float (no voltage) are left out, as are currents
    that are undetermined.

    Parameters
    ----------
    point : OperatingPoint
    path : path-like
    title : str
        First line of the file.
    form : {"binary", "ascii"}
        Binary keeps every bit; text keeps 17 digits, the same.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the form is unknown or the file cannot be written.
    """
    return write_bytes(path, format_raw(raw_vectors(point), title=title, form=form))


def raw_vectors(point: OperatingPoint) -> RawVectors:
    """Voltages and source currents of an operating point, with ngspice's names."""
    netlist = point.netlist
    nodes = np.flatnonzero(np.isfinite(point.voltage))
    nodes = nodes[nodes != GROUND]
    sources = np.flatnonzero(np.isfinite(point.source_current))
    given = (netlist.element_names or {}).get("voltage source")
    labels = [given[i] if given else f"v{i + 1}" for i in sources.tolist()]
    names = [f"v({name.lower()})" for name in netlist.names_of(nodes)]
    names += [f"i({ngspice_name(label)})" for label in labels]
    kinds = ["voltage"] * len(nodes) + ["current"] * len(sources)
    return RawVectors(names, kinds, np.concatenate([point.voltage[nodes], point.source_current[sources]])[np.newaxis])


def format_raw(
    vectors: RawVectors, *, title: str = "resistor network", plot: str = "Operating Point", form: str = "binary"
) -> bytes:
    """One plot as the content of a raw file."""
    if form not in FORMS:
        raise InputError(f"a raw file cannot be {form!r}; it may be {' or '.join(FORMS)}")
    points, variables = vectors.values.shape
    spaceless = ("".join(name.split()) for name in vectors.names)
    rows = (f"\t{i}\t{name}\t{kind}" for i, (name, kind) in enumerate(zip(spaceless, vectors.kinds, strict=True)))
    head = [
        f"Title: {' '.join(title.split())}",
        "Date: ",
        f"Plotname: {plot}",
        "Flags: real",
        f"No. Variables: {variables}",
        f"No. Points: {points}",
        "Variables:",
        *rows,
    ]
    if form == "binary":
        text = "\n".join([*head, "Binary:", ""])
        return text.encode("utf-8") + np.ascontiguousarray(vectors.values, dtype="<f8").tobytes()
    return "\n".join([*head, "Values:", *_rows(vectors.values), ""]).encode("utf-8")


def _rows(values: NDArray[np.float64]) -> Iterable[str]:
    for number, row in enumerate(values.tolist()):
        first, *rest = map(repr, row) if row else ("",)
        yield f" {number}\t{first}"
        yield from (f"\t{value}" for value in rest)
