"""What a robot is: a new one is a subclass of `Robot` in a file of its own, and a line in `resgrid.robots.ROBOTS`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product
from math import inf, tau
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import with_article
from resgrid.core.axis import Axis, Point
from resgrid.errors import InputError
from resgrid.robots.cells import GoalCells, Progress, Sampling, cells_of_place
from resgrid.robots.geometry import Pose, RigidPart, obstacles_of
from resgrid.robots.shapes import Shape, require_plane

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

BATCH = 4096
"""Configurations looked at in one go."""

SLACK = 1e-9
"""Share of the farthest motion by which the conservative rule errs on the side of collision, ..."""

ULPS = 64
"""... and units in the last place of the coordinates."""


class Robot(ABC):
    """A robot seen from its configuration space; the obstacles are shapes of its workspace.

    A robot must say where its parts are (`parts`) and how far they move (`travel`).  The rest has a default, right for
    bodies that move freely, with the place of their reference point as first coordinates: free cells follow from
    distances and travel.  What touches obstacles under `resgrid.simulation` needs a `pose` as well.

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
    """Whether its configurations are places of the workspace, so that what is periodic in one is in the other."""

    reference: ClassVar[str] = "reference point"
    """What of it goals speak of."""

    base: Point | None = None
    """Where it is mounted; None if it moves freely."""

    turning_length: float | None = None
    """What a heading of one radian counts as, as the third coordinate of a configuration; None if it does not turn."""

    @property
    def remedy(self) -> str:
        """What to do where it does not fit; empty for a robot without size."""
        return "make the robot smaller"

    @property
    def reach(self) -> float:
        """Largest distance of its reference point from the base."""
        return inf

    @abstractmethod
    def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:
        """Its rigid parts: shapely geometries, one for each of the configurations, shape (n, ndim), with a radius.

        Raises `InputError` if its workspace is not the plane.
        """

    @abstractmethod
    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bound of how far any point of it moves on straight lines in configuration space, shape (n,).

        Only the difference of `start` and `end`, shapes (n, ndim), matters, and the bound is a convex function of it.
        """

    def pose(self, configuration: NDArray[np.float64]) -> Pose:  # noqa: ARG002
        """How it lies in the plane in a configuration, shape (ndim,), and how its points move, for contacts.

        `Pose.of_body` makes the pose of one rigid body.
        """
        name = type(self).__name__
        raise InputError(f"how a {name} touches obstacles is not known; give {name} a method pose(configuration)")

    def reference_point(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where its reference point (an arm's tip) is. Shapes: (n, ndim); returns (n, d)."""
        return configurations if self.moves_in_workspace else configurations[:, :2]

    def heading(self, configurations: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Direction that it looks in, in radians, shape (n,); None if it has none."""
        return None if self.turning_length is None else configurations[:, 2] / self.turning_length

    def bare(self, *, self_collision: bool = True) -> Robot:  # noqa: ARG002
        """The robot without virtual obstacles, and if so asked without collisions with itself."""
        return self

    def turning_axis(self, cells: int, name: str = "theta") -> Axis:
        """The third axis of a robot that turns: a full turn from 0 to ``2 pi turning_length``, periodic."""
        if self.turning_length is None:
            raise InputError(f"{with_article(type(self).__name__)} does not turn, for it has no turning_length")
        return Axis(name, 0.0, tau * self.turning_length, cells, periodic=True)

    def implied_axes(self) -> tuple[dict[str, Any], ...]:
        """What it knows of its axes before a scene says anything: keys of each, in order; of turning, a full turn."""
        if self.turning_length is None:
            return ()
        turn = {key: value for key, value in vars(self.turning_axis(1)).items() if key != "cells"}
        return {"name": "x"}, {"name": "y"}, turn

    def axes_on_map(self, axes: Sequence[Axis], headings: int) -> tuple[Axis, ...]:
        """Axes of its configuration space on a map of the plane; a robot that turns has as many headings."""
        return tuple(axes) if self.turning_length is None else (*axes, self.turning_axis(headings))

    def check_axes(self, axes: Sequence[Axis]) -> None:
        """Refuse axes that are not this robot's with an `InputError`.

        By default a robot that turns has ``(x, y, theta)``, x and y not periodic, and a periodic theta is a full turn.
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
        """Cells in which the robot would touch an obstacle, True where blocked.

        By default a cell is free if at its centre every part is farther from every obstacle than any point of the robot
        moves within the cell; with the rule ``"centre"`` instead of ``"conservative"``, if nothing is touched there.
        `progress` is called as ``progress(done, total)``.
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

    def goal_cells(self, axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
        """Cells that hold a configuration which solves a goal, and such a configuration for each.

        A region, or a point, with as many coordinates as there are axes is one of configurations; with two coordinates
        one of places for the reference point, reached with the other coordinates at the centre of their cells.
        """
        self.check_axes(axes)
        count = len(region) if isinstance(region, tuple) else region.ndim
        if self.moves_in_workspace or count == len(axes):
            return cells_of_place(axes, region)
        cells, places = cells_of_place(axes[:2], region)
        rest = np.array(list(product(*(axis.centres for axis in axes[2:]))))
        points = np.column_stack([np.repeat(places, len(rest), axis=0), np.tile(rest, (len(places), 1))])
        shape = tuple(axis.cells for axis in axes)
        return GoalCells(np.repeat(cells.ravel(), len(rest)).reshape(shape), points)

    def shapes_at(self, configuration: ArrayLike) -> list[BaseGeometry]:
        """The robot in the workspace: shapely geometry of each rigid part in a configuration, shape (ndim,).

        Round ends are polygons of 32 edges a half-circle, inside the circle.
        """
        parts = self.parts(np.asarray(configuration, dtype=np.float64).reshape(1, -1))
        return [part.core[0].buffer(part.radius, quad_segs=16) if part.radius else part.core[0] for part in parts]

    def workspace_axes(self, axes: Sequence[Axis]) -> Sequence[Axis]:
        """The axes, if they are those of a plane workspace: obstacles then have copies across their seams."""
        return axes if self.moves_in_workspace and len(axes) == 2 else ()

    def within_seams(self, axes: Sequence[Axis], configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Configurations, shape (..., ndim), brought back into periodic axes of the workspace."""
        if not (self.moves_in_workspace and any(axis.periodic for axis in axes)):
            return configurations
        lower, upper, ring = np.array([(axis.lower, axis.upper, axis.periodic) for axis in axes]).T
        folded = lower + np.mod(configurations - lower, upper - lower)
        return np.asarray(np.where(ring.astype(bool), folded, configurations))
