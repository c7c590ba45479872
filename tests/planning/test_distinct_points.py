"""Distinct points of paths, shortcuts and motions, for starts on faces, edges, corners and seams.

Tests internals: `resgrid.planning.streamline`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.planning.streamline import distinct_rows

NEAR = 4.9e-10
"""Fraction of a cell's width below which two points count as equal."""


def check_distinct(path: rg.Streamline) -> None:
    """Assert distinct points and valid certificates of a path, its shortcut and its motion."""
    rg.certify(path)
    assert len(path.points) == len(path.line) <= len(path.axis_points)
    for each in (path, rg.shortcut(path, rounds=50)):
        line = rg.planning.unwrap(each)
        steps = np.abs(np.diff(line, axis=0) / path.space.spacing).max(axis=1)
        assert np.all(steps > NEAR), steps.min()
        rg.certify_collision_free(each)
        rg.certify_collision_free(rg.Polyline(line, path.space))
        assert np.all(np.diff(rg.time_parameterize(each, velocity_limits=1.0).times) > 0)


@pytest.mark.slow
@settings(max_examples=80, deadline=None)
@given(spaces(), st.sampled_from(["dirichlet", "neumann"]), st.data())
def test_paths_from_faces_edges_and_corners_have_distinct_points(
    space: rg.ConfigurationSpace, boundary: str, data: st.DataObject
) -> None:
    planner = rg.plan(space, boundary=boundary)
    places = st.sampled_from([0.0, 1.0, 0.5, 1e-15, 1.0 - 1e-15, 1e-10, 0.3])
    for _ in range(4):
        cell = np.array([data.draw(st.integers(0, n - 1)) for n in space.shape])
        local = np.array([data.draw(places) for _ in space.shape])
        start = np.minimum(space.lower + (cell + local) * space.spacing, space.upper)
        path = planner.path(start)
        if path.outcome is rg.Outcome.REACHED:
            check_distinct(path)
            np.testing.assert_allclose(path.points[0], path.axis_points[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [(6, 6), (4, 4, 4)])
def test_a_path_through_corners_lists_every_cell(shape: tuple[int, ...]) -> None:
    """By symmetry the path runs along the diagonal: a face of every axis is crossed at every corner."""
    cell = np.zeros(shape, dtype=np.uint8)
    cell[(0,) * len(shape)] = rg.Cell.GOAL
    path = rg.plan(space_of(cell), boundary="neumann", edge="open").path(cell=[n - 1 for n in shape])
    check_distinct(path)
    assert len(path.cells) == 1 + sum(n - 1 for n in shape)
    assert all(np.abs(after - before).sum() == 1 for before, after in pairwise(path.cells))
    assert len(path.points) <= shape[0] + 1 < len(path.cells)


def test_the_first_segment_has_the_direction_of_the_path() -> None:
    """A start on a corner of cells whose width is not exactly representable."""
    cell = np.zeros((30, 20), dtype=np.uint8)
    cell[25, 12] = rg.Cell.GOAL
    space = space_of(cell, spacing=(0.05, 0.05))
    path = rg.plan(space, boundary="neumann").path((0.6, 0.3))
    first, second = path.points[:2]
    assert np.linalg.norm(second - first) > 1e-3
    np.testing.assert_array_equal(first, (0.6, 0.3))
    check_distinct(path)


@settings(max_examples=200)
@given(st.lists(st.sampled_from([0.0, 0.4, 0.8, 1.2, 3.0]), min_size=1, max_size=12))
def test_distinct_rows_merges_rows_within_a_tolerance(values: list[float]) -> None:
    points: Any = np.array(values)[:, np.newaxis]
    rows = distinct_rows(points, np.array([0.5]))
    assert rows[0] == 0 and np.all(np.diff(rows) > 0)
    assert len(rows) == 1 or rows[-1] == len(values) - 1
    kept = points[rows]
    assert np.all(np.abs(np.diff(kept[:-1], axis=0)) > 0.5)
    # Every dropped row lies within the tolerance of a kept row, or of the last row.
    assert all(np.abs(point - kept).min() <= 1.0 for point in points)
