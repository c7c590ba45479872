"""The command: along the current, admittance, limits, and clear stops.

Tests internals: `resgrid.planning.pipeline`.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.planning.pipeline import solve_field

WALL = np.zeros((12, 10), np.uint8)
WALL[5:7, 2:8], WALL[9, 5] = rg.Cell.OBSTACLE, rg.Cell.GOAL


def controller_of(cell: np.ndarray, k: float = 0.98, **options: object) -> rg.control.Controller:
    return rg.control.make_controller(rg.plan(space_of(cell), k=k).field, **options)  # type: ignore[arg-type]


@settings(max_examples=40)
@given(spaces(), st.integers(0, 2**32 - 1))
def test_the_velocity_is_linear_between_the_face_currents(space, seed) -> None:
    """Pollock's interpolation, written out anew from the field's own face currents."""
    try:
        field = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))
    except rg.CircuitError:
        return
    controller = rg.control.make_controller(field, speed=2.0)
    rng = np.random.default_rng(seed)
    for cell in np.argwhere(space.goal_connected)[:5]:
        local = rng.random(space.ndim)
        point = space.lower + (cell + local) * space.spacing
        faces = [(field.face_current(a)[tuple(cell)], field.face_current(a)[tuple(cell + (np.arange(space.ndim) == a))])
                 for a in range(space.ndim)]  # fmt: skip
        low, high = np.array(faces).T
        velocity = (low * (1 - local) + high * local) * space.spacing
        leaves = ((velocity > 0) & (high > 0)) | ((velocity < 0) & (low < 0))
        got = controller.nominal(point).velocity
        assert np.linalg.norm(got) == pytest.approx(2.0)
        if leaves.any():
            np.testing.assert_allclose(got, 2 * velocity / np.linalg.norm(velocity), atol=1e-6)
        else:
            assert np.abs(got).max() == pytest.approx(2.0)


@pytest.mark.parametrize("k", [0.0, 0.5, 0.98, 1.0])
def test_chained_commands_visit_the_cells_of_the_streamline_and_arrive(k: float) -> None:
    """Short steps converge to Pollock's streamline."""
    controller = controller_of(WALL, k)
    for start in [(0.6, 0.7), (3.2, 5.1), (7.4, 9.3)]:
        path = rg.streamline(controller.field, start)
        point, met = np.array(start), [tuple(path.cells[0])]
        for _ in range(20_000):
            seen = controller.seen(point)
            if seen.place == "goal":
                break
            point = point + seen.velocity * min(seen.longest, 0.01 / controller.speed)
            cell = tuple(controller.field.space.locate(point).tolist())
            if cell != met[-1]:
                met.append(cell)
        assert path.outcome is rg.Outcome.REACHED
        assert controller.field.space.cell[met[-1]] == rg.Cell.GOAL
        assert [tuple(c) for c in path.cells.tolist()] == met


def test_inside_a_cell_the_velocity_is_continuous() -> None:
    controller = controller_of(WALL)
    rng = np.random.default_rng(0)
    for point in controller.field.space.centre(np.argwhere(controller.field.space.goal_connected))[::7]:
        a = point + rng.uniform(-0.49, 0.49, 2)
        change = controller.command(a + 1e-9) - controller.command(a)
        assert np.abs(change).max() < 1e-4


def test_a_stagnation_point_is_left_by_the_strongest_face() -> None:
    """Exactly between two goals the currents cancel; the command is still at full speed."""
    cell = np.zeros((9, 3), np.uint8)
    cell[[0, 8], 1] = rg.Cell.GOAL
    controller = controller_of(cell, 0.0, speed=1.0)
    assert np.linalg.norm(controller.command([4.5, 1.5])) == pytest.approx(1.0)


def test_the_admittance_answers_forces_and_limits_keep_the_direction() -> None:
    give = np.array([[2.0, 0.5], [0.5, 1.0]])
    controller = controller_of(WALL, admittance=give, speed=1.0, speed_limits=[1e9, 1e9])
    nominal = controller.command([1.2, 3.4])
    force = np.array([3.0, -4.0])
    np.testing.assert_allclose(controller.command([1.2, 3.4], force), nominal + give @ force)
    slow = controller_of(WALL, admittance=give, speed=1.0, speed_limits=[0.5, 2.0]).command([1.2, 3.4], force)
    assert np.max(np.abs(slow) / [0.5, 2.0]) == pytest.approx(1.0)
    fast = nominal + give @ force
    np.testing.assert_allclose(slow / np.linalg.norm(slow), fast / np.linalg.norm(fast))
    turning = controller_of(WALL, speed=1.0, response="equipotential").command([1.2, 3.4], force)
    assert turning @ nominal == pytest.approx(0.0, abs=1e-12)
    assert turning @ force > 0


def test_in_a_goal_it_gives_way_and_goes_nowhere() -> None:
    controller = controller_of(WALL, admittance=3.0, speed=1.0)
    np.testing.assert_array_equal(controller.command([9.5, 5.5]), 0.0)
    np.testing.assert_array_equal(controller.command([9.5, 5.5], [0.1, 0.0]), [3.0 * 0.1, 0.0])


def test_from_a_cell_without_a_path_it_leads_to_the_nearest_with_one() -> None:
    controller = controller_of(WALL, speed=1.0)
    assert controller.command([5.2, 4.5])[0] < -0.9
    assert controller.command([6.8, 4.5])[0] > 0.9
    ring = np.ones((20, 20), np.uint8)
    ring[1, 1], ring[2, 1] = rg.Cell.GOAL, rg.Cell.FREE
    with pytest.raises(rg.InputError, match=r"obstacle cell, \(15, 15\).*stop the robot"):
        controller_of(ring).command([15.5, 15.5])


@pytest.mark.parametrize(
    ("point", "force", "says"),
    [
        ([np.nan, 1.0], None, "not finite: stop the robot"),
        ([1.0, np.inf], None, "not finite"),
        ([-0.5, 1.0], None, "outside the grid"),
        ([1.0], None, "2 coordinates"),
        ([1.0, 1.0], [np.nan, 0.0], "generalised force .* not finite"),
        ([1.0, 1.0], [0.0, 0.0, 0.0], "there are 2 axes"),
    ],
)
def test_what_cannot_be_commanded_is_said(point, force, says) -> None:
    with pytest.raises(rg.InputError, match=says):
        controller_of(WALL).command(point, force)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"admittance": [[1.0, 0.5], [0.0, 1.0]]}, "not symmetric"),
        ({"admittance": [[1.0, 2.0], [2.0, 1.0]]}, "not positive definite"),
        ({"admittance": -1.0}, "not positive definite"),
        ({"admittance": np.eye(3)}, "2 x 2"),
        ({"admittance": [np.nan, 1.0]}, "finite"),
        ({"admittance": "much"}, "numbers"),
        ({"speed": 0.0}, "above 0"),
        ({"speed": np.nan}, "above 0"),
        ({"speed_limits": [1.0, 0.0]}, "above 0"),
        ({"response": "hope"}, "'admittance' or 'equipotential'"),
    ],
)
def test_impossible_controllers_are_refused(options, says) -> None:
    with pytest.raises(rg.InputError, match=says):
        controller_of(WALL, **options)


@given(
    st.sampled_from([1e-300, 1e-9, 1.0, 1e200, 1e308]),
    st.lists(st.sampled_from([0.0, 1.0, -1e5, 1e200, -1e308]), min_size=2, max_size=2),
    st.sampled_from([1e-300, 1e-3, 1.0, 1e300, np.inf]),
    st.sampled_from(["admittance", "equipotential"]),
)
def test_finite_inputs_give_finite_commands_within_the_limits(give, force, limit, response) -> None:
    controller = controller_of(WALL, admittance=give, speed_limits=limit, response=response)
    command = controller.command((0.6, 0.7), force)
    assert np.isfinite(command).all()
    assert np.all(np.abs(command) <= limit)


@pytest.mark.parametrize("number", [np.float32(0.5), np.int64(1), 1e-300, 1e307])
def test_any_real_number_is_a_speed(number) -> None:
    assert controller_of(WALL, speed=number).speed == float(number)


@pytest.mark.parametrize("wrong", [True, "fast", 1 + 1j, np.nan])
def test_other_things_are_no_speed(wrong) -> None:
    with pytest.raises(rg.InputError, match="speed"):
        controller_of(WALL, speed=wrong)


@pytest.mark.parametrize("wrong", [["a", "b"], (1 + 1j, 2), None, ((1.0,), (1.0, 2.0))])
def test_what_is_no_configuration_or_force_is_refused(wrong) -> None:
    controller = controller_of(WALL)
    with pytest.raises(rg.InputError, match="configuration"):
        controller.command(wrong)
    if wrong is not None:
        with pytest.raises(rg.InputError, match="force"):
            controller.command((0.6, 0.7), wrong)


@pytest.mark.parametrize("seed", [15, 51, 69, 87, 89, 91, 93, 95])
def test_from_the_corners_of_cells_a_few_steps_lead_to_the_goal(seed: int) -> None:
    """Beside lines that lead to stagnation points, and on edges where two cells meet that no current joins."""
    rng = np.random.default_rng(seed)
    cell = (rng.random((6, 6, 6)) < 0.25).astype(np.uint8)
    cell[0, 0, 0] = rg.Cell.GOAL
    space = space_of(cell)
    controller = rg.control.make_controller(solve_field(space, rg.Wiring(boundary="neumann", edge="open")))
    for at in np.argwhere(space.goal_connected)[::7]:
        place = at + rng.integers(0, 2, 3) + rng.choice([0, 0, 1e-16, -1e-16, 1e-13, -1e-13, 1e-10], 3)
        place, steps = np.clip(place, space.lower, space.upper), 0
        while (seen := controller.seen(place)).place == "free" and steps < 300:
            place, steps = np.clip(place + seen.velocity * seen.longest, space.lower, space.upper), steps + 1
        assert seen.place == "goal", (at, steps)
