"""Learning from contacts: proven cells against the true occupancy, and solving again with the learnt map.

Tests internals: `resgrid.control.plant`, `resgrid.control.state_estimate`, `resgrid.planning.pipeline`.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from support.hidden import controlled, square
from support.robots import BAR

import resgrid as rg
from resgrid.control.plant import INSIDE, make_plant
from resgrid.control.state_estimate import LiveMap, solve_again
from resgrid.planning.pipeline import solve_field

TURNING = (rg.Axis("x", -2, 2, 12), rg.Axis("y", -2, 2, 12), BAR.turning_axis(12))
ARM = rg.Arm((1.0, 0.8), widths=(0.06, 0.0), self_collision=True, singularity_cells=1)
PLANE = (rg.Axis("x", -2, 2, 17), rg.Axis("y", -2, 2, 17))
ROBOTS: list[tuple[rg.Robot, tuple[rg.Axis, ...]]] = [
    (rg.DiscRobot(0.2), PLANE), (BAR, TURNING), (ARM, ARM.axes(30)),
    (rg.Arm((0.9, 0.9), angles="absolute"), ARM.axes(30)),
]  # fmt: skip
SOLIDS = [
    rg.Box((0.3, 0.2), (0.9, 0.8)),
    rg.Ball((-0.6, 0.5), 0.3),
    rg.Polygon(((0.0, -0.4), (0.6, -0.9), (-0.4, -1.0))),
]


@pytest.mark.slow
@settings(max_examples=60)
@given(st.sampled_from(ROBOTS), st.integers(0, 2**32 - 1))
@example(ROBOTS[1], 5608)  # the bisection ends inside the ball by a rounding error
def test_a_contact_proves_its_own_cell_and_no_free_cell(case, seed: int) -> None:
    """The robot approaches a solid by bisection; the true occupancy contains every proven cell."""
    robot, axes = case
    rng = np.random.default_rng(seed)
    plant = make_plant(robot, axes, [], SOLIDS)
    ends = np.array([[rng.uniform(axis.lower, axis.upper) for axis in axes] for _ in range(2)])
    way = ends[0] + np.linspace(0, 1, 400)[:, None] * (ends[1] - ends[0])
    inside = plant.penetration(way) > 0
    if inside[0] or not inside.any() or len(plant.near(plant.pose(way[0]), 1e-6)):
        return
    first = int(np.argmax(inside))
    low, high = way[first - 1], way[first]
    for _ in range(40):
        middle = (low + high) / 2
        touching = plant.penetration(middle)[0] > 0 or len(plant.near(plant.pose(middle), 1e-7))
        low, high = (low, middle) if touching else (middle, high)
    pairs = plant.near(plant.pose(low), 1e-3)
    near = pairs[np.argmin(pairs["gap"])]
    proven = plant.proven_cells(near["point"] + INSIDE * plant.cell_motion * near["inward"])
    space = rg.ConfigurationSpace(axes, np.zeros(tuple(axis.cells for axis in axes), np.uint8))
    itself = robot.occupancy(axes, [], "conservative")
    true = robot.occupancy(axes, SOLIDS, "conservative")
    assert not np.any(proven & ~true)
    cells = space.locate([low, high])
    assert itself[tuple(cells[0])] or itself[tuple(cells[1])] or proven[tuple(cells.T)].any()
    assert not np.any(proven & itself)


def test_marking_cells_adds_exactly_these_obstacles_to_the_map() -> None:
    space = square()
    cells = np.zeros(space.shape, bool)
    cells[3:5, 2], cells[8, 1] = True, True
    live = LiveMap(controlled(space))
    live.mark(cells)
    np.testing.assert_array_equal(live.space.cell == rg.Cell.OBSTACLE, cells)
    assert live.space.goal_count == 0
    assert space.goal_count == 1


def test_a_blend_without_obstacles_has_the_direction_of_its_neumann_part() -> None:
    cell = np.zeros((6, 6), np.uint8)
    cell[2, 2] = rg.Cell.GOAL
    torus = rg.ConfigurationSpace([rg.Axis("a", 0, 1, 6, True), rg.Axis("b", 0, 1, 6, True)], cell)
    blend, neumann = solve_field(torus, rg.Wiring(), 0.98), solve_field(torus, rg.Wiring(), 0.0)
    assert (blend.k, neumann.k) == (0.98, 0.0)
    np.testing.assert_allclose(blend.potential, 0.02 * neumann.potential)
    for axis in range(2):
        np.testing.assert_allclose(blend.face_current(axis), 0.02 * neumann.face_current(axis), atol=1e-15)
    assert not solve_field(torus, rg.Wiring(), 1.0).is_flowing
    assert not solve_field(torus, rg.Wiring()).is_flowing


def test_solve_again_uses_the_boundary_and_blend_of_the_scene() -> None:
    space = square()
    scene = rg.Scene(space.axes, k=(0.3, 0.9), goals=(rg.GoalCell((8, 1)),))
    for made, k, boundary in (
        (rg.simulation(scene), 0.3, "blend"),
        (rg.simulation(scene, k=0.5), 0.5, "blend"),
        (rg.simulation(scene, k=0.0), 0.0, "neumann"),
        (rg.simulation(scene.replace(k=())), 1.0, "dirichlet"),
    ):
        field = made.controller.field
        assert (field.k, field.boundary) == (k, boundary)
        again = solve_again(field, field.space)
        assert (again.k, again.boundary) == (k, boundary)
        np.testing.assert_array_equal(again.potential, field.potential)
    with pytest.raises(rg.InputError, match="one start at a time"):
        rg.simulation(scene.replace(k=(), boundary="neumann", drive="start", starts=((1.0, 1.0),)))
