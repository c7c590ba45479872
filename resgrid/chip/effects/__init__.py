"""Effects of real devices on a chip's netlist: all effects by name, those of a chip description, and JSON conversion.

An effect is a frozen dataclass with ``apply(netlist) -> netlist``.  `resgrid.chip.build_chip` takes a list of effects
or a chip description.  To add an effect, write a dataclass that derives from `Effect` in a new file, and add a line to
`EFFECTS`.

>>> netlist = rg.Netlist(2, [[1, 0]], [1e-3])
>>> effects = (rg.chip.effects.PreferredValues("E6"), rg.chip.effects.Mismatch(0.01, seed=3))
>>> rg.chip.effects.from_json(rg.chip.effects.to_json(effects)) == effects
True
>>> rg.chip.build_chip(netlist, effects).conductance.round(5)
array([0.00101])
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from resgrid.chip.effects.base import Effect as Effect, checked
from resgrid.chip.effects.spread import Faults as Faults, Mismatch as Mismatch, ResistanceGradient as ResistanceGradient
from resgrid.chip.effects.switches import (
    Capacitance as Capacitance,
    InternodalSwitches as InternodalSwitches,
    RailResistance as RailResistance,
    RailSwitches as RailSwitches,
    ReadoutLoad as ReadoutLoad,
)
from resgrid.chip.effects.values import (
    PreferredValues as PreferredValues,
    Saturation as Saturation,
    SheetResistors as SheetResistors,
    Temperature as Temperature,
    TemperatureCoefficients as TemperatureCoefficients,
)
from resgrid.core.random_sites import seed_of
from resgrid.errors import InputError, suggestion
from resgrid.scene.chip import Chip
from resgrid.scene.table_models import fields_of, plain

EFFECTS: dict[str, type[Effect]] = {
    "preferred_values": PreferredValues,
    "sheet_resistors": SheetResistors,
    "gradient": ResistanceGradient,
    "mismatch": Mismatch,
    "temperature_coefficients": TemperatureCoefficients,
    "temperature": Temperature,
    "internodal_switches": InternodalSwitches,
    "saturation": Saturation,
    "rail_switches": RailSwitches,
    "rail_resistance": RailResistance,
    "capacitance": Capacitance,
    "readout_load": ReadoutLoad,
    "faults": Faults,  # last: a switch or a load may connect a cell that opens isolate
}
"""All effects by their names in JSON, in the order of design, fabrication and use."""


def of_chip(chip: Chip, seed: Any = None) -> tuple[Effect, ...]:
    """Return the effects of a chip description, in the order of design, fabrication and use.

    Parameters
    ----------
    chip : Chip
        The chip description.
    seed : int, sequence of int or numpy.random.SeedSequence, optional
        Seed of the random effects; by default the seed in the chip description.

    Returns
    -------
    tuple of Effect
        The effects, in the order in which they are applied.
    """
    which, described = seed_of(chip.seed if seed is None else seed), chip.with_process()
    effects = (kind.of(described, which) for kind in EFFECTS.values())
    return tuple(effect for effect in effects if effect is not None)


def to_json(effects: Iterable[Effect]) -> list[dict[str, Any]]:
    """Return effects as a list of tables with JSON values, which `from_json` reads.

    Parameters
    ----------
    effects : iterable of Effect
        The effects, in the order in which they are applied.

    Returns
    -------
    list of dict
        One table for each effect: its name in `EFFECTS` under ``"pass"``, and its fields.
    """
    names = {kind: name for name, kind in EFFECTS.items()}
    return [{"pass": names[type(effect)], **plain(effect)} for effect in checked(effects)]


def from_json(entries: Sequence[Mapping[str, Any]]) -> tuple[Effect, ...]:
    """Return the effects of a list of tables, the output of `to_json`.

    Parameters
    ----------
    entries : list or tuple of mapping
        One table for each effect: its name in `EFFECTS` under ``"pass"``, and its fields.

    Returns
    -------
    tuple of Effect
        The effects, in the order in which they are applied.

    Raises
    ------
    InputError
        If an entry is not a table, a name or key is unknown, or a value is out of range.
    """
    if not isinstance(entries, list | tuple):
        raise InputError(
            f"effects = {entries!r} must be a list of tables, such as [{{'pass': 'mismatch', 'sigma': 0.01}}]"
        )
    return tuple(_effect_of(number, entry) for number, entry in enumerate(entries))


def _effect_of(number: int, entry: Any) -> Effect:
    """Return the effect of one table; raise InputError if the table is not valid.

    `number`: position of the table in the list, for messages; `entry`: mapping with the name of the effect under
    ``"pass"``, and the values of its fields by name.
    """
    if not isinstance(entry, Mapping):
        raise InputError(f"effect {number} = {entry!r} must be a table, such as {{'pass': 'mismatch', 'sigma': 0.01}}")
    name = entry.get("pass")
    kind: Any = EFFECTS.get(name) if isinstance(name, str) else None
    if kind is None:
        hint = suggestion(str(name), list(EFFECTS)) or f"there are {', '.join(EFFECTS)}"
        raise InputError(f"effect {number}: {name!r} is unknown; {hint}")
    values = {key: value for key, value in entry.items() if key != "pass"}
    known = [item.name for item in dataclasses.fields(kind)]
    for key in values:
        if key not in known:
            hint = suggestion(key, known) or f"it may hold {', '.join(known)}"
            raise InputError(f"effect {number} ({name}): {key!r} is unknown; {hint}")
    try:
        effect: Effect = kind(**fields_of(kind, values))
    except InputError as error:
        raise InputError(f"effect {number} ({name}): {error}") from None
    return effect
