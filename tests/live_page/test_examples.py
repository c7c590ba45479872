"""The examples of the live page: every sentence on an example states a property of its solution.

Tests internals: `resgrid.live_page.drawing`, `resgrid.live_page.examples`, `resgrid.live_page.settle`,
`resgrid.live_page.solving`, `resgrid.scene.shipped`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import resgrid as rg
from resgrid.live_page.drawing import drawing_of
from resgrid.live_page.examples import EXAMPLES, example_menu, examples, open_example
from resgrid.live_page.settle import settle
from resgrid.live_page.solving import SolvedDrawing, solve_drawing, without_imperfections
from resgrid.scene.shipped import shipped_scenes


@cache
def solved(name: str) -> SolvedDrawing:
    """Return the solution of an example as it opens."""
    return solve_drawing(drawing_of(open_example(name)), exact=True)


def decades(name: str) -> np.ndarray:
    """Return log10 of the drop in the cells with a path to a goal; NaN elsewhere."""
    field = solved(name).field
    assert field.log_drop is not None
    return np.where(field.space.goal_connected, field.log_drop / np.log(10.0), np.nan)


def test_every_shipped_scene_with_two_axes_is_an_example_with_a_title_of_its_own():
    plane = {name for name, file in shipped_scenes().items() if rg.read_scene(file).ndim == 2}
    assert {example.scene for example in EXAMPLES.values()} == plane
    menu = example_menu()
    assert [entry["name"] for entry in menu] == list(examples()) == list(EXAMPLES)
    assert len({entry["title"] for entry in menu}) == len(menu)
    groups = [entry["group"] for entry in menu]
    assert groups == sorted(groups, key=groups.index)  # the entries of a group follow each other


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_opens_with_its_title_and_one_short_sentence(name):
    about = EXAMPLES[name].about
    assert drawing_of(open_example(name)).title == EXAMPLES[name].title
    assert about.endswith(".") and about.count(". ") == 0 and len(about) <= 120


def test_an_unknown_example_is_rejected_with_the_known_names():
    with pytest.raises(rg.InputError, match=r"there is no example 'cave'; the examples are lesson, .*scara"):
        open_example("cave")


def test_lesson_node_voltages_are_the_means_of_their_neighbours():
    space, phi = solved("lesson").field.space, np.pad(solved("lesson").field.potential, 1, constant_values=1.0)
    mean = (phi[2:, 1:-1] + phi[:-2, 1:-1] + phi[1:-1, 2:] + phi[1:-1, :-2]) / 4
    free = space.cell == rg.Cell.FREE
    np.testing.assert_allclose(phi[1:-1, 1:-1][free], mean[free], rtol=1e-12)


def test_rooms_has_three_starts_and_two_goals():
    paths = solved("rooms").paths
    assert [path.outcome for path in paths] == ["reached"] * 3 and solved("rooms").field.space.goal_count == 2
    assert min(path.clearance for path in paths) > 0.15


def test_the_drop_of_the_maze_decreases_by_more_than_60_decades():
    assert np.nanmin(decades("maze")) < -60
    assert all(path.outcome == "reached" for path in solved("maze").paths)


def test_the_first_path_of_the_ring_crosses_its_seam_to_the_left():
    cells = solved("ring").paths[0].cells[:, 0]
    assert (np.diff(cells) == solved("ring").field.space.shape[0] - 1).any()


def test_dirichlet_paths_turn_to_the_middle_of_the_corridor():
    frame = solved("corridor")
    for path in frame.paths:
        assert np.interp(3.0, *path.points.T) == pytest.approx(0.5, abs=0.02)
    along = decades("corridor")[:, 10]
    assert 10 ** (along[60] - along[40]) == pytest.approx(20, rel=0.03)  # cells 1 m apart


def test_neumann_paths_keep_their_distance_from_the_walls_of_the_corridor():
    for path in solved("corridor_open").paths:
        assert np.interp(3.0, *path.points.T) == pytest.approx(path.points[0, 1], abs=0.02)


def test_the_clearance_of_the_blend_lies_between_those_of_both_ends():
    drawing = drawing_of(open_example("blend"))
    frames = [solve_drawing(replace(drawing, k=k), exact=True) for k in (0.0, 0.97, 1.0)]
    assert drawing.k == 0.97
    assert [f"{frame.paths[1].clearance:.2f}" for frame in frames] == ["0.11", "0.22", "0.25"]
    assert all(number in EXAMPLES["blend"].about for number in ("0.11 m", "0.22 m", "0.25 m"))


def test_paths_from_outside_bend_around_the_mud():
    frame = solved("mud")
    assert frame.drawing.palette == (1.0, 0.03)
    inside = [int((frame.drawing.level[tuple(path.cells.T)] > 0).sum()) for path in frame.paths]
    assert inside[:2] == [0, 0] and inside[2] > 0
    dry = solve_drawing(replace(frame.drawing, level=0 * frame.drawing.level), exact=True)
    assert all((frame.drawing.level[tuple(path.cells.T)] > 0).any() for path in dry.paths)


def test_the_path_of_the_chip_with_mismatch_differs_from_the_ideal_path():
    (path,), drawing = solved("mismatch").paths, solved("mismatch").drawing
    (ideal,) = solve_drawing(without_imperfections(drawing), exact=True).paths
    assert drawing.chip is not None and drawing.chip["mismatch"] == 0.2
    assert path.outcome == ideal.outcome == "reached" and path.cells.tolist() != ideal.cells.tolist()


def test_the_planning_chip_settles_within_a_microsecond():
    chip = drawing_of(open_example("chip"))
    assert chip.chip is not None and (chip.chip["resistance"], chip.chip["capacitance"]) == (100e3, 60e-15)
    assert settle(chip, None)[0]["times"][-1] < 1e-6


def test_problem_b_has_one_path_and_two_starts_without_a_path():
    assert [path.outcome for path in solved("problem_b").paths] == ["reached", "no_path", "no_path"]


def test_neighbouring_starts_of_two_goals_reach_different_goals():
    first, second, _ = solved("problem_two_goals").paths
    assert first.goal != second.goal and np.linalg.norm(first.points[0] - second.points[0]) < 1.2


@pytest.mark.parametrize("name", ["problem_a", "chair", "container", "scara"])
def test_paths_of_the_other_robots_reach_their_goals(name):
    frame = solved(name)
    assert all(path.outcome == "reached" for path in frame.paths)
    assert len(frame.drawing.axes) == 2
    assert name == "scara" or all(axis.periodic for axis in frame.drawing.axes)
