"""The self-verifying companion: a file that makes ngspice run a deck and print PASS or FAIL.

It needs nothing but ngspice.  Expected voltages and values stand in it as plain numbers; ``compose`` makes vectors of
errors, in a plot of their own (every new vector makes ngspice build the table of its plot's names anew).  An error
counts as right only if it is compared and found small: what is missing, not a number, or was never computed is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.text.texts import Texts, names, numbers, weave
from resgrid.spice.write.expected import Expected

TOLERANCE = 1e-9
"""Largest error of a voltage relative to the supply, of a current to the largest, of a value to itself."""
LARGEST = 400_000
"""Number of comparisons beyond which no companion is written: ngspice would take hours for the deck alone."""
_PER_LINE = 40


@dataclass(frozen=True, eq=False)
class _Group:
    """Errors of one kind: what they are errors of, and expressions for them."""

    what: str
    unit: str
    errors: Texts


def format_companion(
    deck: str,
    expected: Expected,
    resistors: Texts,
    values: NDArray[np.float64],
    sha256: str,
    *,
    tolerance: float = TOLERANCE,
) -> str:
    """Write the companion of an ngspice deck.  Shapes: `values` (resistors,)."""
    groups = [group for group in _groups(expected, resistors, values) if len(group.errors)]
    lines = [
        f"* verify {deck}: prints PASS or FAIL",
        f"* ngspice -n -b {deck}.verify",
        f"* the deck that it was written for has the SHA-256 {sha256}",
        f"* this file's own is in {deck}.json, which resgrid check compares: altered, it proves nothing",
        f'.include "{deck}"',
        ".options klu",
        ".control",
        "op",
        "setplot new",
        "let right = 0",
        "let worst = 0",
        "let place = 0",
    ]
    for group in groups:
        lines += [f"let worst_{group.what} = 0", *_comparisons(group, len(lines) + 1, tolerance)]
    lines += _verdict(groups, tolerance)
    return "\n".join([*lines, ".endc", ".end"]) + "\n"


def _groups(expected: Expected, resistors: Texts, values: NDArray[np.float64]) -> list[_Group]:
    voltage = np.array(list(expected.voltage.values()))
    known = {name: amps for name, amps in expected.source_current.items() if amps is not None}
    amps = np.array(list(known.values()))
    rows = len(resistors)
    return [
        _Group("voltages", "of the supply", _errors(b"op1.v(", list(expected.voltage), voltage, expected.supply)),
        _Group("currents", "of the largest", _errors(b"op1.i(", list(known), amps, expected.current_scale)),
        _Group("resistances", "relative", weave(rows, b" abs(@", resistors, b"[resistance]/", numbers(values), b"-1)")),
    ]


def _errors(function: bytes, words: Sequence[str], values: NDArray[np.float64], scale: float) -> Texts:
    sign = names(["+", "-"]).take((values >= 0).astype(np.int64))
    by = b")/" + repr(scale).encode()
    return weave(len(words), b" abs(" + function, names(words), b")", sign, numbers(np.abs(values)), by)


def _comparisons(group: _Group, before: int, tolerance: float) -> list[str]:
    """Lines that compare; ``before`` is the number of the line in front of them."""
    text, offset = group.errors.decode(), group.errors.offset
    lines: list[str] = []
    for first in range(0, len(group.errors), _PER_LINE):
        last = min(first + _PER_LINE, len(group.errors))
        lines += [
            "compose error values" + text[offset[first] : offset[last]],
            f"let place = vecmax(error) gt worst ? {before + len(lines) + 1} : place",
            "let worst = vecmax(error) gt worst ? vecmax(error) : worst",
            f"let worst_{group.what} = vecmax(error) gt worst_{group.what} ? vecmax(error) : worst_{group.what}",
            f"let right = right + length(error)*mean(error le {tolerance!r})",
            "unlet error",
        ]
    return lines


def _verdict(groups: Sequence[_Group], tolerance: float) -> list[str]:
    total = sum(len(group.errors) for group in groups)
    told = ", ".join(f"{len(group.errors)} {group.what} ($&worst_{group.what} {group.unit})" for group in groups)
    return [
        f"if right gt {total - 0.5}",
        f"  echo PASS: the largest error is $&worst where {tolerance!r} is allowed: {told}",
        "  quit 0",
        "else",
        f"  echo FAIL: the largest error is $&worst where {tolerance!r} is allowed: {told}",
        f"  let wrong = {total} - right",
        f"  echo $&wrong of {total} comparisons failed; line $&place of this file holds the largest error",
        "  quit 1",
        "end",
    ]
