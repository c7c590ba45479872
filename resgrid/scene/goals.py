"""What stands in a scene beside obstacles: goals, and areas of another conductivity."""

from __future__ import annotations

from dataclasses import dataclass

from resgrid.arguments import checked
from resgrid.robots import Box, Shape
from resgrid.robots.shapes import Point


@checked
@dataclass(frozen=True)
class GoalPoint:
    """A goal that is the cell around a point, in world coordinates; for an arm, the cells that bring its tip there.

    Attributes
    ----------
    point : tuple of float
        World coordinates; of a turning robot a place in the plane, or one with a heading.
    """

    point: Point


@checked
@dataclass(frozen=True)
class GoalCell:
    """A goal that is one cell.

    Attributes
    ----------
    cell : tuple of int
        Its index, counted from 0.
    """

    cell: tuple[int, ...]


@checked
@dataclass(frozen=True)
class GoalJoints:
    """A goal in configuration space: a box of configurations, or the cell around a single one.

    Attributes
    ----------
    lower, upper : tuple of float
        Corners, in world coordinates (of an arm its angles); equal for a single configuration.
    """

    lower: Point
    upper: Point

    def __post_init__(self) -> None:
        Box(self.lower, self.upper)


Goal = Shape | GoalPoint | GoalCell | GoalJoints


@checked
@dataclass(frozen=True)
class CostArea:
    """A region that conducts better (above 1) or worse (below 1): streamlines prefer what conducts.

    Attributes
    ----------
    shape : Shape
        Of configuration space (for points and discs that is the world).
    conductivity : float
        Of its cells, above 0.
    """

    shape: Shape
    conductivity: float
