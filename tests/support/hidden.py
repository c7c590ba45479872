"""Small worlds for the tests of control."""

from __future__ import annotations

from typing import Any

import numpy as np

import resgrid as rg
from resgrid.control.plant import make_plant
from resgrid.planning.pipeline import solve_field
from resgrid.robots import Shape


def square(cells: int = 16, size: float = 8.0, goal: tuple[int, int] = (8, 1)) -> rg.ConfigurationSpace:
    """Return an empty square with one goal cell."""
    cell = np.zeros((cells, cells), dtype=np.uint8)
    cell[goal] = rg.Cell.GOAL
    return rg.ConfigurationSpace([rg.Axis("x", 0, size, cells), rg.Axis("y", 0, size, cells)], cell)


def controlled(space: rg.ConfigurationSpace, k: float = 0.98, **options: Any) -> rg.control.Controller:
    """Return the controller of a blend on a space."""
    return rg.control.make_controller(solve_field(space, rg.Wiring(), k), **options)


def hiding(
    hidden: list[Shape], *, robot: rg.Robot | None = None, k: float = 0.98, **options: object
) -> rg.control.Simulation:
    """Return a simulation of a disc in the square, with obstacles that are not on its map."""
    space = square()
    response = str(options.pop("response", "equipotential"))
    plant = make_plant(robot or rg.DiscRobot(0.2), space.axes, [], hidden)
    return rg.control.Simulation(controlled(space, k, response=response), plant, **options)  # type: ignore[arg-type]


def hidden_room(*, k: str = "[0.98]", radius: float = 0.0, left: float = 2.5, right: float = 6.2) -> str:
    """Return the text of a scene: a robot above a wall that is not on its map, and a goal below."""
    return f"""schema = 1
title = "Room"
starts = [[4.2, 7.2]]
k = {k}
[robot]
type = "point"
radius = {radius}
[grid]
axes = [{{ name = "x", lower = 0, upper = 8, cells = 16 }}, {{ name = "y", lower = 0, upper = 8, cells = 16 }}]
[[goal]]
point = [4.2, 0.7]
[[hidden]]
shape = "rectangle"
lower = [{left}, 3.0]
upper = [{right}, 4.0]
"""
