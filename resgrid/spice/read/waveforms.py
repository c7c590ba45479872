"""What a voltage or current source is worth at direct current."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import pairwise

from resgrid.spice.read.cards import Card, Token
from resgrid.spice.read.scopes import Scope

_DELAYS = {"pulse": (2,), "sin": (3,), "sine": (3,), "exp": (2, 4), "pwl": (), "sffm": ()}
"""Waveforms that are known here, and which of their values are delays."""

_OTHER_WAVEFORMS = frozenset(
    ("am", "trnoise", "trrandom", "external", "pat", "pattern", "prbs", "wavefile", "port", "lfsr", "trrand", "pwlz")
)
_IGNORED = frozenset({"ac", "distof1", "distof2", "acmag", "acphase"})


@dataclass(frozen=True)
class SourceValue:
    """Value of a source at direct current, how many lie in parallel, and a resistance in series, in ohms."""

    volts_or_amps: float
    count: float = 1.0
    series: float = 0.0


def source_value(card: Card, tokens: list[Token], scope: Scope) -> SourceValue:
    """Read what follows the nodes of an independent source.

    A value (with or without ``DC``) is the source's; failing that, the waveform's at time 0; failing that, 0.
    """
    source = _Source(card, tokens, scope)
    while source.position < len(tokens):
        source.read_next()
    value = source.value
    if value is None and source.waveform is not None:
        scope.diagnostics.inform(card.spot(), "a source without DC value has its waveform's value at time 0")
        value = _at_zero(card, *source.waveform)
    if not tokens:
        scope.diagnostics.warn(card.spot(), "a source without any value is 0")
    return SourceValue(0.0 if value is None else value, source.keys.get("m", 1.0), source.keys.get("rser", 0.0))


def _at_zero(card: Card, token: Token, values: list[float], keys: dict[str, float]) -> float:
    """What a waveform is worth at time 0, where all simulators agree about that."""
    text = token.text
    delays = [*(values[i] for i in _DELAYS[text.lower()] if i < len(values)), keys.get("td", 0.0)]
    wrong = ""
    if text.lower() == "sffm":
        wrong = f"simulators, and versions of ngspice, differ on {text} at time 0"
    elif min(delays) < 0:
        wrong = f"{text} has a negative delay, and has begun at time 0"
    elif text.lower() == "pwl":
        times, levels, now = values[0::2], values[1::2], -keys.get("td", 0.0)
        if len(times) != len(levels):
            raise card.error(token.offset, f"{text} has a time without a value")
        if any(after <= time for time, after in pairwise(times)):
            wrong = f"the times of {text} do not increase; simulators differ on that"
        elif times[-1] <= now and not keys.keys() <= {"td"}:
            wrong = f"{text} has repeated itself before time 0"
        else:
            i = bisect_right(times, now)
            if i in (0, len(times)):
                return levels[max(i - 1, 0)]
            return levels[i - 1] + (levels[i] - levels[i - 1]) * (now - times[i - 1]) / (times[i] - times[i - 1])
    if wrong:
        raise card.error(token.offset, f"{wrong}: say its value at direct current, DC ...")
    if text.lower() in ("sin", "sine") and len(values) > 5:
        return values[0] + values[1] * math.sin(math.radians(values[5]))
    return values[0]


@dataclass
class _Source:
    """What was read of a source; of its waveform the word, the values, and those that have a key."""

    card: Card
    tokens: list[Token]
    scope: Scope
    position: int = 0
    value: float | None = None
    waveform: tuple[Token, list[float], dict[str, float]] | None = None
    keys: dict[str, float] = field(default_factory=dict)

    def read_next(self) -> None:
        token = self.tokens[self.position]
        word = token.text.lower() if token.kind == "word" else ""
        keyed = self._is_mark(self.position + 1, "=")
        own_keys = ("m", "rser") if self.card.rules.series_resistance else ("m",)
        if word == "dc":
            self.position += 1 + keyed
            self._state(token, self._number(token))
        elif word in _IGNORED:
            self.position += 1 + keyed
            for _ in range(2):
                if self.position < len(self.tokens) and self._begins_number():
                    self._number(self.tokens[self.position])
        elif word in _DELAYS and not keyed:
            self.position += 1
            self._read_waveform(token)
        elif word in own_keys and keyed:
            self.position += 2
            self.keys[word] = self._number(token)
        elif word in _OTHER_WAVEFORMS or keyed:
            raise self.card.error(token.offset, f"{token.text!r} is not understood in a source at direct current")
        else:
            self._state(token, self._number(token))

    def _state(self, token: Token, value: float) -> None:
        if self.waveform is not None and token.text.lower() != "dc":
            raise self.card.error(token.offset, f"a value after a waveform, which ngspice drops: write DC {token.text}")
        if self.value is not None:
            raise self.card.error(token.offset, "a second value: the source has one already")
        self.value = value

    def _is_mark(self, i: int, text: str) -> bool:
        return i < len(self.tokens) and self.tokens[i].is_mark(text)

    def _number(self, after: Token) -> float:
        if self.position >= len(self.tokens):
            raise self.card.error(after.offset, f"{after.text!r} has no value")
        self.position += 1
        return self.scope.number(self.card, self.tokens[self.position - 1])

    def _begins_number(self) -> bool:
        token = self.tokens[self.position]
        return token.kind == "expression" or (token.kind == "word" and token.text[0] in "0123456789.+-")

    def _read_waveform(self, token: Token) -> None:
        bracketed = self._is_mark(self.position, "(")
        self.position += bracketed
        values: list[float] = []
        keys: dict[str, float] = {}
        while self.position < len(self.tokens) and not self._is_mark(self.position, ")"):
            if not bracketed and not self._begins_number():
                break
            if self._is_mark(self.position + 1, "="):
                key = self.tokens[self.position]
                if token.text.lower() != "pwl" or key.text.lower() not in ("r", "td", "repeat"):
                    raise self.card.error(key.offset, f"{key.text!r} is not understood in {token.text.lower()}")
                self.position += 2
                keys[key.text.lower()] = self._number(key)
            else:
                values.append(self._number(token))
        if bracketed:
            if not self._is_mark(self.position, ")"):
                raise self.card.error(token.offset, f"the parenthesis after {token.text} is not closed")
            self.position += 1
        if len(values) < 2:
            raise self.card.error(token.offset, f"{token.text} needs two values at least, not {len(values)}")
        self.waveform = token, values, keys
