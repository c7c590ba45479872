"""Scaled numbers: doubles with an additional exponent, which cannot overflow or underflow."""

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
"""An exponent counts factors of ``2**BITS``."""

NOISE = 2.0**-70
"""Relative difference below which two refined values are equal up to rounding."""


_LOG_BASE = BITS * np.log(2.0)
_LEAST, _MOST = -5, 4
_POWERS = np.append(np.ldexp(1.0, BITS * np.arange(_LEAST, _MOST)), np.inf)
_POWERS.flags.writeable = False


Numbers = tuple[Floats, Integers]
"""Scaled numbers as plain doubles: mantissas and exponents."""


class Scaled(NamedTuple):
    """Numbers ``(hi + lo) * 2**(256 exponent)``; relative differences below `noise` are rounding errors."""

    hi: Floats
    lo: Floats
    exponent: Integers
    noise: float = NOISE

    @staticmethod
    def of(values: Floats) -> Scaled:
        """Convert doubles to scaled numbers."""
        return Scaled(values, np.zeros(len(values)), np.zeros(len(values), dtype=np.int64))

    @property
    def plain(self) -> Floats:
        """The values as doubles; 0 where they underflow."""
        return unscaled(self.hi, self.exponent)

    @property
    def log(self) -> Floats:
        """Natural logarithm of the values; -inf for those that are not positive."""
        return logarithm(self.hi, self.exponent)


def canonical(m: Floats, e: Integers, *rest: Floats) -> None:
    """Make scaled numbers canonical, ``2**-128 <= |m| < 2**128`` or 0, and rescale `rest` alike, in place."""
    steps = (np.frexp(m)[1] + (BITS // 2 - 1)) // BITS
    if steps.any():
        e += steps
        for part in (m, *rest):
            np.ldexp(part, -BITS * steps, out=part)


def power(exponent: Integers) -> Floats:
    """Return ``2**(256 exponent)``: 0 or infinity beyond the range of a double."""
    return np.asarray(_POWERS[np.clip(exponent, _LEAST, _MOST) - _LEAST])


def unscaled(m: Floats, e: Integers) -> Floats:
    """Return scaled numbers as doubles: 0 or infinite beyond their range."""
    if not e.any():
        return m.copy()
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(np.ldexp(m, BITS * np.clip(e, 2 * _LEAST, 2 * _MOST)))


def logarithm(m: Floats, e: Integers) -> Floats:
    """Return the natural logarithm of scaled numbers; -inf for those that are not positive."""
    with np.errstate(divide="ignore"):
        log = np.log(np.maximum(m, 0.0))
    if e.any():
        log += e * _LOG_BASE
    return np.asarray(log)
