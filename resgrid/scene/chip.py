"""The chip: what its maker says about resistors, switches, rails, read-out and defects."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from sys import float_info
from typing import Any

from resgrid.errors import InputError

SERIES = ("E6", "E12", "E24", "E48", "E96", "E192")
MOST_BITS = 32
ABSOLUTE_ZERO = -273.15
SMALLEST, LARGEST = 1e-30, 1e30
"""Limits of all values in SI units, so that their products and squares are numbers, too."""


@dataclass(frozen=True)
class Readout:
    """How node voltages are measured; None where it is ideal.

    Attributes
    ----------
    input_resistance : float or None
        From every cell's node to ground, in ohms.
    offset : float or None
        Standard deviation of the offset voltage, in volts.
    noise_bandwidth : float or None
        Equivalent noise bandwidth, in hertz.
    bits : int or None
        Of the converter, 1 to 32.
    range : tuple of float or None
        Lowest and highest voltage that the converter tells, in volts; None means from rail to rail.
    """

    input_resistance: float | None = None
    offset: float | None = None
    noise_bandwidth: float | None = None
    bits: int | None = None
    range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        _raise(_readout_problems(self))


@dataclass(frozen=True)
class Defects:
    """Faults of fabrication.

    Attributes
    ----------
    open_density, short_density : float
        Share of the grid's resistors that are open, and that are shorted, each at least 0, together at most 1.
    short_resistance : float
        Resistance of a short, in ohms.
    """

    open_density: float = 0.0
    short_density: float = 0.0
    short_resistance: float = 1.0

    def __post_init__(self) -> None:
        _raise(_defect_problems(self))


@dataclass(frozen=True)
class Chip:
    """What a chip is made of, in SI units; ideal where it does not say.

    Attributes
    ----------
    resistance : float
        Between neighbours along the finest axis at conductivity 1, in ohms.
    supply : float
        Obstacle rail (or driven start) above the goal rail, in volts; not 0.
    wall_resistance : float or None
        In series with every obstacle contact where ``boundary = "wall"``, in ohms, at least 0.
    capacitance : float or None
        From every cell's node to ground, in farads.
    goal_switch_on, goal_switch_off, obstacle_switch_on, obstacle_switch_off : float or None
        Resistance of the switches between a cell's node and the rails, closed and open, in ohms; None is a wire
        and no connection.
    internodal_switch_on, internodal_switch_off : float or None
        Resistance of the switches in series with the resistors between cells, closed and open, in ohms.
    mismatch : float or None
        Standard deviation of a resistance, as a share of its mean, at least 0 and below 1.
    pelgrom : float or None
        Instead: ``A_R`` in % µm, for a standard deviation ``A_R / sqrt(W L)`` (Pelgrom, Duinmaijer & Welbers 1989).
    width, length : float or None
        ``W`` and ``L`` of a resistor, in metres.
    gradient : tuple of float or None
        Growth of the resistance from one end of the die to the other along every axis (missing ones: 0), as a share of
        its nominal value, which the middle of the die has.
    temperature : float or None
        Of the die, in degrees Celsius; None is the nominal 27.
    tc1, tc2 : float or None
        Temperature coefficients of the grid's resistors, in 1/K and 1/K^2.
    preferred : str or None
        Series of preferred values that resistances are taken from, ``"E6"`` to ``"E192"`` (IEC 60063).
    sheet_resistance : float or None
        Instead: of the polysilicon that resistors of the given width are drawn in, in ohms per square.
    drawing_grid : float
        Step of drawn lengths, in metres.
    rail_resistance : float or None
        Of a rail between neighbouring cells, in ohms.
    saturation_voltage : float or None
        ``V0`` of nonlinear resistors ``I0 tanh(dV / V0)`` in place of linear ones, in volts; ``I0 = V0 / R``.
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
    """

    resistance: float = 10e3
    supply: float = 1.0
    wall_resistance: float | None = None
    capacitance: float | None = None
    goal_switch_on: float | None = None
    goal_switch_off: float | None = None
    obstacle_switch_on: float | None = None
    obstacle_switch_off: float | None = None
    internodal_switch_on: float | None = None
    internodal_switch_off: float | None = None
    mismatch: float | None = None
    pelgrom: float | None = None
    width: float | None = None
    length: float | None = None
    gradient: tuple[float, ...] | None = None
    temperature: float | None = None
    tc1: float | None = None
    tc2: float | None = None
    preferred: str | None = None
    sheet_resistance: float | None = None
    drawing_grid: float = 5e-9
    rail_resistance: float | None = None
    saturation_voltage: float | None = None
    seed: int = 0
    readout: Readout = field(default_factory=Readout)
    defects: Defects = field(default_factory=Defects)

    def __post_init__(self) -> None:
        _raise(_chip_problems(self))


_POSITIVE = (
    "resistance",
    "goal_switch_on",
    "goal_switch_off",
    "obstacle_switch_on",
    "obstacle_switch_off",
    "internodal_switch_on",
    "internodal_switch_off",
    "width",
    "length",
    "sheet_resistance",
    "drawing_grid",
    "saturation_voltage",
    "input_resistance",
    "noise_bandwidth",
    "short_resistance",
)
_NOT_NEGATIVE = (
    "wall_resistance",
    "capacitance",
    "mismatch",
    "pelgrom",
    "rail_resistance",
    "offset",
    "open_density",
    "short_density",
)


def _raise(problems: Iterator[str]) -> None:
    found = list(problems)
    if found:
        raise InputError("; ".join(found))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= float_info.max


def _are_numbers(values: object) -> bool:
    return isinstance(values, tuple | list) and all(_is_number(value) for value in values)


def _numbers(value: Any) -> Iterator[str]:
    for item in fields(value):
        number = getattr(value, item.name)
        if number is None or not item.type.startswith("float"):
            continue
        if not _is_number(number):
            yield f"{item.name} = {number!r} must be a finite number"
        elif item.name in _POSITIVE and number <= 0:
            yield f"{item.name} = {number:g} must be greater than 0"
        elif item.name in _NOT_NEGATIVE and number < 0:
            yield f"{item.name} = {number:g} must be at least 0"
        elif abs(number) > LARGEST:
            yield f"{item.name} = {number:g} must not exceed {LARGEST:g}"
        elif 0 < abs(number) < SMALLEST:
            yield f"{item.name} = {number:g} is too small: it must be {SMALLEST:g} or more"


def _whole(name: str, number: object, least: int, most: int) -> Iterator[str]:
    if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
        yield f"{name} = {number!r} must be a whole number from {least} to {most}"


def _readout_problems(readout: Readout) -> Iterator[str]:
    yield from _numbers(readout)
    if readout.bits is not None:
        yield from _whole("bits", readout.bits, 1, MOST_BITS)
    if readout.range is not None:
        limits = readout.range
        shown = list(limits) if isinstance(limits, tuple) else limits
        if not _are_numbers(limits) or len(limits) != 2 or not limits[0] < limits[1]:
            yield f"range = {shown!r} must be the lowest and the highest voltage of the converter, the lower first"
        elif max(map(abs, limits)) > LARGEST:
            yield f"range = {shown!r} must not exceed {LARGEST:g} V"


def _defect_problems(defects: Defects) -> Iterator[str]:
    wrong = list(_numbers(defects))
    yield from wrong
    if not wrong and (both := defects.open_density + defects.short_density) > 1:
        yield f"open_density + short_density = {both:g}, but no more than all resistors (1 or 100 %) can be faulty"


def _chip_problems(chip: Chip) -> Iterator[str]:
    wrong = list(_numbers(chip))
    for name, kind in (("readout", Readout), ("defects", Defects)):
        if not isinstance(getattr(chip, name), kind):
            wrong.append(f"{name} = {getattr(chip, name)!r} must be a {kind.__name__}")
    yield from wrong
    if wrong:
        return
    if chip.supply == 0:
        yield "supply = 0 drives nothing; give the voltage between the rails"
    yield from _whole("seed", chip.seed, 0, 2**128 - 1)
    yield from _switch_problems(chip)
    yield from _spread_problems(chip)
    yield from _value_problems(chip)
    yield from _heat_problems(chip)
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
    gradient = () if chip.gradient is None else chip.gradient
    if not _are_numbers(gradient):
        yield f"gradient = {gradient!r} must hold finite shares, one for each axis"
    elif sum(abs(share) for share in gradient) >= 2:
        yield (
            f"gradient = {list(gradient)} takes a resistance below 0 in a corner of the die; "
            "its shares must add up to less than 2 (200 %)"
        )


def _value_problems(chip: Chip) -> Iterator[str]:
    if chip.preferred is not None and chip.preferred not in SERIES:
        yield f"preferred = {chip.preferred!r} is unknown; it may be one of {', '.join(SERIES)}"
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
