"""Updates of planners: every frame gives the fields, outcomes and errors of a fresh plan.

Tests internals: `resgrid.planning`.
"""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from numpy.typing import NDArray

import resgrid as rg
from resgrid.solvers.elimination_tree import PlaneElimination

FREE, OBSTACLE, GOAL = rg.Cell.FREE, rg.Cell.OBSTACLE, rg.Cell.GOAL
CIRCUITS: list[dict[str, object]] = [
    {},
    {"boundary": "neumann"},
    {"boundary": "wall", "wall_resistance": 2e6},
    {"k": 0.7},
    {"edge": "open"},
    {"edge": ("open", "obstacle"), "supply": -5.0, "goal_voltage": 2.0, "resistance": 33.0},
]


def open_map(rng: np.random.Generator) -> NDArray[np.uint8]:
    cell = (rng.random((24, 31)) < 0.08).astype(np.uint8)
    cell[20:22, 4:6], cell[3, 27] = GOAL, GOAL
    return cell


def rooms(rng: np.random.Generator) -> NDArray[np.uint8]:
    cell = np.zeros((29, 26), dtype=np.uint8)
    cell[9], cell[19], cell[:, 12] = OBSTACLE, OBSTACLE, OBSTACLE
    for line in (9, 19):
        cell[line, rng.integers(0, 12)] = cell[line, rng.integers(13, 26)] = FREE
    cell[rng.integers(0, 9), 12] = FREE
    cell[25, 22] = GOAL
    return cell


def maze(rng: np.random.Generator) -> NDArray[np.uint8]:
    cell = np.zeros((33, 23), dtype=np.uint8)
    cell[2::4] = OBSTACLE
    for number, row in enumerate(range(2, 33, 4)):
        cell[row, 0 if number % 2 else -1] = FREE
    cell[32, 12] = GOAL
    cell[0, rng.integers(0, 23)] = OBSTACLE
    return cell


def frames(cell: NDArray[np.uint8], rng: np.random.Generator, count: int) -> list[NDArray[np.uint8]]:
    """Return changed maps: flickering cells, moving boxes, and degenerate frames."""
    found, now = [], cell.copy()
    for _ in range(count):
        kind = rng.integers(0, 10)
        if kind == 0:  # an enclosed goal
            now = cell.copy()
            x, y = np.argwhere(cell == GOAL)[0]
            around = now[max(x - 1, 0) : x + 4, max(y - 1, 0) : y + 4]
            around[around == FREE] = OBSTACLE
        elif kind == 1:  # everything unknown
            now = np.where(cell == GOAL, GOAL, OBSTACLE).astype(np.uint8)
        elif kind == 2:  # the map as it was at first
            now = cell.copy()
        elif kind == 3:  # nothing changes
            now = now.copy()
        elif kind == 4:  # everything free
            now = np.where(cell == GOAL, GOAL, FREE).astype(np.uint8)
        elif kind == 5:  # another goal
            now = cell.copy()
            now[tuple(rng.integers(0, cell.shape))] = GOAL
        elif kind == 6:  # a box
            now = cell.copy()
            x, y = rng.integers(0, cell.shape)
            box = now[x : x + 6, y : y + 6]
            box[box == FREE] = OBSTACLE
        else:  # flickering cells
            now = now.copy()
            for x, y in rng.integers(0, cell.shape, (6, 2)):
                if now[x, y] != GOAL:
                    now[x, y] = OBSTACLE - now[x, y]
        found.append(now)
    return found


def assert_fields_agree(one: rg.Field, other: rg.Field) -> None:
    assert one.wiring == other.wiring
    assert one.k == other.k
    assert one.safe is None
    np.testing.assert_allclose(one.potential, other.potential, rtol=1e-9, atol=1e-12)
    assert (one.log_drop is None) == (other.log_drop is None)
    if one.log_drop is not None and other.log_drop is not None:
        np.testing.assert_allclose(one.log_drop, other.log_drop, rtol=1e-8, atol=1e-8)
    assert np.abs(relative_currents(one, other) - relative_currents(other, other)).max(initial=0.0) <= 1e-7


def relative_currents(field: rg.Field, reference: rg.Field) -> NDArray[np.float64]:
    """Return the face currents of all free cells, divided by the largest current of the cell in another field."""
    cells = np.argwhere(reference.space.goal_connected)
    direction, log_current = field.faces_of(cells)
    largest = reference.faces_of(cells)[1].max(axis=(0, 2))
    base = np.where(np.isfinite(largest), largest, 0.0)
    return direction * np.exp(log_current - base[:, np.newaxis])


def assert_plans_agree(planner: rg.planning.Planner, fresh: rg.planning.Planner) -> None:
    for name, field in planner.solution.pure.items():
        assert_fields_agree(field, fresh.solution.pure[name])
    cells = np.argwhere(np.ones(planner.space.shape, dtype=bool))[::7]
    starts = planner.space.centre(cells)
    np.testing.assert_array_equal(planner.ends(starts).outcome, fresh.ends(starts).outcome)
    for cell in cells[::9]:
        path, reference = planner.path(cell=cell), fresh.path(cell=cell)
        rg.certify(path)
        assert path.outcome is reference.outcome
        np.testing.assert_array_equal(path.cells, reference.cells)
        np.testing.assert_allclose(path.axis_points, reference.axis_points, atol=1e-6)
        assert path.goal == reference.goal
        assert path.clearance == pytest.approx(reference.clearance, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("options", CIRCUITS, ids=str)
@pytest.mark.parametrize("make", [open_map, rooms, maze])
@pytest.mark.quick_cases(6)
def test_every_frame_agrees_with_a_fresh_plan(make, options) -> None:
    rng = np.random.default_rng([len(str(options)), len(make.__name__)])
    planner = rg.plan(rg.ConfigurationSpace.from_array(make(rng), spacing=(0.5, 0.4)), **options)
    methods = set()
    for frame in frames(planner.space.cell, rng, 8):
        planner = planner.update(frame)
        assert planner.replanning is not None
        methods.add(planner.replanning.method)
        assert_plans_agree(planner, rg.plan(planner.space, **options))
    assert "elimination" in methods


def test_results_do_not_depend_on_earlier_frames() -> None:
    rng = np.random.default_rng(3)
    cell = rooms(rng)
    first = rg.plan(rg.ConfigurationSpace.from_array(cell))
    last = cell.copy()
    last[2:6, 2:6] = OBSTACLE
    direct, detour = first.update(last), first
    for frame in [*frames(cell, rng, 20), cell]:
        detour = detour.update(frame)
    detour = detour.update(last)
    assert detour.replanning is not None and detour.replanning.method == "elimination"
    np.testing.assert_array_equal(direct.field.potential, detour.field.potential)
    for axis in range(2):
        np.testing.assert_array_equal(direct.field.face_log_current[axis], detour.field.face_log_current[axis])


def test_an_update_eliminates_only_around_the_changes() -> None:
    planner = rg.plan(rg.ConfigurationSpace.from_array(np.pad([[GOAL]], [(40, 80), (30, 90)])))
    planner = planner.update(cells=[(3, 4)], values=OBSTACLE)
    assert planner.replanning == rg.planning.Replanning("elimination", None, 1, 1.0)
    planner = planner.update(cells=[(100, 100), (101, 100)], values=[OBSTACLE, FREE])
    assert planner.replanning is not None and planner.replanning.changed == 1
    assert planner.replanning.eliminated < 0.03


def test_an_old_planner_stays_valid_and_can_be_updated_again() -> None:
    cell = open_map(np.random.default_rng(1))
    planner = rg.plan(rg.ConfigurationSpace.from_array(cell))
    before = planner.field.potential.copy()
    one = planner.update(cells=[(10, 10)], values=OBSTACLE)
    other = planner.update(cells=[(12, 20)], values=OBSTACLE)
    np.testing.assert_array_equal(planner.field.potential, before)
    for changed in (one, other):
        assert_plans_agree(changed, rg.plan(changed.space))


def test_reports_of_the_method() -> None:
    cell = open_map(np.random.default_rng(1))
    planner = rg.plan(rg.ConfigurationSpace.from_array(cell))
    assert planner.replanning is None
    same = planner.update(cell)
    assert same.replanning == rg.planning.Replanning("unchanged", None, 0, 0.0)
    assert same.field is planner.field
    most = planner.update(np.where(cell == FREE, OBSTACLE, cell))
    assert most.replanning is not None and most.replanning.method == "fresh"
    assert "have changed, more than 25%" in str(most.replanning.reason)


@pytest.mark.parametrize(
    ("space", "options", "reason"),
    [
        (rg.ConfigurationSpace.from_array(np.pad([[[2]]], 3)), {}, "3 axes"),
        (rg.ConfigurationSpace.from_array(np.pad([[2]], 4), periodic=(True, False)), {}, "periodic"),
        (rg.ConfigurationSpace.from_array(np.pad([[2]], 4)), {"rails": "cells"}, "rails"),
    ],
)
def test_other_spaces_get_a_fresh_plan(space, options, reason) -> None:
    planner = rg.plan(space, **options).update(cells=[(0,) * space.ndim], values=OBSTACLE)
    assert planner.replanning is not None and planner.replanning.method == "fresh"
    assert reason in str(planner.replanning.reason)
    fresh = rg.plan(planner.space, **options)
    np.testing.assert_array_equal(planner.field.potential, fresh.field.potential)


def test_a_deep_maze_keeps_its_directions() -> None:
    cell = np.zeros((63, 63), dtype=np.uint8)
    cell[1::2] = OBSTACLE
    for number, row in enumerate(range(1, 63, 2)):
        cell[row, 0 if number % 2 else -1] = FREE
    cell[62, 30] = GOAL
    planner = rg.plan(rg.ConfigurationSpace.from_array(cell)).update(cells=[(0, 0)], values=OBSTACLE)
    fresh = rg.plan(planner.space)
    assert fresh.field.log_drop is not None and fresh.field.log_drop[0, 1] < -1400.0  # below the range of doubles
    assert_fields_agree(planner.field, fresh.field)
    path = planner.path(cell=(0, 40))
    assert path.outcome is rg.Outcome.REACHED
    rg.certify(path)


def test_a_cost_map() -> None:
    rng = np.random.default_rng(5)
    cell = open_map(rng)
    costs = rng.uniform(0.05, 1.0, cell.shape)
    space = rg.ConfigurationSpace.from_array(cell, conductivity=costs)
    costs[8:12, 8:12] = 0.01
    planner = rg.plan(space).update(rg.ConfigurationSpace(space.axes, cell, costs))
    assert planner.replanning is not None
    assert (planner.replanning.method, planner.replanning.changed) == ("elimination", 16)
    assert_plans_agree(planner, rg.plan(planner.space))


def test_a_removed_goal_is_an_error_as_in_a_fresh_plan() -> None:
    cell = rooms(np.random.default_rng(2))
    planner = rg.plan(rg.ConfigurationSpace.from_array(cell))
    with pytest.raises(rg.InputError) as fresh:
        rg.plan(rg.ConfigurationSpace.from_array(np.where(cell == GOAL, FREE, cell)))
    with pytest.raises(rg.InputError) as update:
        planner.update(np.where(cell == GOAL, FREE, cell))
    assert str(update.value) == str(fresh.value)
    assert_plans_agree(planner.update(cells=[(0, 0)], values=OBSTACLE), rg.plan(planner.space.with_cells(
        np.where(np.indices(cell.shape).sum(axis=0) == 0, OBSTACLE, cell))))  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "one of grid"),
        ({"grid": np.zeros((2, 2)), "cells": [(0, 0)], "values": 1}, "one of grid"),
        ({"cells": [(0, 0)]}, "both cells and values"),
        ({"grid": np.zeros((2, 2))}, "make them equal"),
        ({"cells": [(0, 99)], "values": 1}, "not in the grid"),
        ({"cells": [(0, 0)], "values": 7}, "no cell code"),
        ({"cells": [(0, 0)], "values": [1, 0]}, "one per cell"),
    ],
)
def test_wrong_arguments(arguments, message) -> None:
    planner = rg.plan(rg.ConfigurationSpace.from_array(open_map(np.random.default_rng(1))))
    with pytest.raises(rg.InputError, match=message):
        planner.update(**arguments)


def test_an_updated_planner_blends_and_pickles() -> None:
    cell = open_map(np.random.default_rng(4))
    planner = rg.plan(rg.ConfigurationSpace.from_array(cell), k=0.9).update(cells=[(5, 5)], values=OBSTACLE)
    assert planner.at(0.2).field.k == 0.2
    again = pickle.loads(pickle.dumps(planner)).update(cells=[(6, 5)], values=OBSTACLE)
    assert_plans_agree(again, rg.plan(again.space, k=0.9))


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (2, 2), (17, 3), (30, 30)])
def test_elimination_solves_the_equations(shape) -> None:
    rng = np.random.default_rng(shape)
    own = rng.random(shape) < 0.8
    across, along = np.zeros((shape[0] + 1, shape[1])), np.zeros((shape[0], shape[1] + 1))
    across[1:-1] = rng.uniform(0.1, 2.0, across[1:-1].shape) * (own[1:] & own[:-1])
    along[:, 1:-1] = rng.uniform(0.1, 2.0, along[:, 1:-1].shape) * (own[:, 1:] & own[:, :-1])
    ground, currents = rng.uniform(0.1, 1.0, shape) * own, rng.uniform(0.1, 1.0, shape) * own
    elimination = PlaneElimination(shape)
    assert elimination.update(across, along, ground, own) == 1.0
    assert elimination.update(across, along, ground, own) == 0.0
    m, e = elimination.solve(currents)
    assert not e.any()
    wide = np.pad(m, 1)
    net = currents - ground * m
    net += across[:-1] * (wide[:-2, 1:-1] - m) + across[1:] * (wide[2:, 1:-1] - m)
    net += along[:, :-1] * (wide[1:-1, :-2] - m) + along[:, 1:] * (wide[1:-1, 2:] - m)
    np.testing.assert_allclose(net[own], 0.0, atol=1e-13)
