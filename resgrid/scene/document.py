"""The scene file's schema: what keys there are and what each may hold.  Imported only when a scene is read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import ulp
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, WithJsonSchema, model_validator

from resgrid.errors import InputError
from resgrid.robots import Ball, Box, HalfSpace, Polygon, Shape
from resgrid.robots.shapes import LARGEST
from resgrid.scene.quantities import PATTERN, parse_quantity
from resgrid.scene.scene import GoalCell, GoalPoint


def _quantity(value: object) -> float:
    try:
        return parse_quantity(value)
    except InputError as error:
        raise ValueError(str(error)) from None


def _listed(value: object) -> object:
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


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


class ShapeTable(Table):
    """A shape that can be made; what makes it impossible is an error of the file."""

    def value(self) -> Any:
        """The shape this table describes."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _is_possible(self) -> ShapeTable:
        try:
            self.value()
        except InputError as error:
            raise ValueError(str(error)) from None
        return self


class Rectangle(ShapeTable):
    """A rectangle with sides along the axes; two axes."""

    shape: Literal["rectangle"]
    lower: Pair
    upper: Pair

    def value(self) -> Shape:
        """The shape this table describes."""
        return Box(tuple(self.lower), tuple(self.upper))


class Cuboid(ShapeTable):
    """A box with sides along the axes; any number of axes."""

    shape: Literal["box"]
    lower: Coordinates
    upper: Coordinates

    def value(self) -> Shape:
        """The shape this table describes."""
        return Box(tuple(self.lower), tuple(self.upper))


class Circle(ShapeTable):
    """A disc; two axes."""

    shape: Literal["circle"]
    centre: Pair
    radius: NotNegative

    def value(self) -> Shape:
        """The shape this table describes."""
        return Ball(tuple(self.centre), self.radius)


class Sphere(ShapeTable):
    """A ball; any number of axes."""

    shape: Literal["sphere"]
    centre: Coordinates
    radius: NotNegative

    def value(self) -> Shape:
        """The shape this table describes."""
        return Ball(tuple(self.centre), self.radius)


class PolygonTable(ShapeTable):
    """A simple polygon, with holes if need be; two axes."""

    shape: Literal["polygon"]
    vertices: Ring
    holes: list[Ring] = []

    def value(self) -> Shape:
        """The shape this table describes."""
        vertices, *holes = (tuple(map(tuple, ring)) for ring in (self.vertices, *self.holes))
        return Polygon(vertices, tuple(holes))


class HalfPlane(ShapeTable):
    """All points with ``normal . x <= offset``; any number of axes."""

    shape: Literal["half_plane"]
    normal: Coordinates
    offset: Number

    def value(self) -> Shape:
        """The shape this table describes."""
        return HalfSpace(tuple(self.normal), self.offset)


class PointTable(Table):
    """The cell around a point."""

    point: Coordinates

    def value(self) -> GoalPoint:
        """The place this table describes."""
        return GoalPoint(tuple(self.point))


class CellTable(Table):
    """A cell by its index."""

    cell: Index

    def value(self) -> GoalCell:
        """The place this table describes."""
        return GoalCell(tuple(self.cell))


class _Conducting(Table):
    conductivity: Positive


class RectangleArea(_Conducting, Rectangle):
    """A rectangle with another conductivity."""


class CuboidArea(_Conducting, Cuboid):
    """A box with another conductivity."""


class CircleArea(_Conducting, Circle):
    """A disc with another conductivity."""


class SphereArea(_Conducting, Sphere):
    """A ball with another conductivity."""


class PolygonArea(_Conducting, PolygonTable):
    """A polygon with another conductivity."""


class HalfPlaneArea(_Conducting, HalfPlane):
    """A half-plane with another conductivity."""


def _kind(*places: str) -> Callable[[Any], str | None]:
    def kind(table: Any) -> str | None:
        if not isinstance(table, dict):
            return getattr(table, "shape", None) or next((key for key in places if hasattr(table, key)), None)
        shape = table.get("shape")
        return shape if isinstance(shape, str) else next((key for key in places if key in table), None)

    return kind


AnyShape = Annotated[
    Rectangle | Cuboid | Circle | Sphere | PolygonTable | HalfPlane,
    Field(discriminator="shape"),
]
AnyArea = Annotated[
    RectangleArea | CuboidArea | CircleArea | SphereArea | PolygonArea | HalfPlaneArea,
    Field(discriminator="shape"),
]
AnyGoal = Annotated[
    Annotated[Rectangle, Tag("rectangle")]
    | Annotated[Cuboid, Tag("box")]
    | Annotated[Circle, Tag("circle")]
    | Annotated[Sphere, Tag("sphere")]
    | Annotated[PolygonTable, Tag("polygon")]
    | Annotated[HalfPlane, Tag("half_plane")]
    | Annotated[PointTable, Tag("point")]
    | Annotated[CellTable, Tag("cell")],
    Discriminator(_kind("point", "cell")),
]
AnyStart = Annotated[
    Annotated[PointTable, Tag("point")] | Annotated[CellTable, Tag("cell")],
    Discriminator(_kind("point", "cell")),
]


class RobotTable(Table):
    """The robot."""

    type: Literal["point"] = "point"
    radius: NotNegative = 0.0


class AxisTable(Table):
    """One axis of the grid."""

    name: Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
    lower: Number
    upper: Number
    cells: Annotated[int, Field(ge=1)] | None = None
    spacing: Positive | None = None
    periodic: bool = False
    unit: str = "m"

    @model_validator(mode="after")
    def _is_possible(self) -> AxisTable:
        if not self.lower < self.upper:
            raise ValueError(f"lower = {self.lower} must lie below upper = {self.upper}")
        if max(abs(self.lower), abs(self.upper)) > LARGEST:
            raise ValueError(f"lower and upper must not exceed {LARGEST:g}")
        if (self.cells is None) == (self.spacing is None):
            raise ValueError("give either cells or spacing, not " + ("both" if self.cells else "neither"))
        if self.spacing is not None:
            count = (self.upper - self.lower) / self.spacing
            if count > 1e18 or round(count) < 1 or abs(count - round(count)) > 1e-6 * max(1.0, count * 1e-3):
                raise ValueError(
                    f"spacing = {self.spacing} does not divide upper - lower = {self.upper - self.lower} into whole "
                    "cells; change one of them, or give cells"
                )
        if (self.upper - self.lower) / self.count() < 64 * ulp(max(abs(self.lower), abs(self.upper))):
            raise ValueError("the cells are too narrow to be told apart in floating point; move the axis towards 0")
        return self

    def count(self) -> int:
        """Number of cells."""
        return self.cells if self.spacing is None else round((self.upper - self.lower) / self.spacing)  # type: ignore[return-value]


class GridTable(Table):
    """The grid."""

    axes: Annotated[list[AxisTable], Field(min_length=1, max_length=4)]


class MapTable(Table):
    """A map file instead of a grid, and how to read it; each format takes its own options."""

    file: Annotated[str, Field(min_length=1)]
    format: Literal["auto", "ros", "movingai", "image", "epic", "npy"] = "auto"
    dialect: Literal["nav2", "ros1"] | None = None
    unknown: Literal["obstacle", "free"] | None = None
    lethal: Annotated[int, Field(ge=1, le=100)] | None = None
    passable: Annotated[str, Field(min_length=1)] | None = None
    threshold: Annotated[int, Field(ge=0, le=65536)] | None = None
    spacing: Positive | None = None
    origin: Coordinates | None = None
    unit: str | None = None


class ChipTable(Table):
    """Component values in SI units, as numbers or engineering values such as "4k7"."""

    resistance: PositiveQuantity = 10e3
    supply: Quantity = 1.0
    wall_resistance: Annotated[Quantity, Field(ge=0)] | None = None
    capacitance: Annotated[Quantity, Field(ge=0)] | None = None
    goal_switch_on: PositiveQuantity | None = None
    goal_switch_off: PositiveQuantity | None = None
    obstacle_switch_on: PositiveQuantity | None = None
    obstacle_switch_off: PositiveQuantity | None = None
    internodal_switch_on: PositiveQuantity | None = None
    internodal_switch_off: PositiveQuantity | None = None

    @model_validator(mode="after")
    def _is_possible(self) -> ChipTable:
        if self.supply == 0:
            raise ValueError("supply = 0 drives nothing; give the voltage between the rails")
        return self


EdgeRule = Literal["obstacle", "open", "periodic"]


class SceneDocument(Table):
    """A resgrid scene."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
    title: str = ""
    boundary: Literal["dirichlet", "neumann", "wall"] = "dirichlet"
    drive: Literal["uniform", "start"] | None = None
    edge: Annotated[
        list[EdgeRule],
        BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
        WithJsonSchema({"anyOf": [{"enum": ["obstacle", "open"]}, {"type": "array", "items": {"type": "string"}}]}),
    ] = ["obstacle"]
    sampling: Literal["conservative", "centre"] = "conservative"
    k: Annotated[
        list[Share],
        BeforeValidator(_listed),
        WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}),
    ] = []
    robot: RobotTable = RobotTable()
    grid: GridTable | None = None
    map: MapTable | None = None
    obstacle: list[AnyShape] = []
    goal: list[AnyGoal] = []
    start: list[AnyStart] = []
    starts: list[Coordinates] = []
    area: list[AnyArea] = []
    chip: ChipTable = ChipTable()


def table_keys(model: type[BaseModel]) -> Iterable[str]:
    """The keys a table may hold, as written in the file."""
    return [info.alias or name for name, info in model.model_fields.items()]
