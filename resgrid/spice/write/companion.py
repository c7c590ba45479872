"""The self-verifying companion: a file that makes ngspice run a deck and print PASS or FAIL.

It needs nothing but ngspice.  Expected voltages and values stand in it as plain numbers; ``compose`` makes vectors of
errors, in a plot of their own (every new vector makes ngspice build the table of its plot's names anew).  An error
counts as right only if it is compared and found small: what is missing, not a number, or was never computed is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from resgrid.spice.write.flat import Deck, plain
from resgrid.spice.write.sidecar import Expected

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
    errors: list[str]


def format_companion(name: str, deck: Deck, expected: Expected, sha256: str) -> str:
    """Write the companion of a deck in a file of this name."""
    groups = [group for group in _groups(deck, expected) if group.errors]
    lines = [
        f"* verify {name}: prints PASS or FAIL",
        f"* ngspice -n -b {name}.verify",
        f"* the deck that it was written for has the SHA-256 {sha256}",
        f"* this file's own is in {name}.json, which resgrid check compares: altered, it proves nothing",
        f'.include "{name}"',
        ".options klu",
        ".control",
        "op",
        "setplot new",
        "let right = 0",
        "let worst = 0",
        "let place = 0",
    ]
    for group in groups:
        lines += [f"let worst_{group.what} = 0", *_comparisons(group, len(lines) + 1)]
    lines += _summary(groups)
    return "\n".join([*lines, ".endc", ".end"]) + "\n"


def _groups(deck: Deck, expected: Expected) -> list[_Group]:
    amps = {source: value for source, value in expected.source_current.items() if value is not None}
    values = zip(deck.resistors, plain(deck.resistor_value), strict=True)
    return [
        _Group("voltages", "of the supply", _errors("op1.v", expected.voltage, expected.supply)),
        _Group("currents", "of the largest", _errors("op1.i", amps, expected.current_scale)),
        _Group("resistances", "relative", [f" abs(@{name}[resistance]/{ohms}-1)" for name, ohms in values]),
    ]


def _errors(function: str, values: Mapping[str, float], scale: float) -> list[str]:
    return [
        f" abs({function}({name}){'-' if value >= 0 else '+'}{abs(value)!r})/{scale!r}"
        for name, value in values.items()
    ]


def _comparisons(group: _Group, before: int) -> list[str]:
    """Lines that compare; ``before`` is the number of the line in front of them."""
    lines: list[str] = []
    for first in range(0, len(group.errors), _PER_LINE):
        lines += [
            "compose error values" + "".join(group.errors[first : first + _PER_LINE]),
            f"let place = vecmax(error) gt worst ? {before + len(lines) + 1} : place",
            "let worst = vecmax(error) gt worst ? vecmax(error) : worst",
            f"let worst_{group.what} = vecmax(error) gt worst_{group.what} ? vecmax(error) : worst_{group.what}",
            f"let right = right + length(error)*mean(error le {TOLERANCE!r})",
            "unlet error",
        ]
    return lines


def _summary(groups: Sequence[_Group]) -> list[str]:
    total = sum(len(group.errors) for group in groups)
    counts = ", ".join(f"{len(group.errors)} {group.what} ($&worst_{group.what} {group.unit})" for group in groups)
    return [
        f"if right gt {total - 0.5}",
        f"  echo PASS: the largest error is $&worst where {TOLERANCE!r} is allowed: {counts}",
        "  quit 0",
        "else",
        f"  echo FAIL: the largest error is $&worst where {TOLERANCE!r} is allowed: {counts}",
        f"  let wrong = {total} - right",
        f"  echo $&wrong of {total} comparisons failed; line $&place of this file holds the largest error",
        "  quit 1",
        "end",
    ]
