"""Goals of a scene, and cost areas: regions with a conductivity other than 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Gt, Le

from resgrid._internal.validation import checked
from resgrid.core.axis import LARGEST, Point
from resgrid.robots import Box, Shape

Conductivity = Annotated[float, Gt(0), Le(LARGEST)]


@checked
@dataclass(frozen=True)
class GoalPoint:
    """A goal that is the cell of a point in world coordinates; for an arm, all cells with its tip at this point.

    Attributes
    ----------
    point : tuple of float
        World coordinates; for a robot that turns, a place in the plane, with or without a heading.

    Raises
    ------
    InputError
        If a coordinate is not finite.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(goal=rg.GoalPoint((7.2, 0.4)))
    >>> np.argwhere(rg.build_space(scene).cell == rg.Cell.GOAL)
    array([[7, 0]])
    """

    point: Point


@checked
@dataclass(frozen=True)
class GoalCell:
    """A goal that is one cell.

    Attributes
    ----------
    cell : tuple of int
        Index of the cell along every axis, from 0.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(goal=rg.GoalCell((7, 0)))
    >>> np.argwhere(rg.build_space(scene).cell == rg.Cell.GOAL)
    array([[7, 0]])
    """

    cell: tuple[int, ...]


@checked
@dataclass(frozen=True)
class GoalJoints:
    """A goal in configuration space: a box of configurations, or the cell around a single one.

    Attributes
    ----------
    lower, upper : tuple of float
        Opposite corners, in world coordinates (of an arm its joint angles); equal for a single configuration.

    Raises
    ------
    InputError
        If a coordinate is not finite, or ``lower`` is above ``upper``.

    Examples
    --------
    >>> arm = rg.Arm(lengths=(1.0, 1.0))
    >>> scene = rg.Scene(arm.axes(8), robot=arm, goals=(rg.GoalJoints((0.1, 0.1), (0.7, 0.7)),))
    >>> np.argwhere(rg.build_space(scene).cell == rg.Cell.GOAL)
    array([[4, 4]])
    """

    lower: Point
    upper: Point

    def __post_init__(self) -> None:
        Box(self.lower, self.upper)


Goal = Shape | GoalPoint | GoalCell | GoalJoints


@checked
@dataclass(frozen=True)
class CostArea:
    """A region with a higher or lower conductivity than the rest of the grid, which streamlines prefer or avoid.

    Attributes
    ----------
    shape : Shape
        Region of configuration space (for points and discs, of the world).
    conductivity : float
        Conductivity of its cells, above 0; other cells have 1.

    Raises
    ------
    InputError
        If the conductivity is not above 0 and finite.

    Examples
    --------
    >>> axes = (rg.Axis("x", 0.0, 3.0, 3), rg.Axis("y", 0.0, 2.0, 2))
    >>> mud = rg.CostArea(rg.Box((1.0, 0.0), (2.0, 1.0)), conductivity=0.2)
    >>> rg.build_space(rg.Scene(axes, areas=(mud,), goals=(rg.GoalCell((2, 0)),))).conductivity
    array([[1. , 1. ],
           [0.2, 1. ],
           [1. , 1. ]])
    """

    shape: Shape
    conductivity: Conductivity
