"""Compiled loops over the bytes of a deck: plain cards cut, node names numbered, plain numbers recognised.

A *plain* card is one line ``name node node value``, or ``R=value`` for a resistor, ``DC value`` for a source, of
printable ASCII without quotes, parentheses or comments, that no other line continues.  Everything else is kept aside.

Numba takes seconds to import: only readers of large decks import this module.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner, kernel

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

NO_KIND = 255
KINDS = np.full(256, NO_KIND, dtype=np.uint8)
"""Kind of element that a letter stands for: 0 resistor, 1 voltage source, 2 current source, 3 capacitor."""
for _kind, _letters in enumerate((b"rR", b"vV", b"iI", b"cC")):
    KINDS[list(_letters)] = _kind


@njit(cache=True, inline="always")
def _token_end(text: Bytes, start: int) -> int:
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


@inner
def _hash(text: Bytes, start: int) -> tuple[int, np.uint64]:
    """End of a token, and the hash of its name in lower case (FNV-1a)."""
    key = _OFFSET
    i = start
    while CLASSES[text[i]] == NAME:
        key = (key ^ np.uint64(FOLDED[text[i]])) * _PRIME
        i += 1
    return i, key ^ (key >> _MIX)


class NodeHash(NamedTuple):
    """Node names in the order of their first occurrence, found by their hash.

    `slots` (power of two,): number of a name, -1 where there is none; `keys` (names,): hashes; `spans` (names, 3):
    first and last byte of a name where it occurs first, and that line.
    """

    slots: NDArray[np.int32]
    keys: NDArray[np.uint64]
    spans: NDArray[np.int64]


class CardTable(NamedTuple):
    """Plain cards: kinds, spans of names, nodes, spans of values, whether those are decimal numbers, lines."""

    kind: NDArray[np.uint8]
    name: NDArray[np.int32]
    nodes: NDArray[np.int32]
    value: NDArray[np.int32]
    decimal: NDArray[np.bool_]
    line: NDArray[np.int32]


@njit(cache=True, inline="always")
def _node(text: Bytes, start: int, stop: int, key: np.uint64, known: NodeHash, count: int, line: int) -> Any:
    """Number of a node name: that of its first occurrence (case folded), or ``count`` for a new one, then entered."""
    spans = known.spans
    mask = np.int64(len(known.slots) - 1)
    slot = np.int64(key) & mask
    while True:
        number = np.int64(known.slots[slot])
        if number < 0:
            known.slots[slot] = count
            known.keys[count] = key
            spans[count, 0] = start
            spans[count, 1] = stop
            spans[count, 2] = line
            return count
        if known.keys[number] == key and spans[number, 1] - spans[number, 0] == stop - start:
            first = spans[number, 0]
            same = True
            for i in range(stop - start):
                x, y = text[first + i], text[start + i]
                if x != y and FOLDED[x] != FOLDED[y]:
                    same = False
                    break
            if same:
                return number
        slot = (slot + 1) & mask


@kernel
def cut(
    text: Bytes,
    start: int,
    line: int,
    has_slashes: bool,
    comments: NDArray[np.bool_],
    known: NodeHash,
    cards: CardTable,
    other: NDArray[np.int64],
    card: int,
    others: int,
    node_count: int,
) -> tuple[int, int, int, int, int]:
    """Cut lines into plain cards and others, up to a command or a strange line, or behind one that holds a backslash.

    Returns where that is, the number of the line there, and how many cards, other lines and nodes there are.
    Shapes: `comments` (256,), `other` (.., 3).
    """
    position, number = start, line
    last_start, last_stop, last_number = -1, 0, 0  # of a plain card that may go on
    while position < len(text):
        begin = position
        i = _skip_blanks(text, begin)
        c = text[i]
        if KINDS[c] != NO_KIND:
            stop, node_count = _card(text, i, KINDS[c], has_slashes, known, node_count, number, cards, card)
            if stop >= 0:
                cards.kind[card] = KINDS[c]
                cards.line[card] = number
                card += 1
                last_start, last_stop, last_number = begin, stop, number
                position, number = stop + 1, number + 1
                continue
        stop, goes_on = i, False
        while text[stop] != 10:
            goes_on |= text[stop] == 92
            stop += 1
        is_comment = i == stop or c == 42 or (comments[c] and (c != 47 or text[i + 1] == 47))
        is_strange = (c < 32 or c > 126) and not is_comment
        if (c == 43 or is_strange) and last_start >= 0:
            card -= 1
            other[others, 0], other[others, 1], other[others, 2] = last_start, last_stop, last_number
            others += 1
        if c == 46 or is_strange:
            break
        position, number = stop + 1, number + 1
        if is_comment:
            continue
        last_start = -1
        other[others, 0], other[others, 1], other[others, 2] = begin, stop, number - 1
        others += 1
        if goes_on:
            break
    return position, number, card, others, node_count


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


@inner
def _comments_out(text: Bytes, start: int, stop: int) -> bool:
    """Whether ``//`` stands there."""
    for i in range(start, stop):  # noqa: SIM110
        if text[i] == 47 and text[i + 1] == 47:
            return True
    return False


@njit(cache=True, inline="always")
def _card(
    text: Bytes,
    start: int,
    kind: int,
    has_slashes: bool,
    known: NodeHash,
    node_count: int,
    line: int,
    cards: CardTable,
    card: int,
) -> tuple[int, int]:
    """Read one card; returns where its line ends, -1 if it is not plain, and how many nodes are known now."""
    name_stop = _token_end(text, start)
    a = _skip_blanks(text, name_stop)
    a_stop, a_key = _hash(text, a)
    b = _skip_blanks(text, a_stop)
    b_stop, b_key = _hash(text, b)
    v = _skip_blanks(text, b_stop)
    if kind == 0 and FOLDED[text[v]] == 114 and text[v + 1] == 61:
        v += 2
    elif 1 <= kind <= 2 and FOLDED[text[v]] == 100 and FOLDED[text[v + 1]] == 99 and CLASSES[text[v + 2]] == BLANK:
        v = _skip_blanks(text, v + 2)  # behind DC
    v_stop = _token_end(text, v)
    stop = _skip_blanks(text, v_stop)
    if text[stop] != 10 or min(a - name_stop, b - a_stop, v - b_stop, v_stop - v) == 0:
        return -1, node_count
    if not (_is_digit(text[v]) or 45 <= text[v] <= 46 or text[v] == 43):  # a sign or a point
        return -1, node_count
    if has_slashes and _comments_out(text, start, v_stop):
        return -1, node_count
    cards.decimal[card] = _is_decimal(text, v, v_stop)
    cards.value[card, 0], cards.value[card, 1] = v, v_stop
    cards.name[card, 0], cards.name[card, 1] = start, name_stop
    node = _node(text, a, a_stop, a_key, known, node_count, line)
    node_count += node == node_count
    cards.nodes[card, 0] = node
    node = _node(text, b, b_stop, b_key, known, node_count, line)
    node_count += node == node_count
    cards.nodes[card, 1] = node
    return stop, node_count


@kernel
def gather(text: Bytes, spans: NDArray[np.int64]) -> Bytes:
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
