"""Rules about values: shorts, negative resistances, spreads that a simulator cannot hold."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.check.violation import Violation
from resgrid.spice.subject import SHOWN, Subject

WIDEST_SPREAD = 1e15
"""Ratio of resistances beyond which double precision loses the small currents beside the large ones."""

SMALLEST_SAFE, LARGEST_SAFE = 1e-5, 1e12
"""In ohms: HSPICE raises what lies below (RESMIN); what lies above competes with the 1e-12 S a simulator may add."""


def negative(subject: Subject) -> Iterator[Violation]:
    """Negative resistances."""
    wrong = np.flatnonzero(subject.resistance < 0)
    if wrong.size:
        yield Violation(
            "error",
            "negative resistance",
            subject.place_of_element("resistor", int(wrong[0])),
            f"{wrong.size:,} resistances are negative ({_told(subject, wrong)}): the circuit is active and cannot be "
            "solved as a resistor network",
            "correct the values",
        )


def zero(subject: Subject) -> Iterator[Violation]:
    """Resistances of 0 ohm, which simulators read each in its own way."""
    shorts = np.flatnonzero(subject.resistance == 0)
    if shorts.size:
        yield Violation(
            "warning",
            "zero resistance",
            subject.place_of_element("resistor", int(shorts[0])),
            f"{shorts.size:,} resistances are 0 ohm ({_told(subject, shorts)}): resgrid takes them for shorts, ngspice "
            "silently for 1 milliohm, HSPICE for its RESMIN",
            "write voltage sources of 0 V, or the resistance that is meant",
        )


def overflow(subject: Subject) -> Iterator[Violation]:
    """Values whose reciprocal is beyond the largest number."""
    with np.errstate(over="ignore", divide="ignore"):
        beyond = np.isinf(subject.resistance) | (np.isinf(1 / subject.resistance) & (subject.resistance != 0))
    wrong = np.flatnonzero(beyond)
    if wrong.size:
        yield Violation(
            "error",
            "value",
            subject.place_of_element("resistor", int(wrong[0])),
            f"{wrong.size:,} resistances or their reciprocals are beyond the largest number ({_told(subject, wrong)})",
            "leave a resistor that large out: it is open; write one that small as a voltage source of 0 V",
        )


def spread(subject: Subject) -> Iterator[Violation]:
    """Resistances that lie too many decades apart."""
    size = np.where(subject.resistance > 0, subject.resistance, np.nan)
    if np.isnan(size).all():
        return
    low, high = int(np.nanargmin(size)), int(np.nanargmax(size))
    if size[high] / WIDEST_SPREAD > size[low]:
        yield Violation(
            "warning",
            "value range",
            subject.place_of_element("resistor", high),
            f"resistances run from {size[low]:g} ({subject.element_name('resistor', low)}) to {size[high]:g} ohm "
            f"({subject.element_name('resistor', high)}); a simulator loses the weak ones beside the strong ones",
            "replace the smallest by voltage sources of 0 V, or leave the largest out",
        )


def extremes(subject: Subject) -> Iterator[Violation]:
    """Values that some simulator changes, or that its own leakage competes with."""
    size = np.abs(subject.resistance)
    for which, text, remedy in (
        (
            (size > 0) & (size < SMALLEST_SAFE),
            f"below {SMALLEST_SAFE:g} ohm, which HSPICE raises to its RESMIN",
            "set .option resmin there, or write voltage sources of 0 V",
        ),
        (
            (size > LARGEST_SAFE) & np.isfinite(size),
            f"above {LARGEST_SAFE:g} ohm: weaker than the 1e-12 S (gmin, rshunt) that a simulator may add to a node",
            "switch gmin and rshunt off, or leave the resistors out",
        ),
    ):
        found = np.flatnonzero(which)
        if found.size:
            yield Violation(
                "info",
                "extreme value",
                subject.place_of_element("resistor", int(found[0])),
                f"{found.size:,} resistances are {text} ({_told(subject, found)})",
                remedy,
            )


def _told(subject: Subject, numbers: NDArray[np.int64]) -> str:
    shown = ", ".join(
        f"{subject.element_name('resistor', number)} = {subject.resistance[number]:g}"
        for number in numbers[:SHOWN].tolist()
    )
    return shown if numbers.size <= SHOWN else f"{shown} and {numbers.size - SHOWN:,} more"
