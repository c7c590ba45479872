"""Requests to a simulator that `write_spice` writes for a deck: analyses, probes (saved results) and measurements.

The analyses are operating point, transient, noise, several temperatures, and mismatch of the resistors.

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
    """Request for the operating point, which is also the only analysis if `write_spice` gets no request.

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
    """Request for the node voltages over time, from the operating point of the deck at time 0.

    Attributes
    ----------
    stop : float
        End of the transient, in seconds.
    step : float
        Largest time step, in seconds.  From time 0 to `step`, the values of the elements change linearly from those of
        the deck to those of `after`; later they are those of `after`.
    after : Netlist or None
        Circuit after the change, which has the nodes and elements of the deck with other values; None for no change.
        In tile form (``form="cells"`` of `write_spice`) it may be a different scene on the same grid; in flat form,
        supply, drive or switch states may differ.

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
    """Request for the spectral density of the noise voltage at a node, over a band of frequencies.

    The input of the analysis is the voltage source of the deck with the lowest index in the netlist.

    Attributes
    ----------
    node : str
        Name, in the deck, of the node with the noise voltage (the output).
    start, stop : float
        Limits of the frequency band, in hertz.
    points : int
        Number of frequencies per factor of 10.

    Raises
    ------
    InputError
        Unless ``0 < start < stop`` and ``points >= 1``.

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
                f"noise: {self.points} points per decade from {self.start} to {self.stop} Hz; "
                "points must be at least 1, and start positive and below stop"
            )


@checked
@dataclass(frozen=True)
class TemperatureAnalysis:
    """Request for the operating points of the circuit at several temperatures.

    Attributes
    ----------
    celsius : tuple of float
        Temperatures in degrees Celsius.  The nominal temperature, at which the values of the deck apply, is 27.

    Raises
    ------
    InputError
        If the tuple is empty, or a temperature is not above absolute zero.

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
    """Request for independent random deviations of the resistances, for one chip or a Monte Carlo run of many chips.

    Attributes
    ----------
    sigma : float
        Standard deviation of a resistance, as a fraction of its mean.
    seed : int
        Seed of the random numbers.  With ``runs = 0`` the factors are log-normal with mean 1, and equal to those of a
        scene with this seed and ``chip.mismatch = sigma``.  Otherwise the simulator gets the seed, except LTspice.
    runs : int
        Number of chips for which the simulator draws normally distributed resistances; with 0, resgrid draws the
        resistances of one chip and writes them into the deck.

    Raises
    ------
    InputError
        If ``sigma`` is not between 0 and 1 (0 and 0.2 if ``runs`` is not 0), or ``seed`` or ``runs`` is negative.

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
                f"mismatch: sigma = {self.sigma} must be below 0.2 for runs of a simulator: its normal distribution "
                "has negative resistances"
            )
        if self.seed < 0 or self.runs < 0:
            raise InputError(f"mismatch: seed = {self.seed} and runs = {self.runs} must not be negative")

    def factors(self, netlist: Netlist) -> NDArray[np.float64]:
        """Return the random factors of one chip's resistances.

        Parameters
        ----------
        netlist : Netlist
            Netlist of the chip without mismatch.

        Returns
        -------
        ndarray of float64, shape (n,)
            Log-normal factors with mean 1, one per site (position of a resistor).  The sites of a grid are all its
            faces between cells, then with a leak all cells; those of a netlist without cells are its resistors, then
            its nonlinear resistors.
        """
        return random_sites.mismatch_factors(random_sites.site_count(netlist), self.sigma, self.seed)

    def apply(self, netlist: Netlist) -> Netlist:
        """Return the netlist of the chip whose random resistances are drawn with the seed `seed`.

        Parameters
        ----------
        netlist : Netlist
            Netlist of the chip without mismatch.

        Returns
        -------
        Netlist
            Copy of the netlist in which the resistances between cells, and those of a leak, are multiplied by the
            random factors that `factors` returns; switches and rail segments are unchanged.
        """
        return random_sites.scale_resistances(netlist, self.factors(netlist))


@checked
@dataclass(frozen=True)
class Probe:
    """Request to save only these voltages and currents; without a `Probe` the simulator saves all voltages.

    Attributes
    ----------
    nodes : tuple of str
        Names of nodes in the deck whose voltages are saved.
    sources : tuple of str
        Names of voltage sources in the deck whose currents are saved.

    Raises
    ------
    InputError
        If both tuples are empty.

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
    """Request for a number that the simulator computes from a transient, which a `TransientAnalysis` must request.

    Attributes
    ----------
    name : str
        Name of the result: letters, digits and underscores.
    node : str
        Name of the node in the deck whose voltage is measured.
    what : {"maximum", "minimum", "value", "crossing"}
        Largest or smallest voltage of the node, voltage at the time `at`, or time at which the voltage first crosses
        `at`, rising or falling.
    at : float or None
        Time in seconds (``"value"``) or voltage in volts (``"crossing"``); None for a maximum and a minimum.

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
            raise InputError(
                f"measure {self.name}: at is required for a value (a time) and a crossing (a voltage) only"
            )


Analysis = (
    OperatingAnalysis | TransientAnalysis | NoiseAnalysis | TemperatureAnalysis | MismatchAnalysis | Probe | Measure
)


def kind_of(analysis: Analysis) -> str:
    """Return the name of an analysis, such as ``"operating"``, ``"transient"``, ``"probe"`` or ``"measure"``.

    Parameters
    ----------
    analysis : Analysis
        An analysis of this module.

    Returns
    -------
    str
        Name of the class of `analysis` in lower case, without ``Analysis``.
    """
    return type(analysis).__name__.removesuffix("Analysis").lower()
