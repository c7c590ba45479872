"""Compiled loops over the bytes of a deck: plain cards found, node names numbered, plain numbers recognised.

A *plain* card is one line ``name node node value``, or ``R=value`` for a resistor, ``DC value`` for a source, of
printable ASCII without quotes, parentheses or comments, that no other line continues.

Numba takes seconds to import: only readers of large decks import this module.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid._internal.jit import inner, interruptible, kernel

Bytes = NDArray[np.uint8]

BAD, NAME, BLANK = 0, 1, 2
_OFFSET = np.uint64(14695981039346656037)
_PRIME = np.uint64(1099511628211)
_MIX = np.uint64(29)

CLASSES = np.full(256, BAD, dtype=np.uint8)
"""What every byte means in a plain card."""
CLASSES[33:127] = NAME
CLASSES[list(b"\"$'(),;={}\\")] = BAD
CLASSES[list(b" \t")] = BLANK

FOLDED = np.frombuffer(bytes(range(256)).lower(), dtype=np.uint8)
"""Every byte in lower case."""

OTHER, EMPTY = 254, 255
"""Kinds of lines that are no plain cards: what needs a closer look, and blank lines and comments."""
KINDS = np.full(256, OTHER, dtype=np.uint8)
"""Kind of element that a letter stands for: 0 resistor, 1 voltage source, 2 current source, 3 capacitor."""
for _kind, _letters in enumerate((b"rR", b"vV", b"iI", b"cC")):
    KINDS[list(_letters)] = _kind


class Lines(NamedTuple):
    """The lines of a text.

    `start` (lines,): first byte; `kind` (lines,): of a plain card, or `OTHER` or `EMPTY`.  Of plain cards: `words`
    (lines, 4, 2): first byte and end of name, nodes and value; `decimal` (lines,): whether the value has no suffix.
    """

    start: NDArray[np.int32]
    kind: NDArray[np.uint8]
    words: NDArray[np.int32]
    decimal: NDArray[np.bool_]


@njit(cache=True, inline="always")
def _word_end(text: Bytes, start: int) -> int:
    """End of a run of characters that a plain card may hold; the line ends at the latest."""
    i = start
    while CLASSES[text[i]] == NAME:
        i += 1
    return i


@njit(cache=True, inline="always")
def _skip_blanks(text: Bytes, start: int) -> int:
    i = start
    while CLASSES[text[i]] == BLANK:
        i += 1
    return i


@kernel
def cut(text: Bytes, start: int, lines: Lines) -> None:
    """Find the plain cards among the lines of a text from a byte on.

    Where it is not sure that a card stands by itself, it is another line: before a line that may continue it, and
    behind commands, which decide what it belongs to, and behind backslashes.
    """
    i, last = start, -1  # the last plain card
    follows_command = follows_backslash = False
    for line in range(len(lines.start)):
        lines.start[line] = i
        i = _skip_blanks(text, i)
        c = text[i]
        kind = KINDS[c]
        stop = -1 if kind == OTHER else _card(text, i, lines, line)
        if stop >= 0:
            if follows_backslash:
                kind, follows_backslash = OTHER, False
            elif follows_command:
                kind, follows_command = OTHER, False
            else:
                last = line
        else:
            kind = EMPTY if c in (10, 42) else OTHER
            is_strange = c != 10 and not 32 < c < 127  # a blank to Python, perhaps
            follows_command |= c == 46 or is_strange
            if (c == 43 or is_strange) and last >= 0:
                lines.kind[last] = OTHER
            stop = i
            while text[stop] != 10:
                follows_backslash |= text[stop] == 92
                stop += 1
        lines.kind[line] = kind
        i = stop + 1


@njit(cache=True, inline="always")
def _is_digit(c: int) -> bool:
    return 48 <= c <= 57


@inner
def _is_decimal(text: Bytes, start: int, stop: int) -> bool:
    """Whether a word is a number without a suffix: a sign, digits with a point among them, an exponent."""
    i = start + (text[start] == 45 or text[start] == 43)
    digits, points = 0, 0
    while i < stop and (_is_digit(text[i]) or (text[i] == 46 and points == 0)):
        points += text[i] == 46
        digits += text[i] != 46
        i += 1
    if i < stop and text[i] | 32 == 101:
        i += 1
        i += i < stop and (text[i] == 45 or text[i] == 43)
        digits *= 0 < stop - i <= 9  # as many as are read of an exponent
        while i < stop and _is_digit(text[i]):
            i += 1
    return i == stop and digits > 0


@njit(cache=True, inline="always")
def _card(text: Bytes, start: int, lines: Lines, line: int) -> int:
    """Read one line as a plain card; returns where it ends, -1 if it is none."""
    kind = KINDS[text[start]]
    name_stop = _word_end(text, start)
    a = _skip_blanks(text, name_stop)
    a_stop = _word_end(text, a)
    b = _skip_blanks(text, a_stop)
    b_stop = _word_end(text, b)
    v = _skip_blanks(text, b_stop)
    if kind == 0 and FOLDED[text[v]] == 114 and text[v + 1] == 61:
        v += 2
    elif 1 <= kind <= 2 and FOLDED[text[v]] == 100 and FOLDED[text[v + 1]] == 99 and CLASSES[text[v + 2]] == BLANK:
        v = _skip_blanks(text, v + 2)  # behind DC
    v_stop = _word_end(text, v)
    stop = _skip_blanks(text, v_stop)
    if text[stop] != 10 or min(a - name_stop, b - a_stop, v - b_stop, v_stop - v) == 0:
        return -1
    if not (_is_digit(text[v]) or 45 <= text[v] <= 46 or text[v] == 43):  # a sign or a point
        return -1
    words = lines.words[line]
    words[0, 0], words[1, 0], words[2, 0], words[3, 0] = start, a, b, v
    words[0, 1], words[1, 1], words[2, 1], words[3, 1] = name_stop, a_stop, b_stop, v_stop
    lines.decimal[line] = _is_decimal(text, v, v_stop)
    return stop


@inner
def _hash(text: Bytes, start: int, stop: int) -> np.uint64:
    """Hash of a name in lower case (FNV-1a)."""
    key = _OFFSET
    for i in range(start, stop):
        key = (key ^ np.uint64(FOLDED[text[i]])) * _PRIME
    return key ^ (key >> _MIX)


@inner
def _are_alike(text: Bytes, first: int, second: int, size: int) -> bool:
    """Whether two names of one length are the same, case folded."""
    for i in range(size):  # noqa: SIM110
        if FOLDED[text[first + i]] != FOLDED[text[second + i]]:
            return False
    return True


@interruptible
@kernel
def number_names(text: Bytes, spans: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Number names in the order of their first occurrence, case folded.

    Shapes: `spans` (n, 2): first byte and end of each; returns numbers (n,), and (names,): where each occurs first.
    """
    count, size = len(spans), 64
    while size < 2 * count:
        size *= 2
    slots = np.full(size, -1, dtype=np.int32)  # number of a name, by its hash; -1 where there is none
    keys, first = np.empty(count, dtype=np.uint64), np.empty(count, dtype=np.int64)
    numbers = np.empty(count, dtype=np.int32)
    names = 0
    for i in range(count):
        start, stop = spans[i]
        key = _hash(text, start, stop)
        slot = np.int64(key) & (size - 1)
        while True:
            number = slots[slot]
            if number < 0:
                number = slots[slot] = names
                keys[names], first[names] = key, i
                names += 1
                break
            begin, end = spans[first[number]]
            if keys[number] == key and end - begin == stop - start and _are_alike(text, begin, start, stop - start):
                break
            slot = (slot + 1) & (size - 1)
        numbers[i] = number
    return numbers, first[:names]


@kernel
def gather(text: Bytes, spans: NDArray[np.int32]) -> Bytes:
    """Pieces of a text, a line each."""
    size = 0
    for i in range(len(spans)):
        size += spans[i, 1] - spans[i, 0] + 1
    out = np.empty(size, dtype=np.uint8)
    at = 0
    for i in range(len(spans)):
        for j in range(spans[i, 0], spans[i, 1]):
            out[at] = text[j]
            at += 1
        out[at] = 10
        at += 1
    return out
