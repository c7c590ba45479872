"""From lines to cards, and from cards to tokens.

Comments are stripped and continuations joined; every character's place is kept.  Tokens are words, marks, expressions
and strings.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from resgrid.spice.read.diagnostics import CardError, Journal, Spot
from resgrid.spice.read.rules import ReadingRules

Line = tuple[int, str]
"""A line's number, from 1, and its text."""


@dataclass(frozen=True, eq=False)
class Card:
    """A statement: a line and those that continue it.

    `text`: joined by blanks, comments stripped; `file`: index of its file; `name`: the file, as displayed; `line`:
    its first line; `joins`: per piece: its offset in ``text``, its line, the column of its first character, from 1.
    """

    text: str
    file: int
    name: str
    line: int
    joins: tuple[tuple[int, int, int], ...]

    def spot(self, offset: int | None = None) -> Spot:
        """Place of a character of the text; of the whole card without one."""
        if offset is None:
            return Spot(self.name, self.line)
        start, line, column = next(join for join in reversed(self.joins) if join[0] <= max(offset, 0))
        return Spot(self.name, line, column + max(offset, 0) - start)

    def error(self, offset: int | None, text: str) -> CardError:
        """Make an error about a place in this card."""
        return CardError(self.spot(offset), text)


@dataclass
class _Pieces:
    line: int
    texts: list[str]
    places: list[tuple[int, int]]


def cards(lines: Iterable[Line], file: int, name: str, rules: ReadingRules, journal: Journal) -> Iterator[Card]:
    """Join and strip lines into cards; blank lines and comments vanish."""
    pieces: _Pieces | None = None
    glued = False
    for number, line in lines:
        text = strip_comment(line, rules)
        bare = text.strip()
        if not bare:
            continue
        column = len(text) - len(text.lstrip()) + 1
        continues = bare[0] == "+"
        if (continues or glued) and pieces is None:
            journal.error(CardError(Spot(name, number, column), "this line continues (+) nothing"))
            continue
        if pieces is not None and not (continues or glued):
            yield _card(pieces, file, name)
            pieces = None
        if continues and not glued:
            bare, column = bare[1:], column + 1
        glued = bare.endswith("\\\\")
        bare = bare[:-2].rstrip() if glued else bare
        if pieces is None and not bare.strip():
            glued = False
            continue
        if pieces is None:
            pieces = _Pieces(number, [], [])
        pieces.texts.append(bare)
        pieces.places.append((number, column))
    if pieces is not None:
        yield _card(pieces, file, name)


def _card(pieces: _Pieces, file: int, name: str) -> Card:
    joins: list[tuple[int, int, int]] = []
    offset = 0
    for text, (line, column) in zip(pieces.texts, pieces.places, strict=True):
        joins.append((offset, line, column))
        offset += len(text) + 1
    return Card(" ".join(pieces.texts), file, name, pieces.line, tuple(joins))


_DOLLAR = re.compile(r"(?:^|[\s,])\$")


def strip_comment(line: str, rules: ReadingRules) -> str:
    """What is left of a line without its comment.

    Examples
    --------
    >>> from resgrid.spice.read.rules import NGSPICE
    >>> strip_comment("R1 a 0 1k ; load", NGSPICE)
    'R1 a 0 1k '
    """
    if line.lstrip()[:1] == "*":
        return ""
    end = len(line)
    for mark in rules.comments:
        place = line.find(mark)
        if place >= 0:
            end = min(end, place)
    if rules.dollar_comments and "$" in line:
        found = _DOLLAR.search(line)
        if found is not None:
            end = min(end, found.end() - 1)
    return line[:end]


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
