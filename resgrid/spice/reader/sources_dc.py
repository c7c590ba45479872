"""What a voltage or current source is worth at direct current."""

from __future__ import annotations

import math

from resgrid.spice.reader.blocks import Scope
from resgrid.spice.reader.journal import Journal
from resgrid.spice.reader.lines import Card
from resgrid.spice.reader.tokens import Token

WAVEFORMS = frozenset({"pulse", "sin", "exp", "pwl", "sffm"})
"""Waveforms whose value at time 0 is known here."""

_OTHER_WAVEFORMS = frozenset(
    ("am", "trnoise", "trrandom", "external", "pat", "pattern", "prbs", "wavefile", "port", "lfsr", "trrand", "pwlz")
)
_IGNORED = frozenset({"ac", "distof1", "distof2", "acmag", "acphase"})


def source_value(card: Card, tokens: list[Token], scope: Scope, journal: Journal) -> tuple[float, float]:
    """Read what follows the nodes of an independent source.

    A value (with or without ``DC``) is the source's; failing that, the waveform's at time 0; failing that, 0.

    Parameters
    ----------
    card : Card
    tokens : list of Token
    scope : Scope
    journal : Journal

    Returns
    -------
    value, multiplier : float

    Raises
    ------
    CardError
        If something is not understood.
    """
    reader = _SourceReader(card, tokens, scope, journal)
    while reader.position < len(tokens):
        reader.step()
    if reader.direct is not None:
        return reader.direct, reader.count
    if reader.initial is not None:
        journal.note("info", card.spot(), "a source without DC value has its waveform's value at time 0")
        return reader.initial, reader.count
    if not tokens:
        journal.note("warning", card.spot(), "a source without any value is 0")
    return 0.0, reader.count


class _SourceReader:
    def __init__(self, card: Card, tokens: list[Token], scope: Scope, journal: Journal) -> None:
        self.card, self.tokens, self.scope, self.journal = card, tokens, scope, journal
        self.position = 0
        self.direct: float | None = None
        self.initial: float | None = None
        self.count = 1.0

    def step(self) -> None:
        token = self.tokens[self.position]
        word = token.text.lower() if token.kind == "word" else ""
        keyed = self._is_mark(self.position + 1, "=")
        if word == "dc":
            self.position += 1 + keyed
            self._state(token, self._number(token))
        elif word in _IGNORED:
            self.position += 1 + keyed
            self._skip_numbers()
        elif word in WAVEFORMS and not keyed:
            self.position += 1
            self._waveform(word, token)
        elif word == "m" and keyed:
            self.position += 2
            self.count = self._number(token)
        elif word in _OTHER_WAVEFORMS or keyed:
            raise self.card.error(token.offset, f"{token.text!r} is not understood in a source at direct current")
        else:
            self._state(token, self._number(token))

    def _state(self, token: Token, value: float) -> None:
        if self.direct is not None:
            raise self.card.error(token.offset, "a second value: the source has one already")
        self.direct = value

    def _is_mark(self, i: int, text: str) -> bool:
        return i < len(self.tokens) and self.tokens[i].kind == "mark" and self.tokens[i].text == text

    def _number(self, after: Token) -> float:
        if self.position >= len(self.tokens):
            raise self.card.error(after.offset, f"{after.text!r} has no value")
        token = self.tokens[self.position]
        self.position += 1
        value, warning = self.scope.value(self.card, token)
        if warning:
            self.journal.note("warning", self.card.spot(token.offset), warning)
        return value

    def _skip_numbers(self) -> None:
        for _ in range(2):
            if self.position < len(self.tokens) and self._is_number(self.position):
                self._number(self.tokens[self.position])

    def _is_number(self, i: int) -> bool:
        token = self.tokens[i]
        if token.kind == "word":
            return token.text[0] in "0123456789.+-"
        return token.kind == "expression"

    def _waveform(self, name: str, token: Token) -> None:
        bracketed = self._is_mark(self.position, "(")
        self.position += bracketed
        values: list[float] = []
        while self.position < len(self.tokens) and not self._is_mark(self.position, ")"):
            if not bracketed and not self._is_number(self.position):
                break
            if self._is_mark(self.position + 1, "="):
                self._trailing_key(name)
                continue
            values.append(self._number(token))
        if bracketed:
            if not self._is_mark(self.position, ")"):
                raise self.card.error(token.offset, f"the parenthesis after {token.text} is not closed")
            self.position += 1
        if not values:
            raise self.card.error(token.offset, f"{token.text} has no values")
        self.initial = _at_zero(name, values)

    def _trailing_key(self, name: str) -> None:
        key = self.tokens[self.position]
        if name != "pwl" or key.text.lower() not in ("r", "td", "repeat"):
            raise self.card.error(key.offset, f"{key.text!r} is not understood in {name}")
        self.position += 2
        self._number(key)


def _at_zero(name: str, values: list[float]) -> float:
    if name == "sin":
        offset, amplitude, _, _, _, phase = [*values, *[0.0] * 6][:6]
        return offset + amplitude * math.sin(math.radians(phase))
    if name == "pwl":
        times, levels = values[0::2], values[1::2]
        earlier = [i for i, time in enumerate(times) if time <= 0]
        if not levels:
            return 0.0
        if not earlier or earlier[-1] + 1 >= len(levels):
            return levels[min(earlier[-1], len(levels) - 1)] if earlier else levels[0]
        i = earlier[-1]
        return levels[i] + (levels[i + 1] - levels[i]) * (0.0 - times[i]) / (times[i + 1] - times[i])
    return values[0]
