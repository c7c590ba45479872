"""Passes over the values of the grid's resistors: preferred and drawn ones, heat and saturation."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid import die
from resgrid.arguments import check_number
from resgrid.chip.passes.base import Pass, select_resistors
from resgrid.die import Seed
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.scene.chip import ABSOLUTE_ZERO, Chip

NOMINAL_CELSIUS = 27.0
"""Temperature at which resistances are given: SPICE's ``TNOM``."""

_E24 = (10, 11, 12, 13, 15, 16, 18, 20, 22, 24, 27, 30, 33, 36, 39, 43, 47, 51, 56, 62, 68, 75, 82, 91)


def preferred_values(series: str) -> NDArray[np.float64]:
    """The preferred values of a decade, IEC 60063.  Returns (n,)."""
    if series in ("E6", "E12", "E24"):
        return np.array(_E24[:: 24 // int(series[1:])]) / 10
    if series not in ("E48", "E96", "E192"):
        raise InputError(f"preferred = {series!r} is unknown; it may be one of E6, E12, E24, E48, E96, E192")
    count = int(series[1:])
    values = np.round(10.0 ** (np.arange(count) / count), 2)
    values[values == 9.19] = 9.2  # as the standard lists it
    return values


@dataclass(frozen=True)
class PreferredValues(Pass):
    """Take every resistance from a series of preferred values: the nearest one by ratio.

    `series`: ``"E6"`` to ``"E192"``.
    """

    series: str

    def __post_init__(self) -> None:
        preferred_values(self.series)

    @classmethod
    def of(cls, chip: Chip, _seed: Seed) -> PreferredValues | None:
        """Nothing where any value can be had."""
        return None if chip.preferred is None else cls(chip.preferred)

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with resistances of the series."""
        decade = np.append(preferred_values(self.series), 10.0)
        between = np.sqrt(decade[:-1] * decade[1:])

        def nearest(resistance: NDArray[np.float64]) -> NDArray[np.float64]:
            scale = 10.0 ** np.floor(np.log10(resistance))
            return np.asarray(decade[np.searchsorted(between, resistance / scale)] * scale)

        return _with_resistances(netlist, nearest)


@dataclass(frozen=True)
class SheetResistors(Pass):
    """Draw every resistor as a strip of polysilicon: its length ``R W / Rs`` is a whole number of drawing steps.

    `sheet_resistance`: ``Rs``, in ohms per square; `width`: ``W``, in metres; `drawing_grid`: step of the length, in
    metres.
    """

    sheet_resistance: float
    width: float
    drawing_grid: float = 5e-9

    def __post_init__(self) -> None:
        for name, unit in (("sheet_resistance", "ohms per square"), ("width", "metres"), ("drawing_grid", "metres")):
            check_number(name, getattr(self, name), f"positive and finite, in {unit}", above=0.0)

    @classmethod
    def of(cls, chip: Chip, _seed: Seed) -> SheetResistors | None:
        """Nothing where any length can be drawn."""
        if chip.sheet_resistance is None or chip.width is None:
            return None
        return cls(chip.sheet_resistance, chip.width, chip.drawing_grid)

    def length(self, resistance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Drawn length of resistors, in metres."""
        steps = np.rint(resistance * self.width / (self.sheet_resistance * self.drawing_grid))
        if np.any(steps < 1):
            raise InputError(
                f"a resistor of {resistance.min():g} ohm would be shorter than the drawing step of "
                f"{self.drawing_grid:g} m at {self.sheet_resistance:g} ohm per square and width = {self.width:g} m; "
                "give a larger width, a smaller sheet_resistance or a finer drawing_grid"
            )
        return np.asarray(steps * self.drawing_grid)

    def area(self, netlist: Netlist) -> float:
        """Area of the strips of all resistors of the grid, in square metres."""
        resistance = 1 / netlist.conductance[die.on_grid(netlist)]
        nonlinear = netlist.nonlinear_voltage / netlist.nonlinear_current
        return float(self.width * self.length(np.append(resistance, nonlinear)).sum())

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with the resistances of the drawn strips."""
        return _with_resistances(netlist, lambda r: self.sheet_resistance * self.length(r) / self.width)


def _with_resistances(netlist: Netlist, drawn: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Netlist:
    own = die.on_grid(netlist)
    conductance = netlist.conductance.copy()
    conductance[own] = 1 / drawn(1 / conductance[own])
    nonlinear = netlist.nonlinear_current
    if nonlinear.size:
        nonlinear = netlist.nonlinear_voltage / drawn(netlist.nonlinear_voltage / nonlinear)
    return netlist.replace(conductance=conductance, nonlinear_current=nonlinear)


@dataclass(frozen=True)
class TemperatureCoefficients(Pass):
    """Give the grid's resistors temperature coefficients, which a deck hands on to the simulator.

    `tc1, tc2`: in 1/K and 1/K^2, from 27 degrees Celsius.
    """

    tc1: float = 0.0
    tc2: float = 0.0

    def __post_init__(self) -> None:
        check_number("tc1", self.tc1, "finite, in 1/K")
        check_number("tc2", self.tc2, "finite, in 1/K^2")

    @classmethod
    def of(cls, chip: Chip, _seed: Seed) -> TemperatureCoefficients | None:
        """Nothing where heat does not matter."""
        return cls(chip.tc1 or 0.0, chip.tc2 or 0.0) if chip.tc1 or chip.tc2 else None

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with ``tc1`` and ``tc2``."""
        own = die.on_grid(netlist)
        return netlist.replace(tc1=np.where(own, self.tc1, 0.0), tc2=np.where(own, self.tc2, 0.0))


@dataclass(frozen=True)
class Temperature(Pass):
    """Bring resistors to a temperature: ``R (1 + tc1 dT + tc2 dT^2)``, as SPICE does.

    `celsius`: in degrees Celsius.
    """

    celsius: float

    def __post_init__(self) -> None:
        words = f"finite and above {ABSOLUTE_ZERO}, absolute zero in degrees Celsius"
        check_number("celsius", self.celsius, words, above=ABSOLUTE_ZERO)

    @classmethod
    def of(cls, chip: Chip, _seed: Seed) -> Temperature | None:
        """Nothing at the nominal temperature, and where it does not matter."""
        return None if chip.temperature is None or not (chip.tc1 or chip.tc2) else cls(chip.temperature)

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with its resistances at this temperature, and no coefficients left."""
        rise = self.celsius - NOMINAL_CELSIUS
        tc1 = 0.0 if netlist.tc1 is None else netlist.tc1
        tc2 = 0.0 if netlist.tc2 is None else netlist.tc2
        factor = np.broadcast_to(1 + tc1 * rise + tc2 * rise**2, netlist.conductance.shape)
        if np.any(factor <= 0):
            raise InputError(
                f"the temperature coefficients turn a resistance into {factor.min():g} of itself at {self.celsius:g} "
                "degrees Celsius; they hold for 1/K and 1/K^2 around 27 degrees"
            )
        return netlist.replace(conductance=netlist.conductance / factor, tc1=None, tc2=None)


@dataclass(frozen=True)
class Saturation(Pass):
    """Replace the grid's resistors by nonlinear ones of the same resistance at 0 V, ``I = V0 / R tanh(dV / V0)``.

    `volts`: ``V0``, in volts.
    """

    volts: float

    def __post_init__(self) -> None:
        check_number("volts", self.volts, "positive and finite", above=0.0)

    @classmethod
    def of(cls, chip: Chip, _seed: Seed) -> Saturation | None:
        """Nothing where resistors are linear."""
        return None if chip.saturation_voltage is None else cls(chip.saturation_voltage)

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with saturating resistors; their temperature coefficients are lost."""
        own = die.on_grid(netlist)
        cell_map = netlist.cell_map
        if cell_map is not None:
            cell_map = dataclasses.replace(
                cell_map,
                nonlinear_face=np.append(cell_map.nonlinear_face, cell_map.resistor_face[own]),
                nonlinear_upward=np.append(cell_map.nonlinear_upward, cell_map.resistor_upward[own]),
            )
        saturating = netlist.replace(
            nonlinear_nodes=np.concatenate([netlist.nonlinear_nodes, netlist.resistor_nodes[own]]),
            nonlinear_current=np.append(netlist.nonlinear_current, self.volts * netlist.conductance[own]),
            nonlinear_voltage=np.append(netlist.nonlinear_voltage, np.full(int(own.sum()), self.volts)),
            element_names=None,
            cell_map=cell_map,
        )
        return select_resistors(saturating, ~own)
