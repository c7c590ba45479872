"""Checks for expressions of the simulation temperature that the dialect's simulator does not evaluate."""

from __future__ import annotations

from collections.abc import Collection

from resgrid.spice.read.cards import Card, Setting, Token
from resgrid.spice.read.diagnostics import Diagnostics
from resgrid.spice.read.scopes import TemperatureUse


def refuse_unsupported(card: Card, use: TemperatureUse, ohms: float | None) -> None:
    """Raise CardError if an expression uses the temperature in a way that the dialect's simulator cannot evaluate.

    The reason is a function or operator that is not available together with the temperature, or a resistance of 0 ohm.
    `card`: the statement with the expression; `use`: record of the temperature use of its evaluation; `ohms`: value of
    the expression in ohms if it is a resistance, None for other quantities.
    """
    words = card.rules.words
    if not use.used or not words.temperature_in_values:
        return
    name = min(words.temperature)
    if use.unsupported:
        text = f"{card.rules.name} does not know {use.unsupported} in an expression of {name}: avoid it there"
        raise card.error(None, text)
    if ohms == 0:
        raise card.error(None, f"{card.rules.name} fails for an expression of {name} that is 0 ohm: write 0")


_DROPPED = ("dtemp", "scale", "tc", "tce", "temp")
_BASE = 27.0
"""Reference temperature of a B element of ngspice, in degrees Celsius."""


def refuse_dropped(
    card: Card, use: TemperatureUse, keys: Collection[str], nodes: Collection[str], nominal: float
) -> None:
    """Raise CardError for parts of a resistor that ngspice drops or misreads with a temperature-dependent value.

    ngspice replaces such a resistor by a B element.  A B element supports only ``tc1`` and ``tc2``, relative to 27
    degrees Celsius for every nominal temperature, and misreads parentheses in names of nodes.  `card`: statement of the
    resistor; `use`: record of the temperature use of its value, without which nothing is checked; `keys`: keys of the
    resistor, and "model" if it has a model; `nodes`: names of its nodes; `nominal`: nominal temperature of the deck, in
    degrees Celsius.
    """
    if not use.used or not card.rules.words.temperature_in_values:
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


def refuse_temperature(card: Card, offset: int | None, place: str) -> None:
    """Raise CardError for a use of the temperature outside the values of elements, in dialects that know no other use.

    The caller has found this use.  `card`: the statement; `offset`: position in the text of the statement, None for the
    whole statement; `place`: description of the place in the message, such as ``m=``.
    """
    words = card.rules.words
    if words.temperature_in_values:
        name = min(words.temperature)
        text = f"{card.rules.name} does not know {name} in {place}, only in values of R, C and L: write the number"
        raise card.error(offset, text)


def refuse_unspaced(card: Card, pairs: list[Setting]) -> None:
    """Raise CardError if a list of values, such as ``tc=1m,2m``, is one that the dialect's simulator misreads.

    Such a list is in parentheses, or has no blank between its first two values, or its second value begins with a
    decimal point.  `pairs`: the ``key=value`` pairs of the statement `card`; those with one value are skipped.
    """
    for first, second in (pair.values[:2] for pair in pairs if len(pair.values) > 1):
        gap = card.text[first.offset + len(first.text) : second.offset].strip("{}'")
        bracketed = card.text[: first.offset].rstrip(" {'").endswith("(")
        parted = gap.isspace() or (first.kind == "word" and gap[0] == "," and gap[1:].isspace())
        if bracketed or second.text[0] == "." or not parted:
            raise card.error(first.offset, f"{card.rules.name} misreads or rejects this list: write tc1=... tc2=...")


def note_bare(card: Card, use: TemperatureUse, tokens: list[Token], diagnostics: Diagnostics) -> None:
    """Add a warning if the value of a resistor is the bare name of a parameter that depends on the temperature.

    The dialect's simulator stops there.  `card`: statement of the resistor; `use`: record of the temperature use of its
    value; `tokens`: tokens of its value, without those of ``key=value`` pairs; `diagnostics`: receives the warning.
    """
    bare = next((token for token in tokens if token.kind == "word"), None)
    if bare is not None and use.used and card.rules.words.temperature_in_values:
        name = min(card.rules.words.temperature)
        text = f"{card.rules.name} stops at a parameter that depends on {name}, without braces: write {{{bare.text}}}"
        diagnostics.refuse(card.spot(bare.offset), text)
