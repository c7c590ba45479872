import numpy as np
import pytest

import resgrid as rg
from resgrid.compiler import compile_space
from resgrid.nodal.solve import solve
from resgrid.planning.fields import Field
from resgrid.space import Axis, Cell, ConfigurationSpace


@pytest.fixture(scope="session")
def space() -> ConfigurationSpace:
    """7 x 5 cells of 0.5 m x 0.25 m: a wall, a walled-in pocket, a goal; nothing symmetric."""
    cell = np.zeros((7, 5), dtype=np.uint8)
    cell[2, 1:4] = Cell.OBSTACLE
    cell[4:7, 2:5] = Cell.OBSTACLE
    cell[5, 3] = Cell.FREE
    cell[6, 0] = Cell.GOAL
    return ConfigurationSpace([Axis("x", 1.0, 4.5, 7), Axis("y", -1.0, 0.25, 5)], cell)


@pytest.fixture(scope="session")
def field(space: ConfigurationSpace) -> Field:
    return rg.field(solve(compile_space(space)))


@pytest.fixture(scope="session")
def neumann(space: ConfigurationSpace) -> Field:
    return rg.field(solve(compile_space(space, boundary="neumann")))
