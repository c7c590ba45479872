"""The 3-D view of points and balls in space: paths, surfaces and handles, without a browser.

Tests internals: `resgrid.viewer`.
"""

from __future__ import annotations

import time
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from support.pages import PATIENCE

import resgrid as rg
from resgrid.viewer.planning import answer
from resgrid.viewer.point_planning import PointPlan

import_module("viser")


@pytest.fixture(scope="module")
def planner() -> rg.planning.Planner:
    cell = np.zeros((8, 6, 5), dtype=np.uint8)
    cell[4, :5] = rg.Cell.OBSTACLE
    cell[7, 1, 1] = rg.Cell.GOAL
    return rg.plan(rg.ConfigurationSpace.from_array(cell, spacing=0.5), boundary="neumann")


def test_a_path_is_shown_with_its_own_start_and_circuit(planner: rg.planning.Planner) -> None:
    path = planner.path((0.6, 0.7, 2.1))
    task = PointPlan.of_path(path)
    motion = task.motion()
    assert task.wiring.boundary == "neumann" and f"length {path.length:.4g} m" in motion.text
    np.testing.assert_allclose(motion.configurations[[0, -1]], path.points[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(task.towards(task.start, np.array([9.0, 1.0, -3.0])), [4.0, 1.0, 0.0])


def test_goals_and_starts_in_obstacles_are_reported(planner: rg.planning.Planner) -> None:
    task = PointPlan.of_path(planner.path((0.6, 0.7, 2.1)))
    assert "the goal lies in a cell" in answer(task, np.array([2.2, 1.0, 1.0])).text
    task.start = task.start + 0.01
    assert "the goal lies in a cell" in answer(task, None).text
    motion = answer(task, np.array([3.3, 2.9, 0.2]))
    np.testing.assert_allclose(motion.configurations[-1], [3.3, 2.9, 0.2], atol=0.5)
    task.start = np.array([2.2, 1.0, 1.0])
    assert "start blocked" in answer(task, None).text


def test_handles_of_a_view_plan_again(planner: rg.planning.Planner) -> None:
    with rg.view(planner.path((0.6, 0.7, 2.1)), browser=False) as view:
        panel = view.panel
        before = str(panel.status.content)
        assert "reached" in before and [slider.value for slider in panel.joints["start"]] == [0.6, 0.7, 2.1]
        panel.handles["goal"].position = (3.3, 2.6, 2.2)
        panel._dragged("goal", SimpleNamespace(phase="end"))
        end = time.monotonic() + PATIENCE
        while panel.status.content in (before, "planning ..."):
            assert time.monotonic() < end
            time.sleep(0.05)
        assert "reached" in panel.status.content
        np.testing.assert_allclose(panel.motion.configurations[-1], (3.3, 2.6, 2.2), atol=0.5)
        panel.slider.value = 1.0
        panel._show_pose()
        np.testing.assert_allclose(panel.robot._ball.position, panel.motion.configurations[-1])


def test_a_scene_of_a_ball_is_shown_and_planes_are_refused(tmp_path) -> None:
    (tmp_path / "room.3dmap").write_text("voxel 8 6 5\n" + "".join(f"4 {y} {z}\n" for y in range(4) for z in range(5)))
    scene = rg.read_scene(tmp_path / "room.3dmap", goal=(7.2, 1, 2), start=(0.7, 1, 2), robot=rg.PointRobot(0.4))
    with rg.view(scene, browser=False) as view:
        assert "reached" in view.panel.status.content and view.panel.task.radius == 0.4
    with pytest.raises(rg.InputError, match="points and balls in space; this robot is neither"):
        rg.view(rg.read_scene("examples/scenes/lesson.toml"), browser=False)
