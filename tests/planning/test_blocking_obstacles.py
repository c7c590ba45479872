"""Obstacles between a start and the goals of a space, compared with flood fills over all sets of obstacles.

Tests internals: `resgrid.core.regions`.
"""

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from support.spaces import space_of, spaces
from support.verdicts import check_verdicts

import resgrid as rg
from resgrid.core.regions import label_regions

Index = tuple[int, ...]


def flood(mask: np.ndarray, periodic: np.ndarray, start: Index, corners: bool) -> set[Index]:
    """Cells of a mask that are connected to `start`, by flood fill."""
    steps = [s for s in product((-1, 0, 1), repeat=mask.ndim) if any(s) and (corners or np.abs(s).sum() == 1)]
    found, waiting = {start}, [start]
    while waiting:
        cell = waiting.pop()
        for step in steps:
            near = [i + d for i, d in zip(cell, step, strict=True)]
            near = [i % n if ring else i for i, n, ring in zip(near, mask.shape, periodic, strict=True)]
            there = tuple(near)
            inside = all(0 <= i < n for i, n in zip(there, mask.shape, strict=True))
            if inside and mask[there] and there not in found:
                found.add(there)
                waiting.append(there)
    return found


def groups_of(mask: np.ndarray, periodic: np.ndarray) -> list[set[Index]]:
    groups: list[set[Index]] = []
    for cell in map(tuple, np.argwhere(mask).tolist()):
        if not any(cell in group for group in groups):
            groups.append(flood(mask, periodic, cell, corners=True))
    return groups


def opens_a_path(space: rg.ConfigurationSpace, groups: list[set[Index]], start: Index, goal: int) -> bool:
    passable = space.cell != 1
    for group in groups:
        for cell in group:
            passable[cell] = True
    if not passable[start]:
        return False
    return any(space.goal_region[cell] == goal for cell in flood(passable, space.periodic, start, corners=False))


@pytest.mark.slow
@settings(max_examples=100)
@given(spaces(max_cells=7, conductive=False), st.integers(0, 2**32 - 1))
def test_the_least_set_equals_that_of_an_exhaustive_search(space: rg.ConfigurationSpace, seed: int) -> None:
    start = tuple(np.argwhere(space.cell < 2)[seed % int((space.cell < 2).sum())].tolist())
    found = rg.find_blocking_obstacles(space, cell=start)
    groups = groups_of(space.cell == 1, space.periodic)
    assume(len(groups) < 9)
    label = np.full(space.shape, -1)
    for number, group in enumerate(groups):
        label[tuple(np.array(sorted(group)).T)] = number
    np.testing.assert_array_equal(found.barriers.label, label)
    for goal, item in enumerate(found.obstructions):
        sets = (s for n in range(len(groups) + 1) for s in combinations(range(len(groups)), n))
        least = next(s for s in sets if opens_a_path(space, [groups[g] for g in s], start, goal))
        assert len(item.least) == len(least)
        assert opens_a_path(space, [groups[g] for g in item.least], start, goal)
        if len(least) == 1:
            alone = [g for g in range(len(groups)) if opens_a_path(space, [groups[g]], start, goal)]
            assert list(item.alone) == alone and item.least[0] in alone
        else:
            assert item.alone == ()
    reached = flood(space.cell != 1, space.periodic, start, corners=False) if space.cell[start] != 1 else set()
    assert set(map(tuple, np.argwhere(found.region).tolist())) == reached
    assert (found.outcome is rg.Outcome.REACHED) == any(space.cell[c] == 2 for c in reached)
    assert (found.separating == ()) == (found.outcome is rg.Outcome.REACHED)
    assert all(found.barriers.mask(g)[tuple(np.array(sorted(groups[g])).T)].all() for g in found.bounding)


@settings(max_examples=60)
@given(st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_labels_join_cells_at_corners_and_across_seams(ndim: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random(tuple(rng.integers(1, 7, ndim))) < 0.35
    periodic = rng.random(ndim) < 0.5
    found = label_regions(mask, periodic, corners=True) - 1
    for number, group in enumerate(groups_of(mask, periodic)):
        assert set(map(tuple, np.argwhere(found == number).tolist())) == group
    assert np.array_equal(found >= 0, mask)


def test_a_diagonal_wall_is_one_obstacle() -> None:
    found = rg.find_blocking_obstacles(space_of(np.eye(6) + np.pad([[2.0]], ((0, 5), (5, 0)))), cell=(5, 0))
    assert found.outcome is rg.Outcome.NO_PATH and found.edge
    assert found.separating == (0,) and found.obstructions[0].alone == (0,)
    np.testing.assert_array_equal(found.mask, np.eye(6, dtype=bool))


def test_two_goals_within_nested_rings_have_different_least_sets() -> None:
    """A start within two rings: a goal between them needs one ring removed, a goal outside both."""
    cell = np.zeros((11, 11))
    cell[1:10, 1:10], cell[2:9, 2:9] = 1, 0
    cell[3:8, 3:8], cell[4:7, 4:7] = 1, 0
    cell[2, 2], cell[0, 0] = 2, 2
    found = rg.find_blocking_obstacles(space_of(cell), (5.5, 5.5))
    outside, between = found.obstructions
    assert outside.goal == 0 and outside.least == (1, 0) and outside.alone == ()
    assert between.goal == 1 and between.least == (1,) and between.alone == (1,)
    assert found.outcome is rg.Outcome.NO_PATH and found.separating == (1,) and not found.edge
    assert found.mask.sum() == 16


def test_either_of_two_walls_on_a_ring_opens_a_path() -> None:
    cell = np.zeros((12, 4))
    cell[2], cell[7] = 1, 1
    cell[4, 1] = 2
    space = space_of(cell, periodic=(True, False))
    found = rg.find_blocking_obstacles(space, cell=(0, 0))
    assert found.outcome is rg.Outcome.NO_PATH
    assert found.obstructions[0].alone == (0, 1) and found.bounding == (0, 1)
    assert len(found.separating) == 1


def test_virtual_obstacles_are_groups_of_their_own() -> None:
    """A strip with a real block in its middle: both ends are separate groups, and each one alone opens a path."""
    cell = np.zeros((7, 9))
    cell[3] = 1
    cell[6, 4] = 2
    strip = np.zeros((7, 9), dtype=bool)
    strip[3, :3], strip[3, 6:] = True, True
    found = rg.find_blocking_obstacles(space_of(cell), cell=(0, 4), virtual=strip)
    assert found.barriers.virtual.tolist() == [False, True, True]
    assert found.obstructions[0].alone == (0, 1, 2)
    assert len(found.separating) == 1
    crossed = np.array([[0, 1, 1], [1, 1, 1], [1, 1, 2]])
    diagonal = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=bool)
    found = rg.find_blocking_obstacles(space_of(crossed), cell=(0, 0), virtual=diagonal)
    assert found.obstructions[0].alone == ()
    assert set(found.separating) == {0, 1}


def test_a_start_in_an_obstacle_is_separated_by_it() -> None:
    found = rg.find_blocking_obstacles(space_of([[0, 1, 1, 0, 2]]), cell=(0, 1))
    assert found.outcome is rg.Outcome.START_BLOCKED
    assert found.separating == (0,) and not found.region.any() and found.bounding == ()


def test_enclosed_goals_are_goal_blocked_and_free_starts_reach() -> None:
    closed = rg.find_blocking_obstacles(space_of([[0, 1, 2]]), cell=(0, 0))
    assert closed.outcome is rg.Outcome.GOAL_BLOCKED and closed.separating == (0,)
    free = rg.find_blocking_obstacles(space_of([[0, 0, 2]]), cell=(0, 0))
    assert free.outcome is rg.Outcome.REACHED and free.separating == () and not free.mask.any()
    at_goal = rg.find_blocking_obstacles(space_of([[0, 1, 2]]), cell=(0, 2))
    assert at_goal.outcome is rg.Outcome.REACHED


def test_invalid_arguments_raise_input_error() -> None:
    space = space_of([[0, 1, 2]])
    with pytest.raises(rg.InputError, match="outside the grid"):
        rg.find_blocking_obstacles(space, (9.0, 0.0))
    with pytest.raises(rg.InputError, match="either"):
        rg.find_blocking_obstacles(space)
    with pytest.raises(rg.InputError, match="virtual must be"):
        rg.find_blocking_obstacles(space, cell=(0, 0), virtual=np.zeros((1, 2), dtype=bool))
    with pytest.raises(rg.InputError, match="no goal cell"):
        rg.find_blocking_obstacles(space_of([[0, 1, 0]]), cell=(0, 0))


def solved(space: rg.ConfigurationSpace, **options: object) -> rg.Field:
    try:
        return rg.field(rg.solve(rg.compile_space(space, resistance=1.0, **options)))
    except rg.CircuitError:
        assume(False)
        raise


@pytest.mark.slow
@settings(max_examples=80)
@given(
    spaces(),
    st.sampled_from([{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 2.0}, {"edge": "open"}]),
)
def test_outcomes_agree_with_streamlines_for_every_circuit(
    space: rg.ConfigurationSpace, options: dict[str, object]
) -> None:
    field = solved(space, **options)
    check_verdicts(field)
    for cell in np.argwhere(space.cell == 0)[:20].tolist():
        found = rg.find_blocking_obstacles(space, cell=cell)
        path = rg.streamline(field, cell=cell)
        assert (found.outcome is rg.Outcome.REACHED) == (path.outcome in {rg.Outcome.REACHED, rg.Outcome.NO_CURRENT})
        if found.outcome is not rg.Outcome.REACHED:
            assert found.outcome is path.outcome


def test_check_verdicts_detects_a_field_of_another_space() -> None:
    cell = np.zeros((5, 5))
    cell[:, 2], cell[2, 4] = 1, 2
    space = space_of(cell)
    field = solved(space)
    other = np.array(space.cell)
    other[0, 2] = 0
    wrong = rg.Field(**{**fields_of(field), "space": space_of(other)})
    with pytest.raises(AssertionError, match=r"finds a path from cell \(0, 0\)"):
        check_verdicts(wrong)


def fields_of(field: rg.Field) -> dict[str, object]:
    return {name: getattr(field, name) for name in rg.Field.__dataclass_fields__}
