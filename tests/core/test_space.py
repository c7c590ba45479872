"""Tests internals: `resgrid.core.regions`."""

import numpy as np
import pytest
from scipy import ndimage
from support.spaces import space_of

import resgrid as rg
from resgrid.core.regions import label_regions


def test_a_point_is_located_and_split() -> None:
    space = rg.ConfigurationSpace([rg.Axis("x", -1, 3, 8), rg.Axis("t", 0, 6, 3, periodic=True)], np.zeros((8, 3)))
    cells, local = space.split([[-1, 0], [3, 7], [0.1, -0.5]])
    assert cells.tolist() == [[0, 0], [7, 0], [2, 2]]
    assert np.allclose(local, [[0, 0], [1, 0.5], [0.2, 0.75]])
    assert space.locate(space.centre([4, 2])).tolist() == [4, 2]


@pytest.mark.parametrize("point", [[4.0, 0.0], [np.nan, 0.0], [-np.inf, 1.0], [0.0]])
def test_a_point_outside_is_refused(point: list[float]) -> None:
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 3, 3), rg.Axis("y", 0, 3, 3)], np.zeros((3, 3)))
    with pytest.raises(rg.InputError):
        space.locate(point)


@pytest.mark.parametrize(
    ("cell", "conductivity", "words"),
    [
        (np.zeros((2, 3)), None, "shape"),
        (np.full((3, 3), 3), None, "0 \\(free\\)"),
        (np.zeros((3, 3)), np.zeros((3, 3)), "positive"),
        (np.zeros((3, 3)), np.ones(3), "shape"),
    ],
)
def test_wrong_arrays_are_refused(cell: np.ndarray, conductivity: np.ndarray | None, words: str) -> None:
    with pytest.raises(rg.InputError, match=words):
        rg.ConfigurationSpace([rg.Axis("x", 0, 3, 3), rg.Axis("y", 0, 3, 3)], cell, conductivity)


@pytest.mark.parametrize(("lower", "upper", "cells"), [(1, 1, 2), (0, np.inf, 2), (0, 1, 0), (np.nan, 1, 1)])
def test_wrong_axes_are_refused(lower: float, upper: float, cells: int) -> None:
    with pytest.raises(rg.InputError, match=r"lower = |upper = inf|cells = 0"):
        rg.Axis("x", lower, upper, cells)


def test_cells_that_rounding_cannot_tell_apart_are_refused() -> None:
    assert rg.Axis("x", 1e15, 1e15 + 400, 4).cells == 4
    with pytest.raises(rg.InputError, match="too narrow"):
        rg.Axis("x", 1e15, 1e15 + 4, 4)


def test_goal_regions_are_numbered_in_order_of_their_first_cell_across_seams() -> None:
    cell = np.zeros((5, 6))
    cell[0, 5] = cell[0, 0] = cell[2, 2] = cell[2, 3] = cell[4, 4] = 2
    assert space_of(cell).goal_count == 4
    ring = space_of(cell, periodic=(False, True))
    assert ring.goal_count == 3
    assert ring.goal_region[0, 0] == ring.goal_region[0, 5] == 0
    assert ring.goal_region[2, 3] == 1
    assert ring.goal_region[4, 4] == 2


def test_labels_agree_with_tiling_the_ring() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        mask = rng.random((7, 6)) < 0.5
        labels = label_regions(mask, [True, False])
        tiled = ndimage.label(np.tile(mask, (3, 1)))[0][7:14]
        middle_pairs = {(a, b) for a, b in zip(labels[mask], tiled[mask], strict=True)}
        # Two cells joined in three turns of the ring are joined in it; cells joined in the ring may need more turns.
        assert len({b for _, b in middle_pairs}) == len(middle_pairs)
        firsts = [int(np.flatnonzero(labels.ravel() == k)[0]) for k in range(1, labels.max() + 1)]
        assert firsts == sorted(firsts)


def test_values_are_read_only() -> None:
    space = space_of(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="read-only"):
        space.cell[0, 0] = 1


def test_goal_regions_are_those_of_the_whole_grid_wherever_the_goals_lie() -> None:
    rng = np.random.default_rng(5)
    for share in (0.0, 0.01, 0.05, 0.4):
        for ring in ([False, False], [True, False], [True, True]):
            cell = np.where(rng.random((7, 9)) < share, rg.Cell.GOAL, rg.Cell.FREE)
            axes = [rg.Axis(name, 0, 1, size, periodic=p) for name, size, p in zip("xy", cell.shape, ring, strict=True)]
            space = rg.ConfigurationSpace(axes, cell)
            assert np.array_equal(space.goal_region, label_regions(cell == rg.Cell.GOAL, ring) - 1)


def _two_goals(**options):
    return rg.ConfigurationSpace(
        [rg.Axis("x", 0, 4, 4), rg.Axis("y", 0, 2, 2)], [[0, 0], [2, 0], [0, 2], [1, 0]], **options
    )


def test_a_space_with_other_cells_keeps_its_place_and_the_points_of_goals_that_stay():
    frame = rg.Frame(3.0, 4.0, 0.5)
    space = _two_goals(frame=frame, goal_points=[[1.25, 0.5], [2.5, 1.75]])
    changed = space.with_cells([[0, 0], [1, 2], [0, 2], [1, 0]])
    assert changed.frame == frame
    assert np.array_equal(changed.goal_points, [[np.nan, np.nan], [2.5, 1.75]], equal_nan=True)
    assert _two_goals().goal_points is None
    with pytest.raises(rg.InputError, match="cell must be an array of real numbers"):
        space.with_cells([[0, 0], [1]])


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[1.5, 0.5]], "goal_points have shape"),
        ([[1.5, 0.5], [3.5, 1.5]], r"\[3.5, 1.5\] does not lie in its cell \(2, 1\)"),
    ],
)
def test_goal_points_lie_in_their_cells(points, message):
    with pytest.raises(rg.InputError, match=message):
        _two_goals(goal_points=points)


@pytest.mark.parametrize(("lower", "upper"), [(0.0, 1.0), (0.0, 10.0), (-0.7, 0.1), (1e6, 1e6 + 0.3)])
def test_both_ends_of_an_axis_lie_on_it_whatever_the_number_of_cells(lower, upper):
    for cells in range(1, 400):
        space = rg.ConfigurationSpace((rg.Axis("x", lower, upper, cells),), np.zeros(cells, dtype=np.uint8))
        numbers, local = space.split([[lower], [upper]])
        assert numbers.tolist() == [[0], [cells - 1]]
        assert np.allclose(local, [[0.0], [1.0]])
    beside = (upper - lower) * 1e-6
    for point in (lower - beside, upper + beside, np.nan, np.inf):
        with pytest.raises(rg.InputError, match="outside the grid"):
            space.locate([point])


def test_a_goal_cell_names_its_point() -> None:
    cell = np.zeros((3, 2))
    cell[0, 1], cell[2, 0] = rg.Cell.GOAL, rg.Cell.GOAL
    axes = [rg.Axis("x", 0, 3, 3), rg.Axis("y", 0, 2, 2)]
    space = rg.ConfigurationSpace(axes, cell, goal_points=[(0.5, 1.25), (np.nan, np.nan)])
    np.testing.assert_array_equal(space.goal_point((0, 1)), (0.5, 1.25))
    np.testing.assert_array_equal(space.goal_point([[2, 0], [0, 1], [1, 1]])[1], (0.5, 1.25))
    assert np.isnan(space.goal_point([[2, 0], [0, 1], [1, 1]])[[0, 2]]).all()
    assert np.isnan(rg.ConfigurationSpace(axes, cell).goal_point((0, 1))).all()
    for wrong in ((0.5, np.nan), (1.5, 1.25), (np.inf, 1.25)):
        with pytest.raises(rg.InputError, match=r"goal point .* cell \(0, 1\)"):
            rg.ConfigurationSpace(axes, cell, goal_points=[wrong, (2.5, 0.5)])
