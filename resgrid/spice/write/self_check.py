"""The self-verifying companion: a file that makes ngspice run a deck and print PASS or FAIL.

It needs nothing but ngspice.  Expected voltages and values stand in it as plain numbers; ``compose`` makes vectors of
errors, in a plot of their own (every new vector makes ngspice build the table of its plot's names anew).  An error
counts as right only if it is compared and found small: what is missing, not a number, or was never computed is not.
"""

from __future__ import annotations

from collections.abc import Mapping

from resgrid.spice.circuit import TOLERANCE
from resgrid.spice.write.flat import FlatDeck, plain
from resgrid.spice.write.sidecar import Expected

LARGEST = 400_000
"""Number of comparisons beyond which no companion is written: ngspice would take hours for the deck alone."""
_PER_LINE = 40


def format_companion(name: str, deck: FlatDeck, expected: Expected, sha256: str) -> str:
    """Write the companion of a deck in a file of this name."""
    amps = {source: value for source, value in expected.source_current.items() if value is not None}
    values = zip(deck.resistors, plain(deck.resistor_value), strict=True)
    groups = {
        ("voltages", "of the supply"): _errors("op1.v", expected.voltage, expected.supply),
        ("currents", "of the largest"): _errors("op1.i", amps, expected.current_scale),
        ("resistances", "relative"): [f" abs(@{name}[resistance]/{ohms}-1)" for name, ohms in values],
    }
    groups = {kind: errors for kind, errors in groups.items() if errors}
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
    for (what, _), errors in groups.items():
        lines.append(f"let worst_{what} = 0")
        for first in range(0, len(errors), _PER_LINE):
            lines += [
                "compose error values" + "".join(errors[first : first + _PER_LINE]),
                f"let place = vecmax(error) gt worst ? {len(lines) + 1} : place",
                "let worst = vecmax(error) gt worst ? vecmax(error) : worst",
                f"let worst_{what} = vecmax(error) gt worst_{what} ? vecmax(error) : worst_{what}",
                f"let right = right + length(error)*mean(error le {TOLERANCE!r})",
                "unlet error",
            ]
    return "\n".join([*lines, *_summary(groups), ".endc", ".end"]) + "\n"


def _errors(function: str, values: Mapping[str, float], scale: float) -> list[str]:
    return [
        f" abs({function}({name}){'-' if value >= 0 else '+'}{abs(value)!r})/{scale!r}"
        for name, value in values.items()
    ]


def _summary(groups: Mapping[tuple[str, str], list[str]]) -> list[str]:
    total = sum(map(len, groups.values()))
    counts = ", ".join(f"{len(errors)} {what} ($&worst_{what} {unit})" for (what, unit), errors in groups.items())
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
