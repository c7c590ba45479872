"""Scaled numbers, a double or the sum of two doubles times ``2**(256 e)``: array types, conversions and logarithms.

The exponent ``e`` is a 64-bit integer of each number, so that scaled numbers cannot overflow or underflow.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]
Singles = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]

BITS = 256
"""Number of binary places per unit of a separate exponent: a number with exponent ``e`` has the factor ``2**(BITS e)``.
"""

NOISE = 2.0**-70
"""Default of `Scaled.noise`: relative difference up to which two numbers count as equal except for rounding errors.

The numbers are results of iterative refinement in double-double arithmetic.
"""


_LOG_BASE = BITS * np.log(2.0)
_LEAST, _MOST = -5, 4
"""Largest exponent ``e`` for which ``2**(256 e)`` underflows to 0, and smallest for which it overflows."""
_POWERS = np.append(np.ldexp(1.0, BITS * np.arange(_LEAST, _MOST)), np.inf)
_POWERS.flags.writeable = False


Numbers = tuple[Floats, Integers]
"""Pair of arrays: mantissas (n,), doubles, and exponents (n,), integers, of ``mantissa * 2**(256 * exponent)``."""


class Scaled(NamedTuple):
    """Double-doubles with separate exponents, ``(hi + lo) * 2**(256 * exponent)``.

    `hi, lo` (n,): upper and lower parts, where ``|lo|`` is at most half a unit in the last place of ``hi``; `exponent`
    (n,): integers; `noise`: relative difference up to which two of the numbers count as equal except for rounding
    errors.
    """

    hi: Floats
    lo: Floats
    exponent: Integers
    noise: float = NOISE

    @staticmethod
    def of(values: Floats) -> Scaled:
        """Return the doubles `values` (n,) as scaled double-doubles, with all exponents 0.

        The upper parts are `values`, not copied; the lower parts are 0.
        """
        return Scaled(values, np.zeros(len(values)), np.zeros(len(values), dtype=np.int64))

    @property
    def plain(self) -> Floats:
        """The numbers rounded to doubles, shape (n,); 0 where they underflow, infinite where they overflow."""
        return unscaled(self.hi, self.exponent)

    @property
    def log(self) -> Floats:
        """Natural logarithm of ``hi * 2**(256 * exponent)``, shape (n,); -inf for numbers that are not positive."""
        return logarithm(self.hi, self.exponent)


def canonical(m: Floats, e: Integers, *rest: Floats) -> None:
    """Rescale numbers ``m * 2**(256 e)`` in place, so that each mantissa is 0 or ``2**-128 <= |m| < 2**128``.

    The numbers do not change. `m, e` (n,): mantissas and exponents; `rest`: further arrays of mantissas (n,) with the
    exponents ``e`` (such as lower parts), multiplied by the same powers of two as ``m``.
    """
    steps = (np.frexp(m)[1] + (BITS // 2 - 1)) // BITS
    if steps.any():
        e += steps
        for part in (m, *rest):
            np.ldexp(part, -BITS * steps, out=part)


def divided(values: Floats, divisor: float) -> Scaled:
    """Return the quotients of the doubles `values` (n,) and a divisor other than 0.

    The exponents are 0 except where a quotient exceeds the range of a double, as it may with a subnormal divisor. Lower
    parts are 0. A quotient below the range of a double becomes subnormal or 0.
    """
    with np.errstate(over="ignore"):
        out = Scaled.of(values / divisor)
    large = np.isinf(out.hi)
    if large.any():
        large &= np.isfinite(values)
        (m, e), (unit, places) = np.frexp(values[large]), np.frexp(divisor)
        bits = (e - places).astype(np.int64)
        quotient, exponent = np.ldexp(m / unit, bits % BITS), bits // BITS
        canonical(quotient, exponent)
        out.hi[large], out.exponent[large] = quotient, exponent
    return out


def power(exponent: Integers) -> Floats:
    """Return ``2**(256 * exponent)``, shape (n,), for integers `exponent` (n,).

    The result is 0 or infinity beyond the range of a double.
    """
    return np.asarray(_POWERS[np.clip(exponent, _LEAST, _MOST) - _LEAST])


def unscaled(m: Floats, e: Integers) -> Floats:
    """Return the numbers ``m * 2**(256 e)`` as doubles, shape (n,): 0 or infinite beyond the range of doubles.

    `m, e` (n,): mantissas and exponents.
    """
    if not e.any():
        return m.copy()
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(np.ldexp(m, BITS * np.clip(e, 2 * _LEAST, 2 * _MOST)))


def logarithm(m: Floats, e: Integers) -> Floats:
    """Return the natural logarithm of the numbers ``m * 2**(256 e)``, shape (n,); -inf for those that are not positive.

    `m, e` (n,): mantissas and exponents.
    """
    with np.errstate(divide="ignore"):
        log = np.log(np.maximum(m, 0.0))
    if e.any():
        log += e * _LOG_BASE
    return np.asarray(log)
