"""Contacts against shapely, finite differences, and the laws of friction.

Tests internals: `resgrid.control.contact`, `resgrid.control.contact_forces`, `resgrid.control.plant`,
`resgrid.robots`, `resgrid.robots.geometry`.
"""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from scipy.optimize import nnls
from support.robots import BAR

import resgrid as rg
from resgrid.control.contact import Surroundings, solve_contacts, surroundings
from resgrid.control.contact_forces import contact_forces
from resgrid.control.plant import PAIR, make_plant, plant_of
from resgrid.robots import CellSet, to_shapely
from resgrid.robots.geometry import Pose, obstacles_of

PLANE = (rg.Axis("x", -3, 3, 12), rg.Axis("y", -3, 3, 12))
WEDGE = rg.PolygonRobot(((-0.5, -0.1), (0.5, -0.1), (0.5, 0.1), (-0.2, 0.3)), turning_length=0.5)
ROBOTS: list[rg.Robot] = [
    rg.PointRobot(),
    rg.PointRobot(0.1),
    rg.DiscRobot(0.3),
    WEDGE,
    rg.Arm((1.0, 0.8), widths=(0.1, 0.0)),
    rg.Arm((0.9, 0.7, 0.5), widths=(0.0, 0.06, 0.1), angles="absolute", base=(0.2, -0.1), base_angle=0.3),
    rg.Arm((1.1, 0.9, 0.3)),
]
SOLIDS = [
    rg.Box((0.8, 0.5), (1.4, 1.1)),
    rg.Ball((-1.2, 0.4), 0.35),
    rg.Polygon(((0.2, -1.5), (1.0, -1.2), (0.6, -0.7), (0.7, -1.1))),
    rg.HalfSpace((0.6, -0.8), -1.7),
]


def jacobian(pose: Pose, point: np.ndarray, part: int) -> np.ndarray:
    """Velocity of a point of a part for unit velocities of the axes, shape (2, ndim)."""
    spin, pivot = pose.spin[part], pose.pivot[part]
    return np.stack([-spin * (point[1] - pivot[:, 1]), spin * (point[0] - pivot[:, 0])]) + pose.shift[part].T


def axes_of(robot: rg.Robot) -> tuple[rg.Axis, ...]:
    if isinstance(robot, rg.Arm):
        return robot.axes(24)
    return (*PLANE, robot.turning_axis(12)) if isinstance(robot, rg.PolygonRobot) else PLANE


def configuration(robot: rg.Robot, rng: np.random.Generator) -> np.ndarray:
    axes = axes_of(robot)
    return np.array([rng.uniform(axis.lower, axis.upper) for axis in axes])


@given(st.floats(-9e-10, 9e-10), st.floats(0, 2 * np.pi), st.sampled_from([0.0, 0.2]))
def test_what_is_touched_but_for_rounding_is_near(height: float, angle: float, radius: float) -> None:
    """Whatever shapely calls no collision, a contact can be felt at: nothing falls between the two."""
    toward = np.array([np.cos(angle), np.sin(angle)])
    robot = rg.PointRobot(radius)
    for solid in (rg.Ball((0.3, 0.2), 0.8), rg.HalfSpace(tuple(toward), float(toward @ (0.3, 0.2)) + 0.8)):
        plant = make_plant(robot, PLANE, [], [solid])
        centre = np.array([0.3, 0.2]) + (0.8 + radius + height) * toward
        pairs = plant.near(plant.pose(centre), 1e-6)
        assert plant.penetration(centre)[0] == 0
        assert len(pairs) == 1
        assert pairs["gap"][0] == pytest.approx(0, abs=2e-9)
        np.testing.assert_allclose(pairs["normal"][0], toward, atol=1e-6)


@settings(max_examples=150)
@given(st.sampled_from(ROBOTS), st.integers(0, 2**32 - 1))
def test_the_nearest_pair_is_as_near_as_shapely_says(robot: rg.Robot, seed: int) -> None:
    plant = make_plant(robot, axes_of(robot), SOLIDS)
    q = configuration(robot, np.random.default_rng(seed))
    if plant.penetration(q)[0] > 0:
        return
    pairs = plant.near(plant.pose(q), 9.0)
    for obstacle in obstacles_of(SOLIDS):
        apart = [float(obstacle.distance(part)[0]) for part in robot.parts(q[np.newaxis])]
        own = pairs[pairs["body"] == obstacle.number]
        assert own["gap"].min() == pytest.approx(min(apart), abs=1e-9)
        assert apart[int(own["part"][np.argmin(own["gap"])])] == pytest.approx(min(apart), abs=1e-9)
    behind = shapely.points(pairs["point"] + 1e-6 * pairs["inward"])
    solids = np.array([to_shapely(solid) for solid in SOLIDS])[pairs["body"]]
    assert np.all(shapely.distance(solids, behind) <= (pairs["body"] == 1) * 1e-3)
    np.testing.assert_allclose(np.linalg.norm(pairs["normal"], axis=1), 1.0)
    np.testing.assert_allclose(pairs["on_robot"] - pairs["point"], pairs["gap"][:, None] * pairs["normal"], atol=1e-12)


@settings(max_examples=150)
@given(st.sampled_from(ROBOTS), st.integers(0, 2**32 - 1))
def test_the_jacobian_is_the_derivative_of_where_a_point_goes(robot: rg.Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = make_plant(robot, axes_of(robot), [])
    q = configuration(robot, rng)
    here = plant.pose(q)
    for part in range(len(here.frame)):
        point = here.frame[part, :2] + rng.uniform(-1, 1, 2)
        for axis in range(len(q)):
            step = np.zeros(len(q))
            step[axis] = 1e-6
            ahead, back = (here.carried(point, part, plant.pose(q + s * step)) for s in (1, -1))
            np.testing.assert_allclose((ahead - back) / 2e-6, jacobian(here, point, part)[:, axis], atol=1e-8)


@settings(max_examples=150)
@given(st.sampled_from(ROBOTS), st.integers(0, 2**32 - 1), st.floats(0, 1.5))
def test_contact_forces_obey_coulomb_and_power_balances(robot: rg.Robot, seed: int, mu: float) -> None:
    """Whatever touches: no gap closes, no force pulls, friction opposes slip, tau . qdot = f . xdot."""
    rng = np.random.default_rng(seed)
    plant = make_plant(robot, axes_of(robot), SOLIDS)
    q = configuration(robot, rng)
    pose = plant.pose(q)
    around = surroundings(pose, plant.near(pose, 0.4))
    if plant.penetration(q)[0] > 0 or not len(around.gap):
        return
    free = rng.normal(size=len(q))
    root = rng.normal(size=(len(q), len(q)))
    give = root @ root.T + np.eye(len(q))
    felt = solve_contacts(around, np.ones(len(around.gap), bool), free, give, mu, np.zeros(len(around.gap)))
    np.testing.assert_allclose(felt.velocity, free + give @ felt.torque, atol=1e-9)
    power = 0.0
    for k in range(len(felt.pairs)):
        speed = jacobian(pose, felt.pairs["on_robot"][k], int(felt.pairs["part"][k])) @ felt.velocity
        normal = felt.pairs["normal"][k]
        tangent = np.array([-normal[1], normal[0]])
        pull, rub = felt.force[k] @ normal, felt.force[k] @ tangent
        power += float(felt.force[k] @ speed)
        assert pull >= 0
        assert abs(rub) <= mu * pull + 1e-9
        if len(felt.pairs) == 1 and pull > 1e-6:
            assert normal @ speed == pytest.approx(0.0, abs=1e-8)
            if abs(rub) < mu * pull * (1 - 1e-6) - 1e-9:
                assert tangent @ speed == pytest.approx(0.0, abs=1e-7)
            elif abs(tangent @ speed) > 1e-9 and mu > 0:
                assert rub * (tangent @ speed) <= 1e-9
    assert felt.torque @ felt.velocity == pytest.approx(power, abs=1e-9)


def test_a_force_inside_the_friction_cone_sticks() -> None:
    """A disc driven onto a floor at 45 degrees sticks just when mu exceeds 1."""
    plant = make_plant(rg.DiscRobot(0.5), PLANE, [rg.HalfSpace((0.0, 1.0), 0.0)])
    pose = plant.pose(np.array([0.0, 0.5005]))
    around = surroundings(pose, plant.near(pose, 0.01))
    for mu, sticks in ((0.0, False), (0.9, False), (1.1, True)):
        felt = solve_contacts(around, np.array([True]), np.array([1.0, -1.0]), np.eye(2), mu, np.zeros(1))
        assert felt.sticking.tolist() == [sticks]
        np.testing.assert_allclose(felt.velocity, [0.0 if sticks else 1 - mu, 0.0], atol=1e-12)
        np.testing.assert_allclose(felt.force, [[-1.0 if sticks else -mu, 1.0]], atol=1e-12)


def test_no_force_leaves_the_cone_of_friction() -> None:
    """Rounding included: a contact without normal force rubs nothing, and is none that presses."""
    rng = np.random.default_rng(5)
    for _ in range(400):
        count, ndim = int(rng.integers(1, 7)), int(rng.integers(2, 4))
        normal, tangent = rng.normal(size=(2, count, ndim)) * 10 ** rng.uniform(-3, 1, size=(2, count, 1))
        if count > 1 and rng.random() < 0.5:
            normal[1] = normal[0] * rng.uniform(0.5, 2.0) + 10 ** rng.uniform(-12, -6) * rng.normal(size=ndim)
        mu = float(rng.uniform(0.05, 1.5))
        velocity, none = rng.normal(size=ndim), np.zeros(count)
        _, forces, _ = contact_forces(normal, tangent, none, velocity, np.eye(ndim), mu)
        assert np.all(forces[:, 0] >= 0.0)
        assert np.all(np.abs(forces[:, 1]) <= mu * forces[:, 0] * (1.0 + 1e-15))


@settings(max_examples=100)
@given(st.integers(2, 3), st.integers(1, 8), st.floats(-3.0, 0.0), st.booleans(), st.integers(0, 2**32 - 1))
def test_without_friction_the_velocity_is_projected_onto_what_gaps_allow(ndim, count, wedge, twice, seed) -> None:
    """In the metric of the inverse admittance, by non-negative least squares; narrow wedges and contacts felt twice."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(count, ndim))
    if count > 1:
        rows[1] = -rows[0] * rng.uniform(0.1, 3.0) + 10**wedge * rng.normal(size=ndim)
    if twice and count > 2:
        rows[2] = rows[0]
    root = rng.normal(size=(ndim, ndim))
    give, free = root @ root.T + 0.1 * np.eye(ndim), rng.normal(size=ndim)
    around = Surroundings(np.zeros(count, PAIR), rows, rng.normal(size=(count, ndim)))
    felt = solve_contacts(around, np.ones(count, bool), free, give, 0.0, np.zeros(count))
    factor = np.linalg.cholesky(give)
    force, _ = nnls((rows @ factor).T, -np.linalg.solve(factor, free))
    assert felt.solved
    np.testing.assert_allclose(felt.velocity, free + give @ rows.T @ force, atol=1e-6 * np.linalg.norm(free))


@pytest.mark.parametrize("degrees", [60.0, 10.0, 2.0, 0.1])
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_point_driven_into_a_wedge_stands(degrees, friction) -> None:
    half = np.radians(degrees / 2)
    side = 2 * np.tan(half)
    walls = [rg.Polygon(((-2, side), (0, 0), (0, 2), (-2, 2))), rg.Polygon(((-2, -side), (-2, -2), (0, -2), (0, 0)))]
    plant = make_plant(rg.PointRobot(), PLANE, [], walls)
    pose = plant.pose(np.array([-0.5, 0.0]))
    around = surroundings(pose, plant.near(pose, 0.501 * np.sin(half)))
    free = np.array([1.0, 0.3 * np.tan(half)])
    felt = solve_contacts(around, np.ones(2, bool), free, np.eye(2), friction, np.zeros(2))
    np.testing.assert_allclose(felt.velocity, 0.0, atol=1e-9)
    np.testing.assert_allclose(felt.force.sum(axis=0), -free, atol=1e-6)
    if not friction:
        np.testing.assert_allclose(np.linalg.norm(felt.force, axis=1) * np.sin(half), 0.5, rtol=0.2)


def test_a_stop_and_an_obstacle_are_contacts_of_one_problem() -> None:
    """Pressed along a slanted wall into the end of an axis: neither is violated, and the stop carries what is left."""
    plant = make_plant(rg.PointRobot(), PLANE, [rg.HalfSpace((-1.0, 1.0), 0.0)])
    pose = plant.pose(np.array([2.999, 3.0]))
    around = surroundings(pose, plant.near(pose, 0.01))
    stop = np.array([[0.0, -1.0]])
    felt = solve_contacts(around, np.array([True]), np.array([1.0, 0.2]), np.eye(2), 0.0, np.zeros(1), stop)
    np.testing.assert_allclose(felt.velocity, 0.0, atol=1e-12)
    np.testing.assert_allclose(felt.torque, [-1.0, -0.2], atol=1e-12)
    np.testing.assert_allclose(felt.normal_torque, [-1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("stiff", [1e-9, 1e-14])
def test_a_stiff_axis_is_felt_as_well(stiff) -> None:
    plant = make_plant(rg.PointRobot(), PLANE, [rg.HalfSpace((0.0, 1.0), 0.0)])
    pose = plant.pose(np.array([0.0, 0.001]))
    around = surroundings(pose, plant.near(pose, 0.01))
    felt = solve_contacts(around, np.array([True]), np.array([0.3, -1.0]), np.diag([1.0, stiff]), 0.0, np.zeros(1))
    np.testing.assert_allclose(felt.velocity, [0.3, 0.0], atol=1e-12)
    assert felt.force[0, 1] == pytest.approx(1 / stiff)


def test_a_bar_laid_flat_on_a_box_touches_with_both_ends() -> None:
    plant = make_plant(BAR, (*PLANE, BAR.turning_axis(8)), [rg.Box((-2.0, -1.0), (2.0, 0.0))])
    pose = plant.pose(np.array([0.3, 0.101, 0.0]))
    around = surroundings(pose, plant.near(pose, 0.01))
    assert sorted(around.pairs["on_robot"][:, 0].tolist()) == pytest.approx([-0.2, 0.8])
    felt = solve_contacts(around, np.array([True, True]), np.array([0.0, -1.0, 0.0]), np.eye(3), 0.3, np.zeros(2))
    np.testing.assert_allclose(felt.velocity, 0.0, atol=1e-9)
    assert felt.force[:, 1].sum() == pytest.approx(1.0)


def test_a_map_and_its_copies_across_the_seam_are_bodies() -> None:
    axes = (rg.Axis("x", 0, 4, 4, periodic=True), rg.Axis("y", 0, 4, 4))
    mask = np.zeros((4, 4), bool)
    mask[0, 1:3] = True
    plant = make_plant(rg.PointRobot(), axes, [CellSet(axes, mask)])
    near = plant.near(plant.pose(np.array([3.9, 1.5])), 0.2)
    assert near["gap"].min() == pytest.approx(0.1)
    np.testing.assert_allclose(plant.near(plant.pose(np.array([7.9, 1.5])), 0.2)["gap"], near["gap"])


def test_a_body_described_some_turns_away_is_touched_where_it_is() -> None:
    axes = (rg.Axis("x", 0, 4, 8, periodic=True), rg.Axis("y", 0, 4, 8, periodic=True))
    far = make_plant(
        rg.DiscRobot(0.3), axes, [rg.Ball((1.0 + 12.0, 1.0 - 20.0), 0.5), rg.Box((3.0 - 8.0, 2.0), (3.5 - 8.0, 3.0))]
    )
    near = make_plant(rg.DiscRobot(0.3), axes, [rg.Ball((1.0, 1.0), 0.5), rg.Box((3.0, 2.0), (3.5, 3.0))])
    rng = np.random.default_rng(0)
    for place in rng.uniform(-6, 10, (40, 2)):
        gaps = [np.sort(plant.near(plant.pose(place), 1.0)["gap"]) for plant in (far, near)]
        np.testing.assert_allclose(*gaps, atol=1e-12)
        np.testing.assert_allclose(*(plant.axis_penetration(place[np.newaxis]) for plant in (far, near)), atol=1e-12)


@settings(max_examples=100)
@given(st.sampled_from(ROBOTS), st.integers(0, 2**32 - 1))
def test_no_point_moves_farther_in_a_cell_than_the_bound(robot: rg.Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = axes_of(robot)
    plant = make_plant(robot, axes, [])
    a = configuration(robot, rng)
    b = a + rng.uniform(-1, 1, len(axes)) * [axis.spacing for axis in axes]
    shapes = zip(robot.shapes_at(a), robot.shapes_at(b), strict=True)
    assert max(shapely.hausdorff_distance(x, y) for x, y in shapes) <= plant.cell_motion + 1e-12
    assert robot.travel(a[np.newaxis], b[np.newaxis])[0] <= plant.cell_motion + 1e-12


def test_penetration_is_what_radii_overlap() -> None:
    plant = make_plant(rg.DiscRobot(0.5), PLANE, [rg.Box((0.0, -3.0), (1.0, 3.0)), rg.Ball((-2.0, 0.0), 0.5)])
    depth = plant.penetration([(-0.5, 0.0), (-0.4, 0.0), (-1.2, 0.0), (0.5, 0.0)])
    np.testing.assert_allclose(depth, [0.0, 0.1, 0.2, 1.0], atol=1e-9)


def test_scenes_that_cannot_be_touched_are_refused() -> None:
    cube = tuple(rg.Axis(name, 0, 4, 4) for name in "xyz")
    with pytest.raises(rg.InputError, match="a scene in the plane"):
        plant_of(rg.Scene(cube))
    with pytest.raises(rg.InputError, match=r"hidden\[1\].*thicker"):
        plant_of(rg.Scene(PLANE, hidden=(SOLIDS[0], rg.Box((0.0, 0.0), (0.0, 1.0)))))
