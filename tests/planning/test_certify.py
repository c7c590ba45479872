"""Certificates: they hold for every computed streamline at any origin and fail after any change of one number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.spaces import spaces

import resgrid as rg

PLACES = {
    "origin": ((0.0, 0.0), 0.5),
    "UTM, 5 cm": ((500000.0, 5400000.0), 0.05),
    "UTM, 1 cm": ((500000.0, 5400000.0), 0.01),
    "far away": ((1e9, 1e9), 1.0),
    "nanometres": ((0.0, 0.0), 1e-9),
}


def field_of_a_room(origin: tuple[float, float] = (0.0, 0.0), width: float = 0.5, *, goal: bool = True) -> rg.Field:
    """A room of 24 by 20 cells with pillars, a wall that cuts off a chamber, and a goal of two cells."""
    cell = (np.random.default_rng(3).random((24, 20)) < 0.15).astype(np.uint8)
    cell[17:, 6], cell[17, :7] = 1, 1
    cell[18:22, 2:5], cell[:2, :2] = 0, 0
    cell[10:12, 10] = 2
    axes = [rg.Axis(n, o, o + k * width, k) for n, o, k in zip("xy", origin, (24, 20), strict=True)]
    points = np.array([(o + (i + 0.3) * width, p + 10.6 * width) for o, p in [origin] for i in (10, 11)])
    space = rg.ConfigurationSpace(axes, cell, goal_points=points if goal else None)
    return rg.field(rg.solve(rg.compile_space(space)))


def rejection(path: rg.Streamline) -> str:
    with pytest.raises(rg.CertificateError) as error:
        rg.certify(path)
    assert "np." not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("goal", [True, False], ids=["goal points", "whole cells"])
@pytest.mark.parametrize("place", PLACES)
def test_certificates_hold_at_every_origin_and_fail_for_altered_paths(place: str, goal: bool) -> None:
    field = field_of_a_room(*PLACES[place], goal=goal)
    space, rng = field.space, np.random.default_rng(0)
    for start in np.argwhere(space.goal_connected)[::23]:
        path = rg.streamline(field, cell=start.tolist())
        rg.certify(path)
        rg.certify_collision_free(path)
        assert rg.shortcut(path, rounds=3).length <= path.length
        points, number = path.points.copy(), int(rng.integers(len(path.points)))
        points[number] += rng.choice([-1, 1], 2) * 1e-3 * space.spacing
        rejection(replace(path, axis_points=points))
        for name in ("length", "clearance"):
            rejection(replace(path, **{name: getattr(path, name) + 1e-3 * space.spacing[0]}))
        if len(path.cells) > 1:
            rejection(replace(path, log_duration=path.log_duration + 1e-3))


@settings(max_examples=40)
@given(spaces(max_cells=7), st.integers(0, 2**32 - 1))
def test_a_change_of_any_single_number_fails_the_certificate(space: rg.ConfigurationSpace, seed: int) -> None:
    rng = np.random.default_rng(seed)
    goals = np.argwhere(space.cell == rg.Cell.GOAL)
    points = space.lower + (goals + rng.random(goals.shape)) * space.spacing
    points[rng.random(len(goals)) < 0.3] = np.nan
    space = rg.ConfigurationSpace(space.axes, space.cell, space.conductivity, goal_points=points)
    starts = np.argwhere(space.goal_connected)
    if not len(starts):
        return
    field = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))
    inside = rng.uniform(0.1, 0.9, space.ndim)
    path = rg.streamline(field, space.lower + (starts[rng.integers(len(starts))] + inside) * space.spacing)
    rg.certify(path)
    row, axis = int(rng.integers(len(path.points))), int(rng.integers(space.ndim))
    for off in (np.nan, np.inf, 10.0 ** rng.uniform(-5, 1), -(10.0 ** rng.uniform(-5, 1))):
        altered = path.points.copy()
        altered[row, axis] += off * space.spacing[axis]
        rejection(replace(path, axis_points=altered))
        for name in ("length", "clearance"):
            if getattr(path, name) + off != getattr(path, name):
                rejection(replace(path, **{name: getattr(path, name) + off}))
    cells = path.cells.copy()
    cells[int(rng.integers(len(cells))), axis] += rng.choice([-1, 1])
    rejection(replace(path, cells=cells))
    for changes in (
        {"goal": None}, {"goal": -1}, {"goal": True}, {"goal": "0"}, {"length": np.nan}, {"clearance": np.nan},
        {"log_duration": np.inf}, {"log_duration": -np.inf}, {"length": "1"}, {"length": None},
        {"cells": path.cells.astype(float)}, {"axis_points": path.points[:-1].copy()}, {"cells": path.cells[:0]},
        {"axis_points": np.concatenate([path.points, path.points[-1:]])}, {"axis_points": path.points.astype(str)},
        *({"outcome": outcome} for outcome in (*rg.Outcome, "reached", "fine", None) if outcome is not path.outcome),
    ):  # fmt: skip
        rejection(replace(path, **changes))


def test_failed_streamlines_with_added_points_or_values_are_rejected() -> None:
    field = field_of_a_room()
    wall, chamber = rg.streamline(field, cell=(20, 6)), rg.streamline(field, cell=(20, 3))
    assert (wall.outcome, chamber.outcome) == (rg.Outcome.START_BLOCKED, rg.Outcome.NO_PATH)
    for path in (wall, chamber):
        rg.certify(path)
        for changes in (
            {"axis_points": path.points + 100}, {"axis_points": path.points * np.nan}, {"length": -3.0}, {"goal": 0},
            {"cells": np.repeat(path.cells, 3, axis=0), "axis_points": np.repeat(path.axis_points, 3, axis=0)},
            {"clearance": 0.0}, {"log_duration": 0.0}, {"outcome": rg.Outcome.GOAL_BLOCKED},
            {"cells": np.array([[0, 0]]), "axis_points": np.array([[0.25, 0.25]])},
        ):  # fmt: skip
            rejection(replace(path, **changes))


def test_a_path_with_another_field_is_rejected() -> None:
    """The same cells under other currents, other obstacles and other goal points."""
    field = field_of_a_room()
    space = field.space
    path = rg.streamline(field, cell=(0, 0))
    rg.certify(path)
    against = replace(field, face_direction=tuple(-d for d in field.face_direction))
    assert "no current" in rejection(replace(path, field=against))
    costly = rg.ConfigurationSpace(space.axes, space.cell, np.linspace(1, 9, 480).reshape(24, 20))
    rejection(replace(path, field=rg.field(rg.solve(rg.compile_space(costly)))))
    rejection(replace(path, field=field_of_a_room(goal=False)))
    rg.certify(path)


def test_other_types_and_other_dimensions_are_rejected() -> None:
    field = field_of_a_room()
    with pytest.raises(rg.InputError, match="path = <an ndarray> must be a Streamline"):
        rg.certify(np.zeros((3, 2)))  # type: ignore[arg-type]
    cube = rg.ConfigurationSpace([rg.Axis(name, 0, 1, 2) for name in "xyz"], np.array([[[0, 2], [0, 0]]] * 2))
    path = rg.streamline(rg.field(rg.solve(rg.compile_space(cube))), cell=(0, 0, 0))
    assert "2 axes" in rejection(replace(path, field=field))
