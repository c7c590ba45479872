"""What all tables of a scene file are made of: numbers, quantities, and tables without unknown keys."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema, model_validator

from resgrid.errors import InputError
from resgrid.scene.quantities import PATTERN, parse_quantity


def _quantity(value: object) -> float:
    try:
        return parse_quantity(value)
    except InputError as error:
        raise ValueError(str(error)) from None


Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(allow_inf_nan=False, gt=0)]
NotNegative = Annotated[float, Field(allow_inf_nan=False, ge=0)]
Share = Annotated[float, Field(allow_inf_nan=False, ge=0, le=1)]
Coordinates = Annotated[list[Number], Field(min_length=1, max_length=4)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
Index = Annotated[list[int], Field(min_length=1, max_length=4)]
Ring = Annotated[list[Pair], Field(min_length=3)]
Quantity = Annotated[
    float,
    BeforeValidator(_quantity),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "pattern": f"^({PATTERN})$"}]}),
]
PositiveQuantity = Annotated[Quantity, Field(gt=0)]


class Table(BaseModel):
    """Base of every table: unknown keys are errors, and nothing is converted silently."""

    model_config = ConfigDict(extra="forbid", strict=True)


class ValueTable(Table):
    """A table that stands for a value; what makes it impossible is an error of the file."""

    def value(self) -> Any:
        """What this table describes."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _is_possible(self) -> ValueTable:
        try:
            self.value()
        except InputError as error:
            raise ValueError(str(error)) from None
        return self
