"""Rules about values: shorts, negative resistances, spreads that a simulator cannot hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.check.violation import Violation
from resgrid.spice.circuit import SHOWN, Circuit, Severity, some

WIDEST_SPREAD = 1e15
"""Ratio of resistances beyond which double precision loses the small currents beside the large ones."""

SMALLEST_SAFE, LARGEST_SAFE = 1e-5, 1e12
"""In ohms: HSPICE raises what lies below (RESMIN); what lies above competes with the 1e-12 S a simulator may add."""


class _Limit(NamedTuple):
    """What resistances may not be; fields of the message are ``count`` and ``shown``."""

    severity: Severity
    rule: str
    is_beyond: Callable[[NDArray[np.float64]], NDArray[np.bool_]]
    message: str
    remedy: str


def _overflows(ohms: NDArray[np.float64]) -> NDArray[np.bool_]:
    with np.errstate(over="ignore", divide="ignore"):
        return np.asarray(np.isinf(ohms) | (np.isinf(1 / ohms) & (ohms != 0)))


_LIMITS = (
    _Limit(
        "error",
        "negative resistance",
        lambda ohms: ohms < 0,
        "{count} resistances are negative ({shown}): the circuit is active and cannot be solved as a resistor network",
        "correct the values",
    ),
    _Limit(
        "warning",
        "zero resistance",
        lambda ohms: ohms == 0,
        "{count} resistances are 0 ohm ({shown}): resgrid takes them for shorts, ngspice silently for 1 milliohm, "
        "HSPICE for its RESMIN",
        "write voltage sources of 0 V, or the resistance that is meant",
    ),
    _Limit(
        "error",
        "value",
        _overflows,
        "{count} resistances or their reciprocals are beyond the largest number ({shown})",
        "leave a resistor that large out: it is open; write one that small as a voltage source of 0 V",
    ),
    _Limit(
        "info",
        "extreme value",
        lambda ohms: (ohms != 0) & (np.abs(ohms) < SMALLEST_SAFE),
        f"{{count}} resistances are below {SMALLEST_SAFE:g} ohm, which HSPICE raises to its RESMIN ({{shown}})",
        "set .option resmin there, or write voltage sources of 0 V",
    ),
    _Limit(
        "info",
        "extreme value",
        lambda ohms: (np.abs(ohms) > LARGEST_SAFE) & np.isfinite(ohms),
        f"{{count}} resistances are above {LARGEST_SAFE:g} ohm: weaker than the 1e-12 S (gmin, rshunt) that a "
        "simulator may add to a node ({shown})",
        "switch gmin and rshunt off, or leave the resistors out",
    ),
)


def limits(circuit: Circuit) -> Iterator[Violation]:
    """Resistances that some simulator, or none, can take as they are."""
    for limit in _LIMITS:
        beyond = np.flatnonzero(limit.is_beyond(circuit.resistance))
        if beyond.size:
            named = [
                f"{circuit.element_name('resistor', number)} = {circuit.resistance[number]:g}"
                for number in beyond[:SHOWN].tolist()
            ]
            message = limit.message.format(count=f"{beyond.size:,}", shown=some(named, beyond.size))
            place = circuit.place_of("resistor", int(beyond[0]))
            yield Violation(limit.severity, limit.rule, place, message, limit.remedy)


def spread(circuit: Circuit) -> Iterator[Violation]:
    """Resistances that lie too many decades apart."""
    size = np.where(circuit.resistance > 0, circuit.resistance, np.nan)
    if np.isnan(size).all():
        return
    low, high = int(np.nanargmin(size)), int(np.nanargmax(size))
    if size[high] / WIDEST_SPREAD > size[low]:
        yield Violation(
            "warning",
            "value range",
            circuit.place_of("resistor", high),
            f"resistances run from {size[low]:g} ({circuit.element_name('resistor', low)}) to {size[high]:g} ohm "
            f"({circuit.element_name('resistor', high)}); a simulator loses the weak ones beside the strong ones",
            "replace the smallest by voltage sources of 0 V, or leave the largest out",
        )
