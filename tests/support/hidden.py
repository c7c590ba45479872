"""Small set-ups for the tests of control."""

from __future__ import annotations

import numpy as np

from resgrid.control.controller import make_controller
from resgrid.control.learning import resolver
from resgrid.control.plant import make_plant
from resgrid.control.simulation import Simulation
from resgrid.robots import DiscRobot, Robot, Shape
from resgrid.space import Axis, Cell, ConfigurationSpace


def square(cells: int = 16, size: float = 8.0, goal: tuple[int, int] = (8, 1)) -> ConfigurationSpace:
    """An empty square with one goal cell."""
    cell = np.zeros((cells, cells), dtype=np.uint8)
    cell[goal] = Cell.GOAL
    return ConfigurationSpace([Axis("x", 0, size, cells), Axis("y", 0, size, cells)], cell)


def hiding(hidden: list[Shape], *, robot: Robot | None = None, k: float = 0.98, **options: object) -> Simulation:
    """A disc in that square, with obstacles that its map does not show."""
    space, resolve = square(), resolver(k=k)
    response = str(options.pop("response", "equipotential"))
    plant = make_plant(robot or DiscRobot(0.2), space.axes, [], hidden)
    return Simulation(make_controller(resolve(space), response=response), plant, resolve, **options)  # type: ignore[arg-type]
