"""Scaled numbers: a double times ``2**(256 e)`` with an integer exponent ``e``, which cannot overflow or underflow."""

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
"""Relative difference of two refined values up to which they are equal except for rounding."""


_LOG_BASE = BITS * np.log(2.0)
_LEAST, _MOST = -5, 4
"""Exponents ``e`` at and below which ``2**(256 e)`` underflows to 0, and at and above which it overflows."""
_POWERS = np.append(np.ldexp(1.0, BITS * np.arange(_LEAST, _MOST)), np.inf)
_POWERS.flags.writeable = False


Numbers = tuple[Floats, Integers]
"""Mantissas (n,), doubles, and exponents (n,), integers, of the numbers ``mantissa * 2**(256 * exponent)``."""


class Scaled(NamedTuple):
    """Double-doubles with separate exponents, ``(hi + lo) * 2**(256 * exponent)``.

    `hi, lo` (n,): upper and lower parts; `exponent` (n,): integers; `noise`: relative difference of two values up to
    which they are equal except for rounding.
    """

    hi: Floats
    lo: Floats
    exponent: Integers
    noise: float = NOISE

    @staticmethod
    def of(values: Floats) -> Scaled:
        """Return the doubles `values` (n,) with lower part and exponent 0."""
        return Scaled(values, np.zeros(len(values)), np.zeros(len(values), dtype=np.int64))

    @property
    def plain(self) -> Floats:
        """The values as doubles, shape (n,); 0 where they underflow, infinite where they overflow."""
        return unscaled(self.hi, self.exponent)

    @property
    def log(self) -> Floats:
        """Natural logarithm of the values including exponents, shape (n,); -inf for values that are not positive."""
        return logarithm(self.hi, self.exponent)


def canonical(m: Floats, e: Integers, *rest: Floats) -> None:
    """Rescale numbers ``m * 2**(256 e)`` in place, so that ``2**-128 <= |m| < 2**128``, or 0.

    `m, e` (n,): mantissas and exponents; `rest`: further mantissas (n,) with the exponents ``e``, which are multiplied
    by the same powers of two.
    """
    steps = (np.frexp(m)[1] + (BITS // 2 - 1)) // BITS
    if steps.any():
        e += steps
        for part in (m, *rest):
            np.ldexp(part, -BITS * steps, out=part)


def divided(values: Floats, divisor: float) -> Scaled:
    """Return the quotients of the doubles `values` (n,) and a divisor other than 0.

    The exponents are 0 except where a quotient exceeds the range of a double, as it may with a subnormal divisor.
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
