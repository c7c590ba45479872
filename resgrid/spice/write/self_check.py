"""Writer of self-check decks: a file with which ngspice runs a deck, compares the results and prints PASS or FAIL.

The file needs only ngspice.  It holds the expected voltages, currents and resistances as plain numbers; the command
``compose`` makes vectors of errors.  These vectors have a plot (set of vectors) of their own, because ngspice rebuilds
the table of a plot's names for every new vector.  A comparison passes only if its error was computed and is small: a
missing or undefined number fails.
"""

from __future__ import annotations

from collections.abc import Mapping

from resgrid.spice.circuit import TOLERANCE
from resgrid.spice.write.flat import FlatDeck, plain
from resgrid.spice.write.sidecar import Expected

LARGEST = 400_000
"""Maximum number of comparisons of a self-check deck; with more, which would take hours, the deck is not written."""
_PER_LINE = 40
"""Number of error expressions in one ``compose`` command, which makes a vector of their values."""


def format_self_check(name: str, deck: FlatDeck, expected: Expected, sha256: str) -> str:
    """Return the text of the self-check deck, with which ngspice compares its results with expected ones.

    `name`: file name of the deck; `deck`: the deck; `expected`: expected voltages and currents; `sha256`: hash of the
    deck, 64 hexadecimal digits.
    """
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
    for (quantity, _), errors in groups.items():
        lines.append(f"let worst_{quantity} = 0")
        for first in range(0, len(errors), _PER_LINE):
            lines += [
                "compose error values" + "".join(errors[first : first + _PER_LINE]),
                f"let place = vecmax(error) gt worst ? {len(lines) + 1} : place",
                "let worst = vecmax(error) gt worst ? vecmax(error) : worst",
                f"let worst_{quantity} = vecmax(error) gt worst_{quantity} ? vecmax(error) : worst_{quantity}",
                f"let right = right + length(error)*mean(error le {TOLERANCE!r})",
                "unlet error",
            ]
    return "\n".join([*lines, *_summary(groups), ".endc", ".end"]) + "\n"


def _errors(function: str, values: Mapping[str, float], scale: float) -> list[str]:
    """Return one ngspice expression per value, for the magnitude of its error divided by `scale`, each after a blank.

    `function`: beginning of the name of a simulated value, such as ``op1.v``; `values`: expected value in volts or
    amperes, by the name of the node or source; `scale`: scale of the errors in the same unit, such as the supply.
    """
    return [
        f" abs({function}({name}){'-' if value >= 0 else '+'}{abs(value)!r})/{scale!r}"
        for name, value in values.items()
    ]


def _summary(groups: Mapping[tuple[str, str], list[str]]) -> list[str]:
    """Return the commands that print PASS or FAIL with the largest errors, and set the exit status of ngspice.

    `groups`: ngspice expressions of relative errors, by the quantity ("voltages", ...) and the scale of the errors as
    text ("of the supply", ...).
    """
    total = sum(map(len, groups.values()))
    counts = ", ".join(
        f"{len(errors)} {quantity} ($&worst_{quantity} {unit})" for (quantity, unit), errors in groups.items()
    )
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
