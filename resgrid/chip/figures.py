"""Figures of merit: numbers with unit and definition, and shares of trials with score intervals (Wilson 1927)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.arguments import check_number


@dataclass(frozen=True)
class Reading:
    """One figure of a chip.

    `value`: none where it is not defined; `unit`: SI unit, ``""`` for a pure number; `definition`: what it is, in one
    sentence.
    """

    value: float | int | str | None
    unit: str
    definition: str


def json_form(readings: Mapping[str, Reading]) -> dict[str, Any]:
    """Readings as plain tables, for JSON."""
    return {
        name: {"value": reading.value, "unit": reading.unit, "definition": reading.definition}
        for name, reading in readings.items()
    }


@dataclass(frozen=True)
class Proportion:
    """A share of trials, with its interval.

    Attributes
    ----------
    value, low, high : float
        The share that was seen, and the ends of the interval.
    trials : int
    confidence : float
        Of the interval.
    """

    value: float
    low: float
    high: float
    trials: int
    confidence: float

    @property
    def half_width(self) -> float:
        """Half the length of the interval."""
        return 0.5 * (self.high - self.low)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "trials": self.trials,
            "confidence": self.confidence,
        }


def wilson(share: NDArray[np.float64] | float, trials: float, confidence: float) -> tuple[Any, Any]:
    """Ends of the score interval of shares of so many independent trials."""
    z = quantile(confidence)
    weight = 1.0 + z * z / trials
    middle = (share + 0.5 * z * z / trials) / weight
    half = z / weight * np.sqrt(share * (1.0 - np.asarray(share)) / trials + 0.25 * (z / trials) ** 2)
    return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)


def proportion(share: float, trials: int, confidence: float, effective: float | None = None) -> Proportion:
    """A share of trials with its score interval, for an effective number of trials where it is another."""
    low, high = wilson(share, trials if effective is None else effective, confidence)
    return Proportion(share, min(float(low), share), max(float(high), share), trials, confidence)


def effective_trials(total: int, squares: int, trials: int, members: int) -> float:
    """How many independent trials tell as much as trials of clusters, whose members are not independent (Kish 1965).

    It is ``p (1 - p)`` over the variance of the mean, which is estimated from the spread between clusters; at least
    the number of clusters, at most that of all members.
    """
    share = total / (trials * members)
    if trials < 2:
        return float(trials)
    # Whole numbers as long as differences matter.
    variance = (trials * squares - total * total) / (trials * trials * (trials - 1)) / members**2
    if variance <= 0.0:
        return float(trials)
    return float(min(max(share * (1.0 - share) / variance, trials), trials * members))


def quantile(confidence: float) -> float:
    """Standard deviations on either side of the mean that hold such a share of a normal distribution."""
    check_number("confidence", confidence, "a number between 0 and 1, such as 0.95", above=0.0, below=1.0)
    return NormalDist().inv_cdf(0.5 + 0.5 * confidence)
