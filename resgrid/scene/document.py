"""The scene file's schema: what keys there are and what each may hold.  Imported only when a scene is read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import ulp
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, WithJsonSchema, model_validator

from resgrid.robots import Ball, Box, HalfSpace, Polygon, Shape
from resgrid.robots.shapes import LARGEST
from resgrid.scene.chip_tables import ChipTable
from resgrid.scene.robot_tables import AnyRobot, ArmTable, DiscRobotTable, PointRobotTable, PolygonRobotTable
from resgrid.scene.scene import GoalCell, GoalJoints, GoalPoint
from resgrid.scene.tables import (
    Coordinates,
    Index,
    NotNegative,
    Number,
    Pair,
    Positive,
    Ring,
    Share,
    Table,
    ValueTable,
)

Count = Annotated[int, Field(ge=1)]


def _listed(value: object) -> object:
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


class Rectangle(ValueTable):
    """A rectangle with sides along the axes; two axes."""

    shape: Literal["rectangle"]
    lower: Pair
    upper: Pair

    def value(self) -> Shape:
        """The shape this table describes."""
        return Box(tuple(self.lower), tuple(self.upper))


class Cuboid(ValueTable):
    """A box with sides along the axes; any number of axes."""

    shape: Literal["box"]
    lower: Coordinates
    upper: Coordinates

    def value(self) -> Shape:
        """The shape this table describes."""
        return Box(tuple(self.lower), tuple(self.upper))


class Circle(ValueTable):
    """A disc; two axes."""

    shape: Literal["circle"]
    centre: Pair
    radius: NotNegative

    def value(self) -> Shape:
        """The shape this table describes."""
        return Ball(tuple(self.centre), self.radius)


class Sphere(ValueTable):
    """A ball; any number of axes."""

    shape: Literal["sphere"]
    centre: Coordinates
    radius: NotNegative

    def value(self) -> Shape:
        """The shape this table describes."""
        return Ball(tuple(self.centre), self.radius)


class PolygonTable(ValueTable):
    """A simple polygon, with holes if need be; two axes."""

    shape: Literal["polygon"]
    vertices: Ring
    holes: list[Ring] = Field(default=[])

    def value(self) -> Shape:
        """The shape this table describes."""
        vertices, *holes = (tuple(map(tuple, ring)) for ring in (self.vertices, *self.holes))
        return Polygon(vertices, tuple(holes))


class HalfPlane(ValueTable):
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


class JointsTable(Table):
    """One configuration of the robot: the cell around it."""

    joints: Coordinates

    def value(self) -> GoalJoints:
        """The place this table describes."""
        return GoalJoints(tuple(self.joints), tuple(self.joints))


class JointBoxTable(ValueTable):
    """A box of configurations."""

    joints_lower: Coordinates
    joints_upper: Coordinates

    def value(self) -> GoalJoints:
        """The place this table describes."""
        return GoalJoints(tuple(self.joints_lower), tuple(self.joints_upper))


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
        if isinstance(shape, str):
            return shape if shape not in places else None  # a place has no shape
        return next((key for key in places if key in table), None)

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
    | Annotated[CellTable, Tag("cell")]
    | Annotated[JointsTable, Tag("joints")]
    | Annotated[JointBoxTable, Tag("joints_lower")],
    Discriminator(_kind("point", "cell", "joints", "joints_lower")),
]
AnyStart = Annotated[
    Annotated[PointTable, Tag("point")] | Annotated[CellTable, Tag("cell")],
    Discriminator(_kind("point", "cell")),
]


def _by(key: str, *models: type[Table]) -> dict[str, type[Table]]:
    """Tables by the text that their key must hold."""
    return {get_args(model.model_fields[key].annotation)[0]: model for model in models}


PLACES: dict[str, type[Table]] = {"point": PointTable, "cell": CellTable}
JOINTS: dict[str, type[Table]] = {"joints": JointsTable, "joints_lower": JointBoxTable}
SHAPES = _by("shape", Rectangle, Cuboid, Circle, Sphere, PolygonTable, HalfPlane)
KINDS: dict[str, dict[str, type[Table]]] = {
    "obstacle": SHAPES,
    "hidden": SHAPES,
    "goal": SHAPES | PLACES | JOINTS,
    "start": PLACES,
    "area": _by("shape", RectangleArea, CuboidArea, CircleArea, SphereArea, PolygonArea, HalfPlaneArea),
    "robot": _by("type", PointRobotTable, DiscRobotTable, PolygonRobotTable, ArmTable),
}
"""Tables that come in several kinds, by the kind."""


def _nothing_required(schema: dict[str, Any]) -> None:
    """A robot may bring along what its axes leave out; only then may they."""
    schema.pop("required", None)


class AxisTable(Table):
    """One axis of the grid; what an arm's or a turning polygon's axes leave out, the robot decides."""

    model_config = ConfigDict(json_schema_extra=_nothing_required)

    name: Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
    lower: Number
    upper: Number
    cells: Count | None = None
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
    """The grid; ``cells`` is for axes that do not say, and an arm's axes need say nothing at all."""

    model_config = ConfigDict(json_schema_extra=_nothing_required)

    axes: Annotated[list[AxisTable], Field(min_length=1, max_length=4)]
    cells: Count | Annotated[list[Count], Field(min_length=1, max_length=4)] | None = None


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
    ] = Field(default=["obstacle"])
    sampling: Literal["conservative", "centre"] = "conservative"
    k: Annotated[
        list[Share],
        BeforeValidator(_listed),
        WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}),
    ] = Field(default=[])
    robot: AnyRobot = PointRobotTable()
    grid: GridTable | None = None
    map: MapTable | None = None
    obstacle: list[AnyShape] = Field(default=[])
    hidden: list[AnyShape] = Field(default=[])
    goal: list[AnyGoal] = Field(default=[])
    start: list[AnyStart] = Field(default=[])
    starts: list[Coordinates] = Field(default=[])
    area: list[AnyArea] = Field(default=[])
    chip: ChipTable = ChipTable()


def table_keys(model: type[BaseModel]) -> Iterable[str]:
    """The keys a table may hold, as written in the file."""
    return [info.alias or name for name, info in model.model_fields.items()]
