"""A number that says what it is: value, unit and definition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Reading:
    """One figure of a chip.

    `value`: none where it is not defined; `unit`: SI unit, ``""`` for a pure number; `definition`: what it is, in one
    sentence.
    """

    value: float | int | str | None
    unit: str
    definition: str


def json_form(readings: Mapping[str, Reading]) -> dict[str, Any]:
    """Readings as plain tables, for JSON."""
    return {
        name: {"value": reading.value, "unit": reading.unit, "definition": reading.definition}
        for name, reading in readings.items()
    }
