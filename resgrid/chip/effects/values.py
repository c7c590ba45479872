"""Effects on the grid's resistances: preferred values, whole steps of drawn length, temperature, saturation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from resgrid.chip.effects.base import Effect
from resgrid.core import random_sites
from resgrid.core.netlist import Netlist, add_elements, crossed_by, select_elements
from resgrid.core.random_sites import Seed
from resgrid.errors import InputError
from resgrid.scene.chip import ABSOLUTE_ZERO, Chip, Metres, Ohms
from resgrid.scene.quantities import Quantity

NOMINAL_CELSIUS = 27.0
"""Temperature to which the resistances of a description refer (SPICE's ``TNOM``), in degrees Celsius."""

_E24 = (10, 11, 12, 13, 15, 16, 18, 20, 22, 24, 27, 30, 33, 36, 39, 43, 47, 51, 56, 62, 68, 75, 82, 91)
"""Preferred values of the E24 series between 1 and 10, multiplied by 10."""


Series = Literal["E6", "E12", "E24", "E48", "E96", "E192"]


def preferred_values(series: Series) -> NDArray[np.float64]:
    """Return the preferred values of a series (IEC 60063) from 1 to below 10, in ascending order, shape (n,).

    `series`: name of the series, ``"E6"`` to ``"E192"``; the number in the name is ``n``.
    """
    count = int(series[1:])
    if count <= len(_E24):
        return np.array(_E24[:: len(_E24) // count]) / 10
    values = np.round(10.0 ** (np.arange(count) / count), 2)
    values[values == 9.19] = 9.2  # the standard lists 9.2
    return values


@dataclass(frozen=True)
class PreferredValues(Effect):
    """Round every resistance to the nearest value (by ratio) of a series of preferred values.

    `series`: name of the series in IEC 60063, ``"E6"`` to ``"E192"``.
    """

    KEYS = {"series": "preferred"}

    series: Series

    def apply(self, netlist: Netlist) -> Netlist:
        decade = np.append(preferred_values(self.series), 10.0)
        between = np.sqrt(decade[:-1] * decade[1:])

        def nearest(resistance: NDArray[np.float64]) -> NDArray[np.float64]:
            scale = 10.0 ** np.floor(np.log10(resistance))
            return np.asarray(decade[np.searchsorted(between, resistance / scale)] * scale)

        return _with_resistances(netlist, nearest)


@dataclass(frozen=True)
class SheetResistors(Effect):
    """Round the length ``L = R W / Rs`` of every polysilicon resistor to a whole number of drawing steps.

    ``R`` is the resistance in ohms.  `sheet_resistance`: ``Rs``, in ohms per square; `width`: width ``W`` of the strip,
    in metres; `drawing_grid`: length of a drawing step, in metres.
    """

    sheet_resistance: Ohms
    width: Metres
    drawing_grid: Metres = 5e-9

    @classmethod
    def of(cls, chip: Chip, seed: Seed) -> SheetResistors | None:
        """Return the effect of a chip description; None if the description lacks a sheet resistance or a width.

        `seed`: seed of random effects, which this method ignores.
        """
        del seed
        if chip.sheet_resistance is None or chip.width is None:
            return None
        return cls(chip.sheet_resistance, chip.width, chip.drawing_grid)

    def length(self, resistance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the drawn lengths of resistors in metres, in the shape of `resistance` (ohms).

        Raises InputError if a resistor is shorter than one drawing step.
        """
        steps = np.rint(resistance * self.width / (self.sheet_resistance * self.drawing_grid))
        if np.any(steps < 1):
            raise InputError(
                f"a resistor of {resistance.min():g} ohm would be shorter than the drawing step of "
                f"{self.drawing_grid:g} m at {self.sheet_resistance:g} ohm per square and width = {self.width:g} m; "
                "give a larger width, a smaller sheet_resistance or a finer drawing_grid"
            )
        return np.asarray(steps * self.drawing_grid)

    def area(self, netlist: Netlist) -> float:
        """Return the total area of the strips that form the grid's resistors in a netlist, in square metres."""
        resistance = 1 / netlist.conductance[random_sites.on_grid(netlist)]
        nonlinear = netlist.nonlinear_voltage / netlist.nonlinear_current
        return float(self.width * self.length(np.append(resistance, nonlinear)).sum())

    def apply(self, netlist: Netlist) -> Netlist:
        return _with_resistances(netlist, lambda r: self.sheet_resistance * self.length(r) / self.width)


def _with_resistances(netlist: Netlist, drawn: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Netlist:
    """Return the netlist with new resistances of the grid's linear and nonlinear resistors.

    `drawn`: function from the present to the new resistances, both in ohms, of shape (k,).  A nonlinear resistor gets a
    new resistance at 0 V, and keeps its saturation voltage.
    """
    own = random_sites.on_grid(netlist)
    conductance = netlist.conductance.copy()
    conductance[own] = 1 / drawn(1 / conductance[own])
    nonlinear = netlist.nonlinear_current
    if nonlinear.size:
        nonlinear = netlist.nonlinear_voltage / drawn(netlist.nonlinear_voltage / nonlinear)
    return netlist.replace(conductance=conductance, nonlinear_current=nonlinear)


@dataclass(frozen=True)
class TemperatureCoefficients(Effect):
    """Give the grid's resistors temperature coefficients, which are written to SPICE decks.

    `tc1, tc2`: linear and quadratic coefficient in 1/K and 1/K^2, relative to 27 degrees Celsius; 0 without dependence.
    """

    KEYS = {"tc1": "tc1", "tc2": "tc2"}

    tc1: Annotated[float, Quantity("1/K")] = 0.0
    tc2: Annotated[float, Quantity("1/K^2")] = 0.0

    def apply(self, netlist: Netlist) -> Netlist:
        own = random_sites.on_grid(netlist)
        return netlist.replace(tc1=np.where(own, self.tc1, 0.0), tc2=np.where(own, self.tc2, 0.0))


@dataclass(frozen=True)
class Temperature(Effect):
    """Scale resistances to a temperature: ``R (1 + tc1 dT + tc2 dT^2)``, as in SPICE, with ``dT = celsius - 27``.

    `celsius`: temperature of the die, in degrees Celsius; ``tc1`` and ``tc2``: temperature coefficients of the
    netlist's resistors, in 1/K and 1/K^2, 0 where the netlist has none.  The resistors of the result have no
    temperature coefficients.
    """

    celsius: Annotated[float, Gt(ABSOLUTE_ZERO), Quantity("°C")]

    @classmethod
    def of(cls, chip: Chip, seed: Seed) -> Temperature | None:
        """Return the effect of a chip description; None if it lacks a temperature or temperature coefficients.

        `seed`: seed of random effects, which this method ignores.
        """
        del seed
        return None if chip.temperature is None or not (chip.tc1 or chip.tc2) else cls(chip.temperature)

    def apply(self, netlist: Netlist) -> Netlist:
        rise = self.celsius - NOMINAL_CELSIUS
        tc1 = 0.0 if netlist.tc1 is None else netlist.tc1
        tc2 = 0.0 if netlist.tc2 is None else netlist.tc2
        factor = np.broadcast_to(1 + tc1 * rise + tc2 * rise**2, netlist.conductance.shape)
        if np.any(factor <= 0):
            raise InputError(
                f"the temperature coefficients multiply a resistance by {factor.min():g} at {self.celsius:g} degrees "
                "Celsius; give tc1 in 1/K and tc2 in 1/K^2, relative to 27 degrees"
            )
        return netlist.replace(conductance=netlist.conductance / factor, tc1=None, tc2=None)


@dataclass(frozen=True)
class Saturation(Effect):
    """Replace the grid's resistors by nonlinear ones, ``I = V0 / R tanh(dV / V0)``, with the resistance ``R`` at 0 V.

    ``dV`` is the voltage across the resistor.  `volts`: ``V0``, the voltage at which the current begins to saturate.
    """

    KEYS = {"volts": "saturation_voltage"}

    volts: Annotated[float, Gt(0), Quantity("V")]

    def apply(self, netlist: Netlist) -> Netlist:
        own = random_sites.on_grid(netlist)
        saturating = add_elements(
            netlist,
            "nonlinear resistor",
            netlist.resistor_nodes[own],
            self.volts * netlist.conductance[own],
            self.volts,
            **crossed_by(netlist, "resistor", own),
        )
        return select_elements(saturating, "resistor", ~own)
