import numpy as np
import pytest
from support.hidden import hidden_room
from support.spaces import space_of

import resgrid as rg


@pytest.fixture(scope="session")
def space() -> rg.ConfigurationSpace:
    """7 x 5 cells of 0.5 m x 0.25 m: a wall, an enclosed pocket and a goal, without symmetry."""
    cell = np.zeros((7, 5), dtype=np.uint8)
    cell[2, 1:4] = rg.Cell.OBSTACLE
    cell[4:7, 2:5] = rg.Cell.OBSTACLE
    cell[5, 3] = rg.Cell.FREE
    cell[6, 0] = rg.Cell.GOAL
    return rg.ConfigurationSpace([rg.Axis("x", 1.0, 4.5, 7), rg.Axis("y", -1.0, 0.25, 5)], cell)


@pytest.fixture(scope="session")
def field(space: rg.ConfigurationSpace) -> rg.Field:
    return rg.field(rg.solve(rg.compile_space(space)))


@pytest.fixture(scope="session")
def neumann(space: rg.ConfigurationSpace) -> rg.Field:
    return rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))


@pytest.fixture(scope="session")
def cube() -> rg.Field:
    cell = np.zeros((6, 5, 4), dtype=np.uint8)
    cell[3, :, :2], cell[5, 4, 3] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    return rg.field(rg.solve(rg.compile_space(space_of(cell))))


@pytest.fixture(scope="session")
def line() -> rg.Field:
    return rg.field(rg.solve(rg.compile_space(space_of([0, 0, 2, 0, 0, 1, 0, 1]))))


@pytest.fixture(scope="session")
def scene() -> rg.Scene:
    return rg.parse_scene(hidden_room(), "room")


@pytest.fixture(scope="session")
def run(scene: rg.Scene) -> rg.control.Run:
    return rg.simulation(scene).run(scene.starts[0])
