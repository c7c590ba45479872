"""Measurements of planners, compared with values of known paths."""

import numpy as np
import pytest

from benchmarks.planners import Task, measure, narrow
from benchmarks.planners_contenders import networkx_astar, resgrid

FREE = np.ones((9, 7), bool)


def straight(_free, _goal):
    return lambda _start: np.array([(1.5, 3.5), (7.5, 3.5)])


def test_a_straight_line_has_its_length_and_clearance() -> None:
    found = measure(Task(FREE, (1, 3), (7, 3)), straight, 1)
    assert found["success"] == 1 and found["length"] == pytest.approx(1.0)
    assert found["least clearance"] == pytest.approx(1.5)  # the edge beyond the goal


def test_a_line_through_an_obstacle_is_not_a_success() -> None:
    free = FREE.copy()
    free[4] = False
    free[4, 0] = True
    found = measure(Task(free, (1, 3), (7, 3)), straight, 1)
    assert found["success"] == 0 and "length" not in found


@pytest.mark.parametrize("prepare", [networkx_astar, resgrid(1.0)], ids=["networkx", "resgrid"])
def test_every_narrow_scene_has_a_path(prepare) -> None:
    for task in narrow(24, 0):
        assert measure(task, prepare, 1)["success"] == 1


def test_a_missing_path_is_not_a_success() -> None:
    free = FREE.copy()
    free[4] = False
    assert measure(Task(free, (1, 3), (7, 3)), networkx_astar, 1)["success"] == 0
