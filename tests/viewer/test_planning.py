"""Paths of the 3-D view, without a browser.

Tests internals: `resgrid.viewer.planning`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import resgrid as rg
from resgrid.viewer.planning import ArmPlan, answer


@pytest.fixture
def task(arm_scene: rg.Scene) -> ArmPlan:
    return ArmPlan(arm_scene)


def test_the_first_motion_is_the_timed_path_from_the_first_start(task: ArmPlan, arm_scene: rg.Scene) -> None:
    motion = task.motion()
    short = rg.shortcut(rg.plan(arm_scene).path(arm_scene.starts[0]))
    assert motion.is_timed and "reached" in motion.text and "clearance" in motion.text
    np.testing.assert_allclose(motion.configurations[[0, -1]], short.points[[0, -1]], atol=1e-9)
    assert motion.times[-1] == pytest.approx(rg.time_parameterize(short).duration)
    clearance = rg.planning.workspace_clearance(short, arm_scene.obstacles, step=0.02)
    assert f"clearance {clearance:.3f} m" in motion.text
    np.testing.assert_allclose(motion.at(0.0), arm_scene.starts[0])
    np.testing.assert_allclose(motion.at(1e9), motion.configurations[-1])


def test_a_new_goal_is_solved_without_new_geometry(task: ArmPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(task.robot), "classify", None)
    goal = np.array([-1.2, -0.6])
    motion = answer(task, goal)
    np.testing.assert_allclose(motion.configurations[-1], goal, atol=1e-9)
    assert task.planner.space.undecided is not None


def test_blocked_goals_and_starts_are_reported_and_the_robot_stays(task: ArmPlan) -> None:
    space = task.planner.space
    blocked = space.centre(np.argwhere(space.cell == rg.Cell.OBSTACLE)[0])
    motion = answer(task, blocked)
    assert "the goal lies in a cell that is not proven free" in motion.text
    np.testing.assert_array_equal(motion.at(0.3), task.start)
    task.start = task.start + 0.01
    assert "the goal lies in a cell that is not proven free" in answer(task, None).text
    assert "reached" in answer(task, np.array([-1.2, -0.6])).text
    task.start = blocked
    assert "start blocked" in answer(task, None).text


def test_a_dragged_handle_moves_the_tool_to_its_place(task: ArmPlan) -> None:
    near = np.array([0.3, 0.4])
    place = task.robot.reference_point(np.array([[0.5, 0.9]]))[0]
    joints = task.towards(near, place)
    np.testing.assert_allclose(joints, [0.5, 0.9], atol=2e-3)
    far = task.towards(near, place * (5.0, 5.0, 1.0))
    reached = task.robot.reference_point(far.reshape(1, -1))[0]
    assert np.linalg.norm(reached[:2]) == pytest.approx(0.9, abs=0.02)
    assert (far >= task.lower).all() and (far <= task.upper).all()


def test_a_scene_without_start_gets_one_and_other_robots_are_refused(arm_scene: rg.Scene) -> None:
    task = ArmPlan(replace(arm_scene, starts=()))
    assert "reached" in task.motion().text
    with pytest.raises(rg.InputError, match="shows arms from URDF files"):
        ArmPlan(rg.read_scene("examples/scenes/lesson.toml"))
