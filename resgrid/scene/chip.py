"""The ``[chip]`` table: component values, switches, rails, mismatch, read-out and defects of a chip."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Len

from resgrid._internal.values import brief
from resgrid.errors import InputError
from resgrid.scene.process_values import process_problems, process_values
from resgrid.scene.quantities import Listed, Quantity
from resgrid.scene.table_models import check_fields

ABSOLUTE_ZERO = -273.15
"""Exclusive lower limit of the temperature of a chip, in degrees Celsius."""

Ohms = Annotated[float, Gt(0), Quantity("ohm")]
OhmsOrZero = Annotated[float, Ge(0), Quantity("ohm")]
Metres = Annotated[float, Gt(0), Quantity("m")]
Volts = Annotated[float, Quantity("V")]
Fraction = Annotated[float, Ge(0), Quantity("", is_fraction=True)]
Density = Annotated[float, Ge(0), Le(1), Quantity("", is_fraction=True)]

Place = Annotated[tuple[Annotated[int, Ge(0)], ...], Len(2, 5)]


@brief
@dataclass(frozen=True)
class Readout:
    """The circuit that measures node voltages, with values in SI units; None stands for an ideal property.

    Attributes
    ----------
    input_resistance : float or None
        Resistance of the read-out from every cell's node to ground.
    offset : float or None
        Standard deviation, over nodes, of the constant offset of a node's measurements.
    noise_bandwidth : float or None
        Equivalent noise bandwidth of a measurement.
    bits : int or None
        Resolution of the analog-to-digital converter, 1 to 32.
    range : tuple of float or None
        Lowest and highest input voltage of the converter; by default from rail to rail.
    figure_of_merit : float or None
        Energy of the converter per conversion step (Walden 1999): one conversion takes ``2**bits`` times this energy.
    conversion_time : float or None
        Time of one conversion.

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> readout = rg.chip.Readout(bits=8, range=(0.0, 1.2))
    >>> rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip(readout=readout)).adc_resolution().sentence(8)
    'an 8-bit read-out serves 58 % of the starts'
    """

    input_resistance: Ohms | None = None
    offset: Annotated[float, Ge(0), Quantity("V")] | None = None
    noise_bandwidth: Annotated[float, Gt(0), Quantity("Hz")] | None = None
    bits: Annotated[int, Ge(1), Le(32)] | None = None
    range: tuple[Volts, Volts] | None = None
    figure_of_merit: Annotated[float, Ge(0), Quantity("J")] | None = None
    conversion_time: Annotated[float, Ge(0), Quantity("s")] | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.range is not None and not self.range[0] < self.range[1]:
            shown = list(self.range)
            raise InputError(
                f"range = {shown} is empty; give the lowest and then the highest input voltage of the converter"
            )


@brief
@dataclass(frozen=True)
class Defects:
    """Fabrication faults: fractions of the grid's resistors that are open or shorted.

    The chip's seed decides at random, independently for each resistor, whether it is open, shorted or intact; the
    fractions are the probabilities.  Resistances are in ohms.

    Attributes
    ----------
    open_density : float
        Fraction of the resistors that are open.
    short_density : float
        Fraction of the resistors that are shorted; together with ``open_density`` at most 1.
    short_resistance : float
        Resistance of a shorted resistor.
    open_at : tuple of tuple of int
        Further open resistors, each as the indices of a cell, then the number of an axis: the resistor at the cell's
        lower face along this axis.

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> broken = rg.chip.build_chip(netlist, rg.Chip(defects=rg.chip.Defects(open_density=0.05)))
    >>> len(netlist.conductance), len(broken.conductance)
    (140, 134)
    """

    open_density: Density = 0.0
    short_density: Density = 0.0
    short_resistance: Ohms = 1.0
    open_at: tuple[Place, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)
        if (both := self.open_density + self.short_density) > 1:
            raise InputError(
                f"open_density + short_density = {both:g} exceeds 1: more than all resistors would be faulty; lower one"
            )


@brief
@dataclass(frozen=True)
class Chip:
    """Component values and imperfections of a chip; ideal by default.

    Values are in SI units, except ``pelgrom`` in percent times micrometres and ``temperature`` in degrees Celsius.
    Every value may also be given as an engineering value such as ``"4k7"``, fractions as ``"10 %"``.  None stands for
    an ideal property, unless a default is given below.

    Attributes
    ----------
    resistance : float
        Resistance between neighbours along the finest axis at conductivity 1.
    supply : float
        Voltage of the obstacle rail (or of a driven start) above the goal rail; not 0.
    wall_resistance : float or None
        Resistance in series with every obstacle contact, for ``boundary = "wall"``.
    capacitance : float or None
        Capacitance from every cell's node to ground.
    goal_switch_on, obstacle_switch_on : float or None
        Resistance of the closed switch between a cell's node and this rail; a wire by default.
    goal_switch_off, obstacle_switch_off : float or None
        Resistance of the open switch between a cell's node and this rail; no connection by default.
    internodal_switch_on : float or None
        Resistance of the closed switch in series with every resistor between cells; a wire by default.
    internodal_switch_off : float or None
        Resistance of the open switch in series with every resistor between cells; no connection by default.
    process : str or None
        Process and resistor, such as ``"ihp-sg13g2:rppd"`` (`resgrid.processes.process_names` lists them), which sets
        ``sheet_resistance``, ``width`` (the smallest one), ``pelgrom``, ``gradient``, ``tc1`` and ``tc2`` unless they
        are given.
    corner : {"typical", "low", "high"} or None
        Corner of the process: typical, lowest or highest sheet resistance; typical by default.  Resistors are drawn for
        the typical sheet resistance, and ``resistance`` is their value there.
    mismatch : float or None
        Standard deviation of a resistance, as a fraction of its mean, below 1.
    pelgrom : float or None
        Pelgrom coefficient ``A_R``, instead of ``mismatch``: the standard deviation is ``A_R / sqrt(W L)`` (Pelgrom,
        Duinmaijer & Welbers 1989).
    width : float or None
        Width ``W`` of a resistor.
    length : float or None
        Length ``L`` of a resistor.
    gradient : tuple of float or None
        Increase of the resistance from one edge of the die to the other along every axis (missing ones: 0), as a
        fraction of the nominal value, which holds at the centre of the die.
    temperature : float or None
        Temperature of the die, in degrees Celsius; nominal is 27.
    tc1 : float or None
        First temperature coefficient of the grid's resistors, relative to 27 degrees Celsius.
    tc2 : float or None
        Second (quadratic) temperature coefficient of the grid's resistors, relative to 27 degrees Celsius.
    preferred : {"E6", "E12", "E24", "E48", "E96", "E192"} or None
        Series of preferred values to which resistances are rounded (IEC 60063).
    sheet_resistance : float or None
        Sheet resistance, per square, of the polysilicon in which resistors of ``width`` are drawn; instead of
        ``preferred``.
    drawing_grid : float
        Grid to which drawn lengths are rounded.
    rail_resistance : float or None
        Resistance of the rail between neighbouring cells.
    saturation_voltage : float or None
        Voltage ``V0`` of nonlinear resistors ``I0 tanh(dV / V0)`` with ``I0 = V0 / R``, instead of linear ones.
    seed : int
        Seed of all random values of the chip.
    readout : Readout
        Read-out circuit of the node voltages.
    defects : Defects
        Fabrication faults.

    Raises
    ------
    InputError
        If values are out of range or inconsistent.

    Examples
    --------
    >>> chip = rg.Chip(resistance="4k7", mismatch="1 %", readout=rg.chip.Readout(bits=10))
    >>> chip.resistance, chip.mismatch
    (4700.0, 0.01)
    >>> rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip)
    Study(Eight by eight: 8 x 8 cells, dirichlet, 66 nodes)
    """

    resistance: Ohms = 10e3
    supply: Volts = 1.0
    wall_resistance: OhmsOrZero | None = None
    capacitance: Annotated[float, Ge(0), Quantity("F")] | None = None
    goal_switch_on: Ohms | None = None
    goal_switch_off: Ohms | None = None
    obstacle_switch_on: Ohms | None = None
    obstacle_switch_off: Ohms | None = None
    internodal_switch_on: Ohms | None = None
    internodal_switch_off: Ohms | None = None
    process: str | None = None
    corner: Literal["typical", "low", "high"] | None = None
    mismatch: Fraction | None = None
    pelgrom: Annotated[float, Ge(0), Quantity("% µm")] | None = None
    width: Metres | None = None
    length: Metres | None = None
    gradient: Annotated[tuple[Annotated[float, Quantity("", is_fraction=True)], ...], Len(1, 4), Listed()] | None = None
    temperature: Annotated[float, Quantity("°C")] | None = None
    tc1: Annotated[float, Quantity("1/K")] | None = None
    tc2: Annotated[float, Quantity("1/K^2")] | None = None
    preferred: Literal["E6", "E12", "E24", "E48", "E96", "E192"] | None = None
    sheet_resistance: Ohms | None = None
    drawing_grid: Metres = 5e-9
    rail_resistance: OhmsOrZero | None = None
    saturation_voltage: Annotated[float, Gt(0), Quantity("V")] | None = None
    seed: Annotated[int, Ge(0), Le(2**128 - 1)] = 0
    readout: Readout = field(default_factory=Readout)
    defects: Defects = field(default_factory=Defects)

    def __post_init__(self) -> None:
        for name, kind in (("readout", Readout), ("defects", Defects)):
            if not isinstance(getattr(self, name), kind):
                raise InputError(f"{name} = {getattr(self, name)!r} must be a {kind.__name__}")
        check_fields(self)
        if faults := list(process_problems(vars(self))):
            raise InputError("; ".join(faults))
        if self.process is not None:
            self.with_process()  # checks the values of the process together with the given ones
            return
        laws = _supply_problems, _switch_problems, _spread_problems, _value_problems, _heat_problems
        broken = [problem for law in laws for problem in law(self)]
        if broken:
            raise InputError("; ".join(broken))

    def with_process(self) -> Chip:
        """Return the description with the values of its process in place of ``process`` and ``corner``.

        Returns
        -------
        Chip
            The description without a process; this description if it has none.

        Examples
        --------
        >>> chip = rg.Chip(process="ihp-sg13g2:rppd", width="1u", tc1=0.0).with_process()
        >>> chip.sheet_resistance, round(chip.pelgrom, 3), chip.tc1, chip.tc2
        (260.0, 1.81, 0.0, 4e-07)
        """
        if self.process is None:
            return self
        return dataclasses.replace(self, process=None, corner=None, **process_values(vars(self)))


def _supply_problems(chip: Chip) -> Iterator[str]:
    if chip.supply == 0:
        yield "supply = 0 drives no current; give the voltage between the rails"
    if chip.defects.short_density > 0 and chip.defects.short_resistance >= chip.resistance:
        yield (
            f"defects.short_resistance = {chip.defects.short_resistance:g} ohm is not below the resistance of "
            f"{chip.resistance:g} ohm that it shorts; give a smaller one"
        )


def _switch_problems(chip: Chip) -> Iterator[str]:
    for kind in ("goal", "obstacle", "internodal"):
        on, off = (getattr(chip, f"{kind}_switch_{state}") for state in ("on", "off"))
        if on is not None and off is not None and on >= off:
            yield (
                f"{kind}_switch_on = {on:g} ohm is not below {kind}_switch_off = {off:g} ohm: "
                "a closed switch must conduct better than an open one; exchange them?"
            )


def _spread_problems(chip: Chip) -> Iterator[str]:
    if chip.mismatch is not None and chip.mismatch >= 1:
        yield f"mismatch = {chip.mismatch:g} is {chip.mismatch:.0%} of a resistance; it must stay below 100 %"
    if chip.mismatch is not None and chip.pelgrom is not None:
        yield "mismatch and pelgrom both set the standard deviation of resistances; remove one of them"
    if chip.pelgrom is not None and (chip.width is None or (chip.length is None and chip.sheet_resistance is None)):
        yield (
            "pelgrom needs the area of a resistor: give width and length (or width and sheet_resistance, from which "
            "the length follows)"
        )
    gradient = chip.gradient or ()
    if sum(map(abs, gradient)) >= 2:
        yield (
            f"gradient = {list(gradient)} makes a resistance negative in a corner of the die; "
            "the magnitudes of its entries must add up to less than 2 (200 %)"
        )


def _value_problems(chip: Chip) -> Iterator[str]:
    if chip.sheet_resistance is None:
        return
    if chip.preferred is not None:
        yield "preferred and sheet_resistance both restrict the resistances; remove one of them"
    if chip.width is None:
        yield "sheet_resistance needs the width of a resistor, from which its length follows; give width"
    if chip.length is not None:
        yield "sheet_resistance and width determine the length of every resistor; remove length"


def _heat_problems(chip: Chip) -> Iterator[str]:
    if chip.temperature is None:
        return
    if chip.temperature <= ABSOLUTE_ZERO:
        yield f"temperature = {chip.temperature:g} lies below absolute zero; give degrees Celsius"
        return
    rise = chip.temperature - 27.0
    factor = 1 + (chip.tc1 or 0.0) * rise + (chip.tc2 or 0.0) * rise**2
    if factor <= 0:
        yield (
            f"tc1 and tc2 multiply resistances by {factor:g} at temperature = {chip.temperature:g}; "
            "give coefficients in 1/K and 1/K^2, relative to 27 degrees Celsius, that keep resistances positive"
        )
