"""Arms: occupancy, kinematics and goal cells, compared with shapely, finite differences and exhaustive search.

Tests internals: `resgrid.core.regions`, `resgrid.robots`, `resgrid.robots.arm_cells`.
"""

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from scipy.optimize import least_squares

import resgrid as rg
from resgrid.core.regions import label_regions
from resgrid.robots import to_shapely
from resgrid.robots.arm_cells import tip_travel

OBSTACLES = [
    rg.Box((0.8, -1.2), (1.4, -1.0)),
    rg.Polygon(((-1.0, 0.3), (-0.5, 0.2), (-0.6, 0.9), (-0.75, 0.45))),
    rg.Polygon(((0.2, 1.0), (1.4, 1.0), (1.4, 1.7), (0.2, 1.7)), (((0.4, 1.2), (1.2, 1.2), (1.2, 1.5), (0.4, 1.5)),)),
    rg.Ball((-0.9, -0.9), 0.2),
    rg.HalfSpace((0.3, 1.0), -1.6),
]
GEOMETRY = shapely.union_all([to_shapely(shape) for shape in OBSTACLES])
FAR = shapely.Point(99.0, 99.0)
ARMS = [
    rg.Arm((1.0, 0.8), (0.1, 0.05), angles="absolute"),
    rg.Arm((1.0, 0.8), base=(0.1, -0.1), base_angle=0.4, limits=((-2.0, 2.5), None)),
    rg.Arm((0.6, 0.5, 0.6), (0.08, 0.06, 0.04), self_collision=True),
    rg.Arm((0.6, 0.5, 0.6), (0.08, 0.06, 0.04), angles="absolute", self_collision=True, base=(0.05, 0.0)),
    rg.Arm((0.5, 0.4, 0.4, 0.3), (0.02,) * 4, angles="relative", self_collision=True),
]
CELLS = {1: 90, 2: 64, 3: 20, 4: 12}


def links(arm, configurations):
    """All links of many configurations, as exact segments."""
    places = arm.joints(configurations)
    return shapely.linestrings(np.stack([places[:, :-1], places[:, 1:]], axis=-2))


def collides(arm, configurations, obstacles=GEOMETRY):
    """Exact collisions: a capsule's axis lies within half its width of an obstacle or another link."""
    spines = links(arm, configurations)
    radii = np.array(arm.widths) / 2
    hit = (shapely.distance(spines, obstacles) <= radii).any(axis=1)
    if arm.self_collision:
        for i in range(arm.ndim):
            for j in range(i + 2, arm.ndim):
                hit |= shapely.distance(spines[:, i], spines[:, j]) <= radii[i] + radii[j]
    return hit


def random_configurations(axes, cells, count, rng):
    """Random configurations in random cells, a quarter of them on borders."""
    chosen = cells[rng.integers(len(cells), size=count)]
    share = rng.random(chosen.shape)
    share[: count // 4] = np.round(share[: count // 4])
    spacing = np.array([axis.spacing for axis in axes])
    return np.array([axis.lower for axis in axes]) + (chosen + share) * spacing


@pytest.mark.parametrize(
    ("which", "count"),
    [pytest.param(0, 100_000, marks=pytest.mark.slow), (1, 30_000), (2, 30_000), (3, 30_000), (4, 20_000)],
)
def test_no_configuration_in_a_free_cell_collides(which, count):
    arm = ARMS[which]
    axes = arm.axes(CELLS[arm.ndim])
    blocked = arm.occupancy(axes, OBSTACLES, "conservative")
    assert 0.05 < blocked.mean() < 0.96
    inside = random_configurations(axes, np.argwhere(~blocked), count, np.random.default_rng(1))
    assert not collides(arm, inside).any()


@pytest.mark.parametrize("arm", ARMS)
def test_the_centre_rule_equals_exact_collision_tests_at_cell_centres(arm):
    axes = arm.axes(CELLS[arm.ndim])
    blocked = arm.occupancy(axes, OBSTACLES, "centre")
    grid = np.stack(np.meshgrid(*(axis.centres for axis in axes), indexing="ij"), axis=-1).reshape(-1, arm.ndim)
    chosen = np.random.default_rng(2).choice(len(grid), size=min(len(grid), 5000), replace=False)
    # the disc is a polygon inside its circle for shapely, and an exact disc for the arm
    disc = shapely.distance(links(arm, grid[chosen]), shapely.Point(-0.9, -0.9)) - 0.2 - np.array(arm.widths) / 2
    clear = (np.abs(disc) > 1e-3).all(axis=1)
    assert clear.mean() > 0.95
    assert (blocked.reshape(-1)[chosen] == collides(arm, grid[chosen]))[clear].all()
    assert not (blocked & ~arm.occupancy(axes, OBSTACLES, "conservative")).any()


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS[:2])
def test_few_blocked_cells_are_entirely_free(arm):
    """The over-approximation: cells lost although no sampled configuration in them collides."""
    axes = arm.axes(120)
    blocked = arm.occupancy(axes, OBSTACLES, "conservative")
    cells = np.argwhere(blocked)
    hit = np.zeros(len(cells), dtype=bool)
    for share in np.stack(np.meshgrid(*[np.linspace(0, 1, 5)] * 2), axis=-1).reshape(-1, 2):
        spacing = np.array([axis.spacing for axis in axes])
        hit |= collides(arm, np.array([axis.lower for axis in axes]) + (cells + share) * spacing)
    lost = (~hit).sum() / (~blocked).sum()
    assert lost < 0.015, f"{lost:.2%} of the free volume is lost"


def test_the_lost_volume_decreases_with_the_cell_size():
    arm, lost = ARMS[0], []
    for cells in (30, 120, 480):
        axes = arm.axes(cells)
        conservative = arm.occupancy(axes, OBSTACLES, "conservative")
        lost.append(conservative.mean() - arm.occupancy(axes, OBSTACLES, "centre").mean())
    assert lost[0] > 2.5 * lost[1] > 6 * lost[2] > 0


@settings(max_examples=50)
@given(st.integers(0, 4), st.lists(st.floats(-7, 7), min_size=4, max_size=4))
def test_joints_jacobian_and_shapes_agree_with_forward_kinematics(which, angles):
    arm = ARMS[which]
    q = np.array(angles[: arm.ndim])
    places = arm.joints(q)
    assert places.shape == (arm.ndim + 1, 2)
    assert np.allclose(np.linalg.norm(np.diff(places, axis=0), axis=1), arm.lengths)
    assert np.allclose(places[0], arm.base)
    jacobian = arm.jacobian(q)
    for joint in range(arm.ndim):
        step = np.zeros(arm.ndim)
        step[joint] = 1e-6
        assert np.allclose(jacobian[:, joint], (arm.tip(q + step) - arm.tip(q - step)) / 2e-6, atol=1e-7)
    for shape, (start, end), width in zip(arm.shapes_at(q), itertools.pairwise(places), arm.widths,
                                          strict=True):  # fmt: skip
        segment = shapely.LineString([start, end])
        assert shapely.hausdorff_distance(shape, segment.buffer(width / 2, quad_segs=64) if width else segment) < 1e-3


@given(st.integers(0, 1), st.floats(-3, 3), st.floats(-3, 3))
def test_inverse_kinematics_of_two_links_returns_all_solutions(which, first, second):
    arm = ARMS[which]
    point = arm.tip((first, second))
    solutions = arm.inverse(point)
    assert len(solutions) <= 2
    assert np.allclose(arm.tip(solutions), point, atol=1e-6)
    limits = arm.limits[0]
    if limits is None or limits[0] + 1e-5 < first < limits[1] - 1e-5:
        near = np.abs((solutions - (first, second) + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
        assert near.min() < 1e-5
    assert len(arm.inverse((5.0, 0.0))) == 0


def test_inverse_equals_solutions_computed_by_hand():
    arm = rg.Arm((1.0, 1.0), angles="absolute")
    assert np.allclose(arm.inverse((1.0, 1.0)), [[0, np.pi / 2], [np.pi / 2, 0]])
    assert np.allclose(arm.inverse((2.0, 0.0)), [[0, 0]])
    assert np.allclose(rg.Arm((1.0, 1.0)).inverse((1.0, 1.0)), [[0, np.pi / 2], [np.pi / 2, -np.pi / 2]])
    assert np.allclose(arm.tip(arm.inverse((0.0, 0.0))), 0)


def test_inverse_returns_every_full_turn_within_the_limits():
    wide = (-2 * np.pi, 2 * np.pi)
    once = rg.Arm((1.0, 0.8)).inverse((0.7, -0.9))
    found = rg.Arm((1.0, 0.8), limits=(wide, (-5.0, 2.0))).inverse((0.7, -0.9))
    turns = 2 * np.pi * np.array(list(itertools.product(range(-2, 3), repeat=2)))
    every = (once[:, None] + turns).reshape(-1, 2)
    expected = every[(np.abs(every[:, 0]) <= wide[1]) & (every[:, 1] >= -5.0) & (every[:, 1] <= 2.0)]
    assert len(expected) >= 4
    assert np.allclose(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)])
    with pytest.raises(rg.InputError, match="narrow them"):
        rg.Arm((1.0, 1.0), limits=((-1e6, 1e6), (-1e6, 1e6))).inverse((1.0, 1.0))


GOAL_ARMS = [
    rg.Arm((0.9,), base=(0.3, -0.2), limits=((-7.0, 9.0),)),
    *ARMS[:3],
    rg.Arm((1.0, 1.0), limits=((-2 * np.pi, 2 * np.pi), (-7.0, 0.5))),
    rg.Arm((0.8, 0.7, 0.5), angles="absolute", limits=(None, (-1.0, 8.0), None)),
    rg.Arm((0.5, 0.5, 0.5, 0.5), base_angle=1.0),
]
GOAL_GRIDS = {1: (23,), 2: (17, 20), 3: (9, 8, 7), 4: (5, 4, 5, 4)}


def forward_kinematics(arm, configurations):
    """Forward kinematics, link by link, independent of `Arm.tip`."""
    place, turned = np.array(arm.base), arm.base_angle
    for joint, length in enumerate(arm.lengths):
        turned = configurations[..., joint] + (turned if arm.angles == "relative" else arm.base_angle)
        place = place + length * np.stack([np.cos(turned), np.sin(turned)], axis=-1)
    return place


def distance_from_region(region, points):
    """Exact distance of points from a region."""
    match region:
        case rg.HalfSpace(normal, offset):
            return np.maximum((points @ np.array(normal) - offset) / np.hypot(*normal), 0.0)
        case rg.Ball(centre, radius):
            return np.maximum(np.linalg.norm(points - np.array(centre), axis=-1) - radius, 0.0)
        case rg.Box() | rg.Polygon():
            return shapely.distance(to_shapely(region), shapely.points(points))
    return np.linalg.norm(points - np.array(region), axis=-1)


def check_goal(arm, axes, region):
    """Assert that the point of every goal cell is a solution in that cell; return the mask."""
    cells, points = arm.goal_cells(axes, region)
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    assert (np.abs((points - lower) / spacing - np.argwhere(cells) - 0.5) <= 0.5 + 1e-9).all()
    assert (distance_from_region(region, forward_kinematics(arm, points)) <= 2e-9 * arm.reach).all()
    return cells


def goals_containing(place, size):
    """Goals of all kinds that contain a place."""
    x, y = place
    ring = np.array([(0, 0), (2, -1), (1.2, 0.3), (1.5, 1.4), (-0.4, 1.1)]) * size + place
    yield x, y
    yield rg.Ball((x, y), 0.0)
    yield rg.Ball((x - 0.6 * size, y + 0.8 * size), size * (1 + 1e-12))
    yield rg.Box((x, y - size), (x + 0.4 * size, y + size))
    yield rg.Box((x - size, y), (x + size, y))
    yield rg.Polygon(tuple(map(tuple, ring.tolist())))
    yield rg.HalfSpace((1.5, -2.0), 1.5 * x - 2.0 * y)


@pytest.mark.parametrize("which", range(len(GOAL_ARMS)))
@pytest.mark.parametrize("share", ["inside", "centre", "corner"])
def test_goal_cells_are_exactly_the_cells_with_solutions(which, share):
    arm, rng = GOAL_ARMS[which], np.random.default_rng(which)
    axes = arm.axes(GOAL_GRIDS[arm.ndim])
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    size = np.array([axis.cells for axis in axes])
    cell = rng.integers(size)
    within = {"inside": rng.random(arm.ndim), "centre": 0.5, "corner": rng.integers(2, size=arm.ndim)}[share]
    anywhere = lower + rng.random((4000, arm.ndim)) * size * spacing
    their_cells = tuple(((anywhere - lower) / spacing).astype(int).T)
    for region in goals_containing(forward_kinematics(arm, lower + (cell + within) * spacing).tolist(), 0.2):
        cells = check_goal(arm, axes, region)
        assert cells[tuple(cell)], region
        assert cells[
            tuple(each[distance_from_region(region, forward_kinematics(arm, anywhere)) == 0] for each in their_cells)
        ].all()


@pytest.mark.slow
@pytest.mark.parametrize("arm", GOAL_ARMS[3:6])
def test_least_squares_finds_no_solution_outside_goal_cells(arm):
    point, rng = (0.6, 0.7), np.random.default_rng(5)
    axes = arm.axes((8,) * arm.ndim)
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    cells = check_goal(arm, axes, point)
    grid = np.stack(np.meshgrid(*(axis.centres for axis in axes), indexing="ij"), axis=-1)
    near = np.linalg.norm(forward_kinematics(arm, grid) - point, axis=-1) < tip_travel(arm._links, axes)
    assert near[cells].all()
    for cell in rng.permutation(np.argwhere(near & ~cells))[:25]:
        ends = lower + cell * spacing, lower + (cell + 1) * spacing
        starts = rng.uniform(*ends, (4, arm.ndim))
        rest = [
            least_squares(lambda q: forward_kinematics(arm, q) - point, start, bounds=ends).cost for start in starts
        ]
        assert min(rest) > 1e-12


@pytest.mark.parametrize("arm", [GOAL_ARMS[1], GOAL_ARMS[3], GOAL_ARMS[4], GOAL_ARMS[6]])
def test_goal_cells_of_a_smaller_goal_are_a_subset(arm):
    axes = arm.axes(GOAL_GRIDS[arm.ndim])
    regions = [rg.Ball((0.9, 0.5), radius) for radius in (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.0)]
    masks = [check_goal(arm, axes, region) for region in (*regions, (0.9, 0.5))]
    for larger, smaller in itertools.pairwise(masks):
        assert smaller.any()
        assert not (smaller & ~larger).any()


@pytest.mark.parametrize(
    ("arm", "cells", "centre", "radii"),
    [
        (
            rg.Arm((2.0, 1.0, 1.0, 1.0), limits=((0.0, 2 * np.pi), (np.pi / 4, 2 * np.pi), None, None),
                base_angle=np.pi, angles="absolute"),
            (4, 2, 4, 6), (-1.0, 0.0), (0.0, 1e-6, 1e-4, 1e-3, 5e-3, 0.1),
        ),
        (
            rg.Arm((1.0, 0.5, 0.5, 2.0), limits=((-np.pi / 2, np.pi / 4), None, (np.pi / 4, 2 * np.pi), None),
                base=(1.0, -2.0), base_angle=np.pi / 2),
            (1, 4, 2, 2), (-0.8535533905932738, -1.6464466094067258), (0.0, 1e-3, 0.05, 0.1, 0.15),
        ),
    ],
)  # fmt: skip
def test_goal_cells_of_smaller_goals_are_subsets_on_coarse_grids(arm, cells, centre, radii):
    masks = [arm.goal_cells(arm.axes(cells), rg.Ball(centre, radius)).cells for radius in radii]
    for smaller, larger in itertools.pairwise(masks):
        assert not (smaller & ~larger).any()


def test_both_elbow_configurations_have_goal_cells():
    arm = rg.Arm((1.0, 1.0))
    axes = arm.axes(40)
    rng = np.random.default_rng(0)
    for reach, turn, radius in rng.uniform((0.4, 0.0, 0.03), (1.9, 6.3, 0.2), (50, 3)):
        goal = rg.Ball((reach * np.cos(turn), reach * np.sin(turn)), radius)
        elbows = np.sin(axes[1].centres[np.argwhere(arm.goal_cells(axes, goal).cells)[:, 1]])
        assert (elbows > 0).any()
        assert (elbows < 0).any()


def test_every_inverse_solution_lies_in_a_goal_cell_on_any_axes():
    wide = rg.Arm((1.0, 1.0), limits=((-2 * np.pi, 2 * np.pi),) * 2)
    cells = check_goal(wide, wide.axes(120), (1.2, -1.0))
    solutions = wide.inverse((1.2, -1.0))
    assert len(solutions) == cells.sum() == 8
    assert cells[tuple(((solutions + 2 * np.pi) / (np.pi / 30)).astype(int).T)].all()
    axes = (rg.Axis("a", 0.0, 6.28, 64), rg.Axis("b", 0.0, 6.28, 64))
    cells = check_goal(rg.Arm((1.0, 1.0)), axes, (0.5, -1.2))
    expected = rg.Arm((1.0, 1.0)).inverse((0.5, -1.2)) % (2 * np.pi)
    assert cells[tuple((expected / (6.28 / 64)).astype(int).T)].all()
    assert cells.sum() == 2


def test_goal_cells_of_a_half_plane_do_not_depend_on_the_arms_position():
    far, near = (rg.Arm((4000.0, 3000.0), base=(x, 0.0)) for x in (9e6, 0.0))
    goal = rg.HalfSpace((0.0, 1.0), -500.0)
    assert (check_goal(far, far.axes(40), goal) == check_goal(near, near.axes(40), goal)).all()


def test_folded_equal_links_reach_the_base_in_every_direction():
    arm = rg.Arm((1.0, 1.0))
    cells = check_goal(arm, arm.axes(24), (0.0, 0.0))
    assert cells.sum() == 48
    assert cells[:, [0, -1]].all()
    straight = check_goal(arm, arm.axes(25), (2.0, 0.0))
    assert np.argwhere(straight).tolist() == [[12, 12]]


@pytest.mark.parametrize(
    "region",
    [
        rg.Box((1.0, 1.0), (1.0, 1.0)),
        rg.Box((1.0, 1.0), (1.2, 1.0)),
        rg.Ball((1.0, 1.0), 0.0),
        rg.Ball((1.0, 1.0), 1e-300),
    ],
)
def test_goals_without_area_have_goal_cells(region):
    arm = rg.Arm((1.0, 1.0))
    axes = arm.axes(40)
    found = check_goal(arm, axes, region)
    for solution in arm.inverse((1.0, 1.0)):
        assert found[tuple(((solution + np.pi) / axes[0].spacing).astype(int))]
    assert found.sum() < 40


@pytest.mark.parametrize("cells", [60, 61, (60, 75)])
@pytest.mark.parametrize("angles", ["relative", "absolute"])
def test_the_virtual_obstacle_separates_both_elbow_configurations(cells, angles):
    arm = rg.Arm((1.0, 0.7), angles=angles, singularity_cells=1)
    axes = arm.axes(cells)
    blocked = arm.occupancy(axes, [], "conservative")
    assert label_regions(~blocked, [True, True]).max() == 2
    grid = np.stack(np.meshgrid(*(axis.centres for axis in axes), indexing="ij"), axis=-1)
    turn = np.linalg.det(arm.jacobian(grid))
    region = label_regions(~blocked, [True, True])
    for band in (1, 2):
        signs = np.sign(turn[region == band])
        assert (signs == signs[0]).all()
    assert blocked.mean() < 0.11
    assert not rg.Arm((1.0, 0.7), angles=angles).occupancy(axes, [], "conservative").any()


def test_the_virtual_obstacle_has_the_requested_width():
    axes = rg.Arm((1.0, 1.0), angles="absolute").axes(120)
    count = {
        width: int(rg.Arm((1.0, 1.0), angles="absolute", singularity_cells=width).singular_cells(axes)[0].sum())
        for width in (1, 3, 5)
    }
    assert count == {1: 2, 3: 6, 5: 10}  # two diagonals
    wide = rg.Arm((1.0, 1.0), singularity_width=0.4).singular_cells(rg.Arm((1.0, 1.0)).axes(120))
    bend = axes[1].centres
    expected = np.minimum(np.abs(bend), np.pi - np.abs(bend)) - axes[1].spacing / 2 < 0.2 - 1e-9
    assert (wide[0] == expected).all()
    three = rg.Arm((1.0, 1.0, 1.0), singularity_cells=1).singular_cells(rg.Arm((1.0, 1.0, 1.0)).axes(9))
    assert np.broadcast_to(three, (9, 9, 9)).sum() == 9 * 3 * 3  # theta_2 and theta_3 both 0 or a half turn


@pytest.mark.parametrize("angles", ["relative", "absolute"])
@pytest.mark.parametrize("cells", [40, 41])
def test_the_virtual_obstacle_is_symmetric_about_the_singularity(angles, cells):
    for width in range(1, 8):
        arm = rg.Arm((1.0, 1.0), angles=angles, singularity_cells=width)
        blocked = np.broadcast_to(arm.singular_cells(arm.axes(cells)), (cells, cells))
        if angles == "absolute":  # theta_2 - theta_1 is the relative angle
            blocked = np.array([np.roll(row, cells // 2 - number) for number, row in enumerate(blocked)])
            about = blocked[:, np.arange(cells // 2 - 10, cells // 2 + 11)]
        else:
            about = blocked[:, 10:30] if cells == 40 else blocked[:, 10:31]
        assert (about == about[:, ::-1]).all()
        assert (np.isin(about.sum(axis=1), (width, width + 1))).all()


def test_progress_is_reported_up_to_the_total():
    reported = []
    ARMS[2].occupancy(ARMS[2].axes(56), OBSTACLES, "centre", lambda done, total: reported.append((done, total)))
    done = [each[0] for each in reported]
    assert len(reported) > 3
    assert done == sorted(done)
    assert reported[-1][0] == reported[-1][1] == 56 + 56**2 + 56**3


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: rg.Arm(()), "1 to 4 links"),
        (lambda: rg.Arm((1.0, -1.0)), r"lengths\[1\] = -1.0 must be a finite number above 0"),
        (lambda: rg.Arm((1.0,), (float("nan"),)), r"widths\[0\] = nan"),
        (lambda: rg.Arm((1.0, 1.0), (0.1,)), "needs 2 widths"),
        (lambda: rg.Arm((1.0,), limits=((2.0, 1.0),)), r"links\[0\]: limits = \[2.0, 1.0\] are reversed"),
        (lambda: rg.Arm((1.0,), limits=((1.0, 1.0),)), r"links\[0\]: limits = \[1.0, 1.0\] leave the joint no room"),
        (lambda: rg.Arm((1.0,), base=(0.0, float("inf"))), "base"),
        (lambda: rg.Arm((1.0,), angles="both"), "'relative' or 'absolute'"),
        (lambda: rg.Arm((1.0, 1.0), singularity_cells=1, singularity_width=0.1), "not both"),
        (lambda: rg.Arm((1.0,), singularity_cells=1), "singular everywhere"),
        (lambda: rg.Arm((1.0, 1.0)).goal_cells(rg.Arm((1.0, 1.0)).axes(9), (2.3, 0.0)),
         "the goal is 2.3 from the base, the arm reaches 2"),
        (lambda: rg.Arm((1.0, 0.4)).goal_cells(rg.Arm((1.0, 0.4)).axes(9), rg.Ball((0.1, 0.0), 0.2)),
         "cannot fold nearer"),
        (lambda: rg.Arm((1.0, 1.0)).occupancy([rg.Axis("a", 0, 1, 3)], [], "centre"), "needs 2 axes, got 1"),
        (lambda: rg.Arm((1.0,)).occupancy([rg.Axis("a", 0, 1, 3, True)], [], "centre"), "turns by 2 pi"),
        (lambda: rg.Arm((1.0,), limits=((0.0, 1.0),)).occupancy([rg.Axis("a", 0, 2, 3)], [], "centre"), "limits are"),
        (lambda: rg.Arm((1.0,)).occupancy([rg.Axis("a", 0, 1, 3)], [rg.Ball((0, 0, 0), 1)], "centre"), "2 coordinates"),
        (lambda: rg.Arm((1.0, 1.0)).joints((1.0, 2.0, 3.0)), "has 2 joints"),
        (lambda: to_shapely(rg.Ball((0, 0, 0), 1)), "plane shapes only"),
        (lambda: rg.Arm((1.0,)).inverse((1.0, 0.0)), "two links"),
        (lambda: rg.Arm((1.0, 1.0)).inverse((1.0, float("nan"))), "finite"),
    ],
)  # fmt: skip
def test_invalid_arms_raise_input_error_with_a_remedy(make, expected):
    with pytest.raises(rg.InputError, match=expected):
        make()


def test_arms_implement_the_robot_protocol():
    assert all(isinstance(arm, rg.Robot) for arm in ARMS)


@settings(max_examples=60)
@given(st.integers(0, 4), st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.4, 2.0]))
def test_the_displacement_bound_holds_for_every_link(which, seed, width):
    from resgrid.robots.kernels import _displacement_bound

    arm, rng = ARMS[which], np.random.default_rng(seed)
    middle = rng.uniform(-np.pi, np.pi, arm.ndim)
    widths = width * rng.random(arm.ndim)
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=arm.ndim)))
    moved = arm.joints(
        np.concatenate([middle + corners * widths, middle + rng.uniform(-0.5, 0.5, (50, arm.ndim)) * widths])
    )
    here, chords = arm.joints(middle), 2 * np.sin(widths / 4)
    for link in range(arm.ndim):
        bound = _displacement_bound(here, 0, link, chords, np.array(arm.lengths), arm.angles == "relative")
        ends = np.linalg.norm(moved[:, link : link + 2] - here[link : link + 2], axis=-1)
        assert ends.max() <= bound * (1 + 1e-12) + 1e-14 * arm.reach


@pytest.mark.parametrize("angles", ["relative", "absolute"])
def test_free_cells_contain_no_self_collision(angles):
    arm = rg.Arm((0.6, 0.3, 0.7), (0.04, 0.04, 0.04), angles=angles, self_collision=True)
    axes = arm.axes(20)
    blocked = arm.occupancy(axes, [], "conservative")
    centre = arm.occupancy(axes, [], "centre")
    assert 0 < centre.sum() < blocked.sum() < 0.7 * blocked.size
    inside = random_configurations(axes, np.argwhere(~blocked), 60_000, np.random.default_rng(3))
    assert not collides(arm, inside, FAR).any()
    grid = np.stack(np.meshgrid(*(axis.centres for axis in axes), indexing="ij"), axis=-1).reshape(-1, 3)
    assert (centre.ravel() == collides(arm, grid, FAR)).all()
    assert not rg.Arm((0.6, 0.3, 0.7), (0.04, 0.04, 0.04), angles=angles).occupancy(axes, [], "conservative").any()


def test_an_arm_within_an_obstacle_collides_but_not_within_its_hole():
    arm = rg.Arm((0.2, 0.1), (0.01, 0.01))
    around = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
    hole = tuple((0.5 * x, 0.5 * y) for x, y in around)
    for rule in ("conservative", "centre"):
        assert arm.occupancy(arm.axes(8), [rg.Polygon(around)], rule).all()
        assert not arm.occupancy(arm.axes(8), [rg.Polygon(around, (hole,))], rule).any()
        assert arm.occupancy(arm.axes(8), [rg.Ball((0.0, 0.0), 1.0)], rule).all()
