"""Unwrapped paths on periodic axes, compared with the closed path's length, and clearance on narrow periodic axes.

Tests internals: `resgrid.planning.clearance`, `resgrid.planning.streamline`.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.planning.clearance import clearance_of, obstacle_reach
from resgrid.planning.streamline import length_of


@given(spaces(max_cells=7), st.data())
@settings(max_examples=40)
def test_unwrapped_steps_are_at_most_one_cell_and_sum_to_the_length(
    space: rg.ConfigurationSpace, data: st.DataObject
) -> None:
    reachable = np.argwhere(space.goal_connected)
    if not len(reachable):
        return
    field = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))
    path = rg.streamline(field, cell=reachable[data.draw(st.integers(0, len(reachable) - 1))].tolist())
    points = rg.planning.unwrap(path)
    turns = (points - path.points) / (space.upper - space.lower)
    np.testing.assert_array_equal(turns[0], 0)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    assert np.all(turns[:, ~space.periodic] == 0)
    assert np.all(np.abs(np.diff(points, axis=0)) <= space.spacing * (1 + 1e-9))
    assert length_of(points) == pytest.approx(path.length)


def test_a_path_in_a_helix_unwraps_to_several_turns() -> None:
    """A helix of obstacles: the path turns several times around the periodic axis."""
    turns, around = 4, 12
    cell = np.zeros((around, turns * 4 + 1), dtype=np.uint8)
    for step in range(turns * around):
        cell[step % around, step * 4 // around] = rg.Cell.OBSTACLE
        if step * 4 % around == 0:
            cell[(step - 1) % around, step * 4 // around] = rg.Cell.OBSTACLE
    cell[:, -1] = rg.Cell.OBSTACLE
    cell[around - 1, turns * 4 - 1] = rg.Cell.FREE
    cell[0, 1] = rg.Cell.GOAL
    space = space_of(cell, periodic=(True, False))
    field = rg.field(rg.solve(rg.compile_space(space)))
    free = np.argwhere(space.goal_connected)
    path = rg.streamline(field, cell=free[np.argmax(free[:, 1])].tolist())
    assert path.outcome == "reached"
    points = rg.planning.unwrap(path)
    assert abs(points[-1, 0] - points[0, 0]) > 2 * around
    turns = (points - path.points)[:, 0] / around
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)


def test_on_a_ring_of_two_cells_the_crossed_face_gives_the_direction() -> None:
    space = space_of([[0], [2]], periodic=(True, False))
    field = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))
    up, down = (rg.planning.unwrap(rg.streamline(field, start=(x, 0.5)))[-1, 0] for x in (0.75, 0.25))
    assert (up, down) == (1.0, 0.0)


def test_invalid_polyline_points_raise_input_error() -> None:
    space = space_of(np.zeros((3, 3)), periodic=(True, False))
    for bad, message in [
        ([(0.0,)], "shape"), ([(np.nan, 0.0)], "not finite"), ("x", "numbers"), ([[1, 2], [3]], "numbers"),
        (np.empty((0, 2)), "shape"),
    ]:  # fmt: skip
        with pytest.raises(rg.InputError, match=message):
            rg.Polyline(bad, space)


@pytest.mark.parametrize("cells", [1, 2, 3, 4, 7])
def test_clearance_on_narrow_periodic_axes_equals_brute_force(cells: int) -> None:
    rng = np.random.default_rng(cells)
    cell = (rng.random((12, cells, cells)) < 0.02).astype(np.uint8)
    cell[0, 0, 0] = rg.Cell.OBSTACLE
    widths = np.array([1000.0, 1e-4, 1e-4])  # an exaggerated map of a turning robot in millimetres
    space = space_of(cell, periodic=(False, True, True), spacing=tuple(widths.tolist()))
    for home in np.argwhere(cell == rg.Cell.FREE)[:: cells * 3]:
        point = (home + rng.random(3)) * widths
        boxes = np.argwhere(cell == rg.Cell.OBSTACLE)
        turns = np.arange(-2, 3)[:, np.newaxis, np.newaxis] * np.array([0, cells, cells])
        below = (boxes + turns) * widths
        each = np.maximum(np.maximum(below - point, point - below - widths), 0.0).min(axis=0)  # per axis
        found = clearance_of(point[np.newaxis], space, ("open", "periodic", "periodic"), obstacle_reach(space))
        assert found == pytest.approx(np.linalg.norm(each, axis=1).min(), rel=1e-9)
