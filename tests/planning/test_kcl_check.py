"""Direction-safe cells of fields with normwise accuracy, compared with entrywise solutions; all paths certify.

Tests internals: `resgrid.planning.fields`.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.planning.fields import read_cells


def meander() -> rg.ConfigurationSpace:
    """Corridors one cell wide, whose drop falls far below a normwise tolerance."""
    cell = np.zeros((30, 30), dtype=np.uint8)
    cell[1::2, :] = rg.Cell.OBSTACLE
    cell[1::4, 0] = cell[3::4, -1] = rg.Cell.FREE
    cell[0, 29] = rg.Cell.GOAL
    return space_of(cell)


def room(seed: int) -> rg.ConfigurationSpace:
    cell = (np.random.default_rng(seed).random((24, 20)) < 0.2).astype(np.uint8)
    cell[11:14, 9:12] = rg.Cell.FREE
    cell[12, 10] = rg.Cell.GOAL
    return space_of(cell, periodic=(seed % 2 == 1, False))


def read_warm(space: rg.ConfigurationSpace, **options: object) -> rg.Field:
    return rg.field(rg.circuit.WarmStart(**options).solve(space))


def read_normwise(space: rg.ConfigurationSpace, **options: object) -> rg.Field:
    return rg.field(rg.solve(rg.compile_space(space, **options), accuracy="normwise", rtol=1e-8))


WIRINGS = (
    {"boundary": "dirichlet"},
    {"boundary": "dirichlet", "edge": "open", "supply": -3.0, "goal_voltage": 1.0},
    {"boundary": "neumann", "supply": -2.0},
    {"boundary": "wall", "wall_resistance": 3e5},
)


@pytest.mark.parametrize("read", [read_warm, read_normwise])
@pytest.mark.parametrize("wiring", WIRINGS)
@pytest.mark.quick_cases(3)
def test_streamlines_certify_or_end_in_cells_that_are_not_direction_safe(read, wiring) -> None:
    for space in (meander(), room(0), room(1)):
        field = read(space, **wiring)
        assert field.safe is not None and not field.safe[space.cell != rg.Cell.FREE].any()
        right = rg.field(rg.solve(rg.compile_space(space, **wiring)))
        reached = 0
        for cell in np.argwhere(space.cell == rg.Cell.FREE)[::7].tolist():
            path, exact = rg.streamline(field, cell=cell), rg.streamline(right, cell=cell)
            rg.certify(path)
            if path.outcome == "reached":
                assert exact.outcome == "reached"
                reached += 1
            elif exact.outcome == "reached":
                assert "not direction-safe" in str(path.reason)
        assert reached or space.shape == (30, 30)


def test_cells_below_the_normwise_tolerance_are_not_direction_safe() -> None:
    """The drop at the far end is far below 1e-16."""
    for read in (read_warm, read_normwise):
        safe = read(meander(), boundary="dirichlet").safe
        assert safe is not None and safe[0, 28] and not safe[28, 15]
    assert rg.field(rg.solve(rg.compile_space(meander()))).safe is None


def test_a_voltage_beyond_the_obstacle_rail_is_not_direction_safe() -> None:
    """Current would flow from the last free cell into the obstacle, though Kirchhoff's law holds there."""
    space = space_of(np.array([2, 0, 0, 0, 1], dtype=np.uint8))
    for last, safe in ((1.2, False), (0.8, True)):
        field = read_cells(space, rg.Wiring(), np.array([0.0, 0.1, 2 * last - 1, last, np.nan]))
        assert field.safe is not None and field.safe[3] == safe
