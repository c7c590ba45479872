"""What a contact proves (Connolly & Grupen 1992, section 7, figure 19): cells that the conservative rule blocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.planning.fields import Field
from resgrid.planning.road import solve_field
from resgrid.robots import Ball, Robot
from resgrid.space import Axis, ConfigurationSpace

INSIDE = 1e-6
"""How far behind a touched surface the obstacle is taken to reach at least, in cells (of motion)."""


def proven_cells(
    robot: Robot, axes: Sequence[Axis], point: ArrayLike, itself: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Cells that the conservative rule blocks for one point of the workspace.

    Among them are all cells that hold a configuration in which the robot meets the point; of an arm or a turning
    polygon also some whose nearest configuration passes it at a fraction of a cell's motion: the rule is a bound.  If
    the point belongs to an obstacle, each of them is an obstacle cell by that rule, which blocks every cell for a set
    of points that it blocks for one of them.  Nothing else is claimed about the obstacle.

    Shapes: `point` (2,).
    """
    place = tuple(np.asarray(point, dtype=np.float64).tolist())
    met = robot.occupancy(axes, [Ball(place, 0.0)], "conservative")
    return met & ~(robot.occupancy(axes, [], "conservative") if itself is None else itself)


def solve_again(field: Field, space: ConfigurationSpace) -> Field:
    """The field of a changed space, wired and blended as another was.

    In a map without any obstacle, or edge that counts as one, the Dirichlet part of a blend is flat; what flows is the
    share ``1 - k`` of the Neumann part.
    """
    return solve_field(space, field.wiring, field.k if field.boundary == "blend" else None)
