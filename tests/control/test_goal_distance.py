"""How far from the goal itself a run ends, against the geometry of each kind of goal.

Tests internals: `resgrid.control.goal_distance`.
"""

from __future__ import annotations

import numpy as np
import pytest

import resgrid as rg
from resgrid.control.goal_distance import goal_distance

PLANE = (rg.Axis("x", 0.0, 4.0, 16), rg.Axis("y", 0.0, 4.0, 16))


def scene_of(goal: object, frame: rg.Frame | None = None, **options: object) -> rg.Scene:
    options = {"axes": PLANE, "frame": frame or rg.Frame()} | options
    return rg.Scene(goals=(goal,), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("frame", [rg.Frame(), rg.Frame(2.0, -1.0, 0.7)])
@pytest.mark.parametrize(
    ("goal", "distance"),
    [
        (rg.Ball((3.0, 1.0), 0.4), lambda p: max(0.0, np.hypot(p[0] - 3.0, p[1] - 1.0) - 0.4)),
        (rg.GoalPoint((3.0, 1.0)), lambda p: np.hypot(p[0] - 3.0, p[1] - 1.0)),
        (rg.Box((1.0, 1.0), (2.0, 3.0)), lambda p: np.hypot(max(1 - p[0], p[0] - 2, 0), max(1 - p[1], p[1] - 3, 0))),
    ],
)
def test_places_of_a_point_robot(frame: rg.Frame, goal: object, distance: object) -> None:
    scene, rng = scene_of(goal, frame), np.random.default_rng(0)
    space = rg.ConfigurationSpace(PLANE, np.full((16, 16), 2), frame=frame)
    for place in rng.uniform(0.0, 4.0, (40, 2)):
        expected = distance(space.to_world(place))  # type: ignore[operator]
        assert goal_distance(space, place, scene) == pytest.approx(expected, abs=1e-9)


def test_cells_angles_and_poses() -> None:
    """Distances in axis units, the shorter way around a periodic axis; a box of two axes of three counts as a place."""
    arm = rg.Arm((1.0, 0.8))
    axes = arm.axes(12)
    space = rg.ConfigurationSpace(axes, np.full((12, 12), 2))
    full = 2 * np.pi
    joints = rg.Scene(axes, robot=arm, goals=(rg.GoalJoints((-3.0, 0.1), (-2.9, 0.2)),))
    assert goal_distance(space, np.array([3.1, 0.15]), joints) == pytest.approx(full - 6.1)
    assert goal_distance(space, np.array([3.1 + full, 0.3]), joints) == pytest.approx(np.hypot(full - 6.1, 0.1))
    cell = rg.Scene(axes, robot=arm, goals=(rg.GoalCell((0, 6)),))
    assert goal_distance(space, np.array([-3.0, 0.2]), cell) == 0.0
    assert goal_distance(space, np.array([3.1, 0.2]), cell) == pytest.approx(np.pi - 3.1)
    wedge = rg.PolygonRobot(((-0.2, -0.1), (0.2, -0.1), (0.2, 0.1)), turning_length=0.3)
    turning = (*PLANE, wedge.turning_axis(8))
    poses = rg.ConfigurationSpace(turning, np.full((16, 16, 8), 2))
    at = np.array([1.0, 2.0, 0.1])
    for goal, expected in (
        (rg.GoalPoint((1.0, 2.5)), 0.5),
        (rg.GoalPoint((1.0, 2.5, 0.3 * full)), np.hypot(0.5, 0.1)),
        (rg.Ball((1.0, 3.0), 0.25), 0.75),
    ):
        scene = rg.Scene(turning, robot=wedge, goals=(goal,))
        assert goal_distance(poses, at, scene) == pytest.approx(expected)


def test_without_a_scene_the_points_of_goal_cells_count() -> None:
    cell = np.zeros((4, 4), dtype=np.uint8)
    cell[3, 3] = rg.Cell.GOAL
    axes = (rg.Axis("x", 0.0, 4.0, 4), rg.Axis("y", 0.0, 4.0, 4))
    space = rg.ConfigurationSpace(axes, cell, goal_points=[(3.5, 3.25)])
    assert goal_distance(space, np.array([3.5, 3.75]), None) == pytest.approx(0.5)
    assert np.isnan(goal_distance(space, np.array([1.0, 1.0]), None))


def test_an_arm_that_arrives_by_belief_tells_how_far_its_tip_is_from_the_goal() -> None:
    arm, goal = rg.Arm((1.0, 0.8)), rg.Ball((0.6, 1.1), 0.02)
    scene = rg.Scene(arm.axes(24), robot=arm, goals=(goal,), control=rg.control.Control(k=0.9))
    world, outside = rg.simulation(scene), 0
    for seed in range(6):
        for noise in (0.0, 0.02):
            run = world.run((0.3 + 0.2 * seed, 1.0), noise=noise, seed=seed)
            tip = np.linalg.norm(np.array(arm.tip(run.configuration[-1])) - goal.centre)
            assert run.goal_distance == pytest.approx(max(0.0, tip - goal.radius), abs=1e-8)
            assert run.ending is not rg.control.TerminationReason.ARRIVED or noise > 0 or run.goal_distance == 0.0
            told = "outside the goal itself" in run.message
            assert told == (run.ending is rg.control.TerminationReason.ARRIVED and run.goal_distance > 0)
            outside += told
    assert outside > 0
