"""Places and forms in which a simulator does not know the temperature."""

from __future__ import annotations

from collections.abc import Collection

from resgrid.spice.read.cards import Card
from resgrid.spice.read.scopes import TemperatureUse


def refuse_cold(card: Card, watch: TemperatureUse, ohms: float | None) -> None:
    """Raise CardError for a resistance that the dialect's simulator does not evaluate at a temperature."""
    words = card.rules.words
    if not watch.used or not words.temperature_in_values:
        return
    name = min(words.temperature)
    if watch.cold:
        text = f"{card.rules.name} does not know {watch.cold} in an expression of {name}: write it otherwise"
        raise card.error(None, text)
    if ohms == 0:
        raise card.error(None, f"{card.rules.name} has no answer for an expression of {name} that is 0 ohm")


_DROPPED = ("dtemp", "scale", "tc", "tce", "temp")
_BASE = 27.0
"""Temperature from which a B element of ngspice counts, in degrees Celsius."""


def refuse_dropped(
    card: Card, watch: TemperatureUse, keys: Collection[str], nodes: Collection[str], nominal: float
) -> None:
    """Raise CardError for parts of a resistor that ngspice drops or misreads when its value depends on the temperature.

    ngspice writes such a resistor as a B element, which knows ``tc1`` and ``tc2`` alone, relative to 27 degrees Celsius
    whatever the nominal temperature is, and misreads parentheses in the names of its nodes.
    """
    if not watch.used or not card.rules.words.temperature_in_values:
        return
    label, where = card.rules.name, "with an expression of the temperature"
    dropped = next((f"{key}=" for key in _DROPPED if key in keys), "the model" if "model" in keys else "")
    if dropped:
        raise card.error(None, f"{label} drops {dropped} {where}: put it into the expression")
    if nominal != _BASE and ("tc1" in keys or "tc2" in keys):
        text = (
            f"{label} counts tc1= and tc2= from 27 degrees {where}, not from {nominal:g}: put them into the expression"
        )
        raise card.error(None, text)
    bracketed = next((node for node in nodes if "(" in node), None)
    if bracketed is not None:
        raise card.error(None, f"{label} misreads the parentheses of the node {bracketed} {where}: rename it")


def refuse_temperature(card: Card, offset: int | None, what: str) -> None:
    """Raise CardError where the dialect's simulator does not know the temperature in an expression."""
    words = card.rules.words
    if words.temperature_in_values:
        name = min(words.temperature)
        text = f"{card.rules.name} does not know {name} in {what}, only in values of R, C and L: write the number"
        raise card.error(offset, text)
