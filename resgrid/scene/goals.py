"""Types of a scene's goals (points, cells, joint values, tool poses), and of cost areas (conductivities)."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Annotated

from annotated_types import Ge, Gt, Le

from resgrid._internal.validation import checked
from resgrid._internal.values import brief
from resgrid.core.axis import LARGEST, Point
from resgrid.errors import InputError
from resgrid.robots import Ball, Box, Shape
from resgrid.robots.solids import rotation_matrix
from resgrid.robots.urdf.tool_goals import ToolGoal

Conductivity = Annotated[float, Gt(0), Le(LARGEST)]


@checked
@brief
@dataclass(frozen=True)
class GoalPoint:
    """A goal that is the cell of a point in world coordinates; for an arm, all cells with its tip at this point.

    Attributes
    ----------
    point : tuple of float
        World coordinates; for a robot that turns, a place in the plane, alone or with the heading in radians times the
        robot's turning length as third coordinate.
    tolerance : float
        Largest distance of the robot's reference point from the place, in the unit of the place; above 0, the goal is a
        disc or ball.  A heading given in `point` has no tolerance.
    heading : float or None
        Heading at the goal, in radians, of a robot without a heading of its own (a point or a disc): the orientation of
        the last pose for ROS.  By default there is no demand.

    Raises
    ------
    InputError
        If a coordinate is not finite, or the tolerance is negative.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(goal=rg.GoalPoint((7.2, 0.4)))
    >>> np.argwhere(rg.build_space(scene).cell == rg.Cell.GOAL)
    array([[7, 0]])
    """

    point: Point
    tolerance: Annotated[float, Ge(0), Le(LARGEST)] = 0.0
    heading: Annotated[float, Ge(-LARGEST), Le(LARGEST)] | None = None


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
        Lower and upper corner, in world coordinates (of an arm joint values, in radians or metres); equal for a
        single configuration.

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


@checked
@dataclass(frozen=True)
class GoalPose:
    """A goal that is a set of poses of the tool of a robot from a URDF file.

    Attributes
    ----------
    position : tuple of float
        Position of the tool's origin in the world, in metres.
    radius : float
        Largest distance of the tool's origin from `position`, in metres.
    rotation : tuple of float or None
        Rotation of the tool's frame in the world as roll, pitch and yaw, in radians (as in URDF files: rotations about
        the fixed axes x, y and z, in this order); None permits all rotations.
    angle : float
        Largest angle in radians between the tool's frame and `rotation`.

    Raises
    ------
    InputError
        If `position` or `rotation` does not have three coordinates, or a number is out of range.

    Examples
    --------
    >>> robot = rg.URDFRobot("examples/robots/scara.urdf", moving=("shoulder", "elbow"), tool="tip")
    >>> goal = rg.GoalPose((0.3, 0.2, 0.155), radius=0.02)
    >>> scene = rg.Scene(robot.axes(32), robot=robot, goals=(goal,), sampling="centre")
    >>> int((rg.build_space(scene).cell == rg.Cell.GOAL).sum()) > 0
    True
    """

    position: Point
    radius: Annotated[float, Ge(0), Le(LARGEST)] = 0.0
    rotation: Point | None = None
    angle: Annotated[float, Ge(0), Le(pi)] = 0.0

    def __post_init__(self) -> None:
        for name in ("position", "rotation"):
            value = getattr(self, name)
            if value is not None and len(value) != 3:
                raise InputError(f"{name} needs three numbers, got {list(value)}")

    @property
    def tool_goal(self) -> ToolGoal:
        """The goal as a ball (m) for the origin of the tool's frame, a rotation matrix, and a largest angle (rad)."""
        rotation = None if self.rotation is None else rotation_matrix(self.rotation)
        return ToolGoal(Ball(self.position, self.radius), rotation, self.angle)


Goal = Shape | GoalPoint | GoalCell | GoalJoints | GoalPose


@checked
@dataclass(frozen=True)
class CostArea:
    """A region with a higher or lower conductivity than the rest of the grid, which streamlines prefer or avoid.

    Attributes
    ----------
    shape : Shape
        Region of configuration space (for points and discs, of the world).
    conductivity : float
        Relative conductivity of the cells whose centre lies in the region, above 0; other cells have 1.

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
