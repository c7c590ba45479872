"""The last segment of a path, from the face of a goal cell to its goal point, compared with spaces without goal points.

Tests internals: `resgrid.io.paths`, `resgrid.planning.fields`, `resgrid.planning.streamline`, `resgrid.plot.paths`,
`resgrid.robots`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.io.paths import path_columns, write_path
from resgrid.planning.fields import undriven_field
from resgrid.planning.streamline import length_of
from resgrid.plot.paths import seam_pieces
from resgrid.robots import CellSet


def with_goal_points(
    space: rg.ConfigurationSpace, rng: np.random.Generator, whole: float = 0.3
) -> rg.ConfigurationSpace:
    """Return a space with goal points, some on corners and faces; a fraction `whole` of goal cells has none."""
    goals = np.argwhere(space.cell == rg.Cell.GOAL)
    inside = np.where(rng.random(goals.shape) < 0.3, rng.integers(0, 2, goals.shape), rng.random(goals.shape))
    points = space.lower + (goals + inside) * space.spacing
    points[rng.random(len(goals)) < whole] = np.nan
    return rg.ConfigurationSpace(space.axes, space.cell, space.conductivity, goal_points=points)


def open_field(space: rg.ConfigurationSpace) -> rg.Field:
    return rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))


def without_goal_points(space: rg.ConfigurationSpace) -> rg.ConfigurationSpace:
    return rg.ConfigurationSpace(space.axes, space.cell, space.conductivity)


@pytest.mark.slow
@settings(max_examples=40)
@given(spaces(max_cells=7), st.integers(0, 2**32 - 1))
def test_a_path_continues_straight_from_the_face_to_the_goal_point(space: rg.ConfigurationSpace, seed: int) -> None:
    """Points before the face equal those without goal points; spaces include rings of one and two cells."""
    rng = np.random.default_rng(seed)
    space = with_goal_points(space, rng)
    starts = np.argwhere(space.cell == rg.Cell.GOAL)[:2].tolist() + np.argwhere(space.goal_connected)[::9].tolist()
    if not space.goal_connected.any():
        return
    field, plain = open_field(space), open_field(without_goal_points(space))
    places = space.lower + (np.array(starts) + rng.random((len(starts), space.ndim))) * space.spacing
    many = rg.streamlines(field, places)
    for number, place in enumerate(places):
        path, before = rg.streamline(field, place), rg.streamline(plain, place)
        rg.certify(path)
        assert path.outcome is before.outcome
        np.testing.assert_array_equal(path.cells, before.cells)
        goal = space.goal_point(path.cells[-1])
        if path.outcome is not rg.Outcome.REACHED or np.isnan(goal).any():
            np.testing.assert_array_equal(path.points, before.points)
            continue
        leg = np.linalg.norm(goal - before.points[-1])
        until = -1 if np.all(np.abs(goal - before.points[-1]) <= 0.5 * space.rounding * space.spacing) else None
        np.testing.assert_array_equal(path.points, np.concatenate([before.points[:until], goal[np.newaxis]]))
        assert path.length == pytest.approx(before.length + leg)
        assert many.length[number] == pytest.approx(path.length)
        assert path.clearance <= before.clearance * (1 + 1e-9)
        np.testing.assert_array_equal(path.log_duration, before.log_duration)
        way = rg.planning.unwrap(path)
        assert np.all(np.abs(np.diff(way, axis=0)) <= space.spacing * (1 + 1e-9))
        assert length_of(way) == pytest.approx(path.length)
        turns = (way[-1] - goal) / (space.upper - space.lower)
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
        rg.certify_collision_free(path)
        short = rg.shortcut(path, rounds=5)
        np.testing.assert_array_equal(short.points[-1], way[-1])
        motion = rg.time_parameterize(path, velocity_limits=1.0, acceleration_limits=1.0)
        np.testing.assert_array_equal(motion.positions[-1], way[-1])


def space_with_goal_in_a_corner() -> rg.ConfigurationSpace:
    """A space whose goal point lies in a corner of its cell, nearer to the pillar than the rest of the path."""
    cell = np.zeros((12, 9))
    cell[9, 6] = 1
    cell[8, 5] = 2
    return rg.ConfigurationSpace(space_of(cell).axes, cell, goal_points=[(8.9, 5.9)])


def test_clearance_includes_the_last_segment() -> None:
    space = space_with_goal_in_a_corner()
    field = rg.field(rg.solve(rg.compile_space(space, edge="open")))
    path = rg.streamline(field, (2.0, 2.0))
    exact = shapely.distance(shapely.LineString(path.points), shapely.box(9, 6, 10, 7))
    assert path.clearance == pytest.approx(exact) == pytest.approx(np.hypot(0.1, 0.1))
    assert (
        rg.streamline(
            rg.field(rg.solve(rg.compile_space(without_goal_points(space), edge="open"))), (2.0, 2.0)
        ).clearance
        > 0.2
    )


def test_a_path_without_its_last_segment_fails_the_certificate() -> None:
    space = space_with_goal_in_a_corner()
    field = open_field(space)
    path = rg.streamline(field, (2.0, 2.0))
    assert len(path.points) == len(path.cells) + 1
    moved = path.points.copy()
    moved[-1] -= 1e-6
    face = path.points[:-1].copy()
    for changes in ({"axis_points": moved}, {"axis_points": face}, {"axis_points": face, "length": length_of(face)}):
        with pytest.raises(rg.CertificateError):
            rg.certify(replace(path, **changes))
    with pytest.raises(rg.CertificateError):
        rg.certify(replace(path, field=open_field(without_goal_points(space))))
    with pytest.raises(rg.CertificateError, match="shape"):
        rg.certify(replace(path, axis_points=np.concatenate([path.points, path.points])))


def test_a_path_from_the_goal_cell_is_the_last_segment_only() -> None:
    space = space_with_goal_in_a_corner()
    undriven = undriven_field(space, rg.Wiring("neumann"))
    for path in (rg.streamline(open_field(space), (8.2, 5.5)), rg.streamline(undriven, (8.2, 5.5))):
        assert (path.outcome, path.goal, len(path.cells)) == (rg.Outcome.REACHED, 0, 1)
        np.testing.assert_array_equal(path.points, [(8.2, 5.5), (8.9, 5.9)])
        assert path.length == pytest.approx(np.hypot(0.7, 0.4))
        assert path.clearance == pytest.approx(np.hypot(0.1, 0.1))
        assert np.isnan(path.log_duration)
        rg.certify(path)
    assert rg.streamline(undriven, (9.5, 6.5)).outcome is rg.Outcome.START_BLOCKED
    assert rg.streamline(undriven, (1.0, 1.0)).outcome is rg.Outcome.NO_CURRENT


def test_exports_pictures_and_unwrap_end_at_the_goal_point(tmp_path: Path) -> None:
    """The goal lies across a seam."""
    cell = np.zeros((10, 6))
    cell[5, :], cell[9, 2] = 1, 2
    axes = space_of(cell, periodic=(True, False)).axes
    space = rg.ConfigurationSpace(axes, cell, goal_points=[(9.25, 2.75)])
    path = rg.streamline(open_field(space), (1.5, 3.0))
    goal = (-0.75, 2.75)
    np.testing.assert_allclose(rg.planning.unwrap(path)[-1], goal)
    np.testing.assert_allclose(rg.planning.workspace_path(path)[-1], goal)
    assert path_columns(path)["x"][-1] == pytest.approx(goal[0])
    columns = json.loads(write_path(path, tmp_path / "path.json").read_text())
    assert (columns["x"][-1], columns["y"][-1]) == pytest.approx(goal)
    assert rg.check_collisions(path, [CellSet(space.axes, cell == 1)]) is None
    lines = seam_pieces(path)
    np.testing.assert_allclose(lines[-1][-1], (9.25, 2.75))
    assert sum(map(length_of, lines)) == pytest.approx(path.length)
