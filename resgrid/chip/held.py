"""Which keys of a chip's description each form of its circuit holds: the one place that says so.

``circuit``
    The netlist that `build_chip` makes: everything but how voltages are read.
``tiles``
    The array of tiles with its pattern, whose switches are part of every tile.
``grid``
    The ideal grid that fields and paths follow.  Capacitors draw nothing once it has settled, and so are no difference.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Literal

from resgrid.chip.passes import passes_of
from resgrid.errors import InputError
from resgrid.scene.chip import Chip

Form = Literal["circuit", "tiles", "grid"]

READING = ("readout.offset", "readout.noise_bandwidth", "readout.bits", "readout.range")
"""How voltages are read: what no circuit holds."""

_SCALE = ("resistance", "supply", "wall_resistance")
_HELD = {
    "grid": (*_SCALE, "capacitance"),
    "tiles": (
        *_SCALE,
        "capacitance",
        "goal_switch_on",
        "goal_switch_off",
        "obstacle_switch_on",
        "obstacle_switch_off",
        "internodal_switch_on",
        "internodal_switch_off",
        "mismatch",
        "seed",
    ),
}


def chip_keys(chip: Chip) -> Iterator[tuple[str, Any]]:
    """Every key of a chip, ``readout.bits`` for one of a table in it, and its value."""
    for item in dataclasses.fields(chip):
        value = getattr(chip, item.name)
        if dataclasses.is_dataclass(value):
            yield from ((f"{item.name}.{part.name}", getattr(value, part.name)) for part in dataclasses.fields(value))
        else:
            yield item.name, value


def keys_not_held(chip: Chip, form: Form) -> tuple[str, ...]:
    """The keys of a chip that say something about it and that a form of its circuit does not hold."""
    usual = dict(chip_keys(Chip()))
    return tuple(
        key
        for key, value in chip_keys(chip)
        if value != usual[key] and not _holds(form, key) and _matters(chip, key, usual[key])
    )


def _holds(form: Form, key: str) -> bool:
    return key not in READING if form == "circuit" else key in _HELD[form]


def _matters(chip: Chip, key: str, usual: Any) -> bool:
    """Whether the chip would be another one without the key."""
    table, _, name = key.rpartition(".")
    value = dataclasses.replace(getattr(chip, table), **{name: usual}) if table else usual
    try:
        other = dataclasses.replace(chip, **{table or name: value})
    except InputError:  # other keys rest on it
        return True
    return key in (*_SCALE, *READING) or passes_of(other) != passes_of(chip)
