"""From lines to cards: comments stripped, continuations joined, every character's place kept."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from resgrid.spice.reader.journal import CardError, Journal, Spot
from resgrid.spice.reader.rules import ReadingRules

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
    >>> from resgrid.spice.reader.rules import NGSPICE
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
