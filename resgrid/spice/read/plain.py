"""The short way for plain cards: compiled loops cut a whole file, and keep aside what needs a closer look."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.files import decode
from resgrid.spice.read.numerals import Numeral, parse_numeral

if TYPE_CHECKING:
    from resgrid.spice.read.kernels import CardTable

LEAST_BYTES = 40_000
"""Below this size the compiled loops cost more to load than they save."""

_CAPACITOR = 3
_WORDS = tuple(
    np.frombuffer(word, dtype=np.uint8)
    for word in b".end .alter .subckt .macro .ends .eom .control .endc .endl .if .data dc".split()
)
_NO_WORD = np.frombuffer(b" ", dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Bulk:
    """Plain cards of one file.

    `node_names`: as spelt first; `node_line` (nodes,): where that is; `short`: nodes whose names are short enough to
    be ground's; `kind` (n,): 0 resistor, 1 voltage source, 2 current source, 3 capacitor; `text`: the file; `span`
    (n, 2): where the names of the elements stand in it; `nodes` (n, 2): index into ``node_names``; `value` (n,);
    `line` (n,); `other` (k, 3): first and last byte and number of every line that was not plain.
    """

    node_names: list[str]
    node_line: NDArray[np.int64]
    short: list[int]
    kind: NDArray[np.uint8]
    text: NDArray[np.uint8]
    span: NDArray[np.int32]
    nodes: NDArray[np.int32]
    value: NDArray[np.float64]
    line: NDArray[np.int32]
    other: NDArray[np.int64]

    def names(self, which: NDArray[np.bool_]) -> list[str]:
        """Names of some elements."""
        return _words_at(self.text, self.span[which])

    def others(self, data: bytes) -> Iterator[tuple[int, str]]:
        """Lines that were not plain."""
        for first, last, number in self.other.tolist():
            yield number, decode(data[first:last])


def plain_lines(data: bytes, start: int) -> Iterator[tuple[int, str]]:
    """Every line of a file from a byte on, with its number."""
    number = data.count(b"\n", 0, start) + 1
    return enumerate(map(decode, data[start:].split(b"\n")), number)


def scan(data: bytes, start: int, rules: ReadingRules) -> Bulk | None:
    """Cut a file into plain cards and others; None if it must be read line by line."""
    from resgrid.spice.read.kernels import TOO_HARD, CardTable, NodeHash, cut

    text = np.frombuffer(data, dtype=np.uint8)
    rows = data.count(b"\n", start)
    known = NodeHash(
        slots=np.full(1 << max(6, (4 * rows).bit_length()), -1, dtype=np.int32),
        keys=np.empty(2 * rows + 1, dtype=np.uint64),
        spans=np.empty((2 * rows + 1, 3), dtype=np.int64),
    )
    cards = CardTable(
        kind=np.empty(rows, dtype=np.uint8),
        name=np.empty((rows, 2), dtype=np.int32),
        nodes=np.empty((rows, 2), dtype=np.int32),
        value=np.empty((rows, 2), dtype=np.int32),
        decimal=np.empty(rows, dtype=np.bool_),
        line=np.empty(rows, dtype=np.int32),
    )
    other = np.empty((rows + 1, 3), dtype=np.int64)
    first_line = data.count(b"\n", 0, start) + 1
    comments = np.zeros(256, dtype=np.bool_)  # bytes that make a line a comment when they stand first
    comments[[ord(mark[0]) for mark in (*rules.comments, *("$" * rules.dollar_comments))]] = True
    words = (_NO_WORD, *_WORDS[1:]) if rules.end_is_comment else _WORDS
    ended, count, others, node_count = cut(text, start, first_line, b"//" in data, comments, words, known, cards, other)
    if ended == TOO_HARD:
        return None
    cards = CardTable._make(column[:count] for column in cards)
    value = _values(text, cards, rules)
    plain = np.isfinite(value) & ((cards.kind != _CAPACITOR) | (value >= 0))
    other = _with_demoted(other[:others], cards.line[~plain], data)
    keep = slice(count) if plain.all() else np.flatnonzero(plain)
    spans = known.spans[:node_count]
    longest = max(map(len, rules.grounds))
    return Bulk(
        node_names=_words_at(text, spans[:, :2]),
        node_line=spans[:, 2],
        short=np.flatnonzero(spans[:, 1] - spans[:, 0] <= longest).tolist(),
        kind=cards.kind[keep],
        text=text,
        span=cards.name[keep],
        nodes=cards.nodes[keep],
        value=value[keep],
        line=cards.line[keep],
        other=other,
    )


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


def _with_demoted(other: NDArray[np.int64], lines: NDArray[np.int32], data: bytes) -> NDArray[np.int64]:
    """Other lines, with some whose card turned out not to be plain."""
    if not lines.size:
        return other.copy()
    ends = np.append(-1, np.flatnonzero(np.frombuffer(data, dtype=np.uint8) == ord("\n")))  # of line 0, 1, ...
    rows = np.concatenate([other, np.stack([ends[lines - 1] + 1, ends[lines], lines], axis=1)])
    return rows[np.argsort(rows[:, 2], kind="stable")]


def _words_at(text: NDArray[np.uint8], spans: NDArray[np.integer[Any]]) -> list[str]:
    from resgrid.spice.read.kernels import gather

    return gather(text, spans.astype(np.int64)).tobytes().decode("ascii").split("\n")[:-1]
