"""Reasons of paths that end where no current flows: the true cause, and a remedy that works.

Tests internals: `resgrid.chip.effects.spread`.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.chip.effects.spread import Faults


def symmetric_room() -> rg.ConfigurationSpace:
    """Return a room that is symmetric about its diagonal, with an obstacle in the middle and a goal in a corner."""
    cell = np.zeros((7, 7), dtype=np.uint8)
    cell[3, 3], cell[6, 6] = 1, 2
    return space_of(cell)


def place_in(reason: str) -> tuple[float, ...]:
    """Return the coordinates of the place with a current that a reason names."""
    found = re.search(r"with a current is \((.*?)\), cell \(", reason)
    assert found is not None, reason
    return tuple(map(float, found[1].split(", ")))


@pytest.mark.parametrize("options", [{}, {"boundary": "wall", "wall_resistance": 1e4}], ids=str)
def test_equal_potentials_by_symmetry_are_named_and_the_remedies_work(options: dict) -> None:
    """The corner has no current, although obstacles drive the room."""
    planner = rg.plan(symmetric_room(), edge="open", **options)
    path = planner.path(cell=(0, 0))
    assert path.outcome is rg.Outcome.NO_CURRENT
    rg.certify(path)
    reason = str(path.reason)
    assert "no current flows in cell (0, 0)" in reason
    assert "same potential" in reason
    assert "no obstacle" not in reason
    assert planner.path(place_in(reason)).outcome is rg.Outcome.REACHED
    assert rg.plan(symmetric_room(), boundary="neumann").path(cell=(0, 0)).outcome is rg.Outcome.REACHED


@pytest.mark.parametrize("lattice", ["square", "square8"])
@pytest.mark.parametrize("edge", ["open", "periodic"])
def test_cells_that_touch_no_obstacle_name_the_missing_rail(edge: str, lattice: str) -> None:
    """The room behind the goal touches no obstacle; the edge is a remedy only where it is open."""
    cell = np.zeros((8, 3), dtype=np.uint8)
    cell[0], cell[3], cell[7] = (1, 2, 2) if edge == "periodic" else (1, 2, 0)
    space = rg.ConfigurationSpace(
        [rg.Axis("x", 0.0, 8.0, 8), rg.Axis("y", 0.0, 3.0, 3, periodic=edge == "periodic")], cell
    )
    rules = ("open", edge) if edge == "periodic" else "open"
    planner = rg.plan(space, edge=rules, lattice=lattice)
    path = planner.path(cell=(5, 1))
    assert path.outcome is rg.Outcome.NO_CURRENT
    reason = str(path.reason)
    assert "connected to a goal but to no obstacle" in reason
    assert ("edge = 'obstacle'" in reason) == (edge == "open")
    assert planner.path(place_in(reason)).outcome is rg.Outcome.REACHED
    assert rg.plan(space, edge=rules, boundary="neumann", lattice=lattice).path(cell=(5, 1)).outcome == "reached"


def test_cells_off_the_route_of_a_driven_start_name_it() -> None:
    space = space_of(np.array([[2, 0, 0, 0, 0], [1, 1, 1, 1, 1]]))
    path = rg.streamline(
        rg.field(rg.solve(rg.compile_space(space, boundary="neumann", drive="start", start=(0, 2)))), cell=(0, 4)
    )
    reason = str(path.reason)
    assert "driven start cell (0, 2)" in reason and "drive = 'uniform'" in reason
    assert place_in(reason) == (0.5, 2.5)


def test_missing_resistors_are_named() -> None:
    netlist = Faults(open_density=0.55, seed=2).apply(rg.compile_space(symmetric_room(), boundary="neumann"))
    field = rg.field(rg.solve(netlist))
    paths = [rg.streamline(field, cell=cell) for cell in np.argwhere(symmetric_room().cell == 0)]
    reasons = [str(path.reason) for path in paths if path.outcome is rg.Outcome.NO_CURRENT]
    assert reasons
    assert all("resistors of the circuit are missing" in reason for reason in reasons)
