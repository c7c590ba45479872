"""Polygon and disc robots: occupancy, Minkowski sums and goals, compared with shapely.

Tests internals: `resgrid.robots`, `resgrid.scene.overrides`.
"""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st

import resgrid as rg
from resgrid.robots import CellSet, to_shapely
from resgrid.scene.overrides import apply_overrides

OBSTACLES = [
    rg.Box((0.5, 0.2), (0.7, 1.1)),
    rg.Polygon(((1.2, 1.0), (2.0, 0.9), (2.1, 1.7), (1.6, 1.3), (1.1, 1.8))),
    rg.Polygon(((2.2, 0.1), (3.0, 0.1), (3.0, 0.9), (2.2, 0.9)), (((2.3, 0.2), (2.9, 0.2), (2.9, 0.8), (2.3, 0.8)),)),
    rg.Ball((0.4, 1.7), 0.15),
    rg.HalfSpace((-1.0, 0.2), -2.9),
]
ELL = rg.PolygonRobot(((-0.2, -0.05), (0.25, -0.05), (0.25, 0.05), (-0.1, 0.05), (-0.1, 0.2), (-0.2, 0.2)), 0.3)
KITE = rg.PolygonRobot(((0.2, 0.0), (0.0, 0.06), (-0.1, 0.0), (0.0, -0.06)))
GEOMETRY = shapely.union_all([to_shapely(shape) for shape in OBSTACLES])


def axes_of(robot, cells=(30, 20, 16)):
    return rg.Axis("x", 0, 3, cells[0]), rg.Axis("y", 0, 2, cells[1]), robot.turning_axis(cells[2])


def gaps(robot, configurations):
    """Exact distance of the robot from the obstacles."""
    return shapely.distance(shapely.polygons(robot.corners(configurations)), GEOMETRY)


@pytest.mark.parametrize("robot", [ELL, KITE])
def test_no_configuration_in_a_free_cell_collides(robot):
    axes = axes_of(robot)
    blocked = robot.occupancy(axes, OBSTACLES, "conservative")
    assert 0.2 < blocked.mean() < 0.8
    rng = np.random.default_rng(0)
    cells = np.argwhere(~blocked)
    chosen = cells[rng.integers(len(cells), size=40_000)]
    share = rng.random(chosen.shape)
    share[:10_000] = np.round(share[:10_000])  # corners of the cells
    inside = (chosen + 1e-6 + (1 - 2e-6) * share) * [axis.spacing for axis in axes]
    assert (gaps(robot, inside) > 0).all()


@pytest.mark.parametrize("robot", [ELL, KITE])
def test_the_centre_rule_equals_exact_collision_tests_at_cell_centres(robot):
    axes = axes_of(robot)
    blocked = robot.occupancy(axes, OBSTACLES, "centre")
    grid = np.stack(np.meshgrid(*(axis.centres for axis in axes), indexing="ij"), axis=-1)
    distance = gaps(robot, grid)
    disc = shapely.distance(shapely.polygons(robot.corners(grid)), shapely.Point(0.4, 1.7)) - 0.15
    clear = np.abs(disc) > 1e-3
    assert (blocked == (distance <= 0))[clear].all()
    conservative = robot.occupancy(axes, OBSTACLES, "conservative")
    assert not (blocked & ~conservative).any()
    lost = conservative.mean() - blocked.mean()
    assert 0 < lost < 0.2, f"{lost:.2%} of the volume is lost to the conservative rule at this coarse grid"


@pytest.mark.slow
def test_few_blocked_cells_are_entirely_free_at_fine_headings():
    axes = axes_of(KITE, (30, 20, 64))
    blocked = KITE.occupancy(axes, OBSTACLES, "conservative")
    cells = np.argwhere(blocked)
    hit = np.zeros(len(cells), dtype=bool)
    for share in np.stack(np.meshgrid(*[np.linspace(0, 1, 5)] * 3), axis=-1).reshape(-1, 3):
        rest = np.flatnonzero(~hit)
        hit[rest] = gaps(KITE, (cells[rest] + share) * [axis.spacing for axis in axes]) <= 0
    assert (~hit).sum() / (~blocked).sum() < 0.03


WALLS = [
    rg.Box((0.9, 0.5), (1.0, 1.2)),  # as long as the bar
    rg.Box((1.0, 0.5), (1.7, 0.62)),  # as long and as thick as the bar, adjacent to the first box
    rg.Polygon(((2.0, 1.0), (2.35, 1.0), (2.7, 1.0), (2.7, 1.7), (2.35, 1.7), (2.0, 1.7)),
            (((2.12, 1.12), (2.12, 1.58), (2.35, 1.58), (2.58, 1.58), (2.58, 1.12)),)),
    rg.Polygon(((0.3, 1.5), (1.0, 1.5), (1.0, 1.62), (0.42, 1.62), (0.42, 1.82), (0.3, 1.82))),  # the robot itself
    rg.Box((1.5, 0.2), (2.2, 0.2)),  # a line
]  # fmt: skip
BAR = rg.PolygonRobot(((-0.35, -0.06), (0.0, -0.06), (0.35, -0.06), (0.35, 0.06), (-0.35, 0.06)))
CORNER = rg.PolygonRobot(((-0.35, -0.06), (0.35, -0.06), (0.35, 0.06), (-0.23, 0.06), (-0.23, 0.26), (-0.35, 0.26)))


def overlaps(robot, configurations, obstacles):
    """Masks of certain overlaps (with an area) and of possible ones (within rounding errors)."""
    shapes = shapely.polygons(robot.corners(configurations))
    geometries = [to_shapely(shape) for shape in obstacles]
    sure = np.zeros(shapes.shape, dtype=bool)
    perhaps = np.zeros(shapes.shape, dtype=bool)
    for geometry in geometries:
        near = shapely.distance(shapes, geometry) <= 1e-9
        perhaps |= near
        shared = shapely.intersection(shapes[near], geometry)
        sure[near] |= (shapely.area(shared) > 1e-9) | (~shapely.is_empty(shared) & (geometry.area == 0))
    return sure, perhaps


@pytest.mark.parametrize("robot", [BAR, CORNER, rg.PolygonRobot(BAR.vertices[::-1])])
@pytest.mark.parametrize("turns", [4, 12, 36])
@pytest.mark.quick_cases(3)
def test_coincident_edges_hide_no_collision(robot, turns):
    axes = axes_of(robot, (30, 20, turns))
    grid = np.stack(np.meshgrid(*(axis.centres for axis in axes), indexing="ij"), axis=-1)
    sure, perhaps = overlaps(robot, grid, WALLS)
    centre = robot.occupancy(axes, WALLS, "centre")
    assert not (sure & ~centre).any()
    assert not (centre & ~perhaps).any()
    free = ~robot.occupancy(axes, WALLS, "conservative")
    assert free.any()
    corners = np.stack(np.meshgrid(*[(-0.5, 0.0, 0.5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    chosen = np.random.default_rng(0).choice(np.argwhere(free), 300)
    inside = ((chosen + 0.5)[:, None] + corners) * [axis.spacing for axis in axes]
    assert not overlaps(robot, inside, WALLS)[1].any()


@pytest.mark.parametrize("turns", [5, 24, 36, 64, 72])
def test_the_shipped_scene_has_no_collision_at_any_number_of_headings(scenes, turns):
    scene = apply_overrides(rg.read_scene(scenes / "turning.toml"), {"grid.axes.2.cells": str(turns)})
    space = rg.build_space(scene)
    free = np.argwhere(space.cell != rg.Cell.OBSTACLE)
    chosen = np.random.default_rng(turns).choice(free, 500)
    share = np.random.default_rng(0).choice([0.0, 0.5, 1.0], (500, 3))
    assert not overlaps(scene.robot, space.lower + (chosen + share) * space.spacing, scene.obstacles)[1].any()


@pytest.mark.slow
@pytest.mark.parametrize("robot", [BAR, ELL])
def test_map_cells_are_obstacles_of_turning_robots(robot):
    """Irregular walls, single cells, a ring around a cell, and cells smaller than the robot."""
    rng = np.random.default_rng(1)
    mask = rng.random((30, 20)) < 0.03
    mask[10:20, 4:14], mask[11:19, 5:13], mask[15, 9] = True, False, True
    mask[:, 0] = True
    axes = axes_of(robot, (45, 30, 12))
    cells = CellSet((rg.Axis("x", 0, 3, 30), rg.Axis("y", 0, 2, 20)), mask)
    boxes = cells.boxes()
    assert np.isclose(shapely.union_all([to_shapely(box) for box in boxes]).area, to_shapely(cells).area)
    for rule in ("centre", "conservative"):
        blocked = robot.occupancy(axes, [cells], rule)
        assert 0.1 < blocked.mean() < 0.99
        np.testing.assert_array_equal(blocked, robot.occupancy(axes, boxes, rule))
    grid = np.stack(np.meshgrid(*(axis.centres for axis in axes), indexing="ij"), axis=-1)
    sure, perhaps = overlaps(robot, grid, [cells])
    centre = robot.occupancy(axes, [cells], "centre")
    assert not (sure & ~centre).any()
    assert not (centre & ~perhaps).any()
    assert not robot.occupancy(axes, [CellSet(cells.axes, np.zeros_like(mask))], "conservative").any()


simple = st.sampled_from(
    [ELL.vertices, KITE.vertices, ((0, 0), (1, 0.2), (0.3, 0.9)), ((0, 0), (1, 0), (1, 1), (0, 1))]
)


@settings(max_examples=40)
@given(simple, st.floats(0, 6.3), st.integers(0, 2), st.integers(0, 99))
def test_layers_equal_minkowski_sums(vertices, turn, which, seed):
    polygon = rg.Polygon(((0.5, 0.2), (0.7, 0.2), (0.7, 1.1), (0.5, 1.1))) if which == 0 else OBSTACLES[which]
    robot = rg.PolygonRobot(tuple((float(x), float(y)) for x, y in vertices))
    low = np.random.default_rng(seed).uniform(-1, 0, 2).tolist()
    axes = (
        *(rg.Axis(name, at, at + 6, 24) for name, at in zip("xy", low, strict=True)),
        rg.Axis("t", turn - 1, turn + 1, 1),
    )
    layer = robot.occupancy(axes, [polygon], "centre")
    points = low + (np.argwhere(np.ones(layer.shape[:2])) + 0.5) * 0.25
    shifted = shapely.polygons(robot.corners([(*point, turn) for point in points]))
    meets = shapely.intersects(shifted, to_shapely(polygon))
    sure = np.abs(shapely.distance(shifted, to_shapely(polygon).boundary)) > 1e-9
    sure |= ~meets
    assert (layer.ravel() == meets)[sure].all()


def test_headings_are_measured_as_arc_lengths():
    assert np.isclose(ELL.turning_axis(16).upper, 2 * np.pi * 0.3)
    quarter = ELL.corners((1.0, 2.0, 0.3 * np.pi / 2))
    assert np.allclose(quarter, [(1.0 - y, 2.0 + x) for x, y in ELL.vertices])
    (shape,) = ELL.shapes_at((1.0, 2.0, 0.3 * np.pi / 2))
    assert np.isclose(shape.area, shapely.Polygon(ELL.vertices).area)


def test_goals_are_places_at_any_heading_or_configurations():
    axes = axes_of(ELL, (6, 4, 8))
    place, points = ELL.goal_cells(axes, rg.Box((0.6, 1.0), (1.1, 1.4)))
    assert np.argwhere(place[:, :, 0]).tolist() == [[1, 2], [2, 2]]
    assert place[1:3, 2].all()
    turns = axes[2].centres
    assert np.allclose(points, [*((0.75, 1.25, turn) for turn in turns), *((1.1, 1.25, turn) for turn in turns)])
    cells, points = ELL.goal_cells(axes, (0.6, 1.2, 0.1))
    assert np.argwhere(cells).tolist() == [[1, 2, 0]]
    assert np.allclose(points, [(0.6, 1.2, 0.1)])
    assert ELL.goal_cells(axes, (0.6, 1.2)).cells.sum() == 8


def test_a_disc_robot_equals_a_point_robot_with_a_radius():
    axes = (rg.Axis("x", 0, 3, 30), rg.Axis("y", 0, 2, 20))
    for rule in ("conservative", "centre"):
        assert (
            rg.DiscRobot(0.2).occupancy(axes, OBSTACLES, rule) == rg.PointRobot(0.2).occupancy(axes, OBSTACLES, rule)
        ).all()
    (shape,) = rg.DiscRobot(0.2).shapes_at((1, 1))
    assert np.isclose(shape.area, 0.04 * np.pi, rtol=1e-2)
    assert rg.DiscRobot(0.2).goal_cells(axes, (1.05, 1.05)).cells.sum() == 1


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: rg.PolygonRobot(((0, 0), (1, 1), (1, 0), (0, 1))), "not simple"),
        (lambda: rg.PolygonRobot(((0, 0), (1, 1))), "three corners"),
        (lambda: rg.PolygonRobot(KITE.vertices, 0.0), "turning_length = 0.0"),
        (lambda: KITE.occupancy(axes_of(KITE)[:2], [], "centre"), "needs 3 axes"),
        (lambda: KITE.occupancy(axes_of(ELL), [], "centre"), "full turn is 2 pi"),
        (lambda: KITE.occupancy((rg.Axis("x", 0, 1, 3, True), *axes_of(KITE)[1:]), [], "centre"), "cannot be periodic"),
        (lambda: KITE.corners((1, 2)), "x, y, theta"),
        (lambda: rg.DiscRobot(0.0), "above 0"),
        (lambda: rg.DiscRobot(1.0).occupancy(axes_of(KITE), [], "centre"), "needs 2 axes"),
        (lambda: rg.PointRobot().shapes_at((1, 2, 3)), "2 coordinates"),
    ],
)
def test_invalid_robots_raise_input_error_with_a_remedy(make, expected):
    with pytest.raises(rg.InputError, match=expected):
        make()


def test_polygon_and_disc_robots_implement_the_robot_protocol():
    assert isinstance(ELL, rg.Robot)
    assert isinstance(rg.DiscRobot(1.0), rg.Robot)
