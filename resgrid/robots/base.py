"""`Robot`, the abstract base class of robots: geometry in a configuration, and bounds of its motion.

A new robot is a subclass of `Robot` in a file of its own, with an entry in `resgrid.robots.ROBOTS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from itertools import product
from math import inf, tau
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import with_article
from resgrid.core.axis import Axis, Point
from resgrid.errors import InputError
from resgrid.robots.cells import CellClasses, GoalCells, Progress, Sampling, region_cells
from resgrid.robots.collision_tests import CollisionTest, PlanarTest
from resgrid.robots.geometry import Pose, RigidPart, obstacles_of
from resgrid.robots.shapes import Shape, require_plane

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

BATCH = 4096
"""Number of configurations that one vectorized collision test takes; larger grids are tested in several batches."""

SLACK = 1e-9
"""Safety margin of the distance test of whole cells, as a fraction of the largest motion within a cell.

A cell is free if, at its centre, the distance of the robot from obstacles exceeds the largest motion of a point of the
robot from there to any configuration in the cell, plus this margin, plus the rounding margin `ULPS`.
"""

ULPS = 64
"""Safety margin of the distance test of whole cells against rounding, in units in the last place (ulp) of the largest
absolute coordinate of the grid and the obstacles.
"""


class Robot(ABC):
    """Base class of robots: maps configurations to the workspace, in which the obstacles are shapes.

    A subclass must implement `parts` (geometry in a configuration) and `travel` (bound of the motion).  The defaults of
    all other methods suit free-flying bodies: the first coordinates of a configuration are the position of the
    reference point, and a cell is free if distances to obstacles exceed the motion within the cell.
    `resgrid.simulation` with contacts also needs `pose`.

    Examples
    --------
    >>> import shapely
    >>> from resgrid.robots.base import RigidPart
    >>> class Rod(rg.Robot):
    ...     def parts(self, configurations):
    ...         return [RigidPart(shapely.linestrings([[(x, y), (x + 1, y)] for x, y in configurations]), radius=0.1)]
    ...     def travel(self, start, end):
    ...         return np.linalg.norm(end - start, axis=1)
    >>> axes = (rg.Axis("x", 0.0, 4.0, 8), rg.Axis("y", 0.0, 1.0, 2))
    >>> ball, goal = rg.Ball((2.5, 0.25), 0.1), rg.GoalCell((7, 1))
    >>> rg.build_space(rg.Scene(axes, robot=Rod(), obstacles=(ball,), goals=(goal,))).cell.T
    array([[0, 0, 1, 1, 1, 1, 0, 0],
           [0, 0, 0, 1, 1, 0, 0, 2]], dtype=uint8)
    """

    moves_in_workspace: ClassVar[bool] = False
    """Whether configurations are positions in the workspace, so that periodic axes apply to the workspace too."""

    workspace_ndim: ClassVar[int] = 2
    """Number of coordinates of the workspace: 2 in the plane, 3 in space.  Not used if `moves_in_workspace` is True,
    because the workspace then has as many coordinates as the configuration space."""

    reference: ClassVar[str] = "reference point"
    """Name of the point of the robot whose position a goal prescribes."""

    base: Point | None = None
    """Position (x, y) of the fixed base of an arm, in metres; None if the robot moves freely."""

    turning_length: float | None = None
    """Length in metres that corresponds to a rotation by one radian; the third coordinate of a configuration is the
    heading times this length.  None if the robot does not turn."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints for a motion controller, one per axis; empty for a robot without such names."""
        return ()

    @property
    def fixed_joints(self) -> Mapping[str, float]:
        """Values, in radians or metres, of joints that do not move, by their names for a motion controller."""
        return {}

    @property
    def velocity_limits(self) -> NDArray[np.float64] | None:
        """Largest speeds of the coordinates (ndim,) in axis units per second; None for a robot without own limits.

        A limit is infinite if the robot's description has none for this coordinate.
        """
        return None

    @property
    def acceleration_limits(self) -> NDArray[np.float64] | None:
        """Largest accelerations of the coordinates (ndim,) in axis units per second squared; None without limits."""
        return None

    @property
    def remedy(self) -> str:
        """Advice that error messages append if obstacles leave no free cell; empty for a robot without size."""
        return "make the robot smaller"

    @property
    def reach(self) -> float:
        """Largest distance from the base to the reference point, in metres; infinite for a robot without a base."""
        return inf

    @property
    def extent(self) -> float:
        """Largest distance from the reference point to a point of the robot, in metres; infinite with a base."""
        if self.base is not None:
            return inf
        import shapely

        parts = self.parts(np.zeros((1, 2 if self.turning_length is None else 3)))
        corners = [(shapely.get_coordinates(part.core[0]), part.radius) for part in parts]
        return max((float(np.linalg.norm(at, axis=1).max()) + radius for at, radius in corners), default=0.0)

    @abstractmethod
    def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:
        """Return the rigid parts of the robot, each with a radius and one shapely geometry per configuration.

        Parameters
        ----------
        configurations : ndarray of float64, shape (n, ndim)
            Configurations of the robot.

        Returns
        -------
        list of RigidPart
            Rigid parts whose attribute `core` has shape (n,).

        Raises
        ------
        InputError
            If the workspace of the robot is not the plane.
        """

    @abstractmethod
    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return upper bounds of the distance that any point of the robot moves in straight motions.

        In a straight motion, the configuration moves along a straight line in configuration space.  The bound must
        depend only on ``end - start`` and must be a convex function of this difference.

        Parameters
        ----------
        start, end : ndarray of float64, shape (n, ndim)
            Configurations at the ends of n straight motions.

        Returns
        -------
        ndarray of float64, shape (n,)
            Upper bounds in metres.
        """

    def pose(self, configuration: NDArray[np.float64]) -> Pose:  # noqa: ARG002
        """Return positions and velocities per axis rate of the robot's segments in one `configuration`, shape (ndim,).

        Contact computations need this pose.  The default raises InputError.  A subclass of one rigid body can return
        `Pose.of_body`.
        """
        name = type(self).__name__
        raise InputError(f"{name} has no pose for contacts with obstacles; implement {name}.pose(configuration)")

    def reference_point(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions (n, d) of the reference point, in metres, for configurations (n, ndim).

        The number d is ndim for a robot whose configurations are positions, otherwise 2.
        """
        return configurations if self.moves_in_workspace else configurations[:, :2]

    def heading(self, configurations: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return headings in radians, shape (n,), for configurations (n, ndim); None for a robot that does not turn."""
        return None if self.turning_length is None else configurations[:, 2] / self.turning_length

    def bare(self, *, self_collision: bool = True) -> Robot:  # noqa: ARG002
        """Return the robot without virtual obstacles, and without self-collision if `self_collision` is False.

        A virtual obstacle blocks configurations for a reason other than a collision, such as a singularity of an arm.
        The default returns the robot unchanged.
        """
        return self

    def turning_axis(self, cells: int, name: str = "theta") -> Axis:
        """Return the periodic heading axis of a robot that turns, from 0 to ``2 pi turning_length`` metres.

        `cells`: number of cells; `name`: name of the axis.  Raise InputError for a robot that does not turn.
        """
        if self.turning_length is None:
            raise InputError(f"{with_article(type(self).__name__)} does not turn, because it has no turning_length")
        return Axis(name, 0.0, tau * self.turning_length, cells, periodic=True)

    def implied_axes(self) -> tuple[dict[str, Any], ...]:
        """Return default values of a scene's axis keys (name, lower, upper, periodic, unit), one dict per axis.

        The result is empty if the scene must define all axes.  A robot that turns has the axes x, y and heading.
        """
        if self.turning_length is None:
            return ()
        turn = {key: value for key, value in vars(self.turning_axis(1)).items() if key != "cells"}
        return {"name": "x"}, {"name": "y"}, turn

    def axes_on_map(self, axes: Sequence[Axis], headings: int) -> tuple[Axis, ...]:
        """Return the axes of the configuration space of a robot on a map.

        `axes`: axes x and y of the map; `headings`: number of cells of the heading axis of a robot that turns.
        """
        return tuple(axes) if self.turning_length is None else (*axes, self.turning_axis(headings))

    def check_axes(self, axes: Sequence[Axis]) -> None:
        """Raise InputError unless the axes fit the robot.

        By default, a robot that turns needs the axes ``(x, y, theta)``.  Axes x and y must not be periodic, and a
        periodic theta must span one full turn.
        """
        if self.turning_length is None:
            return
        if len(axes) != 3:
            raise InputError(f"a robot that turns needs 3 axes (x, y, theta), got {len(axes)}")
        for axis in axes[:2]:
            if axis.periodic:
                raise InputError(f"axis {axis.name!r}: x and y of a robot that turns cannot be periodic")
        turn, full = axes[2], tau * self.turning_length
        if turn.periodic and abs(turn.upper - turn.lower - full) > 1e-9 * full:
            raise InputError(
                f"axis {turn.name!r}: a full turn is 2 pi turning_length = {full:.15g}, but the axis spans "
                f"{turn.upper - turn.lower:.15g}; leave lower and upper out, or set periodic = false"
            )

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Return the mask of blocked cells: cells in which the robot may collide with an obstacle.

        By default, with the rule ``"conservative"``, a cell is free if every part at the cell's centre is farther from
        every obstacle than any point of the robot moves within the cell.  With the rule ``"centre"``, a cell is free if
        the robot at the cell's centre touches no obstacle.

        Parameters
        ----------
        axes : sequence of Axis
            Axes of the configuration space.
        obstacles : sequence of Shape
            Shapes in the plane, in metres.
        rule : {"conservative", "centre"}
            ``"conservative"``: a cell is blocked if any configuration in it may collide; ``"centre"``: a cell is
            blocked if the configuration at its centre collides.
        progress : callable, optional
            Called as ``progress(done, total)`` with the finished and the total amount of work, in arbitrary units.

        Returns
        -------
        ndarray of bool, shape of the grid
            True for blocked cells.

        Raises
        ------
        InputError
            If the axes do not fit the robot or an obstacle is not a shape of the plane.
        """
        self.check_axes(axes)
        solid = obstacles_of((require_plane(shape, "this robot") for shape in obstacles), self.workspace_axes(axes))
        reach = 0.0
        if rule == "conservative":
            corners = np.array(list(product(*([0.0, axis.spacing / 2] for axis in axes))))
            extent = max(abs(end) for axis in axes for end in (axis.lower, axis.upper))
            rounding = ULPS * float(np.spacing(max([extent, *(obstacle.extent for obstacle in solid)])))
            reach = float(self.travel(np.zeros_like(corners), corners).max()) * (1.0 + SLACK) + rounding
        shape = tuple(axis.cells for axis in axes)
        blocked = np.zeros(int(np.prod(shape)), dtype=np.bool_)
        for first in range(0, blocked.size, BATCH):
            cells = np.unravel_index(np.arange(first, min(first + BATCH, blocked.size)), shape)
            middle = np.column_stack([axis.centres[index] for axis, index in zip(axes, cells, strict=True)])
            for part in self.parts(middle):
                for obstacle in solid:
                    blocked[first : first + BATCH] |= obstacle.distance(part) <= reach
            if progress is not None:
                progress(first + len(middle), blocked.size)
        return blocked.reshape(shape)

    def classify(
        self,
        axes: Sequence[Axis],
        obstacles: Sequence[Shape],
        rule: Sampling,
        progress: Progress | None = None,
        executor: Executor | None = None,  # noqa: ARG002
    ) -> CellClasses:
        """Return the blocked cells, and which of them are undecided: neither free nor in collision by any proof.

        By default the blocked cells are those of `occupancy`, and `CellClasses.undecided` is None (not distinguished).
        `axes`: axes of the configuration space; `obstacles`: shapes in the workspace, in metres; `rule`: whether the
        whole cell (``"conservative"``) or only its centre (``"centre"``) is tested; `progress`: called as
        ``progress(done, total)``; `executor`: executor that shares the work, for robots that can use one; None for the
        calling process alone.
        """
        return CellClasses(self.occupancy(axes, obstacles, rule, progress))

    def collision_test(self, axes: Sequence[Axis], obstacles: Sequence[Shape]) -> CollisionTest:
        """Return a test of the robot among obstacles at single configurations, with exact geometry.

        By default, robot and obstacles must be shapes of the plane.  `axes`: axes of the configuration space;
        `obstacles`: shapes in workspace coordinates, in metres.
        """
        solids = obstacles_of(obstacles, self.workspace_axes(axes))
        return PlanarTest(lambda configurations: self.parts(self.within_seams(axes, configurations)), solids)

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Return the goal cells of a grid with the given `axes`, with one configuration per cell that solves the goal.

        A `region` (shape or point) with as many coordinates as axes is a set of configurations.  With two coordinates a
        region is a set of positions of the reference point, in metres; the other coordinates of the configurations are
        those of cell centres.
        """
        self.check_axes(axes)
        count = len(region) if isinstance(region, tuple) else region.ndim
        if self.moves_in_workspace or count == len(axes):
            return region_cells(axes, region)
        cells, places = region_cells(axes[:2], region)
        rest = np.array(list(product(*(axis.centres for axis in axes[2:]))))
        points = np.column_stack([np.repeat(places, len(rest), axis=0), np.tile(rest, (len(places), 1))])
        shape = tuple(axis.cells for axis in axes)
        return GoalCells(np.repeat(cells.ravel(), len(rest)).reshape(shape), points)

    def shapes_at(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """Return one shapely geometry in the workspace per rigid part, in metres, for a `configuration` (ndim,).

        Round ends are approximated from inside by 32 edges per half-circle.
        """
        parts = self.parts(np.asarray(configuration, dtype=np.float64).reshape(1, -1))
        return [part.core[0].buffer(part.radius, quad_segs=16) if part.radius else part.core[0] for part in parts]

    def workspace_axes(self, axes: Sequence[Axis]) -> Sequence[Axis]:
        """Return the axes along which obstacles can repeat periodically, given the axes of the configuration space.

        These are all axes if the configuration space is also the workspace and a plane, otherwise none.
        """
        return axes if self.moves_in_workspace and len(axes) == 2 else ()

    def within_seams(self, axes: Sequence[Axis], configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return configurations (..., ndim), wrapped into the axis range along periodic axes of the workspace.

        `axes`: axes of the configuration space.  Configurations of a robot whose configuration space is not the
        workspace are returned unchanged.
        """
        if not (self.moves_in_workspace and any(axis.periodic for axis in axes)):
            return configurations
        lower, upper, ring = np.array([(axis.lower, axis.upper, axis.periodic) for axis in axes]).T
        folded = lower + np.mod(configurations - lower, upper - lower)
        return np.asarray(np.where(ring.astype(bool), folded, configurations))
