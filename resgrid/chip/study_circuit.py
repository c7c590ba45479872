"""`CircuitStudy`, base class of `Study`: the analyses of one chip's circuit, without Monte Carlo trials."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Count, Natural, Positive
from resgrid.chip import noise as thermal
from resgrid.chip.adc_resolution import ADCResolution, analyse_adc_resolution
from resgrid.chip.decks import noise_band
from resgrid.chip.noise import Noise, analyse_noise
from resgrid.chip.plan_energy import PlanEnergy, analyse_plan_energy
from resgrid.chip.power import Power, analyse_power
from resgrid.chip.sensitivity import Sensitivity, analyse_sensitivity, voltage_sensitivity
from resgrid.chip.settling import Settling, analyse_settling
from resgrid.chip.study_inputs import StudyInputs, checked_method
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.errors import InputError
from resgrid.planning.trace import start_cell


@dataclass(frozen=True, eq=False, repr=False)
class CircuitStudy(StudyInputs):
    """Analyses of the circuit of one chip; base class of `Study`, without the analyses that need Monte Carlo trials."""

    @checked_method
    def settling(
        self,
        *,
        bits: Annotated[int, Ge(1), Le(24)] | None = None,
        initial: OperatingPoint | ArrayLike | None = None,
        modes: Count = 6,
        span: Positive | None = None,
        method: str = "auto",
    ) -> Settling:
        """Compute the time and the energy that the chip needs to settle after its supplies are switched on.

        Parameters
        ----------
        bits : int, optional
            Accuracy of a settled voltage, 1 to 24: half a step of a converter of this resolution.  By default the
            resolution of the read-out, or 10.
        initial : OperatingPoint or array_like of float, shape (nodes,), optional
            Voltages before the supplies are switched on.  By default all capacitors are discharged.
        modes : int
            Number of slow time constants to compute.
        span : float, optional
            Range of the converter, in volts.  By default that of the read-out; without a chip description, the largest
            difference of final voltages.
        method : str
            Linear solver, one of the methods of `resgrid.solve`.

        Returns
        -------
        Settling
            Settling time of every node, time constants, energy and power.

        Raises
        ------
        CircuitError
            If a part of the circuit never settles.
        AccuracyError
            If rounding decides the slowest time constant, because the conductances span too many orders of magnitude,
            or if a figure overflows.
        """
        return analyse_settling(
            self.linear,
            bits=min(self.bits, 24) if bits is None else bits,
            initial=initial,
            modes=modes,
            span=self.span if span is None else span,
            method=method,
        )

    @cached_property
    def usual_settling(self) -> Settling:
        """Settling of the chip, for the resolution and the range of the chip's own converter."""
        return self.settling()

    @checked_method
    def noise(
        self,
        *,
        band: tuple[float, float] | None = None,
        temperature: Positive | None = None,
        method: Literal["auto", "exact", "estimate"] = "auto",
        samples: Annotated[int, Ge(2)] = 64,
        seed: Natural = 0,
    ) -> Noise:
        """Compute the thermal noise of every node voltage.

        Parameters
        ----------
        band : tuple of float, optional
            Lower and upper limit of the noise integral, in hertz; a read-out of noise bandwidth ``B`` has ``(0, B)``.
            By default the band of the read-out, else from 0 to 100 times the highest corner frequency of the circuit;
            no band without a chip description or without capacitance.
        temperature : float, optional
            Temperature of the resistors, in kelvin; by default that of the die.
        method : {"auto", "exact", "estimate"}
            "exact" computes the diagonal of the inverse matrix from its factors.  "estimate" estimates the diagonal
            from products with random signs, for large grids of three or more dimensions, whose factors need too much
            memory.  "auto" is exact up to 300,000 unknown voltages in plane grids, and up to 15,000 in other circuits.
        samples : int
            Number of random vectors of an estimate.
        seed : int
            Seed of the random vectors.

        Returns
        -------
        Noise
            Effective resistance, noise density and integrated noise of every node.

        Raises
        ------
        CircuitError
            If no resistors connect a node to a rail.
        AccuracyError
            If rounding errors may exceed 1e-3 of a density within the band, or a tenth of an estimate.
        """
        return analyse_noise(
            self.linear,
            band=self._band if band is None else band,
            temperature=self.temperature if temperature is None else temperature,
            method=method,
            samples=samples,
            seed=seed,
        )

    @cached_property
    def _band(self) -> tuple[float, float] | None:
        """Default lower and upper limit of the noise band in hertz; None for no band.

        The upper limit is the noise bandwidth of the read-out, else about 100 times the highest corner frequency.  If
        the read-out has no noise bandwidth, there is no band for a circuit without capacitors or without a chip
        description.
        """
        if self.description.readout.noise_bandwidth is not None:
            return 0.0, self.description.readout.noise_bandwidth
        if self.chip is None or not self.netlist.capacitance.any():
            return None
        return 0.0, noise_band(self.usual_settling)[1]

    @checked_method
    def noise_density(
        self, nodes: ArrayLike, frequencies: ArrayLike, *, temperature: Positive | None = None
    ) -> NDArray[np.float64]:
        """Compute the power spectral density of thermal noise, ``4 k T Re Z(f)``, for the impedance ``Z`` to the rails.

        Parameters
        ----------
        nodes : array_like of int, shape (k,)
            Numbers of the nodes.
        frequencies : array_like of float, shape (f,)
            Frequencies in hertz, at least 0.
        temperature : float, optional
            Temperature of the resistors, in kelvin; by default that of the die.

        Returns
        -------
        ndarray of float64, shape (f, k)
            Density in V^2/Hz; 0 on rails, NaN where a node floats.

        Raises
        ------
        CircuitError
            If a frequency is 0 and no resistors connect some part of the circuit to a rail.
        AccuracyError
            If the relative error of a density may exceed 1e-6.
        """
        temperature = self.temperature if temperature is None else temperature
        return thermal.noise_density(self.linear, nodes, frequencies, temperature=temperature)

    @checked_method
    def noise_covariance(self, nodes: ArrayLike, *, temperature: Positive | None = None) -> NDArray[np.float64]:
        """Compute the covariance ``k T C^-1`` of node voltages over all frequencies.

        Parameters
        ----------
        nodes : array_like of int, shape (k,)
            Numbers of the nodes; capacitances must connect each of them to a rail.
        temperature : float, optional
            Temperature of the resistors, in kelvin; by default that of the die.

        Returns
        -------
        ndarray of float64, shape (k, k)
            Covariance in V^2; 0 on rails, NaN where a node floats.

        Raises
        ------
        InputError
            If the noise of a node is unbounded, because no capacitances connect it to a rail.
        """
        temperature = self.temperature if temperature is None else temperature
        return thermal.noise_covariance(self.linear, nodes, temperature=temperature)

    @checked_method
    def power(self) -> Power:
        """Compute the power that the sources deliver and the heat of every resistor.

        Returns
        -------
        Power
            Power of every rail, heat of every resistor, and droop of the rails.
        """
        return analyse_power(self.op)

    @checked_method
    def adc_resolution(self, *, span: Positive | None = None) -> ADCResolution:
        """Compute the converter bits that every cell and every start needs.

        Parameters
        ----------
        span : float, optional
            Range of the converter, in volts.  By default that of the read-out.  Without a chip description it is the
            supply or, with a uniform drive, the height of the highest node above the goal rail.

        Returns
        -------
        ADCResolution
            Bits that every cell and every start needs.
        """
        return analyse_adc_resolution(self.op, span=self.span if span is None else span)

    @checked_method
    def plan_energy(self) -> PlanEnergy:
        """Compute energy and time of one plan: settling, supply during the read-out, and conversions along the path.

        Conversions need ``readout.figure_of_merit`` and ``readout.conversion_time`` of the chip description.  The paths
        are those of an ideal read-out.  The number of conversions is the mean over the starts of the scene, or over all
        free cells with a path if the scene has no such start.

        Returns
        -------
        PlanEnergy
            Energies, times and the number of conversions.

        Raises
        ------
        InputError
            If the chip has no capacitance.
        CircuitError
            If a part of the circuit never settles.
        """
        if not self.netlist.capacitance.any():
            raise InputError("the chip has no capacitance, so that no time limits a plan; give chip.capacitance")
        cells = self.netlist.cells
        starts = () if self.scene is None else self.scene.starts
        begins = [start_cell(cells.space, start) for start in starts]
        return analyse_plan_energy(self.usual_settling, self.adc_resolution(), self.description.readout, begins)

    @checked_method
    def sensitivity(self, cells: ArrayLike | None = None) -> Sensitivity:
        """Find the resistors that can change a step of the robot.

        Parameters
        ----------
        cells : array_like of int, shape (axes,) or (k, axes), optional
            Indices of one cell, or of all cells of a path; goal cells are left out.  Each cell costs one linear solve.
            By default the cells on the paths from the starts of the scene; without starts, those on the path from the
            start that needs most bits.

        Returns
        -------
        Sensitivity
            Margins of the steps, and the relative change of each resistance that changes a step.

        Raises
        ------
        AccuracyError
            If the error of a derivative may exceed 1e-5 of the largest derivative.
        """
        if cells is None:
            space = self.netlist.cells.space
            starts = () if self.scene is None else self.scene.starts
            cells = self.adc_resolution().cells_passed([start_cell(space, start) for start in starts])
        return analyse_sensitivity(self.op, cells)

    @checked_method
    def voltage_sensitivity(self, weights: ArrayLike) -> NDArray[np.float64]:
        """Compute the derivatives of a weighted sum of node voltages with respect to the natural log of resistances.

        Parameters
        ----------
        weights : array_like of float, shape (nodes,)
            Weights ``c`` of the sum ``c . V``: a single 1 for one node voltage, 1 and -1 for a difference.

        Returns
        -------
        ndarray of float64, shape (resistors,)
            Derivatives in volts.  The error is at most 1e-5 of the largest derivative, plus the errors of the currents
            of the operating point; derivatives below their error are 0.  Nonlinear resistors follow the linear ones;
            for them the derivative is with respect to ``-ln I0``, with the saturation current ``I0``.

        Raises
        ------
        InputError
            If the weights have another shape, are not finite, or include a floating node.
        AccuracyError
            If the conductances span too many orders of magnitude.
        """
        return voltage_sensitivity(self.op, weights)
