r"""Fast reader of plain cards: one regular expression finds them; other lines are left to the card-by-card reader.

A *plain card* is one line ``name node node value`` of a resistor, source or capacitor.  The value may be written
``R=value`` for a resistor and ``DC value`` for a source.  The line consists of printable ASCII without quotes,
parentheses, assignments or comments, and no other line continues it.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from itertools import compress, count

import numpy as np
from numpy.typing import NDArray

from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.element_tables import ElementArrays, Elements
from resgrid.spice.read.files import SourceFile, decode
from resgrid.spice.read.numerals import Numeral, parse_numeral

LEAST_BYTES = 40_000
"""Smallest file, in bytes, whose plain cards (lines ``name node node value``) are read in bulk by default.

In smaller files, reading in bulk would save less than 0.1 s.
"""

_BLOCK_BYTES = 2**16
"""Size of the parts of a file that one call of the regular expression splits, in bytes; it limits memory use."""

_KINDS = ("resistor", "voltage source", "current source", "capacitor")
_OTHER, _EMPTY = 254, 255
"""Codes of lines that are not plain cards: `_EMPTY` for blank lines and comments, `_OTHER` for all others.

The reader of single cards reads the lines with the code `_OTHER`.
"""

_CODES: dict[bytes | None, int] = {None: _OTHER}
"""Code of a line by the first letter of the plain card in the line; `_OTHER` for None, which means no plain card."""
_CODES |= {bytes([c]): code for code, letters in enumerate((b"rR", b"vV", b"iI", b"cC")) for c in letters}
"""The codes of plain cards are indices into `_KINDS`: 0 for ``r`` and ``R``, 1 for ``v``, 2 for ``i``, 3 for ``c``."""

_COMMAND, _BACKSLASH, _CONTINUES = 1, 2, 4
"""Properties of a line, as bits: a command, a line with a backslash, a line (``+``) that may continue the card before.

Plain cards that such lines can affect are left to the reader of single cards: the plain card after a command or a
backslash, and the plain card before a line that may continue it.
"""

_NAME = rb"[!#%&*+\-./0-9:<>?@A-Z\[\]^_`a-z|~]"
_NAME_WITHOUT_SLASHES = rb"(?:[!#%&*+\-.0-9:<>?@A-Z\[\]^_`a-z|~]++|/(?!/))"
_LINE = rb"""[ \t]*+(?:
    ([rRvViIcC])NAME* [ \t]++ (NAME+) [ \t]++ (NAME+) [ \t]++              # first letter, nodes
    ((?:[rR]=|[dD][cC][ \t]++)?)                                           # key of the value
    (?: ([+\-]?+ (?:\d++\.?+\d*+|\.\d++) (?:[eE][+\-]?\d{1,9}|(?![eE])))   # decimal
      | ([+\-.\d]NAME*) )                                                  # decimal with suffix
    [ \t]*+
    |(.*+)                                                                 # any other line
)\n"""
"""Regular expression of one line: groups 1 to 6 are the parts of a plain card, group 7 is any other line.

The groups are: first letter, first node, second node, key of the value, decimal value, value with suffix, other line.
``NAME`` is replaced by `_NAME`.  Only single characters repeat possessively: Python before 3.11.5 gets groups wrong.
"""
_PIECES = 8
"""Number of strings per line in the result of ``split`` with `_LINE`: seven groups, and the text between lines."""

_FIRST_WORD = re.compile(rb"[ \t]*+(" + _NAME + rb"*+).*+\n")


def plain_lines(data: bytes, start: int) -> Iterator[tuple[int, str]]:
    """Yield line number (counted from 1) and text of all lines of a file from the byte offset `start` on.

    `data`: content of the file; `start`: the beginning of a line.
    """
    number = data.count(b"\n", 0, start) + 1
    return enumerate(map(decode, data[start:].split(b"\n")), number)


def _blocks(data: bytes, start: int) -> Iterator[tuple[int, int]]:
    """Yield the byte offsets (first, end) of consecutive parts of `data` that are whole lines, from `start` on."""
    while start < len(data):
        stop = data.index(b"\n", min(start + _BLOCK_BYTES, len(data)) - 1) + 1
        yield start, stop
        start = stop


class PlainCards:
    """The plain cards of a file (``name node node value`` on one line), which are read in bulk, and the other lines.

    Line 0 of all arrays is at the byte offset `start` of the file.  `_code` (lines,): index into `_KINDS`, or `_OTHER`
    or `_EMPTY`; `_start` (lines,): byte offset of the line in the file; `_value` (lines,): ohms, volts, amperes or
    farads, NaN for other lines; `_spelling` (lines, 2): number of each node's spelling in `_spellings`; `_is_taken`
    (lines,): whether the line has been read in bulk.
    """

    def __init__(self, source: SourceFile, start: int, rules: ReadingRules) -> None:
        data = source.data
        lines = data.count(b"\n", start)
        self._source, self._offset = source, start
        self._number = data.count(b"\n", 0, start) + 1
        self._code = np.empty(lines, dtype=np.uint8)
        self._start = np.empty(lines, dtype=np.int32)
        self._value = np.full(lines, np.nan)
        self._spelling = np.empty((lines, 2), dtype=np.int32)
        self._spellings: defaultdict[bytes | None, int] = defaultdict(count().__next__)
        self._properties: list[tuple[int, int]] = []
        self._suffixed = _SuffixedValues(rules)
        self._scan()
        self._leave_to_general_reader()
        self._value[(self._code == _KINDS.index("capacitor")) & (self._value < 0)] = np.nan
        self._is_plain = (self._code < _OTHER) & np.isfinite(self._value)
        self._others = np.flatnonzero(~self._is_plain & (self._code != _EMPTY))
        self._is_taken = np.zeros(lines, dtype=np.bool_)

    def _scan(self) -> None:
        """Fill the arrays with code, byte offset, value and node names of all lines, one part of the file at a time."""
        data, first = self._source.data, 0
        name = _NAME_WITHOUT_SLASHES if data.find(b"//", self._offset) >= 0 else _NAME  # // may begin a comment
        pattern = re.compile(_LINE.replace(b"NAME", name), re.VERBOSE)
        for begin, stop in _blocks(data, self._offset):
            pieces = pattern.split(data[begin:stop])  # between lines: an empty piece, then all groups
            letters, nodes, more_nodes, keys, decimals, suffixed, texts = (
                pieces[i::_PIECES] for i in range(1, _PIECES)
            )
            lines = slice(first, first + len(letters))
            ends = np.flatnonzero(np.frombuffer(data, np.uint8, stop - begin, begin) == ord("\n"))
            self._start[lines] = np.concatenate([[begin], begin + 1 + ends[:-1]])
            self._code[lines] = np.frombuffer(bytes(map(_CODES.__getitem__, letters)), dtype=np.uint8)
            if any(keys):
                self._reject_keys(first, keys)
            for column, words in enumerate((nodes, more_nodes)):
                numbers = map(self._spellings.__getitem__, words)
                self._spelling[lines, column] = np.fromiter(numbers, np.int32, len(letters))
            self._value[lines] = self._values(decimals, suffixed)
            self._note_properties(first, texts)
            first += len(letters)

    def _reject_keys(self, first: int, keys: list[bytes | None]) -> None:
        """Mark a card as `_OTHER` if its key belongs to a different kind of element, such as a source with ``R=``.

        `first`: index of the first of some consecutive lines; `keys`: key before the value in each of these lines, None
        or empty without a key.
        """
        for line, key in enumerate(keys, first):
            if key and self._code[line] not in ((0,) if key[1:2] == b"=" else (1, 2)):
                self._code[line] = _OTHER

    def _values(self, decimals: list[bytes], suffixed: list[bytes]) -> NDArray[np.float64]:
        """Return the values of consecutive lines in SI units, shape (lines,); NaN or infinity where no plain card is.

        `decimals`: text of the value of each line if it is a decimal without a suffix; `suffixed`: text of the value of
        each line if it has a suffix, such as ``k``. An entry is None or empty if the line is no plain card, or if its
        value belongs to the other list.
        """
        value = _parsed(float, decimals)
        for line in np.flatnonzero(value == 0).tolist():
            if decimals[line].lower().partition(b"e")[0].strip(b"+-0."):  # not zero, but too small for a double
                value[line] = np.nan
        if any(suffixed):
            value = np.where(np.isnan(value), _parsed(self._suffixed.__getitem__, suffixed), value)
        return value

    def _note_properties(self, first: int, texts: list[bytes | None]) -> None:
        """Mark blank lines and comments as `_EMPTY`; record commands, backslashes and continuation lines (``+``).

        `first`: index of the first of some consecutive lines; `texts`: text of each of these lines, None for a plain
        card.
        """
        for line in np.flatnonzero(self._code[first : first + len(texts)] == _OTHER).tolist():
            text = texts[line]
            if text is None:  # a card that was rejected for the key of its value
                continue
            initial = text[0] if text else ord("\n")
            if initial in b"\n*":
                self._code[first + line] = _EMPTY
            strange = initial != ord("\n") and not 32 < initial < 127  # perhaps a blank for Python
            bits = _COMMAND * (initial == ord(".") or strange) | _CONTINUES * (initial == ord("+") or strange)
            bits |= _BACKSLASH * (b"\\" in text)
            if bits:
                self._properties.append((first + line, bits))

    def _leave_to_general_reader(self) -> None:
        """Mark the plain cards that a command, backslash or continuation line next to them may affect as `_OTHER`.

        These cards are then left to the reader of single cards.
        """
        cards = np.flatnonzero(self._code < _OTHER)
        lines = np.array([line for line, _ in self._properties], dtype=np.int64)
        data, start = self._source.data, self._offset
        before = data[data.rfind(b"\n", 0, max(start - 1, 0)) + 1 : start]  # a first line that may be an element
        # bits that concern the next card; index of that; last card of the fast path
        pending, at, last = _BACKSLASH * (b"\\" in before), 0, -1
        for (_, bits), stop in zip(self._properties, np.searchsorted(cards, lines).tolist(), strict=True):
            pending, at, last = self._leave_next(cards, pending, at, stop, last)
            if bits & _CONTINUES and last >= 0:
                self._code[cards[last]] = _OTHER
            pending |= bits & (_COMMAND | _BACKSLASH)
        self._leave_next(cards, pending, at, len(cards), last)

    def _leave_next(
        self, cards: NDArray[np.int64], pending: int, at: int, stop: int, last: int
    ) -> tuple[int, int, int]:
        """Mark the next cards as `_OTHER` (not read in bulk), one for every bit in `pending`; return the new state.

        Two bits concern two cards: a backslash may join the first card to the line before it, so that the card after a
        command is then the second one.  Bits for which no card remains before `stop` are in the returned `pending`.

        The state is `pending`, `at` (then equal to `stop`) and `last`. `cards`: line indices of the plain cards (lines
        ``name node node value``); `pending`: bits `_COMMAND` and `_BACKSLASH` of earlier lines that have not marked a
        card yet; `at, stop`: range of indices into `cards` of the cards before the next line that has such bits or is a
        continuation line; `last`: index into `cards` of the last card before `at` that is read in bulk, -1 for none.
        """
        while pending and at < stop:
            pending &= ~(_BACKSLASH if pending & _BACKSLASH else _COMMAND)
            self._code[cards[at]] = _OTHER
            at += 1
        return pending, max(at, stop), stop - 1 if at < stop else last

    def other_lines(self, may_take: Callable[[], bool]) -> Iterator[tuple[int, str]]:
        """Yield number (counted from 1) and text of the lines that are not read in bulk, in the order of the file.

        `may_take`: function that is called before every group of consecutive plain cards.  If it returns True, this
        group is read in bulk; if False, its lines are yielded, too.
        """
        begin, lines = 0, len(self._is_taken)
        for other in (*self._others.tolist(), lines):
            if begin < other and may_take():
                self._is_taken[begin:other] = True
            else:
                yield from map(self._line, range(begin, other))
            if other < lines:
                yield self._line(other)
            begin = other + 1

    def _line(self, line: int) -> tuple[int, str]:
        """Return the line number in the file (counted from 1) and the text of one line.

        `line`: index of the line among the lines that were scanned (counted from 0 at the offset `start` of the
        constructor).
        """
        start, data = int(self._start[line]), self._source.data
        return self._number + line, decode(data[start : data.index(b"\n", start)])

    def add_to(self, elements: Elements) -> None:
        """Add the elements of all plain cards that have been read in bulk to `elements`."""
        taken = np.flatnonzero(self._is_taken & self._is_plain)
        number, names, first = self._nodes(taken)
        file = self._source.number
        numbers = elements.nodes.numbers_of(names, file << 40 | self._number + taken[first // 2])
        ends = numbers[number].reshape(-1, 2)
        for code, kind in enumerate(_KINDS):
            own = self._code[taken] == code
            if own.any():
                cards = taken[own]
                place = np.stack([np.full(len(cards), file), self._number + cards], axis=1)
                names_of = partial(_first_words, self._source.data, self._offset, cards)
                elements.parts[kind].append(
                    ElementArrays(names_of, ends[own], self._value[cards, np.newaxis], place, None)
                )

    def _nodes(self, cards: NDArray[np.int64]) -> tuple[NDArray[np.int32], list[str], NDArray[np.int64]]:
        """Return node numbers (2 cards,), node names (nodes,), and the index of each node's first use (nodes,).

        In the node numbers, the two nodes of a card follow each other; the first uses are indices into this array.
        Nodes are numbered from 0 in the order of first use and regardless of case; a name has the spelling of the first
        use.  `cards`: indices of the lines of plain cards.
        """
        text = b"\n".join(word or b"" for word in self._spellings).decode("ascii")
        spellings, lower = text.split("\n"), text.lower()
        fold = np.arange(len(spellings), dtype=np.int32)  # number of each spelling regardless of case
        if lower != text:
            folded: defaultdict[str, int] = defaultdict(count().__next__)
            fold = np.fromiter(map(folded.__getitem__, lower.split("\n")), np.int32, len(spellings))
        spelling = self._spelling[cards].ravel()
        node = fold[spelling]
        uses = np.arange(len(node), dtype=np.int32)
        first_use = np.full(len(spellings), len(node), dtype=np.int32)
        first_use[node[::-1]] = uses[::-1]  # the last assignment to an entry counts
        first = np.flatnonzero(first_use[node] == uses)
        rank = np.empty(len(spellings), dtype=np.int32)
        rank[node[first]] = np.arange(len(first))
        return rank[node], list(map(spellings.__getitem__, spelling[first].tolist())), first


def _parsed(parse: Callable[[bytes], float], words: list[bytes]) -> NDArray[np.float64]:
    """Return the numbers that some words mean, shape (words,); NaN for an entry without a word.

    `parse`: function that returns the number that one word means; `words`: one entry per line; None or empty where the
    line is no plain card, or has its value in another notation (with or without suffix).
    """
    if all(words):
        return np.fromiter(map(parse, words), np.float64, len(words))
    value = np.full(len(words), np.nan)
    value[np.fromiter(map(bool, words), np.bool_, len(words))] = np.fromiter(
        map(parse, filter(None, words)), np.float64
    )
    return value


class _SuffixedValues(dict[bytes, float]):
    """Values of numerals with a suffix, each parsed once; NaN for a numeral that would cause an error or a warning."""

    def __init__(self, rules: ReadingRules) -> None:
        super().__init__()
        self._rules = rules

    def __missing__(self, word: bytes) -> float:
        numeral = parse_numeral(word.decode("ascii"), self._rules)
        value = numeral.value if isinstance(numeral, Numeral) and not numeral.warning else np.nan
        self[word] = value
        return value


def _first_words(data: bytes, start: int, lines: NDArray[np.int64]) -> list[str]:
    """Return the first words of some lines of a text, which are the names of the elements in these lines.

    `data`: the text; `start`: byte offset of the beginning of line 0; `lines`: ascending indices of the wanted lines,
    counted from 0 at `start`.
    """
    is_wanted = np.zeros(data.count(b"\n", start), dtype=np.bool_)
    is_wanted[lines] = True
    first, names = 0, list[str]()
    for begin, stop in _blocks(data, start):
        words = _FIRST_WORD.findall(data, begin, stop)
        wanted = list(compress(words, is_wanted[first : first + len(words)].tobytes()))
        if wanted:
            names += b"\n".join(wanted).decode("ascii").split("\n")
        first += len(words)
    return names
