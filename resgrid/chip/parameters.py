"""What the keys of a chip mean, for its report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from resgrid.chip.build import chip_keys
from resgrid.chip.figures import formatted
from resgrid.scene.chip import Chip

MEANING: dict[str, tuple[str, str]] = {
    "resistance": ("ohm", "nominal resistance between neighbouring cells"),
    "supply": ("V", "voltage between the obstacle rail and the goal rail"),
    "wall_resistance": ("ohm", "in series with every contact to an obstacle"),
    "capacitance": ("F", "from every cell's node to ground"),
    "goal_switch_on": ("ohm", "closed switch between a cell and the goal rail"),
    "goal_switch_off": ("ohm", "the same, open"),
    "obstacle_switch_on": ("ohm", "closed switch between a cell and the obstacle rail"),
    "obstacle_switch_off": ("ohm", "the same, open"),
    "internodal_switch_on": ("ohm", "closed switch in series with every resistor between cells"),
    "internodal_switch_off": ("ohm", "the same, open"),
    "mismatch": ("", "standard deviation of a resistance, as a share of its mean"),
    "pelgrom": ("% µm", "A_R: the standard deviation of a resistance is A_R / sqrt(W L)"),
    "width": ("m", "W of a resistor"),
    "length": ("m", "L of a resistor"),
    "gradient": ("", "growth of the resistance across the die, along every axis, as a share"),
    "temperature": ("°C", "of the die"),
    "tc1": ("1/K", "first temperature coefficient of the grid's resistors, from 27 °C"),
    "tc2": ("1/K^2", "second temperature coefficient of the grid's resistors, from 27 °C"),
    "preferred": ("", "series of preferred values that resistances are taken from"),
    "sheet_resistance": ("ohm", "per square of the polysilicon that resistors are drawn in"),
    "drawing_grid": ("m", "step of drawn lengths"),
    "rail_resistance": ("ohm", "of a stretch of rail between neighbouring cells"),
    "saturation_voltage": ("V", "V0 of resistors that saturate as I0 tanh(dV / V0), with I0 = V0 / R"),
    "seed": ("", "of everything random about the chip"),
    "readout.input_resistance": ("ohm", "from every cell's node to ground, by the read-out"),
    "readout.offset": ("V", "standard deviation of a node's measurement, the same at every measurement of the node"),
    "readout.noise_bandwidth": ("Hz", "equivalent noise bandwidth of a measurement"),
    "readout.bits": ("", "bits of the converter"),
    "readout.range": ("V", "lowest and highest voltage of the converter"),
    "defects.open_density": ("", "share of the resistors that are open"),
    "defects.short_density": ("", "share of the resistors that are shorted"),
    "defects.short_resistance": ("ohm", "of a short"),
}
"""Unit and meaning of every key."""


def described(chip: Chip, shape: Sequence[int], boundary: str) -> list[tuple[str, str, str]]:
    """What a chip is made of, key by key, without what is ideal: key, value, meaning."""
    meaning = {"dirichlet": "are a rail", "neumann": "are open", "wall": "are a rail behind a resistance"}[boundary]
    size = f"{' x '.join(map(str, shape))} cells"
    rows = [("grid", size, "one node each"), ("boundary", boundary, f"obstacles {meaning}")]
    values = dict(chip_keys(chip))
    if chip.sheet_resistance is None:
        del values["drawing_grid"]
    for key, value in values.items():
        unit, meaning = MEANING[key]
        if value is not None:
            rows.append((key, value_text(value, unit), meaning))
    return rows


def value_text(value: Any, unit: str) -> str:
    """A value of a chip for people."""
    if isinstance(value, tuple):
        return ", ".join(value_text(part, unit) for part in value)
    if value is None:
        return "none"
    if unit in ("% µm", "1/K", "1/K^2") or isinstance(value, str):
        return f"{value} {unit}".strip()
    return formatted(value, unit)
