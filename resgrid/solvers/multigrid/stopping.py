"""When the iteration may end."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

MOST_ITERATIONS = 200

LEAST_GAIN = 0.5
"""Factor by which the true residual must fall from burst to burst."""

DRIFT = 2.0
"""By how much the true residual may exceed the recursive one where the iteration has ended on its error."""

_FASTEST, _SLOWEST = 0.3, 0.95
"""Bounds on how much shorter the next step is expected to be, which two steps alone tell badly."""


_DOUBT = 10.0
"""By how much a step may go less far than its power lets expect."""


class ErrorBound:
    """Judges from the steps of conjugate gradients whether the error is small enough already.

    A step lessens the square of the error's energy norm by ``(z.r)^2 / p.A p``.  How fast that falls tells how far
    the steps to come still go, as a geometric series that begins with this one.
    """

    def __init__(self, guess: NDArray[np.float64] | None, rtol: float) -> None:
        self.small = False
        self._near = 0.0 if guess is None else rtol * largest(guess)
        self._last = 0.0
        self._far, self._then = 0.0, 1.0

    def moved(self, power: float, far: Callable[[], float]) -> None:
        """A step has lessened the squared norm by so much; ``far`` tells the most it has moved a voltage.

        That is asked only where the steps' powers let expect that it is small, but for the first one.
        """
        if not self._near:
            return
        ratio = math.sqrt(power / self._last) if self._last > 0.0 else _SLOWEST
        ratio = min(max(ratio, _FASTEST), _SLOWEST)
        self._last = power
        ahead = ratio / (1.0 - ratio)
        if self._far * math.sqrt(power / self._then) * ahead <= _DOUBT * self._near:
            self._far, self._then = far(), power
            self.small = self._far * ahead <= self._near


def largest(values: NDArray[np.float64]) -> float:
    """Largest magnitude."""
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
