"""The two voltages that a circuit hangs between, and what ties its rows to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

Ties = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Rails:
    """The two voltages that a circuit with two rails hangs between.

    `high, low`: voltages in volts; ``high`` is the obstacle rail (or the driven start) where there is a map of cells;
    `ties`: returns `to_high` and `to_low`.
    """

    high: float
    low: float
    ties: Callable[[], Ties]

    @cached_property
    def _tied(self) -> Ties:
        return self.ties()

    @property
    def to_high(self) -> NDArray[np.float64]:
        """Conductance from every row to the high rail, in siemens, shape (n,); found when first asked for."""
        return self._tied[0]

    @property
    def to_low(self) -> NDArray[np.float64]:
        """The same for the low rail."""
        return self._tied[1]

    def tied(self, to_high: NDArray[np.float64], to_low: NDArray[np.float64]) -> Rails:
        """Return the same rails, with other ties of the rows to them."""
        return Rails(self.high, self.low, partial(_pair, to_high, to_low))


def _pair(to_high: NDArray[np.float64], to_low: NDArray[np.float64]) -> Ties:
    return to_high, to_low
