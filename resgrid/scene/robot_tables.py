"""The ``[robot]`` table of a scene file: what each kind of robot needs."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from resgrid.robots import Arm, DiscRobot, PointRobot, PolygonRobot, Robot
from resgrid.scene.tables import NotNegative, Number, Pair, Positive, Ring, Table, ValueTable


class PointRobotTable(ValueTable):
    """A point, or a ball around it."""

    type: Literal["point"] = "point"
    radius: NotNegative = 0.0

    def value(self) -> Robot:
        """The robot this table describes."""
        return PointRobot(self.radius)


class DiscRobotTable(ValueTable):
    """A disc in the plane."""

    type: Literal["disc"]
    radius: Positive

    def value(self) -> Robot:
        """The robot this table describes."""
        return DiscRobot(self.radius)


class PolygonRobotTable(ValueTable):
    """A polygon that moves and turns; axes x, y, theta, the last in units of ``turning_length`` times the angle."""

    type: Literal["polygon"]
    vertices: Ring
    turning_length: Positive = 1.0

    def value(self) -> Robot:
        """The robot this table describes."""
        return PolygonRobot(tuple((x, y) for x, y in self.vertices), self.turning_length)


class LinkTable(Table):
    """A link of an arm; without limits its joint turns all the way round."""

    length: Positive
    width: NotNegative = 0.0
    limits: Pair | None = None

    @model_validator(mode="after")
    def _is_possible(self) -> LinkTable:
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            raise ValueError(f"limits = {self.limits} are reversed: the lower limit comes first")
        return self


class ArmTable(ValueTable):
    """A planar arm; one axis per joint, in radians."""

    type: Literal["arm"]
    links: Annotated[list[LinkTable], Field(min_length=1, max_length=4)]
    base: Pair = Field(default=[0.0, 0.0])
    base_angle: Number = 0.0
    angles: Literal["relative", "absolute"] = "relative"
    self_collision: bool = False
    singularity_width: NotNegative | None = None
    singularity_cells: Annotated[int, Field(ge=1)] | None = None

    def value(self) -> Robot:
        """The robot this table describes."""
        return Arm(
            lengths=tuple(link.length for link in self.links),
            widths=tuple(link.width for link in self.links),
            limits=tuple((link.limits[0], link.limits[1]) if link.limits else None for link in self.links),
            base=tuple(self.base),
            base_angle=self.base_angle,
            angles=self.angles,
            self_collision=self.self_collision,
            singularity_width=self.singularity_width,
            singularity_cells=self.singularity_cells,
        )


def _kind(table: Any) -> str | None:
    if not isinstance(table, dict):
        return getattr(table, "type", None)
    kind = table.get("type", "point")
    return kind if isinstance(kind, str) else None


AnyRobot = Annotated[
    Annotated[PointRobotTable, Tag("point")]
    | Annotated[DiscRobotTable, Tag("disc")]
    | Annotated[PolygonRobotTable, Tag("polygon")]
    | Annotated[ArmTable, Tag("arm")],
    Discriminator(_kind),
]
