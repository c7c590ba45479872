"""Points, balls and discs: robots without orientation, whose configuration space is the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from resgrid._internal.validation import checked
from resgrid.core.axis import LARGEST, Axis
from resgrid.errors import InputError
from resgrid.robots.base import Robot
from resgrid.robots.cells import Progress, Sampling, mark
from resgrid.robots.geometry import Pose, RigidPart
from resgrid.robots.shapes import Shape


@checked
@dataclass(frozen=True)
class PointRobot(Robot):
    """A point robot, or a ball around its reference point, in one to four dimensions.

    Obstacles are dilated by the radius: a ball of radius ``r`` touches an obstacle if and only if the distance of its
    centre from the obstacle is at most ``r`` (Lozano-Perez, IEEE Trans. Computers C-32 (1983) 108).

    Parameters
    ----------
    radius : float
        Radius in axis units, at least 0.

    Raises
    ------
    InputError
        If the radius is negative, not finite or above 1e60.

    Examples
    --------
    >>> axes = tuple(rg.Axis(name, 0.0, 4.0, 4) for name in "xyz")
    >>> ball, goal = rg.Ball((2.0, 2.0, 2.0), 0.5), rg.GoalCell((0, 0, 0))
    >>> space = rg.build_space(rg.Scene(axes, robot=rg.PointRobot(0.2), obstacles=(ball,), goals=(goal,)))
    >>> space
    <ConfigurationSpace of 4 x 4 x 4 cells, x 0 to 4 m, y 0 to 4 m, z 0 to 4 m: 8 obstacle, 1 goal>
    """

    moves_in_workspace = True

    radius: Annotated[float, Ge(0), Le(LARGEST)] = 0.0

    @property
    def remedy(self) -> str:
        """Advice that error messages append if obstacles leave no free cell; empty for radius 0."""
        return "make the robot's radius smaller" if self.radius else ""

    @property
    def extent(self) -> float:
        """The radius of the robot, in axis units."""
        return self.radius

    @property
    def shrunk(self) -> PointRobot:
        """Copy of the robot with a thousandth of the radius.

        An error message uses the copy to find out whether a smaller radius would leave free cells.
        """
        return PointRobot(self.radius / 1000)

    def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:
        """Return one rigid part: points at the configurations, shape (n, 2), with the robot's radius."""
        import shapely

        if configurations.shape[1] != 2:
            raise InputError(
                f"geometry of robots exists in the plane only: give 2 coordinates, not {configurations.shape[1]}"
            )
        return [RigidPart(np.asarray(shapely.points(configurations)), self.radius)]

    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (n,), in axis units, between configurations `start` and `end`, both (n, ndim)."""
        return np.asarray(np.linalg.norm(end - start, axis=1))

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        """Return the pose of a disc at a configuration, shape (2,): a segment of length 0 with the robot's radius."""
        if configuration.shape != (2,):
            raise InputError(f"contacts are computed in the plane only: give 2 axes, not {len(configuration)}")
        return Pose.of_body(np.array([[*configuration, *configuration]]), self.radius, configuration)

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Return the mask, shape of the grid, of cells that meet an obstacle dilated by the robot's radius.

        With the rule ``"conservative"``, a cell is blocked if its interior meets a dilated obstacle, so that every
        point of a free cell is free.  An obstacle that ends on a cell's border does not block that cell.  With the rule
        ``"centre"``, a cell is blocked if its centre lies in a dilated obstacle.  The interior excludes a rim of at
        least 1e-9 of the cell width, so that rounding does not move an obstacle's edge across a border between cells.
        `axes`: axes of the grid; `obstacles`: shapes in axis units; `progress`: called as ``progress(done, total)``
        after every obstacle, with numbers of obstacles.
        """
        self.check_axes(axes)
        blocked = np.zeros(tuple(axis.cells for axis in axes), dtype=bool)
        for number, shape in enumerate(obstacles, 1):
            mark(blocked, tuple(axes), shape, self.radius, rule)
            if progress is not None:
                progress(number, len(obstacles))
        return blocked


@checked
@dataclass(frozen=True)
class DiscRobot(PointRobot):
    """A disc around its reference point in the plane; its configuration space is this plane.

    Parameters
    ----------
    radius : float
        Radius in axis units, above 0.

    Raises
    ------
    InputError
        If the radius is not above 0 and finite.

    Examples
    --------
    >>> axes = (rg.Axis("x", 0.0, 5.0, 5), rg.Axis("y", 0.0, 4.0, 4))
    >>> pillar, goal = rg.Box((2.1, 1.1), (2.9, 1.9)), rg.GoalCell((0, 0))
    >>> scene = rg.Scene(axes, robot=rg.DiscRobot(0.5), obstacles=(pillar,), goals=(goal,))
    >>> rg.build_space(scene).cell
    array([[2, 0, 0, 0],
           [1, 1, 1, 0],
           [1, 1, 1, 0],
           [1, 1, 1, 0],
           [0, 0, 0, 0]], dtype=uint8)
    """

    radius: Annotated[float, Gt(0), Le(LARGEST)] = field()  # required, in contrast to the radius of a point robot

    def check_axes(self, axes: Sequence[Axis]) -> None:
        """Raise InputError unless the configuration space has two axes."""
        if len(axes) != 2:
            raise InputError(f"a disc moves in the plane and needs 2 axes, got {len(axes)}; a point has any number")
