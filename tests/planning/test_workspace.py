"""Workspace paths, clearance and collisions of robots, compared with closed forms, finer steps and shapely polygons.

Tests internals: `resgrid.planning.clearance`, `resgrid.planning.workspace`, `resgrid.robots`.
"""

from __future__ import annotations

from math import cos, hypot, pi, sin, tau

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from support.robots import BAR
from support.spaces import space_of

import resgrid as rg
from resgrid.planning.clearance import clearance_of, obstacle_reach
from resgrid.planning.workspace import sample_path
from resgrid.robots import CellSet, to_shapely

ARM = rg.Arm((1.0, 1.0), widths=(0.1, 0.06))
TORUS = rg.ConfigurationSpace(ARM.axes(8), np.zeros((8, 8)), robot=ARM)
PLANE = space_of(np.zeros((10, 10)))
POSES = rg.ConfigurationSpace(
    [rg.Axis("x", 0, 4, 4), rg.Axis("y", 0, 4, 4), BAR.turning_axis(8)], np.zeros((4, 4, 8)), robot=BAR
)


def with_robot(robot: rg.Robot, space: rg.ConfigurationSpace = PLANE) -> rg.ConfigurationSpace:
    """Return the space with a robot."""
    return rg.ConfigurationSpace(space.axes, space.cell, robot=robot)


def test_workspace_paths_are_those_of_the_tip_or_the_reference_point() -> None:
    np.testing.assert_allclose(
        rg.planning.workspace_path(rg.Polyline([(0, pi / 2), (pi, 0)], TORUS)), [(1, 1), (-2, 0)], atol=1e-12
    )
    np.testing.assert_array_equal(rg.planning.workspace_path(rg.Polyline([(1, 2, 3)], POSES)), [(1, 2)])
    cube = space_of(np.zeros((3, 3, 3)))
    np.testing.assert_array_equal(rg.planning.workspace_path(rg.Polyline([(1, 2, 3)], cube)), [(1, 2, 3)])


def test_the_clearance_of_a_sweeping_arm_has_its_closed_form() -> None:
    """The stretched arm turns by a quarter; the disc at 45 degrees lies beyond its round tip."""
    disc = rg.Ball((2.5 * cos(pi / 4), 2.5 * sin(pi / 4)), 0.2)
    sweep = rg.Polyline([(0.0, 0.0), (pi / 2, 0.0)], TORUS)
    step = 0.01
    found = rg.planning.workspace_clearance(sweep, [disc], step=step)
    exact = 2.5 - 2.0 - 0.03 - 0.2
    assert exact - 1e-12 <= found <= exact + step**2
    wall = rg.HalfSpace((0.0, 2.0), -5.0)
    assert rg.planning.workspace_clearance(sweep, [wall]) == pytest.approx(2.5 - 0.05)
    assert rg.check_collisions(sweep, [disc, wall]) is None


def test_the_first_collision_is_reported_with_link_and_obstacle() -> None:
    """The second link of the stretched arm meets a disc on the circle of its centre."""
    angle = 1.0
    obstacles = [rg.Ball((9.0, 9.0), 1.0), rg.Ball((1.5 * cos(angle), 1.5 * sin(angle)), 0.1)]
    hit = rg.check_collisions(rg.Polyline([(0.0, 0.0), (0.5, 0.0), (1.5, 0.0)], TORUS), obstacles, step=1e-3)
    assert hit is not None
    assert (hit.segment, hit.part, hit.obstacle) == (1, 1, 1)
    # The link's side meets the disc when sin(angle - theta) * 1.5 = 0.1 + 0.03.
    assert hit.configuration[0] == pytest.approx(angle - np.arcsin(0.13 / 1.5), abs=1e-3)
    assert rg.planning.workspace_clearance(rg.Polyline([(0.0, 0.0), (1.5, 0.0)], TORUS), obstacles) == 0.0


def test_contact_is_not_a_collision() -> None:
    for robot, wall in ((rg.PointRobot(), 2.0), (rg.DiscRobot(0.5), 1.5)):
        way = rg.Polyline([(0.5, 2.0), (8.0, 2.0)], with_robot(robot))
        for obstacle in (rg.Box((0.0, 0.0), (9.0, wall)), rg.HalfSpace((0.0, 1.0), wall)):
            assert rg.planning.workspace_clearance(way, [obstacle]) == 0.0
            assert rg.check_collisions(way, [obstacle]) is None
        for obstacle in (rg.Box((0.0, 0.0), (9.0, wall + 0.01)), rg.HalfSpace((0.0, 1.0), wall + 0.01)):
            assert rg.check_collisions(way, [obstacle]) is not None


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_robot_travel_bounds_the_motion_of_every_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robots = [
        (rg.Arm((1.0, 0.5, 0.7), widths=(0.2, 0.1, 0.4)), 3),
        (rg.Arm((1.0, 0.5), angles="absolute"), 2),
        (BAR, 3),
        (rg.DiscRobot(0.3), 2),
    ]
    for robot, ndim in robots:
        start = rng.uniform(-3, 3, ndim)
        end = start + rng.uniform(-0.5, 0.5, ndim)
        bound = robot.travel(start[np.newaxis], end[np.newaxis])[0]
        for before, after in zip(robot.shapes_at(start), robot.shapes_at(end), strict=True):
            assert shapely.hausdorff_distance(before, after) <= bound + 1e-9


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_clearances_agree_with_shapely_polygons(seed: int) -> None:
    """Circles are polygons of at least 64 edges, accurate enough to detect errors."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0.5, 2.0, 5)[:, np.newaxis] * np.array([(cos(a), sin(a)) for a in np.arange(5) * tau / 5])
    obstacles = [
        rg.Box((-3.0, 1.0), (-2.0, 2.5)), rg.Ball((2.0, -2.0), 0.7), rg.HalfSpace((1.0, -3.0), -9.0),
        rg.Polygon(tuple(map(tuple, corners + np.array([4, 3])))),
    ]  # fmt: skip
    for robot, space, scale in (
        (ARM, TORUS, 3.0),
        (BAR, POSES, 4.0),
        (rg.DiscRobot(0.4), with_robot(rg.DiscRobot(0.4)), 5.0),
    ):
        pose = rng.uniform(-scale, scale, space.ndim)
        near = min(s.distance(to_shapely(o)) for s in robot.shapes_at(pose) for o in obstacles)
        assert rg.planning.workspace_clearance(rg.Polyline([pose], space), obstacles) == pytest.approx(near, abs=2e-3)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_clearances_of_obstacles_shifted_by_periods_agree_with_sampling(seed: int) -> None:
    """Distances to every image within nine periods, by shapely; sampling and collision tests agree."""
    rng = np.random.default_rng(seed)
    axes = [rg.Axis("x", -1.0, 5.0, 12, True), rg.Axis("y", 2.0, 6.0, 8, bool(rng.integers(2)))]
    period = np.array([axis.upper - axis.lower if axis.periodic else 0.0 for axis in axes])
    size, at = rng.uniform(0.05, [8.0, 1.0]), rng.uniform([-1.0, 2.0], [5.0, 6.0])
    turned = at + rng.integers(-4, 5, 2) * period
    shape = (
        rg.Box(tuple(turned), tuple(turned + size)) if rng.random() < 0.6 else rg.Ball(tuple(turned), float(size[1]))
    )
    robot = rg.DiscRobot(0.1)
    space = rg.ConfigurationSpace(axes, robot.occupancy(axes, [shape], "conservative"), robot=robot)
    way = rg.Polyline(rng.uniform([-1.0, 2.0], [5.0, 6.0], (4, 2)), space)
    shifts = (np.indices((19, 19)).reshape(2, -1).T - 9) * period
    core = shapely.Point(turned) if isinstance(shape, rg.Ball) else to_shapely(shape)
    images = shapely.union_all([shapely.transform(core, lambda points, by=by: points + by) for by in shifts])
    points = shapely.points(sample_path(way, 0.1)[0])
    radius = shape.radius if isinstance(shape, rg.Ball) else 0.0
    nearest = max(float(shapely.distance(points, images).min()) - radius - 0.1, 0.0)
    assert rg.planning.workspace_clearance(way, [shape], step=0.1) == pytest.approx(nearest, abs=1e-12)
    hit = rg.check_collisions(way, [shape], step=0.1)
    assert (hit is None) == (nearest > 0)
    if hit is not None:
        assert space.cell[tuple(space.locate(hit.configuration))] == rg.Cell.OBSTACLE


def test_shapes_and_robots_of_other_dimensions_raise_input_error() -> None:
    """The first two coordinates of a ball's centre must not be taken for those of a disc."""
    for shape in (
        rg.Ball((0.0, 0.0, 0.0), 1.0),
        rg.Box((0, 0, 0), (1, 1, 1)),
        rg.HalfSpace((0.0, 0.0, 1.0), 1.0),
        "wall",
    ):
        with pytest.raises(rg.InputError, match=r"obstacle 0: collision tests|obstacles\[0\] = 'wall'"):
            rg.check_collisions(rg.Polyline([(1.0, 1.0), (2.0, 2.0)], PLANE), [shape])
    for robot in (BAR, rg.Arm((1.0, 1.0, 1.0))):
        with pytest.raises(rg.InputError):
            rg.check_collisions(rg.Polyline([(1.0, 1.0), (2.0, 2.0)], with_robot(robot)), [])


def test_a_half_plane_inclined_along_a_periodic_axis_raises_input_error() -> None:
    ring = space_of(np.zeros((4, 4)), periodic=(True, False))
    assert rg.planning.workspace_clearance(
        rg.Polyline([(1.0, 3.0)], ring), [rg.HalfSpace((0.0, 1.0), 1.0)]
    ) == pytest.approx(2.0)
    with pytest.raises(rg.InputError, match="component along the periodic axis"):
        rg.check_collisions(rg.Polyline([(1.0, 3.0)], ring), [rg.HalfSpace((1.0, 1.0), 1.0)])


def test_clearance_from_map_cells_includes_seams() -> None:
    cell = np.zeros((10, 6), dtype=np.uint8)
    cell[9, 2:4], cell[4, 3] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    space = space_of(cell, periodic=(True, False))
    obstacles = [CellSet(space.axes, space.cell == rg.Cell.OBSTACLE)]
    assert rg.planning.workspace_clearance(
        rg.Polyline([(0.5, 2.5)], with_robot(rg.PointRobot(0.25), space)), obstacles
    ) == pytest.approx(0.25)
    assert rg.planning.workspace_clearance(rg.Polyline([(10.5, 1.0)], space), obstacles) == pytest.approx(
        hypot(0.5, 1.0)
    )
    path = rg.streamline(rg.field(rg.solve(rg.compile_space(space))), start=(0.5, 0.5))
    assert rg.check_collisions(path, obstacles) is None
    cells_apart = clearance_of(rg.planning.unwrap(path), space, ("periodic", "open"), obstacle_reach(space))
    assert rg.planning.workspace_clearance(path, obstacles) == pytest.approx(cells_apart, abs=1e-2)
    assert rg.check_collisions(rg.Polyline([(0.5, 2.5), (-0.5, 2.5)], space), obstacles) is not None


def test_paths_of_an_arm_have_no_collision_in_the_workspace() -> None:
    """Conservative cells, a streamline and its shortcut, tested with exact geometry."""
    obstacles = [rg.Box((1.0, 1.0), (1.3, 1.2)), rg.Ball((-1.3, 0.9), 0.2)]
    axes = ARM.axes(60)
    cell = ARM.occupancy(axes, obstacles, "conservative").astype(np.uint8)
    cell[ARM.goal_cells(axes, rg.Box((-0.3, 1.5), (0.1, 1.9))).cells & (cell == 0)] = rg.Cell.GOAL
    space = rg.ConfigurationSpace(axes, cell, robot=ARM)
    field = rg.field(rg.solve(rg.compile_space(space)))
    path = rg.streamline(field, start=(-0.5, 0.3))
    short = rg.shortcut(path)
    assert short.length < path.length
    for way in (path, short):
        assert rg.check_collisions(way, obstacles, step=5e-3) is None
    assert rg.planning.workspace_clearance(path, obstacles) > 0


def test_sample_path_limits_the_step_length() -> None:
    way = [(0.0, 0.0), (1.0, 2.0), (1.0, 2.0), (-1.0, 0.5)]
    configurations, segment = sample_path(rg.Polyline(way, TORUS), 0.05)
    assert ARM.travel(configurations[:-1], configurations[1:]).max() <= 0.05 * (1 + 1e-9)
    assert segment.tolist() == sorted(segment.tolist())
    assert set(segment.tolist()) == {0, 1, 2}
    np.testing.assert_array_equal(configurations[[0, -1]], [way[0], way[-1]])


def test_unknown_robots_invalid_steps_and_3d_paths_raise_input_error() -> None:
    class Snake:
        pass

    with pytest.raises(rg.InputError, match="Snake"):
        rg.check_collisions(rg.Polyline([(0, 0), (1, 1)], with_robot(Snake())), [])  # type: ignore[arg-type]
    for step in (0.0, -1.0, float("nan"), 1e-12):
        with pytest.raises(rg.InputError, match="step"):
            rg.check_collisions(rg.Polyline([(0, 0), (9, 9)], PLANE), [], step=step)
    with pytest.raises(rg.InputError, match="plane only"):
        rg.check_collisions(rg.Polyline([(0, 0, 0), (1, 1, 1)], space_of(np.zeros((2, 2, 2)))), [])
    assert rg.planning.workspace_clearance(rg.Polyline([(0, 0), (1, 1)], PLANE), []) == np.inf
