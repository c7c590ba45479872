"""Chip process of a chip description: checks of its keys, and the values that follow from process and corner."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from resgrid.errors import InputError
from resgrid.processes.reading import read_process

_MICRO = 1e6
"""Micrometres per metre."""


def process_problems(chip: Mapping[str, Any]) -> Iterator[str]:
    """Yield the problems of the process keys of a chip description, one sentence each.

    `chip`: values of all keys of the `Chip`, in SI units; they may still be inconsistent.
    """
    process, corner = chip["process"], chip["corner"]
    if process is None:
        if corner is not None:
            yield f'corner = "{corner}" needs a process; give process, or remove corner'
        return
    try:
        resistor = read_process(process).resistor
        resistor.at_corner(corner or "typical")
    except InputError as error:
        yield str(error)
        return
    for key, reason in (
        ("preferred", "a process draws resistors by sheet resistance"),
        ("length", "process, width and resistance determine the length of every resistor"),
    ):
        if chip[key] is not None:
            yield f"process and {key} contradict each other: {reason}; remove {key} or process"
    if chip["sheet_resistance"] is not None and corner is not None:
        yield (
            f'corner = "{corner}" has no effect, because sheet_resistance is given; remove sheet_resistance or corner'
        )
    width = _width(chip)
    if width < resistor.min_width * (1 - 1e-9):
        yield (
            f"width = {width:g} um is below the smallest width of {process}, {resistor.min_width:g} um; give at "
            f'least "{resistor.min_width:g}u"'
        )
        return
    sheet = chip["sheet_resistance"] or resistor.sheet_resistance
    resistance = chip["resistance"]
    length = resistance * width / sheet
    if length < resistor.min_length * (1 - 1e-9):
        yield (
            f"resistance = {resistance:g} ohm needs a length of {length:.3g} um at a width of {width:g} um, below "
            f"the smallest length of {process}, {resistor.min_length:g} um; give at least "
            f"{resistor.min_length * sheet / width:.4g} ohm, or a smaller width"
        )


def process_values(chip: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of the keys that the process of a chip sets, by key; except for ``resistance``, given keys win.

    Keys are ``width`` (m), ``sheet_resistance`` (ohm), ``gradient``, ``tc1`` (1/K), ``tc2`` (1/K^2) and, without
    ``mismatch``, ``pelgrom`` (percent times um); keys with a value in `chip` or none in the process are left out.
    ``resistance`` is always present: the given value times corner over typical sheet resistance, because resistors are
    drawn for the typical one.  ``pelgrom`` contains the deviations of width and length at the nominal resistance.
    `chip`: values of all keys of a description with a process and without problems.
    """
    assert chip["process"] is not None
    resistor, width = read_process(chip["process"]).resistor, _width(chip)
    typical = chip["sheet_resistance"] or resistor.sheet_resistance
    scale = 1.0 if chip["corner"] is None else resistor.at_corner(chip["corner"]) / resistor.sheet_resistance
    found: dict[str, Any] = {
        "width": width / _MICRO,
        "sheet_resistance": typical * scale,
        "gradient": None if resistor.gradient is None else (resistor.gradient,),
        "tc1": resistor.tc1,
        "tc2": resistor.tc2,
    }
    if chip["mismatch"] is None:
        found["pelgrom"] = resistor.pelgrom(width, chip["resistance"] * width / typical)
    given = {key: value for key, value in found.items() if value is not None and chip[key] is None}
    return {**given, "resistance": chip["resistance"] * scale}


def _width(chip: Mapping[str, Any]) -> float:
    """Return the width of a chip's resistors in micrometres; the smallest width of the process by default."""
    assert chip["process"] is not None
    return read_process(chip["process"]).resistor.min_width if chip["width"] is None else chip["width"] * _MICRO
