"""Blocking obstacles of scenes, compared with sampling the scene without every subset of obstacles."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import resgrid as rg

ROOMS = """
schema = 1
starts = [[1.0, 1.0]]
[grid]
axes = [
  {{ name = "x", lower = 0, upper = 8, cells = 32 }},
  {{ name = "y", lower = 0, upper = 6, cells = 24 }},
]
[robot]
type = "point"
radius = 0.1
{walls}
[[goal]]
shape = "rectangle"
lower = [7, 5]
upper = [7.5, 5.5]
"""


def scene_with(*walls: tuple[float, float, float, float]) -> rg.Scene:
    tables = (
        f'[[obstacle]]\nshape = "rectangle"\nlower = [{x0}, {y0}]\nupper = [{x1}, {y1}]' for x0, y0, x1, y1 in walls
    )
    return rg.parse_scene(ROOMS.format(walls="\n".join(tables)), "rooms")


def connected_without(scene: rg.Scene, removed: tuple[int, ...], start: tuple[float, float] = (1.0, 1.0)) -> bool:
    kept = tuple(shape for number, shape in enumerate(scene.obstacles) if number not in removed)
    return (
        rg.find_blocking_obstacles(rg.build_space(scene.replace(obstacles=kept)), start).outcome is rg.Outcome.REACHED
    )


@pytest.mark.parametrize(
    "walls",
    [
        [(3, 0, 3.5, 6)],
        [(3, 0, 3.5, 6), (5, 0, 5.5, 6), (0, 4, 2, 4.5)],
        [(3, 0, 3.5, 3.5), (3, 3, 3.5, 6), (3.25, 2, 3.4, 4)],
        [(2.5, 0, 3, 6), (4, 0, 4.5, 6), (5.5, 0, 6, 6)],
        [(0.5, 0.5, 1.5, 1.5), (3, 0, 3.5, 6)],
        [(3, 0, 3.5, 2.9), (3, 3.1, 3.5, 6), (6, 0, 6.5, 3)],
    ],
)
def test_the_smallest_set_equals_that_of_sampling_all_subsets(walls: list[tuple[float, float, float, float]]) -> None:
    """Overlapping walls block the same cells and must both be removed.  A gap of 0.2 is too narrow for the robot."""
    scene = scene_with(*walls)
    found = rg.find_blocking_obstacles(scene, (1.0, 1.0))
    opening = [s for n in range(1, 4) for s in combinations(range(len(walls)), n) if connected_without(scene, s)]
    assert found.outcome in {rg.Outcome.NO_PATH, rg.Outcome.START_BLOCKED}
    assert found.alone == tuple(f"obstacle[{s[0]}]" for s in opening if len(s) == 1)
    assert found.separating == tuple(f"obstacle[{number}]" for number in opening[0])
    assert np.array_equal(found.mask, np.any([found.parts[name] for name in found.separating], axis=0))
    assert np.array_equal(np.any(list(found.parts.values()), axis=0), found.space.cell == 1)


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.quick_cases(10)
def test_sets_with_obstacles_on_goals_and_cell_borders_equal_those_of_sampling(seed: int) -> None:
    """Walls on quarters of cells cover parts of the goal's region, and the start may lie between two of them."""
    rng = np.random.default_rng(seed)
    lower = rng.integers(0, 24, (5, 2)) / 4
    size = np.where(rng.random((5, 1)) < 0.5, [0.5, 4.0], [6.0, 0.5]) + rng.integers(0, 4, (5, 2)) / 4
    scene = scene_with(*np.hstack([lower, np.minimum(lower + size, (8, 6))]).tolist())
    scene = scene.replace(robot=rg.PointRobot(), goals=(rg.Box((5.0, 3.0), (7.5, 5.5)),))
    start = tuple((rng.integers(0, 24, 2) / 4).tolist())
    try:
        found = rg.find_blocking_obstacles(scene, start)
    except rg.InputError:
        return  # every cell of the goal is covered
    if found.outcome is rg.Outcome.REACHED:
        return
    sets = [s for n in range(1, 4) for s in combinations(range(5), n) if connected_without(scene, s, start)]
    assert found.alone == tuple(f"obstacle[{s[0]}]" for s in sets if len(s) == 1)
    assert len(found.separating) == (len(sets[0]) if sets else 0)
    if sets:
        assert tuple(int(name[9:-1]) for name in found.separating) in sets


def test_a_crate_that_covers_half_the_goal_blocks_alone() -> None:
    """The goal continues beneath the crate; a wall behind the crate separates the rest of the goal."""
    scene = scene_with((3, 0, 5, 6), (5, 0, 6, 6)).replace(goals=(rg.Box((4.0, 2.0), (7.0, 4.0)),))
    found = rg.find_blocking_obstacles(scene, (1.0, 1.0))
    assert connected_without(scene, (0,)) and not connected_without(scene, (1,))
    assert found.alone == found.separating == ("obstacle[0]",)


def test_a_reached_goal_has_no_blocking_obstacles() -> None:
    found = rg.find_blocking_obstacles(scene_with((3, 0, 3.5, 3)), (1.0, 1.0))
    assert found.outcome is rg.Outcome.REACHED and found.separating == found.alone == () and not found.mask.any()


def test_a_set_larger_than_most_is_empty_and_bad_limits_raise() -> None:
    scene = scene_with((2.5, 0, 3, 6), (4, 0, 4.5, 6), (5.5, 0, 6, 6))
    assert rg.find_blocking_obstacles(scene, (1.0, 1.0), most=2).separating == ()
    with pytest.raises(rg.InputError, match="most = 0"):
        rg.find_blocking_obstacles(scene, (1.0, 1.0), most=0)
    with pytest.raises(rg.InputError, match="63"):
        rg.find_blocking_obstacles(scene_with(*[(3, 0, 3.5, 6)] * 64), (1.0, 1.0))


def test_removing_either_obstacle_opens_problem_b(scenes: Path) -> None:
    """All cells form one group in the configuration space; in the workspace removing either rectangle is enough."""
    scene = rg.read_scene(scenes / "problem_b.toml")
    blocked = [
        start for start in scene.starts if rg.find_blocking_obstacles(scene, start).outcome is rg.Outcome.NO_PATH
    ]
    assert len(blocked) == 2
    for start in blocked:
        found = rg.find_blocking_obstacles(scene, start)
        assert found.alone == ("obstacle[0]", "obstacle[1]") and "singularity" in found.parts
        assert rg.find_blocking_obstacles(found.space, start).separating == (0,)
        strips = found.parts["singularity"] & ~found.parts["obstacle[0]"] & ~found.parts["obstacle[1]"]
        assert len(rg.find_blocking_obstacles(found.space, start, virtual=strips).obstructions[0].alone) == 2
