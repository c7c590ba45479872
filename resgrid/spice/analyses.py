"""Analyses that a deck can be asked for, as values.

>>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
>>> asked = [rg.spice.analyses.OperatingAnalysis(), rg.spice.analyses.Probe(nodes=("n_0_0",))]
>>> rg.write_spice(netlist, "lesson.cir", analyses=asked).commands.name
'lesson.cir.ngspice'
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.validation import checked
from resgrid.core import random_sites
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError


@checked
@dataclass(frozen=True)
class OperatingAnalysis:
    """The operating point; what a deck is asked for when nothing else is.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> written = rg.write_spice(netlist, "lesson.cir", analyses=[rg.spice.analyses.OperatingAnalysis()])
    >>> print(written.commands.read_text(), end="")
    * analyses of lesson.cir
    * ngspice -n -b -r analyses.raw lesson.cir.ngspice
    .include "lesson.cir"
    .options klu
    .op
    .end
    """


@checked
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

    Raises
    ------
    InputError
        If the step is not above 0 and at most ``stop``.

    Examples
    --------
    >>> study = rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip(capacitance="100f"))
    >>> settle = rg.spice.analyses.TransientAnalysis(stop=1e-8, step=1e-11)
    >>> written = rg.write_spice(study.netlist, "lesson.cir", analyses=[settle])
    >>> written.commands.read_text().splitlines()[-2]
    '.tran 1e-11 1e-08 0.0 1e-11'
    """

    stop: float
    step: float
    after: Netlist | None = None

    def __post_init__(self) -> None:
        if not (0 < self.step <= self.stop and np.isfinite(self.stop)):
            raise InputError(f"transient: step = {self.step} s must be positive and at most stop = {self.stop} s")


@checked
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

    Raises
    ------
    InputError
        If these frequencies are no band.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> written = rg.write_spice(netlist, "lesson.cir", analyses=[rg.spice.analyses.NoiseAnalysis("n_6_2", stop=1e6)])
    >>> written.commands.read_text().splitlines()[-2]
    '.noise v(n_6_2) v_obstacle dec 10 1.0 1000000.0'
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


@checked
@dataclass(frozen=True)
class TemperatureAnalysis:
    """Operating points at other temperatures.

    Attributes
    ----------
    celsius : tuple of float
        The nominal one, at which values hold, is 27 degrees Celsius.

    Raises
    ------
    InputError
        If there is no temperature, or one is not above absolute zero.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> written = rg.write_spice(netlist, "lesson.cir", analyses=[rg.spice.analyses.TemperatureAnalysis((27.0, 85.0))])
    >>> written.commands.read_text().splitlines()[4]
    'foreach celsius 27.0 85.0'
    """

    celsius: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.celsius) or not all(np.isfinite(value) and value > -273.15 for value in self.celsius):
            raise InputError(
                f"temperature: {self.celsius} must be a list of temperatures above -273.15 degrees Celsius"
            )


@checked
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

    Raises
    ------
    InputError
        If ``sigma`` is not between 0 and 1 (with ``runs``, 0.2), or a number is negative.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> chip = rg.spice.analyses.MismatchAnalysis(0.01, seed=3).apply(netlist)
    >>> float((chip.conductance / netlist.conductance).std().round(3))
    0.009
    >>> asked = [rg.spice.analyses.MismatchAnalysis(0.01, runs=10)]
    >>> written = rg.write_spice(netlist, "many.sp", "hspice", analyses=asked)
    >>> written.commands.read_text().splitlines()[4]
    '.dc monte=10'
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
        return random_sites.mismatch_factors(random_sites.site_count(netlist), self.sigma, self.seed)

    def apply(self, netlist: Netlist) -> Netlist:
        """One chip of this seed."""
        return random_sites.scale_resistances(netlist, self.factors(netlist))


@checked
@dataclass(frozen=True)
class Probe:
    """What is kept of every analysis.

    Attributes
    ----------
    nodes : tuple of str
        Names of nodes in the deck, for their voltages.
    sources : tuple of str
        Names of voltage sources in the deck, for their currents.

    Raises
    ------
    InputError
        If nothing is named.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> asked = [rg.spice.analyses.OperatingAnalysis(), rg.spice.analyses.Probe(("n_6_2",), sources=("v_obstacle",))]
    >>> written = rg.write_spice(netlist, "lesson.cir", analyses=asked)
    >>> written.commands.read_text().splitlines()[3]
    '.save v(n_6_2) i(v_obstacle)'
    """

    nodes: tuple[str, ...]
    sources: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not len(self.nodes) and not len(self.sources):
            raise InputError("probe: name a node or a voltage source")


@checked
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

    Raises
    ------
    InputError
        If the name holds other characters, or ``at`` is missing, not finite or does not belong to ``what``.

    Examples
    --------
    >>> study = rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip(capacitance="100f"))
    >>> rise = rg.spice.analyses.Measure("rise", "n_6_2", "crossing", at=0.5)
    >>> asked = [rg.spice.analyses.TransientAnalysis(1e-8, 1e-11), rise]
    >>> written = rg.write_spice(study.netlist, "lesson.cir", analyses=asked)
    >>> written.commands.read_text().splitlines()[-3]
    'meas tran rise when v(n_6_2)=0.5 cross=1'
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
        if self.at is not None and not np.isfinite(self.at):
            raise InputError(f"measure {self.name}: at = {self.at} must be finite")
        if (self.at is None) == (self.what in ("value", "crossing")):
            raise InputError(f"measure {self.name}: only a value (at a time) and a crossing (of a voltage) take at")


Analysis = (
    OperatingAnalysis | TransientAnalysis | NoiseAnalysis | TemperatureAnalysis | MismatchAnalysis | Probe | Measure
)


def kind_of(analysis: Analysis) -> str:
    """What an analysis is called: ``"operating"``, ``"transient"``, ..."""
    return type(analysis).__name__.removesuffix("Analysis").lower()
