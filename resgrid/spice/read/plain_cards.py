"""The short way for plain cards: compiled loops cut them out of a file, and leave what needs a closer look."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.element_tables import ElementArrays, Elements
from resgrid.spice.read.files import SourceFile, decode
from resgrid.spice.read.numerals import Numeral, parse_numeral

if TYPE_CHECKING:
    from resgrid.spice.read.kernels import Lines

LEAST_BYTES = 40_000
"""Below this size the compiled loops cost more to load than they save."""

_KINDS = ("resistor", "voltage source", "current source", "capacitor")
"""What the kinds of plain cards are."""

_SLASHES = re.compile(b"//")


def plain_lines(data: bytes, start: int) -> Iterator[tuple[int, str]]:
    """Every line of a file from a byte on, with its number."""
    number = data.count(b"\n", 0, start) + 1
    return enumerate(map(decode, data[start:].split(b"\n")), number)


class PlainCards:
    """The plain cards of a file, cut away from its other lines while those are read."""

    def __init__(self, source: SourceFile, start: int, rules: ReadingRules) -> None:
        from resgrid.spice.read.kernels import EMPTY, OTHER, Lines, cut

        data = source.data
        count = data.count(b"\n", start)
        self._source, self._rules, self._number = source, rules, data.count(b"\n", 0, start) + 1
        self._text = np.frombuffer(data, dtype=np.uint8)
        self._lines = lines = Lines(
            start=np.empty(count, dtype=np.int32),
            kind=np.empty(count, dtype=np.uint8),
            words=np.empty((count, 4, 2), dtype=np.int32),
            decimal=np.empty(count, dtype=np.bool_),
        )
        cut(self._text, start, lines)
        slashes = [match.start() for match in _SLASHES.finditer(data, start)]
        lines.kind[np.searchsorted(lines.start, slashes, side="right") - 1] = OTHER  # perhaps a comment
        self._value = _values(self._text, lines, rules)
        self._value[(lines.kind == _KINDS.index("capacitor")) & (self._value < 0)] = np.nan
        self._is_plain = np.isfinite(self._value)
        self._others = np.flatnonzero(~self._is_plain & (lines.kind != EMPTY))
        self._is_taken = np.zeros(count, dtype=np.bool_)

    def others(self, may_cut: Callable[[], bool]) -> Iterator[tuple[int, str]]:
        """The lines that are not plain cards, and where none may be cut away, all."""
        begin, count = 0, len(self._is_taken)
        for other in (*self._others.tolist(), count):
            if begin < other and may_cut():
                self._is_taken[begin:other] = True
            else:
                yield from map(self._line, range(begin, other))
            if other < count:
                yield self._line(other)
            begin = other + 1

    def _line(self, line: int) -> tuple[int, str]:
        start, data = int(self._lines.start[line]), self._source.data
        return self._number + line, decode(data[start : data.index(b"\n", start)])

    def enter(self, elements: Elements) -> None:
        """Enter what was cut away into the elements of the deck."""
        from resgrid.spice.read.kernels import number_names

        taken = np.flatnonzero(self._is_taken & self._is_plain)
        spans = self._lines.words[taken, 1:3].reshape(-1, 2)
        number, first = number_names(self._text, spans)
        spelt, line = spans[first], self._number + taken[first // 2]
        short = np.flatnonzero(np.diff(spelt)[:, 0] <= max(map(len, self._rules.grounds)))
        file = self._source.number
        numbers = elements.nodes.of_all(_words_at(self._text, spelt), file << 40 | line, short.tolist())
        ends = numbers[number].reshape(-1, 2)
        for code, kind in enumerate(_KINDS):
            own = self._lines.kind[taken] == code
            if own.any():
                cards = taken[own]
                place = np.stack([np.full(len(cards), file), self._number + cards], axis=1)
                names_of = partial(_words_at, self._text, self._lines.words[cards, 0])
                elements.parts[kind].append(
                    ElementArrays(names_of, ends[own], self._value[cards, np.newaxis], place, None)
                )


def _values(text: NDArray[np.uint8], lines: Lines, rules: ReadingRules) -> NDArray[np.float64]:
    """Values of plain cards, NaN or infinite where there is any doubt about one, and of other lines; shape (lines,)."""
    value = np.full(len(lines.kind), np.nan)
    is_card = lines.kind < len(_KINDS)
    decimal = np.flatnonzero(is_card & lines.decimal)
    value[decimal] = np.fromiter(map(float, _words_at(text, lines.words[decimal, 3])), np.float64, len(decimal))
    zero = np.flatnonzero(value == 0)
    underflows = [word.lower().partition("e")[0].strip("+-0.") != "" for word in _words_at(text, lines.words[zero, 3])]
    value[zero[underflows]] = np.nan
    suffixed = np.flatnonzero(is_card & ~lines.decimal)
    read: dict[str, float] = {}
    for card, word in zip(suffixed.tolist(), _words_at(text, lines.words[suffixed, 3]), strict=True):
        if word not in read:
            numeral = parse_numeral(word, rules)
            read[word] = numeral.value if isinstance(numeral, Numeral) and not numeral.warning else np.nan
        value[card] = read[word]
    return value


def _words_at(text: NDArray[np.uint8], spans: NDArray[np.int32]) -> list[str]:
    from resgrid.spice.read.kernels import gather

    return gather(text, spans).tobytes().decode("ascii").split("\n")[:-1]
