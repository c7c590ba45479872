"""Places and forms in which a simulator does not know the temperature."""

from __future__ import annotations

from resgrid.spice.read.cards import Card
from resgrid.spice.read.scopes import Watch


def refuse_cold(card: Card, watch: Watch, ohms: float | None) -> None:
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


def refuse_temperature(card: Card, offset: int | None, what: str) -> None:
    """Raise CardError where the dialect's simulator does not know the temperature in an expression."""
    words = card.rules.words
    if words.temperature_in_values:
        name = min(words.temperature)
        text = f"{card.rules.name} does not know {name} in {what}, only in values of R, C and L: write the number"
        raise card.error(offset, text)
