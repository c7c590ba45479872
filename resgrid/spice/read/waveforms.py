"""Reader of independent sources: value at direct current, or else the value of their waveform at time 0."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

from resgrid.spice.read.cards import Card, Token
from resgrid.spice.read.name_conflicts import note_hidden_word
from resgrid.spice.read.scopes import Scope

_DELAYS = {"pulse": (2,), "sin": (3,), "sine": (3,), "exp": (2, 4), "pwl": (), "sffm": ()}
"""Positions of the delay times among the values of a waveform, counted from 0, by the waveform's name in lower case.

A waveform with a negative delay begins before time 0 and is rejected. The tuple is empty for a waveform without delays
among its values. Waveforms that are not keys are not supported.
"""

_OTHER_WAVEFORMS = frozenset(
    ("am", "trnoise", "trrandom", "external", "pat", "pattern", "prbs", "wavefile", "port", "lfsr", "trrand", "pwlz")
)
_IGNORED = frozenset({"ac", "distof1", "distof2", "acmag", "acphase"})


@dataclass(frozen=True)
class SourceValue:
    """Value of a source at direct current.

    `volts_or_amps`: the value, in volts for a voltage source, in amperes for a current source; `count`: number of
    parallel sources (``m=``); `series`: series resistance (``rser=``), in ohms.
    """

    volts_or_amps: float
    count: float = 1.0
    series: float = 0.0


def source_value(card: Card, tokens: list[Token], scope: Scope) -> SourceValue:
    """Return the value of an independent source at direct current, its multiplier and its series resistance.

    The value is the number with or without ``DC``; without such a number, the value of the waveform at time 0; without
    a waveform, 0.  `card`: the card of the source; `tokens`: tokens of the card after the nodes; `scope`: parameter
    values for expressions.
    """
    rest, keys = tokens[::-1], dict[str, float]()
    value: float | None = None
    waveform: tuple[Token, list[float], dict[str, float]] | None = None
    own_keys = ("m", "rser") if card.rules.series_resistance else ("m",)
    while rest:
        token = rest.pop()
        word = token.text.lower() if token.kind == "word" else ""
        keyed = _takes(rest, "=")
        note_hidden_word(card, token, scope)
        if word in _IGNORED:
            for _ in range(2):
                if rest and _begins_number(rest[-1]):
                    scope.number(card, rest.pop())
        elif word in _DELAYS and not keyed:
            waveform = _waveform(card, token, rest, scope)
        elif word in own_keys and keyed:
            keys[word] = _number(card, token, rest, scope)
        elif word != "dc" and (keyed or word in _OTHER_WAVEFORMS):
            raise card.error(token.offset, f"{token.text!r} is not supported in a source at direct current")
        else:
            stated = _number(card, token, rest, scope) if word == "dc" else scope.number(card, token)
            if waveform is not None and word != "dc":
                text = f"a value after a waveform, which ngspice drops: write DC {token.text}"
                raise card.error(token.offset, text)
            if value is not None:
                raise card.error(token.offset, "a second value: the source has one already")
            value = stated
    if value is None and waveform is not None:
        scope.diagnostics.inform(card.spot(), "a source without DC value has its waveform's value at time 0")
        value = _at_zero(card, *waveform)
    if not tokens:
        scope.diagnostics.warn(card.spot(), "a source without any value is 0")
    return SourceValue(0.0 if value is None else value, keys.get("m", 1.0), keys.get("rser", 0.0))


def _waveform(card: Card, token: Token, rest: list[Token], scope: Scope) -> tuple[Token, list[float], dict[str, float]]:
    """Consume the values of a waveform; return the token of its name, its values without a key, and its values by key.

    Only ``pwl`` has keys: ``r``, ``td`` and ``repeat``.  `card`: the card; `token`: name of the waveform; `rest`: the
    remaining tokens of the card, in reverse order; `scope`: parameter values.
    """
    bracketed, word = _takes(rest, "("), token.text.lower()
    if bracketed and rest and card.rules.refusals.glued_names:
        first = rest[-1]
        if first.kind == "word" and not _begins_number(first) and card.text[first.offset - 1] == "(":
            text = f"{card.rules.name} stops at a name directly after {word}(: write {{{first.text}}}"
            scope.diagnostics.refuse(card.spot(first.offset), text)
    values: list[float] = []
    keys: dict[str, float] = {}
    while rest and not rest[-1].is_mark(")") and (bracketed or _begins_number(rest[-1])):
        entry = rest.pop()
        if not _takes(rest, "="):
            values.append(scope.number(card, entry))
        elif word == "pwl" and entry.text.lower() in ("r", "td", "repeat"):
            keys[entry.text.lower()] = _number(card, entry, rest, scope)
        else:
            raise card.error(entry.offset, f"{entry.text!r} is not supported in {word}")
    if bracketed and not _takes(rest, ")"):
        raise card.error(token.offset, f"the parenthesis after {token.text} is not closed")
    if len(values) < 2:
        raise card.error(token.offset, f"{token.text} needs at least two values, not {len(values)}")
    return token, values, keys


def _takes(rest: list[Token], mark: str) -> bool:
    """Return whether the next token is `mark`, and if so, remove this token; `rest`: tokens in reverse order."""
    return bool(rest) and rest[-1].is_mark(mark) and bool(rest.pop())


def _number(card: Card, after: Token, rest: list[Token], scope: Scope) -> float:
    """Remove the next token from `rest` and return its value.

    `after`: the word before the number, for the error about a missing number; `rest`: the remaining tokens of the card,
    in reverse order; `scope`: parameter values.
    """
    if not rest:
        raise card.error(after.offset, f"{after.text!r} has no value")
    return scope.number(card, rest.pop())


def _begins_number(token: Token) -> bool:
    """Return whether a token is an expression or begins like a numeral."""
    return token.kind == "expression" or (token.kind == "word" and token.text[0] in "0123456789.+-")


def _at_zero(card: Card, token: Token, values: list[float], keys: dict[str, float]) -> float:
    """Return the value of a waveform at time 0, in volts or amperes; raise CardError where simulators disagree.

    `token`: name of the waveform; `values`: its values without a key, in the order of the card; `keys`: its values by
    key (``r``, ``td`` or ``repeat`` of ``pwl``, in lower case).
    """
    text = token.text
    delays = [*(values[i] for i in _DELAYS[text.lower()] if i < len(values)), keys.get("td", 0.0)]
    problem = ""
    if text.lower() == "sffm":
        problem = f"simulators, and versions of ngspice, differ on {text} at time 0"
    elif min(delays) < 0:
        problem = f"{text} has a negative delay, so it begins before time 0"
    elif text.lower() == "pwl":
        times, levels, now = values[0::2], values[1::2], -keys.get("td", 0.0)
        if len(times) != len(levels):
            raise card.error(token.offset, f"{text} has a time without a value")
        if any(after <= time for time, after in pairwise(times)):
            problem = f"the times of {text} do not increase; simulators differ on that"
        elif times[-1] <= now and not keys.keys() <= {"td"}:
            problem = f"{text} repeats before time 0"
        else:
            i = bisect_right(times, now)
            if i in (0, len(times)):
                return levels[max(i - 1, 0)]
            return levels[i - 1] + (levels[i] - levels[i - 1]) * (now - times[i - 1]) / (times[i] - times[i - 1])
    if problem:
        raise card.error(token.offset, f"{problem}: add its value at direct current, DC ...")
    if text.lower() in ("sin", "sine") and len(values) > 5:
        return values[0] + values[1] * math.sin(math.radians(values[5]))
    return values[0]
