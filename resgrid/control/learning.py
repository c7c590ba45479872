"""What a contact proves (Connolly & Grupen 1992, section 7, figure 19): cells that the conservative rule blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import CircuitError, InputError
from resgrid.planning.field import Field
from resgrid.robots import Ball, Robot
from resgrid.scene.scene import Scene
from resgrid.space import Axis, ConfigurationSpace

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
    from resgrid.planning.planner import plan

    options: dict[str, Any] = {"boundary": boundary, "edge": edge, "resistance": resistance}
    if boundary == "wall":
        options["wall_resistance"] = wall_resistance

    def resolve(space: ConfigurationSpace) -> Field:
        try:
            return plan(space, k=k, **options).field
        except CircuitError:
            if k is None or k == 1.0:
                raise
            neumann = plan(space, boundary="neumann", edge=edge, resistance=resistance).field
            return neumann if k == 0.0 else _beside_flat(neumann, k)

    return resolve


def _beside_flat(neumann: Field, k: float) -> Field:
    """``k phi_D + (1 - k) phi_N`` where ``phi_D`` is 0 in every free cell."""
    currents = tuple(current + np.log1p(-k) for current in neumann.face_log_current)
    return replace(neumann, potential=(1.0 - k) * neumann.potential, face_log_current=currents, boundary="blend", k=k)


def scene_resolver(scene: Scene, k: float | None = None) -> Resolve:
    """How to find the field of a scene's space: as the scene says, or with another blend."""
    return resolver(**scene_rules(scene, k))


def scene_rules(scene: Scene, k: float | None = None) -> dict[str, Any]:
    """What `resolver` needs to know of a scene; arguments and errors as `scene_resolver`."""
    share = k if k is not None else (scene.k[0] if scene.k else None)
    if scene.boundary == "neumann" and scene.drive == "start":
        raise InputError("a scene with drive = 'start' serves one start at a time; control needs drive = 'uniform'")
    rule = "dirichlet" if share is not None and scene.boundary == "neumann" else scene.boundary
    return {
        "k": share,
        "boundary": rule,
        "edge": scene.edge,
        "resistance": scene.chip.resistance,
        "wall_resistance": scene.chip.wall_resistance,
    }
