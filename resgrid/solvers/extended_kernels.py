"""Compiled loops of the direct solver, in numbers whose exponent never runs out.

A *scaled* number is ``m * 2**(256 e)`` with a double ``m`` (canonical: ``2**-128 <= |m| < 2**128``, or 0) and a 64-bit
integer ``e``.  A scaled double-double adds a second double, ``(hi + lo) * 2**(256 e)`` with ``|lo| <= ulp(hi) / 2``;
its error-free sum and product are those of Knuth and Dekker (Ogita, Rump & Oishi 2005, algorithms 3.1 to 3.3).

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inlined
from resgrid.solvers.extended import BITS

_BASE = 2.0**BITS
_INVERSE = 2.0**-BITS
_LARGE = 2.0 ** (BITS // 2)
_SMALL = 2.0 ** -(BITS // 2)
_SPLITTER = 2.0**27 + 1.0

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]


@inlined
def _canonical(m: float, e: int) -> tuple[float, int]:
    if m == 0.0 or not math.isfinite(m):
        return m, e
    while abs(m) < _SMALL:
        m *= _BASE
        e -= 1
    while abs(m) >= _LARGE:
        m *= _INVERSE
        e += 1
    return m, e


@inlined
def _add(m: float, e: int, t: float, te: int) -> tuple[float, int]:
    """Sum of two scaled numbers; what lies 2**256 below the other is dropped."""
    if t == 0.0:
        return m, e
    if m == 0.0 or te > e + 1:
        return t, te
    if te == e:
        return m + t, e
    if te == e + 1:
        return m * _INVERSE + t, te
    if te == e - 1:
        return m + t * _INVERSE, e
    return m, e


@inlined
def _add_product(m: float, e: int, factor: float, v: float, ve: int) -> tuple[float, int]:
    """A scaled number and a double times another."""
    t, te = _canonical(factor * v, ve)
    return _add(m, e, t, te)


@inlined
def _two_sum(a: float, b: float) -> tuple[float, float]:
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@inlined
def _two_product(a: float, b: float) -> tuple[float, float]:
    p = a * b
    t = _SPLITTER * a
    a1 = t - (t - a)
    a2 = a - a1
    t = _SPLITTER * b
    b1 = t - (t - b)
    b2 = b - b1
    return p, a2 * b2 - (((p - a1 * b1) - a2 * b1) - a1 * b2)


@inlined
def _sum(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """Sum of two double-doubles."""
    s, t = _two_sum(a, b)
    u, v = _two_sum(a_low, b_low)
    s, t = _two_sum(s, t + u)
    return _two_sum(s, t + v)


@inlined
def _shift(value: float, steps: int) -> float:
    """``value * 2**(256 steps)``: 0 or infinity beyond the range of a double."""
    if steps == 0 or value == 0.0:
        return value
    if steps == 1:
        return value * _BASE
    if steps == -1:
        return value * _INVERSE
    return 0.0 if steps < 0 else math.copysign(np.inf, value)
