"""What a contact proves (Connolly & Grupen 1992, section 7, figure 19): cells that the conservative rule blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.planning.fields import Field
from resgrid.planning.road import check_blend, require_uniform, scene_wiring, solve_field
from resgrid.robots import Ball, Robot
from resgrid.scene.scene import Scene
from resgrid.space import Axis, ConfigurationSpace
from resgrid.wiring import Wiring

Resolve = Callable[[ConfigurationSpace], Field]
"""From a changed space to its field.  What updates factors in place of solving anew has the same face."""

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


def resolver(
    *,
    k: float | None = None,
    boundary: str = "dirichlet",
    edge: str | Sequence[str] = "obstacle",
    resistance: float = 10e3,
    wall_resistance: float | None = None,
) -> Resolve:
    """How to find the field of a space that has changed: compile it, solve it, blend.

    Parameters
    ----------
    k, boundary, edge, resistance, wall_resistance
        As `resgrid.plan` takes them.

    Returns
    -------
    callable
        From a `ConfigurationSpace` to its `Field`.  In a map without any obstacle, or edge that counts as one, the
        Dirichlet part of a blend is flat; what flows is the share ``1 - k`` of the Neumann part.
    """
    wiring = Wiring(boundary, edge=edge, resistance=resistance, wall_resistance=wall_resistance)
    if k is not None:
        check_blend(k, boundary)
    return partial(solve_field, wiring=wiring, k=k)


def scene_resolver(scene: Scene, k: float | None = None) -> Resolve:
    """How to find the field of a scene's space: as the scene says, or with another blend."""
    require_uniform(scene, "control")
    return partial(solve_field, wiring=scene_wiring(scene), k=scene_share(scene, k))


def scene_share(scene: Scene, k: float | None) -> float | None:
    """The blend that control follows: the one given, or the scene's first."""
    return k if k is not None else next(iter(scene.k), None)
