"""The short way for plain cards: compiled loops cut them out of a file, and leave what needs a closer look."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.cards import strip_comment
from resgrid.spice.read.files import Source, decode
from resgrid.spice.read.numerals import Numeral, parse_numeral
from resgrid.spice.read.tables import Elements, Part

if TYPE_CHECKING:
    from resgrid.spice.read.kernels import CardTable

LEAST_BYTES = 40_000
"""Below this size the compiled loops cost more to load than they save."""

_KINDS = ("resistor", "voltage source", "current source", "capacitor")
"""What the kinds of plain cards are."""


def plain_lines(data: bytes, start: int) -> Iterator[tuple[int, str]]:
    """Every line of a file from a byte on, with its number."""
    number = data.count(b"\n", 0, start) + 1
    return enumerate(map(decode, data[start:].split(b"\n")), number)


class PlainCards:
    """The plain cards of a file, cut away from its other lines while those are read."""

    def __init__(self, source: Source, start: int, rules: ReadingRules) -> None:
        from resgrid.spice.read.kernels import CardTable, NodeHash

        data = source.data
        rows = data.count(b"\n", start)
        self._file, self._data, self._text = source.number, data, np.frombuffer(data, dtype=np.uint8)
        self._rules = rules
        self._position, self._line = start, data.count(b"\n", 0, start) + 1
        self._counts = (0, 0, 0)  # of cards, other lines, and nodes
        self._known = NodeHash(
            slots=np.full(1 << max(6, (4 * rows).bit_length()), -1, dtype=np.int32),
            keys=np.empty(2 * rows + 1, dtype=np.uint64),
            spans=np.empty((2 * rows + 1, 3), dtype=np.int64),
        )
        self._cards = CardTable(
            kind=np.empty(rows, dtype=np.uint8),
            name=np.empty((rows, 2), dtype=np.int32),
            nodes=np.empty((rows, 2), dtype=np.int32),
            value=np.empty((rows, 2), dtype=np.int32),
            decimal=np.empty(rows, dtype=np.bool_),
            line=np.empty(rows, dtype=np.int32),
        )
        self._value = np.empty(rows)
        self._other = np.empty((rows + 1, 3), dtype=np.int64)
        self._has_slashes = b"//" in data
        self._comments = np.zeros(256, dtype=np.bool_)  # bytes that make a line a comment when they stand first
        self._comments[[ord(mark[0]) for mark in (*rules.comments, *("$" * rules.dollar_comments))]] = True

    def others(self, may_cut: Callable[[], bool]) -> Iterator[tuple[int, str]]:
        """The lines that are not plain cards, and where none may be cut away, all.

        What a command changes is known when the next card has begun: that one is never cut away.
        """
        of_command = goes_on = False
        while self._position < len(self._data):
            if may_cut() and not (of_command or goes_on):
                for first, last, number in self._cut():
                    yield number, decode(self._data[first:last])
                    goes_on = b"\\" in self._data[first:last]
                if self._position == len(self._data):
                    break
            number, line = self._next_line()
            yield number, line
            bare = strip_comment(line, self._rules).strip()
            if bare:
                of_command = bare[0] == "." or (of_command and (goes_on or bare[0] == "+"))
                goes_on = "\\" in bare

    def _next_line(self) -> tuple[int, str]:
        stop = self._data.index(b"\n", self._position)
        line = self._line, decode(self._data[self._position : stop])
        self._position, self._line = stop + 1, self._line + 1
        return line

    def _cut(self) -> list[tuple[int, int, int]]:
        """Cut cards away up to the next command: first and last byte and number of every other line before it."""
        from resgrid.spice.read.kernels import cut

        first_card, first_other, _ = self._counts
        self._position, self._line, count, others, nodes = cut(
            self._text, self._position, self._line, self._has_slashes, self._comments,
            self._known, self._cards, self._other, *self._counts,
        )  # fmt: skip
        self._counts = count, others, nodes
        kind, name, *_, line = cards = type(self._cards)._make(one[first_card:count] for one in self._cards)
        value = _values(self._text, cards, self._rules)
        value[(kind == _KINDS.index("capacitor")) & (value < 0)] = np.nan
        self._value[first_card:count] = value
        doubtful = np.flatnonzero(~np.isfinite(value))
        rows: list[tuple[int, int, int]] = self._other[first_other:others].tolist()
        for place, number in zip(name[doubtful, 0].tolist(), line[doubtful].tolist(), strict=True):
            rows.append((self._data.rfind(b"\n", 0, place) + 1, self._data.index(b"\n", place), number))
        if doubtful.size:
            rows.sort(key=itemgetter(2))
        return rows

    def enter(self, elements: Elements) -> None:
        """Enter what was cut away into the elements of the deck."""
        count, _, nodes = self._counts
        plain = np.isfinite(self._value[:count])
        spans = self._known.spans[:nodes]
        short = np.flatnonzero(spans[:, 1] - spans[:, 0] <= max(map(len, self._rules.grounds)))
        names = _words_at(self._text, spans[:, :2])
        numbers = elements.nodes.of_all(names, self._file << 40 | spans[:, 2], short.tolist())
        for code, kind in enumerate(_KINDS):
            own = np.flatnonzero(plain & (self._cards.kind[:count] == code))
            if own.size:
                line = self._cards.line[own].astype(np.int64)
                place = np.stack([np.full(len(line), self._file), line], axis=1)
                names_of = partial(_words_at, self._text, self._cards.name[own])
                ends, value = numbers[self._cards.nodes[own]], self._value[own, np.newaxis]
                elements.parts[kind].append(Part(names_of, ends, value, place, None))


def _values(text: NDArray[np.uint8], cards: CardTable, rules: ReadingRules) -> NDArray[np.float64]:
    """Values of cards, NaN or infinite where there is any doubt about one; shape (n,)."""
    value = np.full(len(cards.kind), np.nan)
    decimal = cards.decimal
    value[decimal] = np.fromiter(map(float, _words_at(text, cards.value[decimal])), np.float64)
    zero = np.flatnonzero(value == 0)
    underflows = [word.lower().partition("e")[0].strip("+-0.") != "" for word in _words_at(text, cards.value[zero])]
    value[zero[underflows]] = np.nan
    read: dict[str, float] = {}
    for card, word in zip(np.flatnonzero(~decimal).tolist(), _words_at(text, cards.value[~decimal]), strict=True):
        if word not in read:
            numeral = parse_numeral(word, rules)
            read[word] = numeral.value if isinstance(numeral, Numeral) and not numeral.warning else np.nan
        value[card] = read[word]
    return value


def _words_at(text: NDArray[np.uint8], spans: NDArray[np.integer[Any]]) -> list[str]:
    from resgrid.spice.read.kernels import gather

    return gather(text, spans.astype(np.int64)).tobytes().decode("ascii").split("\n")[:-1]
