"""Whole runs: arrival, contact, following, learning, retreat, pushes, wrong belief, and every way to end.

Tests internals: `resgrid.control.relaxation`, `resgrid.core.regions`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.hidden import controlled, hiding, square

import resgrid as rg
from resgrid.control.relaxation import Relaxation
from resgrid.core.regions import label_regions

BOX = rg.Box((2.5, 3.0), (6.2, 4.0))
U = [rg.Box((2.0, 2.5), (6.0, 3.0)), rg.Box((2.0, 2.5), (2.5, 5.5)), rg.Box((5.5, 2.5), (6.0, 5.5))]


def connected(space: rg.ConfigurationSpace) -> np.ndarray:
    """Cells with a path to a goal, goals included."""
    region = label_regions(space.cell != rg.Cell.OBSTACLE, space.periodic)
    return np.asarray((region > 0) & np.isin(region, region[(space.cell == rg.Cell.GOAL) & (region > 0)]))


def check(sim: rg.control.Simulation, run: rg.control.Run) -> None:
    """What every run with exact belief keeps."""
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


def test_in_free_space_it_runs_along_the_streamline() -> None:
    sim = hiding([])
    run = sim.run((1.2, 7.1))
    check(sim, run)
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
def test_with_learning_every_start_round_a_hidden_obstacle_arrives(hidden) -> None:
    sim = hiding(hidden)
    open_to = connected(sim.plant.true_space(sim.space)) & (sim.space.cell == rg.Cell.FREE)
    lessons = 0
    for cell in np.argwhere(open_to)[::17]:
        run = sim.run(sim.space.centre(cell))
        check(sim, run)
        assert run.ending is rg.control.TerminationReason.ARRIVED, (cell, run.message)
        lessons += len(run.lessons)
    assert lessons


def test_following_alone_is_a_heuristic_that_learning_is_not() -> None:
    """Behind a hidden U nothing arrives by following; with learning everything does."""
    starts = [(x, y) for x in (3.0, 3.7, 4.6, 5.1) for y in (3.9, 4.9)]
    alone = [hiding(U, learn=False).run(start, max_steps=2000) for start in starts]
    assert {run.ending for run in alone} <= {
        rg.control.TerminationReason.JAM,
        rg.control.TerminationReason.STALLED,
        rg.control.TerminationReason.OUT_OF_STEPS,
    }
    assert all(not run.lessons for run in alone)
    assert {run.ending for run in (hiding(U).run(start) for start in starts)} == {rg.control.TerminationReason.ARRIVED}


def test_following_gets_round_what_it_meets_off_centre_and_names_its_modes() -> None:
    sim = hiding([rg.Ball((3.7, 4.0), 0.5)], learn=False)
    run = sim.run((4.1, 7.5))
    check(sim, run)
    assert run.ending is rg.control.TerminationReason.ARRIVED
    assert {rg.control.ControlMode.FOLLOWING, rg.control.ControlMode.STREAMLINE} <= set(run.mode)
    assert np.all(run.contacts.body == 0)


def test_a_force_along_the_streamline_is_a_jam() -> None:
    """Square on to a wide wall, on the axis of symmetry."""
    sim = hiding([rg.Box((1.0, 3.0), (7.5, 4.0))], learn=False, friction=0.0)
    run = sim.run((4.25, 6.0), max_steps=3000)
    assert run.ending is rg.control.TerminationReason.JAM
    assert run.mode[-2] == rg.control.ControlMode.JAM
    torque, velocity = run.torque[-2], sim.controller.nominal(run.believed[-2]).velocity
    assert (
        abs(np.cross(np.r_[torque, 0], np.r_[velocity, 0])[2]) <= 1e-3 * np.linalg.norm(torque) * sim.controller.speed
    )


@pytest.mark.parametrize("limits", [None, 0.02, [0.1, 0.4], [0.5, 0.01]])
def test_the_velocity_is_the_command_at_the_logged_forces(limits) -> None:
    sim = hiding([rg.Box((1.0, 3.0), (7.5, 4.0))], learn=False, friction=0.0)
    controller = controlled(sim.space, speed=1.0, speed_limits=limits)
    run = replace(sim, controller=controller).run((3.5, 6.0))
    rows = np.flatnonzero(run.torque.any(axis=1))
    assert len(rows) > 100
    for row in rows:
        command = controller.command(run.believed[row], run.torque[row])
        np.testing.assert_allclose(run.velocity[row], command, atol=1e-7 * np.abs(command).max())


def test_friction_that_holds_is_named() -> None:
    sim = hiding([rg.Box((1.0, 3.0), (7.5, 4.0))], learn=False, friction=1.0, response="admittance")
    run = sim.run((3.5, 6.0))
    assert run.ending is rg.control.TerminationReason.STALLED
    assert run.mode[-2] == rg.control.ControlMode.STICKING
    assert run.contacts.sticking[-1]
    smooth = hiding([rg.Box((1.0, 3.0), (7.5, 4.0))], learn=False, friction=0.0, response="admittance").run((3.5, 6.0))
    assert rg.control.ControlMode.SLIDING in smooth.mode
    assert not smooth.contacts.sticking.any()


def test_a_robot_that_learns_its_own_cell_goes_back_the_way_it_came() -> None:
    sim = hiding(U)
    run = sim.run((4.1, 5.1))
    assert run.ending is rg.control.TerminationReason.ARRIVED
    rows = np.flatnonzero(run.mode == rg.control.ControlMode.RETREATING)
    assert len(rows)
    for row in rows:
        apart = np.abs(run.configuration[: row + 1] - run.configuration[row + 1]).max(axis=1)
        assert apart.min() < 1e-6


def test_no_path_is_proved_by_the_cells_learnt() -> None:
    """A goal walled in by hidden boxes: told so, and the cells learnt do separate."""
    walls = [rg.Box((3.0, 0.0), (3.4, 2.0)), rg.Box((5.2, 0.0), (5.6, 2.0)), rg.Box((3.0, 1.7), (5.6, 2.1))]
    sim = hiding(walls)
    run = sim.run((1.2, 6.5))
    check(sim, run)
    assert run.ending is rg.control.TerminationReason.NO_PATH
    assert "separate" in run.message


def test_a_goal_inside_a_hidden_obstacle_is_told() -> None:
    sim = hiding([rg.Box((4.0, 0.5), (4.5, 1.0))], robot=rg.PointRobot())
    run = sim.run((1.2, 6.5))
    assert run.ending is rg.control.TerminationReason.GOAL_BLOCKED
    assert "every goal cell" in run.message
    check(sim, run)


def test_a_scene_says_how_its_robot_is_controlled() -> None:
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


def test_a_start_within_an_obstacle_or_outside_is_refused_and_a_blocked_one_told() -> None:
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


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_pushes_do_not_prevent_arrival(seed: int) -> None:
    """Eight random pushes, three times as strong as the nominal velocity, beside a known wall."""
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
    # A push is felt from the first step on that begins after it.
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
def test_it_ends_in_a_goal_by_belief_though_it_is_a_cell_off(offset) -> None:
    sim = hiding([rg.Ball((3.7, 4.0), 0.5)])
    run = sim.run((4.1, 7.5), **offset)
    assert sim.space.cell[tuple(sim.space.locate(run.believed[-1]))] == rg.Cell.GOAL
    assert np.abs(run.believed - run.configuration).max() <= 0.5 + 1e-9
    assert run.penetration == 0


@pytest.mark.parametrize("offset", [{"bias": (0.5, -0.5)}, {"bias": (-0.2, 0.1)}, {"noise": 0.1}, {"noise": 0.5}])
def test_whether_it_arrived_is_decided_by_where_it_truly_is(offset) -> None:
    for seed in range(6):
        sim = hiding([rg.Ball((3.7, 4.0), 0.5)])
        run = sim.run((4.1, 7.5), **offset, seed=seed)
        truly = sim.space.cell[tuple(sim.space.locate(run.configuration[-1]))] == rg.Cell.GOAL
        assert run.ending is (rg.control.TerminationReason.ARRIVED if truly else rg.control.TerminationReason.MISSED)
        assert (run.goal is not None) == truly
        assert truly or "away from where it believes" in run.message
        assert truly or np.abs(list(offset.values())).max() >= 0.25


def test_the_same_seed_gives_the_same_run() -> None:
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
def test_impossible_beliefs_are_refused(options, says) -> None:
    with pytest.raises(rg.InputError, match=says):
        hiding([]).run((1.0, 1.0), **options)


def test_impossible_simulations_are_refused(scenes) -> None:
    for options, says in (({"friction": -1.0}, "friction"), ({"step": 0.9}, "step = 0.9 .* at most 0.5")):
        with pytest.raises(rg.InputError, match=says):
            hiding([], **options)
    with pytest.raises(rg.InputError, match="a scene in the plane"):
        rg.simulation(rg.read_scene(scenes / "voxels.toml"))


@pytest.mark.parametrize("start", [(-1.5, -1.5), (-2.0, -2.0), (-1.0, -1.0)])
def test_a_corner_that_the_cells_before_and_behind_lead_to_is_left_sideways(start) -> None:
    """Once the disc ahead is learnt, the two free cells on the diagonal both flow to the corner between them."""
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
def test_problems_1_and_2(scenes, name: str) -> None:
    """From the start in the scene's file: free, hidden obstacle without and with learning; coarse grid."""
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
    check(sim, learning)
    check(sim, following)
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
def test_on_the_border_of_an_obstacle_cell_the_free_cell_beside_leads(off) -> None:
    """Its wall carries no current, and rounding alone decides on which side of it a sliding robot is."""
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
