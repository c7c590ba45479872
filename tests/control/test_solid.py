"""Robots never enter obstacles, at any step or push; distances are computed independently with shapely.

Tests internals: `resgrid.control.contact`, `resgrid.control.plant`, `resgrid.control.run_log`, `resgrid.robots`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings, strategies as st
from support.hidden import controlled, hiding, square

import resgrid as rg
from resgrid.control.contact import solve_contacts, surroundings
from resgrid.control.plant import Plant, make_plant
from resgrid.control.run_log import End, Recorder
from resgrid.robots import Shape

BAR = rg.PolygonRobot(((-0.4, -0.1), (0.4, -0.1), (0.4, 0.1), (-0.4, 0.1)), turning_length=0.5)
ROBOTS: list[rg.Robot] = [
    rg.PointRobot(), rg.DiscRobot(0.2), BAR, rg.Arm((1.0, 0.8)), rg.Arm((1.0, 1.0), angles="absolute"),
    rg.Arm((1.0, 0.8), widths=(0.06, 0.0), limits=((-2.5, 2.5), None)), rg.Arm((0.8, 0.6, 0.5), angles="absolute"),
]  # fmt: skip


def axes_of(robot: rg.Robot, cells: int) -> tuple[rg.Axis, ...]:
    if isinstance(robot, rg.Arm):
        return robot.axes(min(cells, 16) if len(robot.lengths) == 3 else cells)
    plane = (rg.Axis("x", -2, 2, cells), rg.Axis("y", -2, 2, cells))
    return (
        (*plane[:1], rg.Axis("y", -2, 2, 12), robot.turning_axis(12)) if isinstance(robot, rg.PolygonRobot) else plane
    )


def shapes_of(rng: np.random.Generator, count: int) -> list[Shape]:
    """Return discs, boxes and thin rectangles, with sizes from 0.1 mm."""
    found: list[Shape] = []
    while len(found) < count:
        x, y = rng.uniform(-1.8, 1.8, 2)
        kind, size, angle = rng.integers(3), float(10 ** rng.uniform(-4, -0.6)), rng.uniform(0, np.pi)
        along, across = 0.4 * np.array([np.cos(angle), np.sin(angle)]), size * np.array([-np.sin(angle), np.cos(angle)])
        ends = [tuple(np.array([x, y]) + a * along + b * across) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        if np.hypot(x, y) > 0.7:
            found.append([rg.Ball((x, y), size), rg.Box((x, y), (x + 0.3, y + 0.2)), rg.Polygon(tuple(ends))][kind])
    return found


def gaps(plant: Plant, points: np.ndarray) -> np.ndarray:
    """Return the distance between robot and obstacles; negative if an obstacle is entered."""
    robot, away = plant.robot, np.full(len(points), np.inf)
    if isinstance(robot, rg.Arm):
        joints = robot.joints(points)
        parts = [(shapely.linestrings(joints[:, m : m + 2]), width / 2) for m, width in enumerate(robot.widths)]
    elif isinstance(robot, rg.PolygonRobot):
        parts = [(shapely.polygons(robot.corners(points)), 0.0)]
    else:
        parts = [(shapely.points(points), robot.radius)]
    for shape in plant.obstacles:
        core, radius = (shapely.Point(shape.centre), shape.radius) if isinstance(shape, rg.Ball) else (None, 0.0)
        if isinstance(shape, rg.Box):
            core = shapely.box(*shape.lower, *shape.upper)
        elif isinstance(shape, rg.Polygon):
            core = shapely.Polygon(shape.vertices)
        for part, width in parts:
            entered = shapely.intersects(part, core) & ~shapely.touches(part, core)
            apart = np.where(entered & (radius == 0), -1.0, shapely.distance(part, core))
            away = np.minimum(away, apart - radius - width)
    return away


def nearest_on_the_way(plant: Plant, way: np.ndarray) -> float:
    """Return the smallest gap on straight lines, bisected until no point can move farther than both end gaps."""
    low, begin, end = float(gaps(plant, way).min()), way[:-1], way[1:]
    for _ in range(14):
        travel = plant.robot.travel(begin, end)
        doubt = (travel > np.maximum(gaps(plant, begin), 0) + np.maximum(gaps(plant, end), 0)) & (travel > 1e-6)
        if not doubt.any():
            break
        begin, end = begin[doubt], end[doubt]
        middle = (begin + end) / 2
        low = min(low, float(gaps(plant, middle).min()))
        begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
    return low


@pytest.mark.slow
@settings(max_examples=40)
@given(
    st.sampled_from(ROBOTS), st.sampled_from([16, 24, 40]), st.sampled_from([0.05, 0.2, 0.5]), st.booleans(),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_no_obstacle_is_entered_for_random_pushes_steps_robots_and_grids(robot, cells, step, learn, seed) -> None:
    rng = np.random.default_rng(seed)
    axes = axes_of(robot, cells)
    cell = np.zeros(tuple(axis.cells for axis in axes), np.uint8)
    cell[tuple(rng.integers(0, cell.shape))] = rg.Cell.GOAL
    space = rg.ConfigurationSpace(axes, cell)
    plant = make_plant(robot, axes, [], shapes_of(rng, 4))
    start = space.lower + rng.random(len(axes)) * (space.upper - space.lower)
    assume(gaps(plant, start[np.newaxis])[0] > 0)
    sim = rg.control.Simulation(controlled(space, 0.9), plant, learn=learn, step=step)
    pushes = [rg.control.ExternalForce(*rng.uniform(0.5, 8.0, 2), rng.normal(size=len(axes)) * 8.0) for _ in range(3)]
    run = sim.run(start, pushes=pushes, max_steps=300)
    assert nearest_on_the_way(plant, run.configuration) >= 0
    assert run.penetration == 0
    assert np.all(np.diff(run.time) >= 0)
    assert np.all(np.abs(run.velocity) <= sim.controller.speed_limits * (1 + 1e-9))
    moved = np.abs(np.diff(run.configuration, axis=0)) / space.spacing
    assert np.all(moved <= step * (1 + 1e-9))


@settings(max_examples=200)
@given(st.sampled_from(ROBOTS), st.integers(0, 2**32 - 1), st.floats(0.01, 1.0))
def test_the_free_fraction_of_a_motion_keeps_the_requested_gap(robot, seed, keep) -> None:
    rng = np.random.default_rng(seed)
    plant = make_plant(robot, axes_of(robot, 20), shapes_of(rng, 4))
    start = np.array([rng.uniform(axis.lower, axis.upper) for axis in plant.axes])
    motion = rng.normal(size=len(start)) * rng.choice([0.01, 0.1, 0.5])
    gap = gaps(plant, start[np.newaxis])[0]
    assume(gap > 0)
    share = plant.free_fraction(plant.pose(start), motion, keep * gap)
    assert share >= 0
    on_the_way = start + np.linspace(0, min(share, 1.0), 60)[:, None] * motion
    assert gaps(plant, on_the_way).min() >= keep * gap - 1e-12


def test_an_arm_pushed_against_a_disc_slides_along_it() -> None:
    """An arm of zero width, a constant push, a disc of 20 cm and cells of 12 degrees."""
    arm = rg.Arm((1.0, 1.0), angles="absolute")
    cell = np.zeros((30, 30), np.uint8)
    cell[2, 2] = rg.Cell.GOAL
    space = rg.ConfigurationSpace(arm.axes(30), cell)
    plant = make_plant(arm, space.axes, [], [rg.Ball((1.1, -0.1), 0.1)])
    sim = rg.control.Simulation(controlled(space), plant, learn=False)
    run = sim.run((2.0, -2.7), pushes=[rg.control.ExternalForce(0.0, 20.0, np.array([-2.0, 1.0]))], max_steps=3000)
    assert len(run.contacts.step) > 10
    assert nearest_on_the_way(plant, run.configuration) > 0


@pytest.mark.parametrize(
    "start", [(4.1, 4.0), (3.0, 4.0), (2.5, 3.5), (6.2, 3.25), (2.5, 4.0), (6.2, 4.0), (2.5, 3.0), (6.2, 3.0)]
)
@pytest.mark.parametrize("as_polygon", [False, True])
def test_starts_on_sides_and_corners_of_an_obstacle_arrive(start, as_polygon) -> None:
    box: Shape = rg.Box((2.5, 3.0), (6.2, 4.0))
    if as_polygon:
        box = rg.Polygon(((2.5, 3.0), (6.2, 3.0), (6.2, 4.0), (2.5, 4.0)))
    sim = hiding([box], robot=rg.PointRobot())
    run = sim.run(start)
    assert run.ending is rg.control.TerminationReason.ARRIVED, run.message
    assert nearest_on_the_way(sim.plant, run.configuration) >= 0


def test_a_start_inside_an_obstacle_beyond_rounding_error_raises_input_error() -> None:
    slanted = rg.Polygon(((1.0, 1.0), (7.0, 3.0), (6.0, 5.0)))
    sim = hiding([slanted], robot=rg.PointRobot())
    on = np.array([1.0, 1.0]) + 0.37 * np.array([6.0, 2.0])
    into = np.array([-2.0, 6.0]) / np.hypot(2.0, 6.0)
    for depth in (-1e-12, 0.0, 1e-12):
        assert sim.run(on + depth * into).ending is rg.control.TerminationReason.ARRIVED
    with pytest.raises(rg.InputError, match=r"inside hidden\[0\]"):
        sim.run(on + 1e-6 * into)


@pytest.mark.parametrize("gap", [0.0, 1e-12])
def test_an_arm_in_contact_along_a_side_arrives(gap) -> None:
    arm = rg.Arm((1.0, 1.0), angles="absolute")
    cell = np.zeros((48, 48), np.uint8)
    cell[20, 20] = rg.Cell.GOAL
    space = rg.ConfigurationSpace(arm.axes(48), cell)
    plant = make_plant(arm, space.axes, [], [rg.Box((0.5, gap), (2.5, 0.5))])
    run = rg.control.Simulation(controlled(space, 0.5), plant, learn=False).run((0.0, 0.0))
    assert run.ending is rg.control.TerminationReason.ARRIVED, run.message
    assert run.penetration == 0


@pytest.mark.parametrize("robot", [rg.PointRobot(), rg.DiscRobot(0.2)])
@pytest.mark.parametrize("learn", [True, False])
def test_time_advances_in_the_wedge_between_an_obstacle_and_the_end_of_an_axis(robot, learn) -> None:
    sim = hiding([rg.Ball((4.0, 7.6), 0.5)], robot=robot, learn=learn)
    run = sim.run(
        (2.5, 7.9 - robot.radius), pushes=[rg.control.ExternalForce(0.0, 3.0, np.array([9.0, 9.0]))], max_steps=2000
    )
    assert run.ending is rg.control.TerminationReason.ARRIVED, run.message
    assert nearest_on_the_way(sim.plant, run.configuration) >= 0
    assert run.configuration.max() <= 8.0
    pushed = np.diff(run.time)[run.push[:-1].any(axis=1)]
    assert pushed.max() > 0.1
    assert (pushed < 1e-6).sum() <= 2


def test_steps_without_known_forces_are_counted() -> None:
    space, none = square(), np.zeros(2)
    plant = make_plant(rg.PointRobot(), space.axes, [], [rg.Box((1.0, 3.0), (7.0, 4.0))])
    pose = plant.pose(np.array([4.0, 4.001]))
    around = surroundings(pose, plant.near(pose, 0.01))
    contacts = solve_contacts(around, np.array([True]), np.array([0.0, -1.0]), np.eye(2), 0.0, np.zeros(1))
    recorder = Recorder(2)
    for solved in (True, False, False):
        row = replace(contacts, solved=solved)
        recorder.add(0.0, np.array([4.0, 4.001]), none, none, rg.control.ControlMode.SLIDING, row, none)
    run = recorder.run(
        End(rg.control.TerminationReason.STALLED, "stood"), None, (), controlled(space).field, space, plant, None
    )
    assert run.unsolved == 2
    assert run.message == "stood; in 2 steps no contact forces were known, and the robot stood still"


def test_penetration_between_rows_is_measured_and_ends_with_entered() -> None:
    """Two consecutive rows lie on either side of an obstacle of 0.1 mm."""
    space = square()
    field = controlled(space).field
    for solid in (rg.Box((1.0, 3.0), (7.0, 3.0001)), rg.Ball((4.0, 3.0), 1e-4)):
        plant = make_plant(rg.PointRobot(), space.axes, [], [solid])
        none = np.zeros(2)
        recorder = Recorder(2)
        for time, y in enumerate((2.9, 3.1)):
            recorder.add(
                float(time), np.array([4.0, y]), np.array([4.0, y]), none, rg.control.ControlMode.STREAMLINE, None, none
            )
        run = recorder.run(End(rg.control.TerminationReason.ARRIVED, ""), 0, (), field, space, plant, None)
        assert 0 < run.penetration <= 1e-4
        assert run.ending is rg.control.TerminationReason.ENTERED
        assert "entered an obstacle" in run.message
        assert plant.penetration(run.configuration).max() == 0


def test_penetration_of_overlapping_polygons_is_finite() -> None:
    axes = (rg.Axis("x", -3, 3, 12), rg.Axis("y", -3, 3, 12))
    solids = [rg.Box((0.0, -2.0), (1.0, 2.0)), rg.HalfSpace((0.0, -1.0), -2.5)]
    point = make_plant(rg.PointRobot(), axes, solids)
    np.testing.assert_allclose(
        point.penetration([(0.25, 0.0), (0.5, 0.0), (0.0, 0.0), (-1.0, 2.75)]), [0.25, 0.5, 0, 0.25]
    )
    bar = make_plant(BAR, (*axes, BAR.turning_axis(12)), solids)
    depth = bar.penetration([(-0.3, 0.0, 0.0), (-0.4, 0.0, 0.0)])
    np.testing.assert_allclose(depth, [0.1, 0.0], atol=1e-12)


def wall_at(degrees: float) -> rg.Polygon:
    along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    into, centre = np.array([along[1], -along[0]]), np.array([4.0, 4.0])
    corners = (centre - 4 * along, centre - 4 * along + 0.5 * into, centre + 4 * along + 0.5 * into, centre + 4 * along)
    return rg.Polygon(tuple(map(tuple, corners)))


@pytest.mark.parametrize("limit", [0.5, 1.0, [0.7, 2.0]])
def test_speed_limits_hold_for_velocities_after_contacts(limit) -> None:
    sim = hiding([wall_at(-22.5)], learn=False, friction=0.0, response="admittance")
    sim = replace(sim, controller=rg.control.make_controller(sim.controller.field, speed=0.4, speed_limits=limit))
    run = sim.run((2.0, 6.5), pushes=[rg.control.ExternalForce(0.0, 6.0, np.array([30.0, -30.0]))], max_steps=500)
    assert len(run.contacts.step)
    assert np.all(np.abs(run.velocity) <= np.asarray(limit) * (1 + 1e-12))
    lasted = np.diff(run.time)[:, None]
    assert np.all(np.abs(np.diff(run.configuration, axis=0)) <= np.asarray(limit) * lasted * (1 + 1e-9) + 1e-12)


def free_run(sim: rg.control.Simulation, **options: object) -> rg.control.Run:
    return replace(sim, learn=False).run((1.2, 7.1), **options)  # type: ignore[arg-type]


def test_slow_robots_and_small_steps_are_not_reported_as_stalled() -> None:
    """Cases: low speed limits, small steps, and cells that are much longer than wide."""
    sim = hiding([])
    field = sim.controller.field
    for limit in (0.1, 0.005, [0.4, 0.004]):
        slow = replace(sim, controller=rg.control.make_controller(field, speed=1.0, speed_limits=limit))
        assert free_run(slow).ending is rg.control.TerminationReason.ARRIVED
    assert free_run(replace(sim, step=0.002), max_steps=10_000).ending is rg.control.TerminationReason.ARRIVED
    cell = np.zeros((16, 800), np.uint8)
    cell[14, 400] = rg.Cell.GOAL
    flat = rg.ConfigurationSpace([rg.Axis("x", 0, 8, 16), rg.Axis("y", 0, 8, 800)], cell)
    wide = rg.control.Simulation(controlled(flat), make_plant(rg.PointRobot(), flat.axes, []), learn=False)
    assert wide.run((1.25, 4.0)).ending is rg.control.TerminationReason.ARRIVED


@pytest.mark.parametrize("cells", [16, 32])
def test_a_start_whose_own_cell_is_learnt_as_an_obstacle_arrives(cells) -> None:
    """The start's own cell is learnt as an obstacle; the neighbouring cell leads to the goal."""
    space = square(cells, goal=(cells // 2, cells // 16))
    plant = make_plant(rg.DiscRobot(0.2), space.axes, [], [rg.Box((2.5, 3.0), (6.2, 4.0))])
    sim = rg.control.Simulation(controlled(space), plant)
    run = sim.run((4.1, 4.201))
    assert run.space.cell[tuple(run.space.locate((4.1, 4.201)))] == rg.Cell.OBSTACLE
    assert run.ending is rg.control.TerminationReason.ARRIVED, run.message
    assert sim.run((4.1, 4.201), noise=1e-12).ending is rg.control.TerminationReason.ARRIVED


def test_the_no_path_message_states_the_cause() -> None:
    closed = hiding([rg.Box((0.0, 3.0), (8.0, 4.0))])
    far, near = closed.run((4.1, 6.0)), closed.run((4.1, 4.201))
    assert far.ending is near.ending is rg.control.TerminationReason.NO_PATH
    assert "separate the start" in far.message
    assert "start's own cell (8, 8)" in near.message


def with_goal_point(point: tuple[float, float], hidden: list[Shape], learn: bool = True) -> rg.control.Simulation:
    space = square()
    space = rg.ConfigurationSpace(space.axes, space.cell, goal_points=[point])
    plant = make_plant(rg.PointRobot(), space.axes, [], hidden)
    return rg.control.Simulation(controlled(space), plant, learn=learn)


@pytest.mark.parametrize("point", [(4.05, 0.52), (4.5, 1.0), (4.25, 0.75)])
def test_a_run_arrives_at_the_goal_point_of_its_cell(point) -> None:
    run = with_goal_point(point, []).run((1.2, 7.1))
    assert run.ending is rg.control.TerminationReason.ARRIVED
    np.testing.assert_allclose(run.configuration[-1], point, atol=1e-9)
    assert rg.control.ControlMode.HOMING in run.mode
    inside = np.all((run.configuration >= (4.0, 0.5)) & (run.configuration <= (4.5, 1.0)), axis=1)
    assert np.all(inside[run.mode == rg.control.ControlMode.HOMING])
    noisy = with_goal_point(point, []).run((1.2, 7.1), noise=0.05)
    in_cell = np.all((noisy.configuration[-1] >= (4.0, 0.5)) & (noisy.configuration[-1] <= (4.5, 1.0)))
    assert noisy.ending is (rg.control.TerminationReason.ARRIVED if in_cell else rg.control.TerminationReason.MISSED)
    assert np.abs(noisy.configuration[-1] - point).max() <= 0.1 + 1e-9
    whole = with_goal_point((np.nan, np.nan), []).run((1.2, 7.1))
    assert whole.ending is rg.control.TerminationReason.ARRIVED
    assert rg.control.ControlMode.HOMING not in whole.mode


def test_a_goal_point_behind_a_wall_in_its_cell_is_not_an_arrival() -> None:
    """A hidden wall crosses the goal cell; without learning the message states the remaining distance."""
    wall = rg.Box((3.0, 0.6), (5.5, 0.7))
    assert with_goal_point((4.25, 0.52), [wall]).run((4.25, 5.0)).ending is rg.control.TerminationReason.GOAL_BLOCKED
    run = with_goal_point((4.25, 0.52), [wall], learn=False).run((4.25, 5.0))
    assert run.ending is rg.control.TerminationReason.STALLED
    assert "from the configuration that solves the goal" in run.message
    assert run.penetration == 0


@pytest.mark.parametrize(("name", "value"), [("max_steps", -3), ("max_steps", 0), ("seed", -1), ("seed", 1.5)])
def test_invalid_max_steps_and_seeds_raise_input_error(name, value) -> None:
    with pytest.raises(rg.InputError, match=name):
        hiding([]).run((1.0, 1.0), **{name: value})
