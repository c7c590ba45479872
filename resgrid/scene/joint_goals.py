"""Schema of goals in scene files that are joint values: one configuration, or a box of configurations."""

from __future__ import annotations

from typing import Annotated, Any

from annotated_types import Len
from pydantic import Field, Strict

from resgrid.scene.goals import GoalJoints
from resgrid.scene.table_models import TableModel, filled_as

Coordinates = Annotated[tuple[float, ...], Strict(False), Len(1, 4)]
"""One number for each axis of the configuration space, 1 to 4: world coordinates, of an arm joint values (rad, m)."""


class Joints(TableModel):
    """A goal that is the cell around one configuration of the robot (of an arm joint values in rad or m)."""

    joints: Annotated[Coordinates, Field(description="Configuration; of an arm its joint angles.")]


class JointBox(TableModel):
    """A goal that is a box of configurations: corners in world coordinates, of an arm joint values (rad or m)."""

    joints_lower: Annotated[Coordinates, Field(description="Lower corner of the box.")]
    joints_upper: Annotated[Coordinates, Field(description="Upper corner of the box.")]


JOINT_GOALS: dict[str, Any] = {
    "joints": filled_as(Joints, lambda joints: GoalJoints(joints, joints)),
    "joints_lower": filled_as(JointBox, lambda **corners: GoalJoints(*corners.values())),
}
"""Pydantic annotations of the tables of goals that are joint values, by the key that only such a table has."""
