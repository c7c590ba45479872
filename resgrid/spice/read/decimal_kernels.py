"""Compiled conversion of decimal numbers to the nearest double.

Lemire, *Number parsing at a gigabyte per second* (2021), algorithm 1: the digits times a 128-bit approximation of the
power of five decide the rounding, but for rare cases that are left to Python's own conversion.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner

Bytes = NDArray[np.uint8]

READ, LONG, OTHER = 0, 1, 2
"""What a value is: read exactly, a number that Python must convert, something else that begins like a number."""

_LARGEST = 80
"""Powers of ten beyond this are left to Python."""

_ONE = np.uint64(1)
_ZERO = np.uint64(0)
_ALL = np.uint64(2**64 - 1)
_LOW = np.uint64(2**32 - 1)
_HALF = np.uint64(32)
_TOP = np.uint64(2**63)
_CUT = np.uint64(0x1FF)
_IMPLICIT = np.uint64(1 << 52)


def _powers_of_five() -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Upper and lower words of ``5**q``, scaled to 128 bits, rounded down for q >= 0 and up below."""
    upper, lower = [], []
    for q in range(-_LARGEST, _LARGEST + 1):
        if q >= 0:
            word = 5**q
            shift = word.bit_length() - 128
            word = word >> shift if shift > 0 else word << -shift
        else:
            bits = (5**-q - 1).bit_length()
            word = (1 << (bits + 127 if q >= -27 else 2 * bits + 128)) // 5**-q + 1
            word >>= max(word.bit_length() - 128, 0)
        upper.append(word >> 64)
        lower.append(word & (2**64 - 1))
    return np.array(upper, dtype=np.uint64), np.array(lower, dtype=np.uint64)


_UPPER, _LOWER = _powers_of_five()


@njit(cache=True, inline="always")
def _product(a: np.uint64, b: np.uint64) -> tuple[np.uint64, np.uint64]:
    """Upper and lower word of a product."""
    a0, a1, b0, b1 = a & _LOW, a >> _HALF, b & _LOW, b >> _HALF
    cross = a1 * b0 + ((a0 * b0) >> _HALF)
    middle = a0 * b1 + (cross & _LOW)
    return a1 * b1 + (cross >> _HALF) + (middle >> _HALF), a * b


@njit(cache=True)
def nearest(digits: np.uint64, power: int) -> tuple[int, np.uint64]:
    """Bits of the double nearest to ``digits * 10**power``."""
    if power < -_LARGEST or power > _LARGEST:
        return LONG, _ZERO
    zeros = 0
    while digits < _TOP:
        digits = digits << _ONE
        zeros += 1
    upper, lower = _product(digits, _UPPER[power + _LARGEST])
    if upper & _CUT == _CUT:
        more, _ = _product(digits, _LOWER[power + _LARGEST])
        lower = lower + more
        if lower < more:
            upper = upper + _ONE
    if lower == _ALL and (power < -27 or power > 55):
        return LONG, _ZERO
    high = upper >> np.uint64(63)
    shift = high + np.uint64(9)
    mantissa = upper >> shift
    exponent = ((217706 * power) >> 16) + 63 + np.int64(high) - zeros + 1023
    if lower <= _ONE and -4 <= power <= 23 and mantissa & np.uint64(3) == _ONE and mantissa << shift == upper:
        mantissa = mantissa & ~_ONE
    mantissa = (mantissa + (mantissa & _ONE)) >> _ONE
    if mantissa >= _IMPLICIT << _ONE:
        mantissa = _IMPLICIT
        exponent += 1
    if exponent <= 0 or exponent >= 2047:
        return LONG, _ZERO
    return READ, (mantissa & ~_IMPLICIT) | (np.uint64(exponent) << np.uint64(52))


@inner
def read_decimal(text: Bytes, start: int, stop: int) -> tuple[int, np.uint64]:
    """Read a decimal number."""
    i = start
    sign = _TOP if text[i] == 45 else _ZERO
    if text[i] == 45 or text[i] == 43:
        i += 1
    mantissa, digits, power, seen, point = _ZERO, 0, 0, 0, 0
    while i < stop:
        c = text[i]
        if 48 <= c <= 57:
            seen += 1
            digits += digits > 0 or c != 48
            if digits <= 19:
                mantissa = mantissa * np.uint64(10) + np.uint64(c - 48)
            power -= point
        elif c == 46 and point == 0:
            point = 1
        else:
            break
        i += 1
    if seen == 0:
        return OTHER, _ZERO
    if i < stop:
        exponent = _exponent(text, i, stop)
        if exponent == _NONE:
            return OTHER, _ZERO
        power += exponent
    if digits > 19:
        return LONG, _ZERO
    if mantissa == _ZERO:
        return READ, sign
    outcome, bits = nearest(mantissa, power)
    return outcome, bits | sign


_NONE = 10**6


@inner
def _exponent(text: Bytes, start: int, stop: int) -> int:
    """The exponent that stands there, with its ``e``; `_NONE` if it is something else, or has more than four digits."""
    if text[start] | 32 != 101:
        return _NONE
    i = start + 1
    sign = 1
    if i < stop and (text[i] == 43 or text[i] == 45):
        sign = -1 if text[i] == 45 else 1
        i += 1
    if i >= stop or stop - i > 4:
        return _NONE
    exponent = 0
    while i < stop:
        if not 48 <= text[i] <= 57:
            return _NONE
        exponent = exponent * 10 + (text[i] - 48)
        i += 1
    return sign * exponent
