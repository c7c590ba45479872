"""Second reading of a deck by another dialect's rules, and the largest difference between both voltages."""

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
"""Largest total size of a deck's files, in bytes, with which these are read by the rules of other dialects, too."""


@dataclass(frozen=True, eq=False)
class Rereading:
    """Result of reading a deck's file by another simulator's rules.

    `circuit`: the circuit, None if the file cannot be read by these rules; `why`: the first error if `circuit` is None;
    `fails`: whether the simulator is certain to return no result.
    """

    circuit: Circuit | None
    why: str = ""
    fails: bool = False


def reread(deck: Circuit, dialect: Dialect) -> Rereading:
    """Return the result of reading the file of a deck by the rules of a dialect.

    `deck`: circuit read from the file by the rules of its own dialect.  If that is `dialect`, or if the deck has no
    file or files of more than `_MOST_BYTES` bytes, nothing is read and the result contains `deck` itself.
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
    """Return the node with the largest difference between its voltages in two readings of a file, and its magnitude.

    `names`: the two circuits, for the node names; `volts` (nodes,) each: their node voltages, in volts, NaN for
    floating nodes.  Differences up to 1e-9 of the largest voltage magnitude in the first reading count as equal.
    Without a larger one, the result is a node with a voltage in the first reading only, and infinity; else None.
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
    """Return whether the files exist and have at most `_MOST_BYTES` bytes together."""
    try:
        return bool(files) and sum(file.stat().st_size for file in files) <= _MOST_BYTES
    except OSError:
        return False
