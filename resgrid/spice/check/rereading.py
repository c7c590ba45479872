"""Second reading of a deck by another dialect's rules, and the node where the voltages of two readings differ most."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import ResgridError
from resgrid.spice.circuit import TOLERANCE, Circuit
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.dialects.record import Dialect
from resgrid.spice.read.deck import read_with

_MOST_BYTES = 20_000_000
"""Largest total size, in bytes, of the files of a deck that is also read by the rules of other dialects."""


@dataclass(frozen=True, eq=False)
class Rereading:
    """Result of reading a deck's file by another simulator's rules.

    `circuit`: the circuit, None if resgrid cannot read the file by these rules; `why`: the first error if `circuit` is
    None; `fails`: whether the simulator is certain to return no result.
    """

    circuit: Circuit | None
    why: str = ""
    fails: bool = False


def reread(deck: Circuit, dialect: Dialect) -> Rereading:
    """Return the result of reading the file of a deck by the rules of a dialect.

    `deck`: circuit read from the file by the rules of its own dialect.  Nothing is read, and the result contains `deck`
    itself, if its own dialect is `dialect`, if it has no file, or if its files have more than 20 MB (`_MOST_BYTES`).  A
    Spectre deck cannot be read by the rules of other dialects: the result then has no circuit.
    """
    if dialect.name == deck.dialect or deck.dialect not in DIALECTS:
        return Rereading(deck)
    if DIALECTS[deck.dialect].reading.instances and not dialect.reading.instances:
        return Rereading(None, f"the file is in the language of {DIALECTS[deck.dialect].label}", fails=True)
    files = [Path(name) for name in deck.files]
    if not _are_small(files):
        return Rereading(deck)
    rules = dialect.reading.spice or dialect.reading
    try:
        root = os.path.commonpath([file.resolve().parent for file in files])
        return Rereading(read_with(files[0], dialect=dialect.name, root=root, rules=rules))
    except ResgridError as error:
        return Rereading(None, str(error).splitlines()[0])


def first_difference(
    names: tuple[Circuit, Circuit], volts: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> tuple[str, float] | None:
    """Return the name of the node whose voltages in two readings of a file differ most, and the difference in volts.

    The difference is a magnitude.  Differences up to 1e-9 of the largest voltage magnitude in the first reading count
    as zero.  If all are zero, the result is a node that has a voltage in the first reading only, and infinity; without
    such a node the result is None.  `names`: the circuits of the two readings, for the node names; `volts`: two arrays
    (nodes,) of node voltages, in volts, NaN for floating nodes.
    """
    first, second = (
        {name.lower(): value for name, value in zip(circuit.node_names, found.tolist(), strict=True)}
        for circuit, found in zip(names, volts, strict=True)
    )
    size = float(np.nanmax(np.abs(volts[0]), initial=0.0))
    shared = [name for name in first if name in second and np.isfinite(first[name])]
    errors = {name: abs(first[name] - second[name]) for name in shared if np.isfinite(second[name])}
    worst = max(errors, key=lambda name: errors[name], default="")
    if worst and errors[worst] > TOLERANCE * size:
        return worst, errors[worst]
    missing = [name for name in first if np.isfinite(first[name]) and not np.isfinite(second.get(name, np.nan))]
    return (missing[0], np.inf) if missing else None


def _are_small(files: list[Path]) -> bool:
    """Return whether there is a file, and all files exist and have at most 20 MB (`_MOST_BYTES`) together."""
    try:
        return bool(files) and sum(file.stat().st_size for file in files) <= _MOST_BYTES
    except OSError:
        return False
