"""Goal cells of a tool, compared with planar arms, closed-form inverse kinematics and random configurations.

Tests internals: `resgrid.robots.urdf.tool_goals`, `resgrid.robots.urdf.tree`.
"""

from collections.abc import Callable
from math import pi

import numpy as np
import pytest
from numpy.typing import NDArray

import resgrid as rg
from resgrid.robots.urdf.tool_goals import ToolGoal, tool_goal_cells, tool_poses
from resgrid.robots.urdf.tree import KinematicTree


def chain(links: list[tuple[tuple[float, float, float], str]], *, prismatic: tuple[int, ...] = ()) -> KinematicTree:
    """Return a chain of joints: the offset of each joint from the one before, and its axis; the last has no joint."""
    joints, count = links[:-1], len(links) - 1
    placement = np.tile(np.eye(4), (count, 1, 1))
    placement[:, :3, 3] = [offset for offset, _ in joints]
    tool = np.eye(4)
    tool[:3, 3] = links[-1][0]
    names = tuple(f"j{n}" for n in range(count))
    is_prismatic = np.isin(np.arange(count), prismatic)
    return KinematicTree(
        moving=names,
        lower=np.where(is_prismatic, -0.5, -pi),
        upper=np.where(is_prismatic, 0.5, pi),
        velocity=np.full(count, np.inf),
        is_continuous=~is_prismatic,
        names=names,
        parent=np.arange(-1, count - 1),
        placement=placement,
        direction=np.array([np.eye(3)["xyz".index(axis)] for _, axis in joints]),
        is_prismatic=is_prismatic,
        driver=np.arange(count),
        factor=np.ones(count),
        offset=np.zeros(count),
        bodies=(),
        pairs=np.empty((0, 2), dtype=np.int64),
        tools={"tool": (count - 1, tool)},
    )


def axes_of(tree: KinematicTree, cells: int) -> tuple[rg.Axis, ...]:
    return tuple(
        rg.Axis(name, low, high, cells, periodic=bool(round_))
        for name, low, high, round_ in zip(tree.moving, tree.lower, tree.upper, tree.is_continuous, strict=True)
    )


PLANAR = chain([((0, 0, 0), "z"), ((1.0, 0, 0), "z"), ((0.7, 0, 0), "")])
WRIST = chain([((0, 0, 0.1), "z"), ((0, 0.1, 0.3), "y"), ((0.5, 0, 0), "y"), ((0.4, 0.05, 0), "")])
RAIL = chain([((0, 0, 0), "x"), ((0, 0, 0.2), "z"), ((0.4, 0, 0), "y"), ((0.3, 0, 0.1), "")], prismatic=(0,))
FOUR = chain([((0, 0, 0), "z"), ((0, 0, 0.3), "y"), ((0.5, 0, 0), "y"), ((0.4, 0, 0), "y"), ((0.2, 0, 0), "")])


@pytest.mark.parametrize("place", [(1.2, 0.3), (0.2, -0.4), (-1.0, 1.0)])
@pytest.mark.parametrize("radius", [0.0, 0.03, 0.4])
def test_goal_cells_equal_those_of_the_planar_arm(place: tuple[float, float], radius: float) -> None:
    arm = rg.Arm(lengths=(1.0, 0.7))
    axes = arm.axes(40)
    wanted = arm.goal_cells(axes, rg.Ball(place, radius) if radius else place)
    found = tool_goal_cells(PLANAR, "tool", axes, ToolGoal(rg.Ball((*place, 0.0), radius) if radius else (*place, 0.0)))
    np.testing.assert_array_equal(found.cells, wanted.cells)
    tips = arm.tip(found.points)
    assert np.hypot(*(tips - place).T).max() <= radius + 2e-9


def random_configurations(tree: KinematicTree, count: int, seed: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform(tree.lower, tree.upper, (count, len(tree.moving)))


def with_neighbours(
    tree: KinematicTree, sample: NDArray[np.float64], solves: Callable[[NDArray[np.float64]], NDArray[np.bool_]]
) -> NDArray[np.float64]:
    """Add random configurations near the solutions in a sample: within 0.3 rad or m, and within 0.03."""
    rng = np.random.default_rng(5)
    for width in (0.3, 0.03):
        found = sample[solves(sample)]
        near = found[rng.integers(len(found), size=10_000)]
        sample = np.concatenate(
            [sample, np.clip(near + rng.uniform(-width, width, near.shape), tree.lower, tree.upper)]
        )
    return sample


def solves_within(
    tree: KinematicTree, sample: NDArray[np.float64], place: NDArray[np.float64], radius: float
) -> NDArray[np.bool_]:
    return np.linalg.norm(tool_poses(tree, "tool", sample)[:, :3, 3] - place, axis=1) <= radius


@pytest.mark.parametrize(
    "tree", [WRIST, RAIL, pytest.param(FOUR, marks=pytest.mark.slow)], ids=["wrist", "rail", "four"]
)
def test_every_random_solution_lies_in_a_goal_cell(tree: KinematicTree) -> None:
    axes = axes_of(tree, 10)
    place = tool_poses(tree, "tool", random_configurations(tree, 1, 3))[0, :3, 3]
    goal = ToolGoal(rg.Ball(tuple(place.tolist()), 0.12))
    cells, points = tool_goal_cells(tree, "tool", axes, goal)
    sample = with_neighbours(
        tree, random_configurations(tree, 40_000, 4), lambda q: solves_within(tree, q, place, 0.12)
    )
    solves = solves_within(tree, sample, place, 0.12)
    assert solves.sum() > 1000
    space = rg.ConfigurationSpace(axes, np.zeros(cells.shape))
    located = space.split(sample[solves])[0]
    assert cells[tuple(located.T)].all()
    assert np.linalg.norm(tool_poses(tree, "tool", points)[:, :3, 3] - place, axis=1).max() <= 0.12 + 2e-9
    inside = space.split(points)[0]
    wanted = np.argwhere(cells)
    on_border = np.abs(points - (space.lower + (wanted + 0.5) * space.spacing)).max(1) > 0.49 * space.spacing.max()
    np.testing.assert_array_equal(inside[~on_border], wanted[~on_border])


def test_a_point_has_the_four_elbow_and_shoulder_solutions() -> None:
    tree = chain([((0, 0, 0.3), "z"), ((0, 0, 0), "y"), ((0.5, 0, 0), "y"), ((0.4, 0, 0), "")])
    axes = axes_of(tree, 37)
    x, y, z = 0.45, 0.2, 0.5
    cells, points = tool_goal_cells(tree, "tool", axes, ToolGoal((x, y, z)))
    assert cells.sum() == 4
    reach, height = np.hypot(x, y), z - 0.3
    elbow = np.arccos((reach**2 + height**2 - 0.5**2 - 0.4**2) / (2 * 0.5 * 0.4))
    wanted = []
    for flip in (1, -1):
        for bend in (elbow, -elbow):
            pan = np.arctan2(y, x) if flip > 0 else np.arctan2(-y, -x)
            tilt = np.arctan2(-height, flip * reach)
            lift = tilt - np.arctan2(0.4 * np.sin(bend), 0.5 + 0.4 * np.cos(bend))
            wanted.append([pan, (lift + pi) % (2 * pi) - pi, bend])
    found, expected = (sorted(np.round(values, 6).tolist()) for values in (points, wanted))
    np.testing.assert_allclose(found, expected, atol=2e-6)


@pytest.mark.slow
def test_a_rotation_restricts_the_goal_to_poses_within_its_angle() -> None:
    axes = axes_of(FOUR, 8)
    wanted = tool_poses(FOUR, "tool", np.array([[0.3, 0.4, 0.5, -0.6]]))[0]
    goal = ToolGoal(rg.Ball(tuple(wanted[:3, 3].tolist()), 0.1), wanted[:3, :3], 0.3)
    cells, points = tool_goal_cells(FOUR, "tool", axes, goal)
    poses = tool_poses(FOUR, "tool", np.concatenate([points, random_configurations(FOUR, 400_000, 1)]))
    angle = np.arccos(np.clip((np.einsum("nij,ij->n", poses[:, :3, :3], wanted[:3, :3]) - 1) / 2, -1, 1))
    solves = (np.linalg.norm(poses[:, :3, 3] - wanted[:3, 3], axis=1) <= 0.1) & (angle <= 0.3)
    assert (angle[: len(points)] <= 0.3 + 1e-7).all()
    space = rg.ConfigurationSpace(axes, np.zeros(cells.shape))
    sample = random_configurations(FOUR, 400_000, 1)[solves[len(points) :]]
    assert len(sample) > 5
    assert cells[tuple(space.split(sample)[0].T)].all()
    assert cells.sum() < tool_goal_cells(FOUR, "tool", axes, ToolGoal(goal.region)).cells.sum()


REACHABLE = tuple(tool_poses(WRIST, "tool", np.array([[0.3, 0.4, 0.5]]))[0, :3, 3].tolist())


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (ToolGoal((2.0, 0.0, 0.4)), r"leaves 1\.[01]\d* m"),
        (ToolGoal(REACHABLE, np.diag([1.0, -1.0, -1.0]), 0.1), "off by .* rad"),
        (ToolGoal(rg.Polygon(((0, 0), (1, 0), (0, 1)))), "a ball, a box, a half-space or a point"),
    ],
)
@pytest.mark.quick_cases(2)
def test_goals_without_solution_have_one_message(goal: ToolGoal, message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        tool_goal_cells(WRIST, "tool", axes_of(WRIST, 6), goal)
