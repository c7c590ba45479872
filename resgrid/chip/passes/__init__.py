"""Passes as data: what a chip's description asks for, as a list that JSON can hold.

A pass is a frozen value with ``apply(netlist) -> netlist``, pure and, where it is random, seeded.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Protocol

from resgrid.chip.passes.spread import Faults, Gradient, Mismatch
from resgrid.chip.passes.switches import Capacitance, InternodalSwitches, RailResistance, RailSwitches, ReadoutLoad
from resgrid.chip.passes.values import PreferredValues, Saturation, SheetResistors, Temperature, TemperatureCoefficients
from resgrid.die import Seed, seed_of
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.scene.chip import Chip


class Pass(Protocol):
    """One effect of a chip on its netlist."""

    def apply(self, netlist: Netlist) -> Netlist:
        """The netlist with this effect."""
        ...


PASSES: dict[str, Any] = {
    "preferred_values": PreferredValues,
    "sheet_resistors": SheetResistors,
    "gradient": Gradient,
    "mismatch": Mismatch,
    "temperature_coefficients": TemperatureCoefficients,
    "temperature": Temperature,
    "internodal_switches": InternodalSwitches,
    "saturation": Saturation,
    "faults": Faults,
    "rail_switches": RailSwitches,
    "rail_resistance": RailResistance,
    "capacitance": Capacitance,
    "readout_load": ReadoutLoad,
}
"""Every pass by its name in JSON."""


def passes_of(chip: Chip, seed: Any = None) -> tuple[Pass, ...]:
    """What a chip's description asks for, in the order of design, fabrication and use.

    Parameters
    ----------
    chip : Chip
    seed : int, sequence of int or numpy.random.SeedSequence, optional
        Which chip of the kind; the description's by default.

    Returns
    -------
    tuple of passes
        Nothing for what is ideal.
    """
    which = seed_of(chip.seed if seed is None else seed)
    return (*_drawn(chip), *_made(chip, which), *_used(chip, which))


def _drawn(chip: Chip) -> list[Pass]:
    passes: list[Pass] = []
    if chip.preferred is not None:
        passes.append(PreferredValues(chip.preferred))
    if chip.sheet_resistance is not None and chip.width is not None:
        passes.append(SheetResistors(chip.sheet_resistance, chip.width, chip.drawing_grid))
    return passes


def _made(chip: Chip, seed: Seed) -> list[Pass]:
    passes: list[Pass] = []
    if chip.gradient is not None:
        passes.append(Gradient(chip.gradient))
    if chip.mismatch:
        passes.append(Mismatch(sigma=chip.mismatch, seed=seed))
    elif chip.pelgrom:
        passes.append(Mismatch(None, chip.pelgrom, chip.width, chip.length, chip.sheet_resistance, seed))
    return passes


def _used(chip: Chip, seed: Seed) -> list[Pass]:
    passes: list[Pass] = []
    if chip.tc1 or chip.tc2:
        passes.append(TemperatureCoefficients(chip.tc1 or 0.0, chip.tc2 or 0.0))
        if chip.temperature is not None:
            passes.append(Temperature(chip.temperature))
    if chip.internodal_switch_on is not None or chip.internodal_switch_off is not None:
        passes.append(InternodalSwitches(chip.internodal_switch_on, chip.internodal_switch_off))
    if chip.saturation_voltage is not None:
        passes.append(Saturation(chip.saturation_voltage))
    switches = RailSwitches(
        chip.obstacle_switch_on, chip.obstacle_switch_off, chip.goal_switch_on, chip.goal_switch_off
    )
    if switches != RailSwitches():
        passes.append(switches)
    if chip.rail_resistance:
        passes.append(RailResistance(chip.rail_resistance))
    if chip.capacitance:
        passes.append(Capacitance(chip.capacitance))
    if chip.readout.input_resistance is not None:
        passes.append(ReadoutLoad(chip.readout.input_resistance))
    if chip.defects.open_density or chip.defects.short_density:  # last, for a switch or a load may still serve a cell
        passes.append(Faults(**dataclasses.asdict(chip.defects), seed=seed))
    return passes


def apply_passes(netlist: Netlist, passes: Iterable[Pass]) -> Netlist:
    """Send a netlist through passes, one after the other.

    Parameters
    ----------
    netlist : Netlist
        Compiled with ``rails="cells"`` where a pass needs it.
    passes : iterable of passes

    Returns
    -------
    Netlist
    """
    for effect in passes:
        netlist = effect.apply(netlist)
    return netlist


def passes_to_json(passes: Iterable[Pass]) -> list[dict[str, Any]]:
    """Passes as plain values.

    Parameters
    ----------
    passes : iterable of passes

    Returns
    -------
    list of dict
        ``"pass"`` names it; the other keys are its values, without those that are None.
    """
    names = {kind: name for name, kind in PASSES.items()}
    return [
        {"pass": names[type(effect)]}
        | {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in dataclasses.asdict(effect).items()  # type: ignore[call-overload]
            if value is not None
        }
        for effect in passes
    ]


def passes_from_json(entries: Sequence[Mapping[str, Any]]) -> tuple[Pass, ...]:
    """Passes from what `passes_to_json` gave.

    Parameters
    ----------
    entries : sequence of mapping

    Returns
    -------
    tuple of passes

    Raises
    ------
    InputError
        If a pass or a value is unknown or does not fit; the message names the entry.
    """
    if not isinstance(entries, list | tuple):
        raise InputError(f"passes must be a list of tables, and this is {entries!r}")
    return tuple(_read(number, entry) for number, entry in enumerate(entries))


def _read(number: int, entry: Mapping[str, Any]) -> Pass:
    name = entry.get("pass") if isinstance(entry, Mapping) else None
    if not isinstance(name, str) or name not in PASSES:
        near = get_close_matches(str(name), PASSES, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(PASSES)}"
        raise InputError(f"pass {number}: {name!r} is unknown; {hint}")
    kind = PASSES[name]
    known = {item.name: item for item in dataclasses.fields(kind)}
    values: dict[str, Any] = {}
    for key, value in entry.items():
        if key == "pass":
            continue
        if key not in known:
            raise InputError(f"pass {number} ({name}): {key!r} is unknown; it may hold {', '.join(known)}")
        values[key] = _value(f"pass {number} ({name}): {key}", key, value)
    required = [key for key, item in known.items() if item.default is dataclasses.MISSING and key not in values]
    if required:
        raise InputError(f"pass {number} ({name}): {required[0]!r} is missing")
    try:
        made: Pass = kind(**values)
    except InputError as error:
        raise InputError(f"pass {number} ({name}): {error}") from None
    return made


def _value(where: str, key: str, value: Any) -> Any:
    if key == "seed":
        return seed_of(value)
    if key == "series":
        return value
    entries = value if key == "shares" and isinstance(value, list | tuple) else [value]
    if not all(isinstance(part, int | float) and not isinstance(part, bool) and abs(part) < 1e300 for part in entries):
        raise InputError(f"{where} = {value!r} must be a finite number")
    return tuple(float(part) for part in entries) if key == "shares" else float(value)
