"""From a card to tokens: words, marks, expressions and strings, each with its offset."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from resgrid.spice.reader.lines import Card

Kind = Literal["word", "mark", "expression", "string"]

_TOKEN = re.compile(
    r"[\s,]*(?:\{(?P<braces>[^{}]*)\}|'(?P<quotes>[^']*)'|\"(?P<string>[^\"]*)\"|(?P<mark>[=()])"
    r"|(?P<word>[^\s=(),{}'\"]+))"
)
_GAP = re.compile(r"[\s,]*")
_KINDS: dict[str | None, Kind] = {
    "braces": "expression",
    "quotes": "expression",
    "string": "string",
    "mark": "mark",
    "word": "word",
}


@dataclass(frozen=True)
class Token:
    """A piece of a card.

    `text`: without quotes or braces; `offset`: of its first character within the card's text, inside quotes or
    braces.
    """

    kind: Kind
    text: str
    offset: int


def tokenise(card: Card) -> list[Token]:
    """Cut a card into tokens; blanks and commas separate."""
    tokens, wrong = _cut(card.text)
    if wrong >= 0:
        raise card.error(wrong, f"{card.text[wrong]!r} is not closed, or closes nothing")
    return list(tokens)


@lru_cache(maxsize=8192)
def _cut(text: str) -> tuple[tuple[Token, ...], int]:
    """Tokens of a text, and the offset of what is none, or -1."""
    tokens: list[Token] = []
    position = 0
    end = len(text.rstrip())
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None:
            gap = _GAP.match(text, position)
            position = gap.end() if gap is not None else position
            return tuple(tokens), position if position < end else -1
        group = match.lastgroup
        assert group is not None
        tokens.append(Token(_KINDS[group], match.group(group), match.start(group)))
        position = match.end()
    return tuple(tokens), -1


@dataclass(frozen=True)
class Setting:
    """``key=value`` of a card; several values where more follow after commas or blanks."""

    key: str
    offset: int
    values: tuple[Token, ...]


def settings(card: Card, tokens: list[Token], several: frozenset[str] = frozenset()) -> list[Setting]:
    """Read ``key=value`` pairs; parentheses around them are ignored."""
    plain = [token for token in tokens if not (token.kind == "mark" and token.text in "()")]
    found: list[Setting] = []
    i = 0
    while i < len(plain):
        key = plain[i]
        if key.kind != "word" or i + 1 >= len(plain) or plain[i + 1].text != "=" or plain[i + 1].kind != "mark":
            raise card.error(key.offset, f"{key.text!r} was not expected here; key=value was")
        first = i + 2
        last = first + 1
        if key.text.lower() in several:
            while last < len(plain) and not _begins_pair(plain, last):
                last += 1
        values = tuple(plain[first:last])
        if not values or values[0].kind == "mark":
            raise card.error(key.offset, f"{key.text!r} has no value")
        found.append(Setting(key.text.lower(), key.offset, values))
        i = last
    return found


def _begins_pair(tokens: list[Token], i: int) -> bool:
    return i + 1 < len(tokens) and tokens[i + 1].kind == "mark" and tokens[i + 1].text == "="


def split_positional(tokens: list[Token]) -> tuple[list[Token], list[Token]]:
    """Part what stands before the first ``key=`` from the pairs."""
    first = next((i for i in range(len(tokens)) if tokens[i].kind == "word" and _begins_pair(tokens, i)), len(tokens))
    return tokens[:first], tokens[first:]
