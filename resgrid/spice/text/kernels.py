"""Text in bulk: numbers and names written into one array of bytes.

`shortest_decimals` finds the shortest decimal number that reads back as the same double, which is what Python's
``repr`` prints, by the Schubfach method (R. Giulietti, "The Schubfach way to render doubles", 2020): the interval that
rounds to the double is scaled by a power of ten, of which 128 bits are kept, and the one or two candidates inside it
are compared.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_FRACTION_BITS = 52
_FRACTION = np.uint64((1 << 52) - 1)
_HIDDEN = np.uint64(1 << 52)
_BIAS = 1075
_SMALLEST_POWER = -292
_LARGEST_POWER = 324
_ZERO, _ONE, _TWO, _FOUR, _TEN, _FORTY = (np.uint64(number) for number in (0, 1, 2, 4, 10, 40))
_DIGIT, _MINUS, _PLUS, _POINT, _E = (ord(character) for character in "0-+.e")
LONGEST = 24
"""Characters of the longest number."""


@lru_cache(maxsize=1)
def powers_of_ten() -> NDArray[np.uint64]:
    """High and low 64 bits of the powers of ten from 1e-292 to 1e324, rounded up to 128 bits; shape (617, 2)."""
    rows = []
    for power in range(_SMALLEST_POWER, _LARGEST_POWER + 1):
        whole = 10 ** abs(power)
        bits = whole.bit_length()
        scaled = -(-(1 << (127 + bits)) // whole) if power < 0 else -(-(whole << 128) // (1 << bits))
        rows.append((scaled >> 64, scaled & (2**64 - 1)))
    return np.array(rows, dtype=np.uint64)


@njit(cache=True, inline="always")
def _product(a: np.uint64, b: np.uint64) -> tuple[np.uint64, np.uint64]:
    """High and low half of a product of 64-bit numbers."""
    a_low, a_high, b_low, b_high = a & _LOW, a >> _HALF, b & _LOW, b >> _HALF
    low = a_low * b_low
    middle = a_high * b_low + (low >> _HALF)
    other = a_low * b_high + (middle & _LOW)
    return a_high * b_high + (middle >> _HALF) + (other >> _HALF), a * b


@njit(cache=True, inline="always")
def _round_to_odd(power: NDArray[np.uint64], factor: np.uint64) -> np.uint64:
    lower, _ = _product(power[1], factor)
    high, low = _product(power[0], factor)
    total = low + lower
    if total < low:
        high += _ONE
    return high | np.uint64(total > _ONE)


@inner
def _shortest(bits: np.uint64, powers: NDArray[np.uint64]) -> tuple[np.uint64, np.int64]:
    """Shortest digits and their power of ten of a positive double."""
    fraction = bits & _FRACTION
    exponent = np.int64(bits >> np.uint64(_FRACTION_BITS)) & 0x7FF
    if exponent:
        c, q = fraction | _HIDDEN, exponent - _BIAS
        if 0 <= -q <= _FRACTION_BITS and (c & ((_ONE << np.uint64(-q)) - _ONE)) == _ZERO:
            return c >> np.uint64(-q), np.int64(0)
    else:
        c, q = fraction, np.int64(1 - _BIAS)
    closer = fraction == _ZERO and exponent > 1
    k = (q * 1262611 - (524031 if closer else 0)) >> 22
    shift = np.uint64(q + ((-k * 1741647) >> 19) + 1)
    power = powers[-k - _SMALLEST_POWER]
    odd = c & _ONE
    below = _round_to_odd(power, (_FOUR * c - (_ONE if closer else _TWO)) << shift)
    value = _round_to_odd(power, (_FOUR * c) << shift)
    above = _round_to_odd(power, (_FOUR * c + _TWO) << shift)
    lower, upper = below + odd, above - odd
    s = value >> _TWO
    if s >= _TEN:
        tens = s // _TEN
        under, over = lower <= _FORTY * tens, _FORTY * tens + _FORTY <= upper
        if under != over:
            return (tens + _ONE if over else tens), np.int64(k + 1)
    under, over = lower <= _FOUR * s, _FOUR * s + _FOUR <= upper
    if under != over:
        return (s + _ONE if over else s), np.int64(k)
    middle = _FOUR * s + _TWO
    up = value > middle or (value == middle and (s & _ONE) == _ONE)
    return (s + _ONE if up else s), np.int64(k)


@inner
def _put_number(out: NDArray[np.uint8], at: int, digits: np.uint64, power: int, scratch: NDArray[np.uint8]) -> int:
    """Write digits times a power of ten as ``repr`` does; returns where it ends."""
    while digits >= _TEN and digits % _TEN == _ZERO:
        digits //= _TEN
        power += 1
    count = 0
    while digits > _ZERO:
        scratch[count] = _DIGIT + np.int64(digits % _TEN)
        digits //= _TEN
        count += 1
    point = count + power
    if -4 < point <= 16:
        return _put_plain(out, at, scratch, count, point)
    out[at] = scratch[count - 1]
    at += 1
    if count > 1:
        out[at] = _POINT
        at += 1
        for i in range(count - 2, -1, -1):
            out[at] = scratch[i]
            at += 1
    return _put_exponent(out, at, point - 1)


@inner
def _put_plain(out: NDArray[np.uint8], at: int, scratch: NDArray[np.uint8], count: int, point: int) -> int:
    if point <= 0:
        out[at], out[at + 1] = _DIGIT, _POINT
        at += 2
        for _ in range(-point):
            out[at] = _DIGIT
            at += 1
    for i in range(max(count, point)):
        if i == point and point > 0:
            out[at] = _POINT
            at += 1
        out[at] = scratch[count - 1 - i] if i < count else _DIGIT
        at += 1
    if point >= count:
        out[at], out[at + 1] = _POINT, _DIGIT
        at += 2
    return at


@inner
def _put_exponent(out: NDArray[np.uint8], at: int, exponent: int) -> int:
    out[at], out[at + 1] = _E, _MINUS if exponent < 0 else _PLUS
    at += 2
    exponent = abs(exponent)
    if exponent >= 100:
        out[at] = _DIGIT + exponent // 100
        at += 1
    out[at], out[at + 1] = _DIGIT + exponent // 10 % 10, _DIGIT + exponent % 10
    return at + 2


@njit(cache=True)
def shortest_decimals(
    bits: NDArray[np.uint64], powers: NDArray[np.uint64], out: NDArray[np.uint8], offset: NDArray[np.int64]
) -> None:
    """Write finite doubles, given by their bits, one after the other into ``out``; ``offset`` has one entry more."""
    scratch = np.empty(LONGEST, dtype=np.uint8)
    at = 0
    for i in range(len(bits)):
        offset[i] = at
        magnitude = bits[i] & np.uint64(0x7FFFFFFFFFFFFFFF)
        if magnitude != bits[i]:
            out[at] = _MINUS
            at += 1
        if magnitude == _ZERO:
            out[at], out[at + 1], out[at + 2] = _DIGIT, _POINT, _DIGIT
            at += 3
        else:
            digits, power = _shortest(magnitude, powers)
            at = _put_number(out, at, digits, int(power), scratch)
    offset[len(bits)] = at


@njit(cache=True)
def put_literal(out: NDArray[np.uint8], at: NDArray[np.int64], literal: NDArray[np.uint8]) -> None:
    """Write one text into every row at its place, and move the places behind it."""
    size = len(literal)
    for row in range(len(at)):
        first = at[row]
        for i in range(size):
            out[first + i] = literal[i]
        at[row] = first + size


@njit(cache=True)
def put_texts(
    out: NDArray[np.uint8],
    at: NDArray[np.int64],
    data: NDArray[np.uint8],
    offset: NDArray[np.int64],
    index: NDArray[np.int64],
) -> None:
    """Write text ``index[row]`` into every row at its place, and move the places behind it."""
    for row in range(len(at)):
        first, start = at[row], offset[index[row]]
        size = offset[index[row] + 1] - start
        for i in range(size):
            out[first + i] = data[start + i]
        at[row] = first + size
