"""Analyses that a deck can be asked for, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid import die
from resgrid.errors import InputError
from resgrid.netlist import Netlist


@dataclass(frozen=True)
class OperatingAnalysis:
    """The operating point; what a deck is asked for when nothing else is."""


@dataclass(frozen=True, eq=False)
class TransientAnalysis:
    """What the voltages do in time, from the operating point of the deck.

    Attributes
    ----------
    stop : float
        End, in seconds.
    step : float
        Largest time step, in seconds; the change takes one.
    after : Netlist or None
        The scene that takes the deck's place at time 0: the same nodes and elements with other values (in tile form
        another scene of the same grid, otherwise another supply, drive or switch).
    """

    stop: float
    step: float
    after: Netlist | None = None

    def __post_init__(self) -> None:
        if not (0 < self.step <= self.stop and np.isfinite(self.stop)):
            raise InputError(f"transient: step = {self.step} s must be positive and at most stop = {self.stop} s")


@dataclass(frozen=True)
class NoiseAnalysis:
    """Noise voltage at a node.

    Attributes
    ----------
    node : str
        Its name in the deck.
    start, stop : float
        Band, in hertz.
    points : int
        Frequencies per decade.
    """

    node: str
    start: float = 1.0
    stop: float = 1e9
    points: int = 10

    def __post_init__(self) -> None:
        if not (0 < self.start < self.stop and np.isfinite(self.stop) and self.points >= 1):
            raise InputError(
                f"noise: {self.points} points a decade from {self.start} to {self.stop} Hz are no band; "
                "start must be positive and below stop"
            )


@dataclass(frozen=True)
class TemperatureAnalysis:
    """Operating points at other temperatures.

    Attributes
    ----------
    celsius : tuple of float
        The nominal one, at which values hold, is 27 degrees Celsius.
    """

    celsius: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.celsius or not all(np.isfinite(value) and value > -273.15 for value in self.celsius):
            raise InputError(
                f"temperature: {self.celsius} must be a list of temperatures above -273.15 degrees Celsius"
            )


@dataclass(frozen=True)
class MismatchAnalysis:
    """Resistors off their values, independently: those of one chip, or as many chips as the simulator draws.

    Attributes
    ----------
    sigma : float
        Standard deviation, as a share of the mean.
    seed : int
        The chip: the same seed draws the same factors, log-normal and of mean 1, as a scene's ``chip.mismatch``.
    runs : int
        How many chips the simulator draws by its own statistics, normal ones; 0 writes the values of one chip into the
        deck.
    """

    sigma: float
    seed: int = 0
    runs: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.sigma < 1:
            raise InputError(f"mismatch: sigma = {self.sigma} must lie between 0 and 1")
        if self.runs and self.sigma >= 0.2:
            raise InputError(
                f"mismatch: sigma = {self.sigma} must stay below 0.2 where a simulator draws: its normal resistances "
                "would be negative"
            )
        if self.seed < 0 or self.runs < 0:
            raise InputError(f"mismatch: seed = {self.seed} and runs = {self.runs} must not be negative")

    def factors(self, netlist: Netlist) -> NDArray[np.float64]:
        """What the resistances of one chip are multiplied by; shape (places on the die,)."""
        return die.mismatch_factors(die.place_count(netlist), self.sigma, self.seed)

    def apply(self, netlist: Netlist) -> Netlist:
        """One chip of this seed."""
        return die.scaled(netlist, self.factors(netlist))


@dataclass(frozen=True)
class Probe:
    """What is kept of every analysis.

    Attributes
    ----------
    nodes : tuple of str
        Names of nodes in the deck, for their voltages.
    sources : tuple of str
        Names of voltage sources in the deck, for their currents.
    """

    nodes: tuple[str, ...]
    sources: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.nodes and not self.sources:
            raise InputError("probe: name a node or a voltage source")


@dataclass(frozen=True)
class Measure:
    """One number of a transient.

    Attributes
    ----------
    name : str
        What the simulator calls it: letters, digits and underscores.
    node : str
        Its name in the deck.
    what : {"maximum", "minimum", "value", "crossing"}
        Extreme voltage, voltage at the time `at`, or time of the first crossing of the voltage `at`.
    at : float or None
        Seconds or volts.
    """

    name: str
    node: str
    what: Literal["maximum", "minimum", "value", "crossing"]
    at: float | None = None

    def __post_init__(self) -> None:
        if not (self.name.isidentifier() and self.name.isascii()):
            raise InputError(f"measure: {self.name!r} must be made of letters, digits and underscores")
        if self.what not in ("maximum", "minimum", "value", "crossing"):
            raise InputError(f"measure: {self.what!r} is unknown; choose maximum, minimum, value or crossing")
        if (self.at is None) == (self.what in ("value", "crossing")):
            raise InputError(f"measure {self.name}: only a value (at a time) and a crossing (of a voltage) take at")


Analysis = (
    OperatingAnalysis | TransientAnalysis | NoiseAnalysis | TemperatureAnalysis | MismatchAnalysis | Probe | Measure
)


def kind_of(analysis: Analysis) -> str:
    """What an analysis is called: ``"operating"``, ``"transient"``, ..."""
    return type(analysis).__name__.removesuffix("Analysis").lower()
