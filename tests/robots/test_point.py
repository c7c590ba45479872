"""Occupancy and goals of point robots, compared with random points in cells, shapely distances and enumeration.

Tests internals: `resgrid.core.space`, `resgrid.robots`.
"""

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st

import resgrid as rg
from resgrid.core.space import label_regions
from resgrid.robots import CellSet

AXES = (rg.Axis("x", -1.0, 2.0, 12), rg.Axis("y", 0.0, 2.0, 5))
coordinate = st.floats(-2, 3, allow_nan=False).map(lambda value: round(value, 3))
radius = st.sampled_from([0.0, 0.05, 0.25, 0.7])


def boxes(axes):
    cells = itertools.product(*(range(axis.cells) for axis in axes))
    for cell in cells:
        lower = np.array([axis.lower + i * axis.spacing for i, axis in zip(cell, axes, strict=True)])
        yield cell, lower, lower + [axis.spacing for axis in axes]


def inside(shape, points, reach):
    """Return whether points lie within a distance of a shape, independent of occupancy code."""
    match shape:
        case rg.Box(lower, upper):
            return np.linalg.norm(points - np.clip(points, lower, upper), axis=1) <= reach
        case rg.Ball(centre, size):
            return np.linalg.norm(points - np.array(centre), axis=1) <= reach + size
        case rg.HalfSpace(normal, offset):
            return points @ np.array(normal) <= offset + reach * np.linalg.norm(normal)
        case rg.Polygon(vertices, holes):
            polygon = shapely.Polygon(vertices, holes)
            return shapely.distance(polygon, shapely.points(points)) <= reach
    raise AssertionError


@st.composite
def shapes(draw, ndim=2):
    kind = draw(st.sampled_from(["box", "ball", "half"] + ["polygon"] * (ndim == 2)))
    if kind == "box":
        corners = [sorted((draw(coordinate), draw(coordinate))) for _ in range(ndim)]
        return rg.Box(tuple(c[0] for c in corners), tuple(c[1] for c in corners))
    centre = tuple(draw(coordinate) for _ in range(ndim))
    if kind == "ball":
        return rg.Ball(centre, draw(st.sampled_from([0.0, 0.1, 0.6, 1.3])))
    if kind == "half":
        angle = draw(st.floats(0, 6.28))
        normal = (np.cos(angle), np.sin(angle), 0.5)[:ndim]
        return rg.HalfSpace(tuple(map(float, normal)), draw(coordinate))
    count = draw(st.integers(3, 8))
    angles = np.sort(draw(st.lists(st.integers(0, 628), min_size=count, max_size=count, unique=True))) / 100
    lengths = draw(st.lists(st.sampled_from([0.2, 0.7, 1.5]), min_size=count, max_size=count))
    vertices = tuple(
        (centre[0] + size * float(np.cos(a)), centre[1] + size * float(np.sin(a)))
        for a, size in zip(angles, lengths, strict=True)
    )
    if not shapely.Polygon(vertices).is_valid or shapely.Polygon(vertices).area < 1e-3:
        vertices = ((0.0, 0.0), (1.0, 0.3), (0.2, 1.1))
    return rg.Polygon(vertices)


@settings(max_examples=150)
@given(shape=shapes(), reach=radius, seed=st.integers(0, 1000))
def test_free_cells_contain_no_point_of_a_grown_obstacle(shape, reach, seed):
    blocked = rg.PointRobot(reach).occupancy(AXES, [shape], "conservative")
    rng = np.random.default_rng(seed)
    for cell, lower, upper in boxes(AXES):
        share = np.concatenate([rng.random((20, 2)), [[0, 0], [0, 1], [1, 0], [1, 1], [0.5, 0.5]]])
        rim = 1e-7
        points = lower + rim + share * (upper - lower - 2 * rim)
        if not blocked[cell]:
            assert not inside(shape, points, max(reach - 1e-7, 0.0)).any()


@settings(max_examples=100)
@given(shape=shapes(), reach=radius)
def test_blocked_cells_lie_within_the_radius_by_shapely(shape, reach):
    if isinstance(shape, rg.Ball):
        geometry, within = shapely.Point(shape.centre), reach + shape.radius
    elif isinstance(shape, rg.Box):
        geometry, within = shapely.box(*shape.lower, *shape.upper), reach
    elif isinstance(shape, rg.Polygon):
        geometry, within = shapely.Polygon(shape.vertices), reach
    else:
        return
    blocked = rg.PointRobot(reach).occupancy(AXES, [shape], "conservative")
    for cell, lower, upper in boxes(AXES):
        gap = shapely.distance(shapely.box(*(lower + 1e-7), *(upper - 1e-7)), geometry)
        if abs(gap - within) > 1e-6:
            assert blocked[cell] == (gap < within), (cell, gap, within)


@settings(max_examples=60)
@given(shape=shapes(), reach=radius)
def test_the_centre_rule_depends_on_cell_centres_only(shape, reach):
    blocked = rg.PointRobot(reach).occupancy(AXES, [shape], "centre")
    centres = np.array([(lower + upper) / 2 for _, lower, upper in boxes(AXES)])
    sure = inside(shape, centres, max(reach - 1e-9, 0.0))
    maybe = inside(shape, centres, reach + 1e-9)
    assert (sure.reshape(blocked.shape) <= blocked).all()
    assert (blocked <= maybe.reshape(blocked.shape)).all()


@settings(max_examples=40)
@given(shape=shapes(ndim=3), reach=radius)
def test_occupancy_in_three_dimensions_agrees_with_points(shape, reach):
    axes = (rg.Axis("x", -1, 2, 4), rg.Axis("y", -1, 2, 5), rg.Axis("z", 0, 1, 3))
    blocked = rg.PointRobot(reach).occupancy(axes, [shape], "conservative")
    rng = np.random.default_rng(0)
    for cell, lower, upper in boxes(axes):
        points = lower + rng.random((40, 3)) * (upper - lower)
        assert blocked[cell] >= inside(shape, points, max(reach - 1e-7, 0.0)).any()
        if blocked[cell]:
            dense = lower + np.array(list(itertools.product(np.linspace(0, 1, 9), repeat=3))) * (upper - lower)
            assert inside(shape, dense, reach + 0.1).any()


def test_an_edge_on_a_cell_border_does_not_block_the_neighbour():
    axes = (rg.Axis("x", 0, 1, 10), rg.Axis("y", 0, 1, 10))
    blocked = rg.PointRobot().occupancy(axes, [rg.Box((0.3, 0.1), (0.6, 0.7))], "conservative")
    expected = np.zeros((10, 10), dtype=bool)
    expected[3:6, 1:7] = True
    assert (blocked == expected).all()
    grown = rg.PointRobot(0.1).occupancy(axes, [rg.Box((0.3, 0.3), (0.6, 0.6))], "conservative")
    assert grown.sum() == 25 - 4 + 4  # the corners of the rounded square still meet their cells
    assert (rg.PointRobot(0.1).occupancy(axes, [rg.Box((0.3, 0.3), (0.6, 0.6))], "centre").sum()) == 25


@pytest.mark.parametrize("at", [5.0, 5.1, 3.0000000000000004, 0.0, 10.0])
@pytest.mark.parametrize("width", [0.0, 1e-13, 1e-10])
@pytest.mark.parametrize("along", [0, 1])
def test_a_wall_without_thickness_separates_the_grid(at, width, along):
    axes = (rg.Axis("x", 0, 10, 20), rg.Axis("y", 0, 10, 20))
    lower, upper = [(at, 0.0), (at + width, 10.0)] if along else [(0.0, at), (10.0, at + width)]
    ring = (lower, (upper[0], lower[1]), upper, (lower[0], upper[1]))
    shapes = [rg.Box(lower, upper), rg.Polygon(ring)] if width > 1e-12 else [rg.Box(lower, upper)]
    for shape in shapes:
        blocked = rg.PointRobot().occupancy(axes, [shape], "conservative")
        assert label_regions(~blocked, [False, False]).max() == (2 if 0 < at < 10 else 1)
        for cell, low, high in boxes(axes):
            if not blocked[cell]:
                assert shapely.distance(shapely.box(*low, *high), shapely.LineString([lower, upper])) > 0
        assert blocked.any(axis=along).sum() <= 2


def test_a_point_on_a_corner_blocks_all_adjacent_cells():
    axes = (rg.Axis("x", 0, 10, 20), rg.Axis("y", 0, 10, 20))
    for shape in (rg.Ball((5.0, 5.0), 0.0), rg.Ball((5.0, 5.0), 1e-12), rg.Box((5.0, 5.0), (5.0, 5.0))):
        blocked = rg.PointRobot().occupancy(axes, [shape], "conservative")
        assert np.argwhere(blocked).tolist() == [[9, 9], [9, 10], [10, 9], [10, 10]]


@pytest.mark.parametrize("wide", [1e4, 1e10, 1e-6])
def test_the_tolerance_of_a_cell_is_relative_to_its_width(wide):
    axes = (rg.Axis("x", 0, wide, 10), rg.Axis("y", 0, 1e-5, 10))
    for shape in (rg.Box((0, 2.1e-6), (wide, 2.4e-6)), rg.Polygon(((0, 2.1e-6), (wide, 2.1e-6), (wide, 2.4e-6)))):
        blocked = rg.PointRobot().occupancy(axes, [shape], "conservative")
        assert np.argwhere(blocked).tolist() == [[column, 2] for column in range(10)]


@pytest.mark.parametrize("size", [1e-300, 1e-12, 1e-10, 5e-10])
def test_a_tiny_radius_keeps_all_obstacles(size):
    axes = (rg.Axis("x", 0, 10, 10), rg.Axis("y", 0, 10, 10))
    mask = np.zeros((10, 10), dtype=bool)
    mask[5, 2:8] = True
    for shape in (CellSet(axes, mask), rg.Box((5, 2), (6, 8))):
        assert (rg.PointRobot(size).occupancy(axes, [shape], "conservative") == mask).all()


@pytest.mark.parametrize("size", [1e16, 1e30, 1e59])
def test_edges_with_distant_ends_are_exact(size):
    axes = (rg.Axis("x", 0, 10, 20), rg.Axis("y", 0, 10, 20))
    diagonal = rg.Polygon(((-size, -size), (size, size), (size, -size)))
    x, y = np.indices((20, 20))
    assert (rg.PointRobot().occupancy(axes, [diagonal], "conservative") == (y <= x)).all()
    assert (rg.PointRobot(0.6).occupancy(axes, [diagonal], "conservative") == (y <= x + 2)).all()
    flat = rg.Polygon(((-size, 4.0), (size, 4.0), (size, 6.0), (-size, 6.0)), (((1.0, 4.5), (9.0, 4.5), (9.0, 5.5)),))
    near = rg.Polygon(((-20.0, 4.0), (20.0, 4.0), (20.0, 6.0), (-20.0, 6.0)), flat.holes)
    for rule in ("conservative", "centre"):
        assert (rg.PointRobot().occupancy(axes, [flat], rule) == rg.PointRobot().occupancy(axes, [near], rule)).all()


def test_a_polygon_with_a_hole_leaves_the_hole_free():
    axes = (rg.Axis("x", 0, 9, 9), rg.Axis("y", 0, 9, 9))
    ring = rg.Polygon(((1, 1), (8, 1), (8, 8), (1, 8)), (((3, 3), (6, 3), (6, 6), (3, 6)),))
    blocked = rg.PointRobot().occupancy(axes, [ring], "conservative")
    expected = np.zeros((9, 9), dtype=bool)
    expected[1:8, 1:8] = True
    expected[3:6, 3:6] = False
    assert (blocked == expected).all()
    assert rg.PointRobot(1.0).occupancy(axes, [ring], "conservative")[3:6, 3:6].sum() == 8


def test_long_edges_agree_with_shapely():
    axes = (rg.Axis("x", 0, 1, 300), rg.Axis("y", 0, 2, 200))
    polygon = rg.Polygon(((-3.0, -0.1), (0.9, 0.2), (5.0, 9.0), (0.4, 1.7)))
    blocked = rg.PointRobot(0.013).occupancy(axes, [polygon], "conservative")
    x, y = np.meshgrid(axes[0].edges[:-1], axes[1].edges[:-1], indexing="ij")
    cells = shapely.box(x, y, x + axes[0].spacing, y + axes[1].spacing)
    gap = shapely.distance(cells, shapely.Polygon(polygon.vertices))
    clear = np.abs(gap - 0.013) > 1e-7
    assert (blocked == (gap < 0.013))[clear].all()
    assert clear.mean() > 0.99


@pytest.mark.parametrize("rule", ["conservative", "centre"])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("reach", [0.0, 0.2, 0.55, 1.0, 1.7])
def test_map_cells_grow_by_the_exact_distance_between_boxes(rule, periodic, reach):
    axes = (rg.Axis("x", 0, 5.0, 10, periodic), rg.Axis("y", 0, 4.2, 14))
    mask = np.random.default_rng(3).random((10, 14)) < 0.03
    blocked = rg.PointRobot(reach).occupancy(axes, [CellSet(axes, mask)], rule)
    slack = 1.0 if rule == "conservative" else 0.5
    expected = mask.copy()
    for i, j in itertools.product(range(10), range(14)):
        for a, b in np.argwhere(mask):
            apart = min(abs(i - a), 10 - abs(i - a)) if periodic else abs(i - a)
            gap = np.hypot(max(apart - slack, 0) * 0.5, max(abs(j - b) - slack, 0) * 0.3)
            expected[i, j] |= reach > 0 and (gap < reach - 1e-9 or (rule == "centre" and gap <= reach))
    assert (blocked == expected).all()


def test_shapes_wrap_around_periodic_axes():
    axes = (rg.Axis("x", 0, 8, 8, periodic=True), rg.Axis("y", 0, 2, 2))
    blocked = rg.PointRobot().occupancy(axes, [rg.Box((7, 0), (10, 1))], "conservative")
    assert blocked[:, 0].tolist() == [True, True, False, False, False, False, False, True]
    same = rg.PointRobot().occupancy(axes, [rg.Box((7 - 80, 0), (10 - 80, 1))], "conservative")
    assert (same == blocked).all()
    assert rg.PointRobot(1.5).occupancy(axes, [rg.Box((0, 0), (1, 2))], "conservative")[:, 0].sum() == 5
    assert rg.PointRobot().occupancy(axes, [rg.Box((-3, 0), (40, 2))], "conservative").all()


def test_invalid_shapes_raise_input_error():
    ring = (rg.Axis("x", 0, 8, 8, periodic=True), rg.Axis("y", 0, 2, 2))
    with pytest.raises(rg.InputError, match="periodic axis 'x'"):
        rg.PointRobot().occupancy(ring, [rg.HalfSpace((1, 0), 3)], "conservative")
    with pytest.raises(rg.InputError, match="winds around"):
        rg.PointRobot().occupancy(ring, [rg.Box((0, 0), (1e12, 1))], "conservative")
    rings = tuple(rg.Axis(name, 0, 4, 4, periodic=True) for name in "xyz")
    with pytest.raises(rg.InputError, match="more than 1000 times"):
        rg.PointRobot().goal_cells(rings, rg.Ball((0, 0, 0), 100))
    with pytest.raises(rg.InputError, match="3 coordinates"):
        rg.PointRobot().occupancy(ring, [rg.Ball((0, 0, 0), 1)], "conservative")
    with pytest.raises(rg.InputError, match="not simple"):
        rg.Polygon(((0, 0), (1, 1), (1, 0), (0, 1)))
    with pytest.raises(rg.InputError, match="finite"):
        rg.Ball((0, float("nan")), 1)
    with pytest.raises(rg.InputError, match="at least 0"):
        rg.PointRobot(-1)
    assert rg.PointRobot().occupancy(ring, [rg.HalfSpace((0, 1), 1)], "conservative")[:, 0].all()


def test_point_robots_implement_the_robot_protocol():
    assert isinstance(rg.PointRobot(), rg.Robot)


@pytest.mark.slow
@settings(max_examples=120)
@given(shape=shapes())
def test_goal_points_are_the_nearest_to_cell_centres(shape):
    cells, points = rg.PointRobot().goal_cells(AXES, shape)
    here = dict(zip(map(tuple, np.argwhere(cells).tolist()), points, strict=True))
    for cell, lower, upper in boxes(AXES):
        dense = lower + np.array(list(itertools.product(np.linspace(0, 1, 21), repeat=2))) * (upper - lower)
        hit = dense[inside(shape, dense, 0.0)]
        if cell not in here:
            assert not inside(shape, dense[np.all((dense > lower + 1e-7) & (dense < upper - 1e-7), axis=1)], 0).any()
            continue
        point = here[cell]
        assert (point >= lower - 1e-12).all()
        assert (point <= upper + 1e-12).all()
        assert inside(shape, point[None], 1e-9).all()
        if len(hit):
            middle = (lower + upper) / 2
            assert np.linalg.norm(point - middle) <= np.linalg.norm(hit - middle, axis=1).min() + 1e-9


@settings(max_examples=60)
@given(shape=shapes(ndim=3))
def test_goals_in_three_dimensions_have_a_point_in_every_cell(shape):
    axes = (rg.Axis("x", -1, 2, 4), rg.Axis("y", -1, 2, 5), rg.Axis("z", 0, 1, 3))
    cells, points = rg.PointRobot().goal_cells(axes, shape)
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    assert (np.abs((points - lower) / spacing - np.argwhere(cells) - 0.5) <= 0.5 + 1e-9).all()
    assert inside(shape, points, 1e-9).all()


def test_goals_with_distant_or_repeated_corners_have_goal_points():
    axes = (rg.Axis("x", 0, 10, 20), rg.Axis("y", 0, 10, 20))
    far = rg.Polygon(((-1e30, -1e30), (-1e30, -1e30), (1e30, 1e30), (1e30, -1e30)))
    near = rg.Polygon(((-30, -30), (-30, -30), (30, 30), (30, -30)))
    for region in (far, near):
        cells, points = rg.PointRobot().goal_cells(axes, region)
        assert (cells == np.tri(20, dtype=bool)).all()
        assert (points[:, 1] <= points[:, 0] + 1e-12).all()
        assert np.allclose(points, (np.argwhere(cells) + 0.5) / 2)


def test_goals_wrap_around_periodic_axes_and_smaller_goals_are_subsets():
    axes = (rg.Axis("x", 0, 8, 8, periodic=True), rg.Axis("y", 0, 2, 2))
    cells, points = rg.PointRobot().goal_cells(axes, rg.Box((7.5, 0), (8.2, 1)))
    assert np.argwhere(cells).tolist() == [[0, 0], [7, 0]]
    assert np.allclose(points, [(0.2, 0.5), (7.5, 0.5)])
    cells, points = rg.PointRobot().goal_cells(axes, (-0.5, 2.0))
    assert np.argwhere(cells).tolist() == [[7, 1]]
    assert np.allclose(points, [(7.5, 2.0)])
    masks = [
        rg.PointRobot().goal_cells(axes, rg.Ball((3.4, 0.8), size)).cells for size in (1.5, 0.5, 0.4, 0.39, 0.1, 0.0)
    ]
    for larger, smaller in itertools.pairwise(masks):
        assert smaller.any()
        assert not (smaller & ~larger).any()


def test_a_disc_robot_requires_a_radius():
    with pytest.raises(TypeError, match="radius"):
        rg.DiscRobot()
    with pytest.raises(rg.InputError, match="radius: this key is missing"):
        rg.parse_scene(
            'schema = 1\nrobot.type = "disc"\ngrid.axes = [{ name = "x", lower = 0, upper = 1, cells = 2 }]\n'
        )
