"""The chip: what its maker says about resistors, switches, rails, read-out and defects."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Len

from resgrid._internal.values import brief
from resgrid.errors import InputError
from resgrid.scene.quantities import Listed, Quantity
from resgrid.scene.table_models import check_fields

ABSOLUTE_ZERO = -273.15

Ohms = Annotated[float, Gt(0), Quantity("ohm")]
OhmsOrZero = Annotated[float, Ge(0), Quantity("ohm")]
Metres = Annotated[float, Gt(0), Quantity("m")]
Volts = Annotated[float, Quantity("V")]
Share = Annotated[float, Ge(0), Quantity("", share=True)]
Density = Annotated[float, Ge(0), Le(1), Quantity("", share=True)]

Place = Annotated[tuple[Annotated[int, Ge(0)], ...], Len(2, 5)]


@brief
@dataclass(frozen=True)
class Readout:
    """How node voltages are measured; ideal where it does not say.

    Attributes
    ----------
    input_resistance : float or None
        From every cell's node to ground, by the read-out.
    offset : float or None
        Standard deviation of a node's measurement, the same at every measurement of the node.
    noise_bandwidth : float or None
        Equivalent noise bandwidth of a measurement.
    bits : int or None
        Of the converter, 1 to 32.
    range : tuple of float or None
        Lowest and highest voltage that the converter tells; without it from rail to rail.

    Raises
    ------
    InputError
        If such a read-out cannot be.

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

    def __post_init__(self) -> None:
        check_fields(self)
        if self.range is not None and not self.range[0] < self.range[1]:
            shown = list(self.range)
            raise InputError(
                f"range = {shown} must be the lowest and the highest voltage of the converter, the lower first"
            )


@brief
@dataclass(frozen=True)
class Defects:
    """Faults of fabrication: shares of the grid's resistors.

    Attributes
    ----------
    open_density : float
        Share of the resistors that are open.
    short_density : float
        Share of the resistors that are shorted; with the open ones at most all.
    short_resistance : float
        Of a short.
    open_at : tuple of tuple of int
        Resistors that are open besides: a cell, and the axis across whose lower face each lies.

    Raises
    ------
    InputError
        If such faults cannot be.

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
                f"open_density + short_density = {both:g}, but no more than all resistors (1 or 100 %) can be faulty"
            )


@brief
@dataclass(frozen=True)
class Chip:
    """What a chip is made of, in SI units; ideal where it does not say.

    Every value may also be given as an engineering value such as ``"4k7"``, shares as ``"10 %"``.

    Attributes
    ----------
    resistance : float
        Between neighbours along the finest axis at conductivity 1.
    supply : float
        Obstacle rail (or driven start) above the goal rail; not 0.
    wall_resistance : float or None
        In series with every obstacle contact where ``boundary = "wall"``.
    capacitance : float or None
        From every cell's node to ground.
    goal_switch_on, obstacle_switch_on : float or None
        Closed switch between a cell's node and this rail; a wire where nothing is said.
    goal_switch_off, obstacle_switch_off : float or None
        The same switch, open; no connection where nothing is said.
    internodal_switch_on : float or None
        Closed switch in series with every resistor between cells.
    internodal_switch_off : float or None
        The same switch, open.
    mismatch : float or None
        Standard deviation of a resistance, as a share of its mean, below 1.
    pelgrom : float or None
        Instead: ``A_R``, for a standard deviation ``A_R / sqrt(W L)`` (Pelgrom, Duinmaijer & Welbers 1989).
    width : float or None
        ``W`` of a resistor.
    length : float or None
        ``L`` of a resistor.
    gradient : tuple of float or None
        Growth of the resistance from one end of the die to the other along every axis (missing ones: 0), as a share of
        its nominal value, which the middle of the die has.
    temperature : float or None
        Of the die; nominal is 27.
    tc1 : float or None
        First temperature coefficient of the grid's resistors, from 27 degrees Celsius.
    tc2 : float or None
        Second temperature coefficient of the grid's resistors.
    preferred : str or None
        Series of preferred values that resistances are taken from (IEC 60063).
    sheet_resistance : float or None
        Instead: per square of the polysilicon that resistors of the given width are drawn in.
    drawing_grid : float
        Step of drawn lengths.
    rail_resistance : float or None
        Of a stretch of rail between neighbouring cells.
    saturation_voltage : float or None
        ``V0`` of nonlinear resistors ``I0 tanh(dV / V0)`` in place of linear ones, with ``I0 = V0 / R``.
    seed : int
        Of everything random about the chip.
    readout : Readout
        How its nodes are measured.
    defects : Defects
        Its faults.

    Raises
    ------
    InputError
        If such a chip cannot be.

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
    mismatch: Share | None = None
    pelgrom: Annotated[float, Ge(0), Quantity("% µm")] | None = None
    width: Metres | None = None
    length: Metres | None = None
    gradient: Annotated[tuple[Annotated[float, Quantity("", share=True)], ...], Len(1, 4), Listed()] | None = None
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
        laws = _supply_problems, _switch_problems, _spread_problems, _value_problems, _heat_problems
        broken = [problem for law in laws for problem in law(self)]
        if broken:
            raise InputError("; ".join(broken))


def _supply_problems(chip: Chip) -> Iterator[str]:
    if chip.supply == 0:
        yield "supply = 0 drives nothing; give the voltage between the rails"
    if chip.defects.short_density > 0 and chip.defects.short_resistance >= chip.resistance:
        yield (
            f"defects.short_resistance = {chip.defects.short_resistance:g} ohm is no short of a resistor of "
            f"{chip.resistance:g} ohm; give a smaller one"
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
        yield "mismatch and pelgrom both say how resistors differ; remove one of them"
    if chip.pelgrom is not None and (chip.width is None or (chip.length is None and chip.sheet_resistance is None)):
        yield (
            "pelgrom needs the area of a resistor: give width and length (or width and sheet_resistance, from which "
            "the length follows)"
        )
    gradient = chip.gradient or ()
    if sum(abs(share) for share in gradient) >= 2:
        yield (
            f"gradient = {list(gradient)} takes a resistance below 0 in a corner of the die; "
            "its shares must add up to less than 2 (200 %)"
        )


def _value_problems(chip: Chip) -> Iterator[str]:
    if chip.sheet_resistance is None:
        return
    if chip.preferred is not None:
        yield "preferred and sheet_resistance both say which resistances there are; remove one of them"
    if chip.width is None:
        yield "sheet_resistance needs the width of a resistor, from which its length follows; give width"
    if chip.length is not None:
        yield "sheet_resistance and width give every resistor its length; remove length"


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
            f"tc1 and tc2 turn resistances into {factor:g} of themselves at temperature = {chip.temperature:g}; "
            "they hold for 1/K and 1/K^2 around 27 degrees Celsius"
        )
