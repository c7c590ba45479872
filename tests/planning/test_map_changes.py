"""Updates of planners by changed maps and by occupancies, with the robot's shape."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import resgrid as rg


@pytest.fixture
def scene(tmp_path) -> rg.Scene:
    cell = np.zeros((40, 30), dtype=np.uint8)
    cell[20, 5:] = rg.Cell.OBSTACLE
    np.save(tmp_path / "cells.npy", cell)
    found = rg.read_scene(tmp_path / "cells.npy", goal=(35.5, 20.5))
    return found.replace(robot=rg.PointRobot(radius=1.0), start=(3.5, 15.5))


def occupancies(scene: rg.Scene) -> np.ndarray:
    assert scene.map is not None
    return np.where(scene.map.cell.T == rg.Cell.OBSTACLE, 100, 0).astype(np.int8)


def assert_equal_to_fresh(planner: rg.planning.Planner, scene: rg.Scene) -> None:
    fresh = rg.plan(scene)
    np.testing.assert_array_equal(planner.space.cell, fresh.space.cell)
    np.testing.assert_allclose(planner.field.potential, fresh.field.potential, atol=1e-12)
    (path,), (reference,) = planner.paths(), fresh.paths()
    rg.certify(path)
    np.testing.assert_array_equal(path.cells, reference.cells)
    np.testing.assert_allclose(path.points, reference.points, atol=1e-6)


def test_a_changed_map_grows_by_the_radius_of_the_robot(scene) -> None:
    cell = scene.map.cell.copy()
    cell[10:13, 12:20] = rg.Cell.OBSTACLE
    changed = dataclasses.replace(scene.map, cell=cell)
    planner = rg.plan(scene).update(changed)
    assert planner.replanning is not None and planner.replanning.method == "elimination"
    assert planner.replanning.changed > 3 * 8
    assert_equal_to_fresh(planner, scene.replace(map=changed))


def test_occupancies_of_the_map(scene) -> None:
    planner, rows = rg.plan(scene), occupancies(scene)
    same = planner.update(occupancy=rows)
    assert same.replanning is not None and same.replanning.method == "unchanged"
    rows[12:20, 10] = 65  # occupied
    rows[3, 30:33] = -1  # unknown
    rows[25, 5:8] = 40  # neither occupied nor free
    planner = same.update(occupancy=rows)
    cell = scene.map.cell.copy()
    cell[10, 12:20] = cell[30:33, 3] = cell[5:8, 25] = rg.Cell.OBSTACLE
    assert_equal_to_fresh(planner, scene.replace(map=dataclasses.replace(scene.map, cell=cell)))


def test_unknown_cells_of_a_map_may_be_free(scene) -> None:
    table = {**scene.map.table, "unknown": "free"}
    scene = scene.replace(map=dataclasses.replace(scene.map, table=table))
    rows = occupancies(scene)
    rows[12:20, 10] = -1
    planner = rg.plan(scene).update(occupancy=rows)
    assert planner.replanning is not None and planner.replanning.method == "unchanged"


def test_a_covered_goal_is_an_error_as_in_a_fresh_plan(scene) -> None:
    planner, rows = rg.plan(scene), occupancies(scene)
    rows[18:24, 33:38] = 100
    with pytest.raises(rg.InputError, match="goal"):
        planner.update(occupancy=rows)
    assert planner.update(occupancy=occupancies(scene)).paths()[0].outcome is rg.Outcome.REACHED


def test_wrong_maps(scene) -> None:
    planner = rg.plan(scene)
    with pytest.raises(rg.InputError, match="30 rows and 40 columns"):
        planner.update(occupancy=occupancies(scene).T)
    with pytest.raises(rg.InputError, match="no scene with a map"):
        rg.plan(planner.space).update(occupancy=occupancies(scene))
    axes = (rg.Axis("x", 0.0, 4.0, 40), rg.Axis("y", 0.0, 3.0, 30))
    with pytest.raises(rg.InputError, match="other axes"):
        planner.update(dataclasses.replace(scene.map, axes=axes))
