"""How a run begins: the start, the grid at time 0, and what the map alone decides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.control.log import Ending
from resgrid.errors import InputError
from resgrid.planning.trace import one_start
from resgrid.space import Cell, ConfigurationSpace

if TYPE_CHECKING:
    from resgrid.control.settling import LiveGrid
    from resgrid.control.simulation import Simulation

Vector = NDArray[np.float64]


def live_grid(simulation: Simulation) -> LiveGrid | None:
    """The grid at time 0, already on the rails of the map as it is now."""
    if simulation.settling is None:
        return None
    from resgrid.control.settling import LiveGrid, check_same_grid

    before = simulation.before if simulation.before is not None else simulation.space
    check_same_grid(before, simulation.space)
    grid = LiveGrid(simulation.settling, before)
    if before is not simulation.space:
        grid.change(simulation.space)
    return grid


def checked_start(simulation: Simulation, start: ArrayLike) -> Vector:
    """A start that is a configuration of the grid, and not inside an obstacle; to touch one is not to be inside."""
    point = one_start(simulation.space, start, None)
    if simulation.plant.axis_penetration(point[np.newaxis])[0] > 0:
        inside = next(
            number
            for number in range(len(simulation.plant.obstacles))
            if simulation.plant.only(number).axis_penetration(point[np.newaxis])[0] > 0
        )
        raise InputError(
            f"the start {simulation.space.to_world(point).tolist()} puts the robot inside "
            f"{simulation.plant.name_of(inside)}: move the start"
        )
    return point


def static_ending(space: ConfigurationSpace, start: Vector) -> tuple[Ending, str] | None:
    """What the map alone decides, where belief is exact."""
    cell = tuple(space.split(start)[0].tolist())
    if space.cell[cell] == Cell.OBSTACLE:
        return Ending.START_BLOCKED, f"the start's cell {cell} is an obstacle in the map"
    if space.cell[cell] == Cell.FREE and not space.goal_connected[cell]:
        if not space.goal_connected.any():
            return Ending.GOAL_BLOCKED, "in the map no free cell has a path to a goal"
        return Ending.NO_PATH, f"in the map the start's cell {cell} has no path to a goal"
    return None
