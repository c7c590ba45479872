"""Simulated runs: arrival, contacts, following, learning, pushes, errors of the estimated position, and all endings.

Tests internals: `resgrid.control.plant`, `resgrid.control.relaxation`, `resgrid.core.regions`,
`resgrid.planning.pipeline`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.hidden import controlled, hiding, square

import resgrid as rg
from resgrid.control.plant import make_plant
from resgrid.control.relaxation import Relaxation
from resgrid.core.regions import label_regions
from resgrid.planning.pipeline import solve_field

BOX = rg.Box((2.5, 3.0), (6.2, 4.0))
U = [rg.Box((2.0, 2.5), (6.0, 3.0)), rg.Box((2.0, 2.5), (2.5, 5.5)), rg.Box((5.5, 2.5), (6.0, 5.5))]


def connected(space: rg.ConfigurationSpace) -> np.ndarray:
    """Return the cells with a path to a goal, including goals."""
    region = label_regions(space.cell != rg.Cell.OBSTACLE, space.periodic)
    return np.asarray((region > 0) & np.isin(region, region[(space.cell == rg.Cell.GOAL) & (region > 0)]))


def assert_run_is_consistent(sim: rg.control.Simulation, run: rg.control.Run) -> None:
    """Assert the properties of every run with an exact position estimate."""
    truth = sim.plant.true_space(sim.space)
    assert run.penetration == 0
    assert not np.any(run.learnt & (truth.cell != rg.Cell.OBSTACLE))
    assert all(len(lesson.cells) for lesson in run.lessons)
    assert int(run.learnt.sum()) == sum(len(lesson.cells) for lesson in run.lessons)
    np.testing.assert_array_equal(run.space.cell == rg.Cell.OBSTACLE, (sim.space.cell == rg.Cell.OBSTACLE) | run.learnt)
    assert np.all(np.diff(run.time) >= 0)
    moved = np.abs(np.diff(run.configuration, axis=0)) / sim.space.spacing
    assert np.all(moved <= sim.step * (1 + 1e-9))
    assert np.all(np.linalg.norm(run.contacts.normal, axis=1) == pytest.approx(1.0))
    if run.ending is rg.control.TerminationReason.NO_PATH:
        assert not connected(run.space)[tuple(run.space.locate(run.believed[0]))]


def test_a_run_in_free_space_follows_the_streamline() -> None:
    sim = hiding([])
    run = sim.run((1.2, 7.1))
    assert_run_is_consistent(sim, run)
    path = rg.streamline(sim.controller.field, (1.2, 7.1))
    assert (run.ending, run.goal) == (rg.control.TerminationReason.ARRIVED, path.goal)
    assert set(run.mode[:-1]) == {rg.control.ControlMode.STREAMLINE}
    assert run.mode[-1] == rg.control.ControlMode.ARRIVED
    length = np.linalg.norm(np.diff(run.configuration, axis=0), axis=1).sum()
    assert length == pytest.approx(path.length, rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(run.velocity[:-1], axis=1), sim.controller.speed)


@pytest.mark.parametrize(
    "hidden", [[BOX], U, [rg.Ball((4.2, 3.4), 1.1)], [rg.Polygon(((3.0, 3.0), (6.0, 3.4), (4.0, 4.5)))]]
)
@pytest.mark.quick_cases(2)
def test_with_learning_every_connected_start_arrives_around_a_hidden_obstacle(hidden) -> None:
    sim = hiding(hidden)
    open_to = connected(sim.plant.true_space(sim.space)) & (sim.space.cell == rg.Cell.FREE)
    lessons = 0
    for cell in np.argwhere(open_to)[::31]:
        run = sim.run(sim.space.centre(cell))
        assert_run_is_consistent(sim, run)
        assert run.ending is rg.control.TerminationReason.ARRIVED, (cell, run.message)
        lessons += len(run.lessons)
    assert lessons


@pytest.mark.slow
def test_starts_inside_a_hidden_u_arrive_with_learning_and_not_by_following() -> None:
    """The starts lie inside a hidden U-shaped obstacle."""
    starts = [(x, y) for x in (3.0, 4.6) for y in (3.9, 4.9)]
    alone = [hiding(U, learn=False).run(start, max_steps=2000) for start in starts]
    assert {run.ending for run in alone} <= {
        rg.control.TerminationReason.JAM,
        rg.control.TerminationReason.STALLED,
        rg.control.TerminationReason.OUT_OF_STEPS,
    }
    assert all(not run.lessons for run in alone)
    assert {run.ending for run in (hiding(U).run(start) for start in starts)} == {rg.control.TerminationReason.ARRIVED}


def test_following_arrives_around_a_disc_that_is_hit_off_centre() -> None:
    sim = hiding([rg.Ball((3.7, 4.0), 0.5)], learn=False)
    run = sim.run((4.1, 7.5))
    assert_run_is_consistent(sim, run)
    assert run.ending is rg.control.TerminationReason.ARRIVED
    assert {rg.control.ControlMode.FOLLOWING, rg.control.ControlMode.STREAMLINE} <= set(run.mode)
    assert np.all(run.contacts.body == 0)


def test_a_contact_force_along_the_streamline_ends_in_a_jam() -> None:
    """The robot meets a wide wall perpendicularly on the axis of symmetry."""
    sim = hiding([rg.Box((1.0, 3.0), (7.5, 4.0))], learn=False, friction=0.0)
    run = sim.run((4.25, 4.6), max_steps=3000)
    assert run.ending is rg.control.TerminationReason.JAM
    assert run.mode[-2] == rg.control.ControlMode.JAM
    torque, velocity = run.torque[-2], sim.controller.nominal(run.believed[-2]).velocity
    assert (
        abs(np.cross(np.r_[torque, 0], np.r_[velocity, 0])[2]) <= 1e-3 * np.linalg.norm(torque) * sim.controller.speed
    )


@pytest.mark.parametrize("limits", [None, 0.02, [0.1, 0.4], [0.5, 0.01]])
def test_logged_velocities_equal_the_commands_for_the_logged_forces(limits) -> None:
    sim = hiding([rg.Box((1.0, 3.0), (7.5, 4.0))], learn=False, friction=0.0)
    controller = controlled(sim.space, speed=1.0, speed_limits=limits)
    run = replace(sim, controller=controller).run((3.5, 6.0))
    rows = np.flatnonzero(run.torque.any(axis=1))
    assert len(rows) > 100
    for row in rows:
        command = controller.command(run.believed[row], run.torque[row])
        np.testing.assert_allclose(run.velocity[row], command, atol=1e-7 * np.abs(command).max())


def test_sticking_friction_stalls_and_is_logged() -> None:
    sim = hiding([rg.Box((1.0, 3.0), (7.5, 4.0))], learn=False, friction=1.0, response="admittance")
    run = sim.run((3.5, 6.0))
    assert run.ending is rg.control.TerminationReason.STALLED
    assert run.mode[-2] == rg.control.ControlMode.STICKING
    assert run.contacts.sticking[-1]
    smooth = hiding([rg.Box((1.0, 3.0), (7.5, 4.0))], learn=False, friction=0.0, response="admittance").run((3.5, 6.0))
    assert rg.control.ControlMode.SLIDING in smooth.mode
    assert not smooth.contacts.sticking.any()


def test_a_robot_that_learns_its_own_cell_retreats_along_its_path() -> None:
    sim = hiding(U)
    run = sim.run((4.1, 5.1))
    assert run.ending is rg.control.TerminationReason.ARRIVED
    rows = np.flatnonzero(run.mode == rg.control.ControlMode.RETREATING)
    assert len(rows)
    for row in rows:
        apart = np.abs(run.configuration[: row + 1] - run.configuration[row + 1]).max(axis=1)
        assert apart.min() < 1e-6


def test_an_enclosed_goal_ends_with_no_path_after_learning_separating_cells() -> None:
    """Hidden boxes enclose the goal; the learnt cells separate it from the start."""
    walls = [rg.Box((3.0, 0.0), (3.4, 2.0)), rg.Box((5.2, 0.0), (5.6, 2.0)), rg.Box((3.0, 1.7), (5.6, 2.1))]
    sim = hiding(walls)
    run = sim.run((1.2, 6.5))
    assert_run_is_consistent(sim, run)
    assert run.ending is rg.control.TerminationReason.NO_PATH
    assert "separate" in run.message


def test_a_goal_inside_a_hidden_obstacle_ends_with_goal_blocked() -> None:
    sim = hiding([rg.Box((4.0, 0.5), (4.5, 1.0))], robot=rg.PointRobot())
    run = sim.run((1.2, 6.5))
    assert run.ending is rg.control.TerminationReason.GOAL_BLOCKED
    assert "every goal cell" in run.message
    assert_run_is_consistent(sim, run)


def test_the_control_table_of_a_scene_sets_the_options_of_a_run() -> None:
    scene = rg.Scene(
        square().axes, goals=(rg.GoalCell((8, 1)),), starts=((4.1, 7.3),), k=(0.5,), hidden=(BOX,),
        control=rg.control.Control(
            k=0.98, speed=0.5, friction=0.0, steps=7, push=((0.0, 1.0, 1.0, 0.0),), pushes=2, bias=(0.1,)
        ),
    )  # fmt: skip
    sim = rg.simulation(scene)
    assert (sim.controller.field.k, sim.controller.speed, sim.friction, sim.learn) == (0.98, 0.5, 0.0, True)
    run = sim.run()
    assert run.ending is rg.control.TerminationReason.OUT_OF_STEPS
    assert run.push[0].tolist() == [1.0, 0.0]
    np.testing.assert_allclose((run.believed - run.configuration)[:-1], 0.1)
    unpushed = sim.run(pushes=(), bias=0.0, max_steps=5000)
    assert unpushed.ending is rg.control.TerminationReason.ARRIVED
    assert not unpushed.push.any()
    assert rg.simulation(scene, k=1.0, friction=0.1).friction == 0.1
    announced = rg.simulation(scene.replace(control=rg.control.Control(announce=True, pace=5.0)))
    assert (announced.learn, announced.relaxation) == (False, Relaxation(pace=5.0))
    assert announced.before is not None
    with pytest.raises(rg.InputError, match="force of 2 entries"):
        rg.simulation(scene.replace(control=rg.control.Control(push=((0.0, 1.0, 1.0),)))).run()


def test_invalid_starts_raise_input_error_and_blocked_starts_are_outcomes() -> None:
    sim = hiding([BOX])
    for start, says in (
        ((4.0, 3.5), r"inside hidden\[0\]"), ((4.0, 4.1), r"inside hidden\[0\]"), ((9.0, 1.0), "outside the grid"),
        ((np.nan, 1.0), "outside the grid"), ("here", "numbers"), ((1.0,), "2 coordinates"),
    ):  # fmt: skip
        with pytest.raises(rg.InputError, match=says):
            sim.run(start)
    touching = sim.run((4.0, 4.0 + 0.2 + 1e-9))
    assert touching.ending is rg.control.TerminationReason.ARRIVED or touching.lessons
    cell = np.array(sim.space.cell)
    cell[3, 3] = rg.Cell.OBSTACLE
    cell[:, 5] = rg.Cell.OBSTACLE
    mapped = rg.ConfigurationSpace(sim.space.axes, cell)
    walled = rg.control.Simulation(controlled(mapped, response="equipotential"), sim.plant)
    assert walled.run((1.7, 1.7)).ending is rg.control.TerminationReason.START_BLOCKED
    assert walled.run((1.0, 6.0)).ending is rg.control.TerminationReason.NO_PATH
    at_goal = sim.run((4.2, 0.7))
    assert (at_goal.ending, at_goal.goal, len(at_goal.time)) == (rg.control.TerminationReason.ARRIVED, 0, 1)


@settings(max_examples=6)
@given(st.integers(0, 10_000))
def test_a_run_with_random_pushes_arrives_without_penetration(seed: int) -> None:
    """Random pushes of about three times the nominal velocity act near a known wall."""
    cell = np.zeros((16, 16), np.uint8)
    cell[3:12, 6:8], cell[8, 1] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    sim = hiding([rg.Box((1.5, 3.0), (6.0, 4.0))], learn=False)
    mapped = rg.ConfigurationSpace(sim.space.axes, cell)
    known = rg.control.Simulation(controlled(mapped, response="equipotential"), sim.plant, learn=False)
    rng = np.random.default_rng(seed)
    cells = np.argwhere(known.space.goal_connected)
    start = known.space.centre(cells[rng.integers(len(cells))])
    if known.plant.penetration(start)[0] > 0:
        return
    pushes = rg.control.random_forces(seed, 2, until=20.0, size=3.0, duration=1.5)
    run = known.run(start, pushes=pushes)
    assert run.ending is rg.control.TerminationReason.ARRIVED, run.message
    assert run.penetration == 0
    # A push acts from the first step that begins after its start.
    assert run.push.any() == np.any(run.time[:-1] >= min(push.start for push in pushes))


def test_a_push_moves_the_robot_to_another_streamline() -> None:
    sim = hiding([])
    push = rg.control.ExternalForce(2.0, 3.0, np.array([2.0, 0.0]))
    pushed, free = sim.run((1.2, 7.1), pushes=[push]), sim.run((1.2, 7.1))
    assert pushed.ending is rg.control.TerminationReason.ARRIVED
    during = (pushed.time >= 2.0) & (pushed.time < 5.0)
    assert np.all(pushed.push[during] == [2.0, 0.0])
    assert set(pushed.mode[during]) == {rg.control.ControlMode.PUSHED}
    after = np.searchsorted(pushed.time, 5.0)
    assert np.linalg.norm(free.configuration - pushed.configuration[after], axis=1).min() > 0.5
    with pytest.raises(rg.InputError, match=r"push at 0 s is not finite"):
        sim.run((1.2, 7.1), pushes=lambda _t, _q: [np.nan, 0.0])
    with pytest.raises(rg.InputError, match="2 axes"):
        sim.run((1.2, 7.1), pushes=[rg.control.ExternalForce(0.0, 1.0, np.ones(3))])


@pytest.mark.parametrize("offset", [{"bias": (0.5, -0.5)}, {"bias": (-0.4, 0.3)}, {"noise": 0.5}])
def test_a_run_with_position_error_ends_in_a_goal_cell_by_its_estimate(offset) -> None:
    sim = hiding([rg.Ball((3.7, 4.0), 0.5)])
    run = sim.run((4.1, 7.5), **offset)
    assert sim.space.cell[tuple(sim.space.locate(run.believed[-1]))] == rg.Cell.GOAL
    assert np.abs(run.believed - run.configuration).max() <= 0.5 + 1e-9
    assert run.penetration == 0


@pytest.mark.parametrize("offset", [{"bias": (0.5, -0.5)}, {"bias": (-0.2, 0.1)}, {"noise": 0.1}, {"noise": 0.5}])
def test_the_ending_is_decided_by_the_true_position(offset) -> None:
    for seed in range(6):
        sim = hiding([rg.Ball((3.7, 4.0), 0.5)])
        run = sim.run((4.1, 7.5), **offset, seed=seed)
        truly = sim.space.cell[tuple(sim.space.locate(run.configuration[-1]))] == rg.Cell.GOAL
        assert run.ending is (rg.control.TerminationReason.ARRIVED if truly else rg.control.TerminationReason.MISSED)
        assert (run.goal is not None) == truly
        assert truly or "away from where it believes" in run.message
        assert truly or np.abs(list(offset.values())).max() >= 0.25


def test_runs_are_reproducible_by_their_seed() -> None:
    sim = hiding(U)
    first, second, other = (sim.run((4.0, 5.0), noise=0.3, seed=seed) for seed in (7, 7, 8))
    for name in ("time", "configuration", "believed", "velocity", "mode", "torque"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert not np.array_equal(first.believed[0], other.believed[0])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"bias": np.nan}, "bias"),
        ({"noise": [1.0, 2.0, 3.0]}, "noise"),
        ({"bias": "left"}, "bias = 'left' must be"),
    ],
)
def test_invalid_bias_and_noise_raise_input_error(options, says) -> None:
    with pytest.raises(rg.InputError, match=says):
        hiding([]).run((1.0, 1.0), **options)


def test_invalid_simulation_options_raise_input_error(scenes) -> None:
    for options, says in (({"friction": -1.0}, "friction"), ({"step": 0.9}, "step = 0.9 .* at most 0.5")):
        with pytest.raises(rg.InputError, match=says):
            hiding([], **options)
    with pytest.raises(rg.InputError, match="a scene in the plane"):
        rg.simulation(rg.read_scene(scenes / "voxels.toml"))


@pytest.mark.parametrize("start", [(-1.5, -1.5), (-2.0, -2.0), (-1.0, -1.0)])
def test_a_corner_between_cells_that_flow_to_each_other_is_left(start) -> None:
    """After the disc is learnt, the two free cells on the diagonal both flow to the corner between them."""
    scene = rg.parse_scene(
        """schema = 1
        [grid]
        axes = [{name = "x", lower = -2, upper = 2, cells = 24}, {name = "y", lower = -2, upper = 2, cells = 24}]
        [[hidden]]
        shape = "circle"
        centre = [0, 0]
        radius = 0.5
        [[goal]]
        point = [1.5, 1.5]"""
    )
    run = rg.simulation(scene).run(start, max_steps=1000)
    assert run.ending is rg.control.TerminationReason.ARRIVED
    assert run.lessons
    assert np.all(np.diff(run.time) > 0.0)
    sim = rg.simulation(scene)
    assert np.all(
        np.abs(np.diff(run.configuration, axis=0)) <= 1.0001 * sim.controller.speed_limits * np.diff(run.time)[:, None]
    )


@pytest.mark.parametrize("name", ["container", "chair"])
def test_example_scenes_arrive_without_obstacle_by_following_and_by_learning(scenes, name: str) -> None:
    """Runs from the start of the scene: without obstacle, by following only, and with learning."""
    scene = rg.read_scene(scenes / f"{name}.toml")
    sim = rg.simulation(scene)
    truth = sim.plant.true_space(sim.space)
    start = scene.starts[0]
    clear = rg.simulation(scene.replace(hidden=()), field=sim.controller.field).run(start)
    following = rg.simulation(scene, field=sim.controller.field, learn=False).run(start)
    learning = sim.run(start)
    assert [run.ending for run in (clear, following, learning)] == [rg.control.TerminationReason.ARRIVED] * 3
    assert set(clear.mode) == {
        rg.control.ControlMode.STREAMLINE,
        rg.control.ControlMode.HOMING,
        rg.control.ControlMode.ARRIVED,
    }
    assert rg.control.ControlMode.FOLLOWING in following.mode
    assert_run_is_consistent(sim, learning)
    assert_run_is_consistent(sim, following)
    assert len(learning.lessons) >= 1
    assert not np.any(learning.learnt & (truth.cell != rg.Cell.OBSTACLE))
    hidden = scene.hidden[0]
    assert isinstance(hidden, rg.Ball)
    felt = np.hypot(*(following.contacts.point - hidden.centre).T)
    np.testing.assert_allclose(felt, hidden.radius, atol=1e-9)
    if name == "chair":
        tips = scene.robot.tip(following.configuration[following.contacts.step])
        assert np.hypot(*(tips - following.contacts.point).T).min() > 0.2
        assert set(following.contacts.part) == {1}


@pytest.mark.parametrize("off", [-1e-10, 0.0, 1e-10])
def test_the_command_on_the_border_of_an_obstacle_cell_is_that_of_the_free_cell(off) -> None:
    """The border carries no current, and rounding error decides on which side a sliding robot is."""
    scene = rg.parse_scene(
        """schema = 1
        k = 0
        [grid]
        axes = [{name = "x", lower = 0, upper = 8, cells = 8}, {name = "y", lower = 0, upper = 8, cells = 8}]
        [[obstacle]]
        shape = "rectangle"
        lower = [2.1, 2.1]
        upper = [5.9, 3.9]
        [[goal]]
        point = [7.5, 5.5]"""
    )
    seen = rg.simulation(scene).controller.seen((3.5, 4.0 + off))
    assert seen.place == "free"
    assert seen.velocity[0] > 0.0


def test_a_run_without_current_states_the_reason_of_the_streamline() -> None:
    """The room behind the goals touches no obstacle; its edge is open."""
    cell = np.zeros((8, 3), dtype=np.uint8)
    cell[0], cell[3] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 8.0, 8), rg.Axis("y", 0.0, 3.0, 3)], cell)
    controller = rg.control.make_controller(solve_field(space, rg.Wiring(edge="open"), 1.0))
    run = rg.control.Simulation(controller, make_plant(rg.DiscRobot(0.2), space.axes, [], [])).run((6.5, 1.5))
    assert run.ending is rg.control.TerminationReason.NO_CURRENT
    reason = rg.streamline(controller.field, (6.5, 1.5)).reason
    assert reason is not None and "edge = 'obstacle'" in reason
    assert run.message == reason
