"""The ``[chip]`` table of a scene file.  Imported only when a scene is read."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from resgrid.errors import InputError
from resgrid.scene.chip import MOST_BITS, Chip, Defects, Readout
from resgrid.scene.quantities import PATTERN, parse_share
from resgrid.scene.tables import PositiveQuantity, Quantity, ValueTable


def _share(value: object) -> float:
    try:
        return parse_share(value)
    except InputError as error:
        raise ValueError(str(error)) from None


def _listed(value: object) -> object:
    return value if isinstance(value, list) else [value]


Percentage = Annotated[
    float,
    BeforeValidator(_share),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "pattern": f"^(({PATTERN}) *%|{PATTERN})$"}]}),
]
NotNegativeQuantity = Annotated[Quantity, Field(ge=0)]


class ReadoutTable(ValueTable):
    """How node voltages are measured; ideal where it does not say."""

    input_resistance: PositiveQuantity | None = None
    offset: NotNegativeQuantity | None = None
    noise_bandwidth: PositiveQuantity | None = None
    bits: Annotated[int, Field(ge=1, le=MOST_BITS)] | None = None
    range: Annotated[list[Quantity], Field(min_length=2, max_length=2)] | None = None

    def value(self) -> Readout:
        """The read-out this table describes."""
        values = self.model_dump()
        return Readout(**values | {"range": None if self.range is None else tuple(self.range)})


class DefectsTable(ValueTable):
    """Faults of fabrication: shares of the grid's resistors."""

    open_density: Annotated[Percentage, Field(ge=0, le=1)] = 0.0
    short_density: Annotated[Percentage, Field(ge=0, le=1)] = 0.0
    short_resistance: PositiveQuantity = 1.0

    def value(self) -> Defects:
        """The faults this table describes."""
        return Defects(**self.model_dump())


class ChipTable(ValueTable):
    """Component values in SI units, as numbers or engineering values such as "4k7"; shares also as "10 %"."""

    resistance: PositiveQuantity = 10e3
    supply: Quantity = 1.0
    wall_resistance: NotNegativeQuantity | None = None
    capacitance: NotNegativeQuantity | None = None
    goal_switch_on: PositiveQuantity | None = None
    goal_switch_off: PositiveQuantity | None = None
    obstacle_switch_on: PositiveQuantity | None = None
    obstacle_switch_off: PositiveQuantity | None = None
    internodal_switch_on: PositiveQuantity | None = None
    internodal_switch_off: PositiveQuantity | None = None
    mismatch: Annotated[Percentage, Field(ge=0)] | None = None
    pelgrom: NotNegativeQuantity | None = None
    width: PositiveQuantity | None = None
    length: PositiveQuantity | None = None
    gradient: (
        Annotated[
            list[Percentage],
            BeforeValidator(_listed),
            Field(min_length=1, max_length=4),
            WithJsonSchema({"anyOf": [{"type": ["number", "string"]}, {"type": "array", "maxItems": 4}]}),
        ]
        | None
    ) = None
    temperature: Quantity | None = None
    tc1: Quantity | None = None
    tc2: Quantity | None = None
    preferred: Literal["E6", "E12", "E24", "E48", "E96", "E192"] | None = None
    sheet_resistance: PositiveQuantity | None = None
    drawing_grid: PositiveQuantity = 5e-9
    rail_resistance: NotNegativeQuantity | None = None
    saturation_voltage: PositiveQuantity | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    readout: ReadoutTable = ReadoutTable()
    defects: DefectsTable = DefectsTable()

    def value(self) -> Chip:
        """The chip this table describes."""
        values: dict[str, Any] = self.model_dump(exclude={"readout", "defects", "gradient"})
        gradient = None if self.gradient is None else tuple(self.gradient)
        return Chip(**values, gradient=gradient, readout=self.readout.value(), defects=self.defects.value())
