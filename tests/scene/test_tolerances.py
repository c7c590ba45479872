"""Goals with a tolerance and headings at goals, compared with distances computed from the definition.

Tests internals: `resgrid.scene.overrides`, `resgrid.scene.reading`.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.cli import call

import resgrid as rg
from resgrid.scene.overrides import document_of
from resgrid.scene.reading import build_scene

AXES = (rg.Axis("x", 0.0, 4.0, 40), rg.Axis("y", 0.0, 3.0, 30))
HEAD = (
    'schema = 1\ngrid.axes = [\n{ name = "x", lower = 0, upper = 4, cells = 40 },\n'
    '{ name = "y", lower = 0, upper = 3, cells = 30 } ]\n'
)


def box_distance(axes, point):
    """Return the distance of every cell's box from a point."""
    gaps = np.meshgrid(*(np.maximum(np.abs(axis.centres - at) - axis.spacing / 2, 0)
                         for axis, at in zip(axes, point, strict=True)), indexing="ij")  # fmt: skip
    return np.sqrt(sum(gap**2 for gap in gaps))


def test_goal_cells_are_the_free_cells_that_the_disc_meets():
    rng = np.random.default_rng(1)
    for _ in range(20):
        point, tolerance = tuple(rng.uniform((0.2, 0.2), (3.8, 2.8))), float(rng.uniform(0.05, 0.6))
        wall = rg.Ball(tuple(rng.uniform((0, 0), (4, 3))), 0.4)
        goal = rg.GoalPoint(point, tolerance)
        space = rg.build_space(rg.Scene(AXES, obstacles=(wall,), goals=(goal,)))
        free = space.cell != rg.Cell.OBSTACLE
        distance = box_distance(AXES, point)
        assert ((space.cell == rg.Cell.GOAL) == (free & (distance <= tolerance))).all()
        assert (np.linalg.norm(space.goal_points - point, axis=1) <= tolerance * (1 + 1e-9)).all()


def test_a_goal_inside_an_obstacle_is_reached_within_its_tolerance():
    scene = rg.Scene(AXES, obstacles=(rg.Ball((3.0, 1.5), 0.3),), starts=((0.5, 1.5),))
    with pytest.raises(rg.InputError, match="lies in an obstacle"):
        rg.build_space(scene.replace(goal=(3.0, 1.5)))
    path = rg.plan(scene.replace(goal=rg.GoalPoint((3.0, 1.5), 0.5))).paths()[0]
    rg.certify(path)
    assert 0.3 < np.linalg.norm(path.points[-1] - (3.0, 1.5)) <= 0.5
    with pytest.raises(rg.InputError, match="inside an obstacle"):
        rg.build_space(scene.replace(goal=rg.GoalPoint((3.0, 1.5), 0.1)))


def test_a_pose_of_a_footprint_has_a_tolerance_of_its_place_only():
    robot = rg.PolygonRobot(((-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)))
    axes = (*AXES, robot.turning_axis(12))
    turn = 1.1 * robot.turning_length
    scene = rg.Scene(axes, robot=robot, goals=(rg.GoalPoint((2.03, 1.47, turn), 0.3),), starts=((0.6, 0.6, 0.0),))
    space = rg.build_space(scene)
    cells = np.argwhere(space.cell == rg.Cell.GOAL)
    assert (cells[:, 2] == int(turn / axes[2].spacing)).all()
    assert ((space.cell == rg.Cell.GOAL).any(axis=2) == (box_distance(AXES, (2.03, 1.47)) <= 0.3)).all()
    assert space.goal_points[:, 2] == pytest.approx(turn)
    path = rg.plan(scene).paths()[0]
    rg.certify(path)
    assert np.linalg.norm(path.points[-1][:2] - (2.03, 1.47)) <= 0.3 + 1e-9 and path.points[-1][2] == pytest.approx(
        turn
    )
    run = rg.simulation(scene.replace(start=(1.6, 1.5, 0.9 * robot.turning_length))).run()
    assert run.ending == "arrived" and run.goal_distance == pytest.approx(0, abs=1e-9)


def test_arms_reach_a_disc_around_a_place():
    arm = rg.Arm(lengths=(1.0, 1.0))
    scene = rg.Scene(arm.axes(48), robot=arm, goals=(rg.GoalPoint((1.2, 0.7), 0.1),), starts=((2.0, 1.0),))
    path = rg.plan(scene, boundary="neumann").paths()[0]
    tip = arm.reference_point(path.points[-1:])[0]
    assert path.outcome == "reached" and np.linalg.norm(tip - (1.2, 0.7)) <= 0.1 + 1e-6


def test_the_last_pose_for_ros_has_the_heading_of_the_goal(tmp_path):
    (tmp_path / "a.toml").write_text(HEAD + "starts = [[0.5, 0.5]]\n[[goal]]\npoint = [3.0, 2.0]\nheading = 2.5\n")
    done = call("path", tmp_path / "a.toml", "-o", tmp_path / "a.yaml", "--json")
    assert done.exit_code == 0 and json.loads(done.stdout)["paths"][0]["goal_heading"] == 2.5
    poses = yaml.safe_load((tmp_path / "a.yaml").read_text())["poses"]
    last = poses[-1]["pose"]["orientation"]
    assert 2 * np.arctan2(last["z"], last["w"]) == pytest.approx(2.5)
    plain = rg.plan(rg.read_scene(tmp_path / "a.toml")).paths()[0]
    text = rg.maps.to_ros_path(plain, heading=2.5)
    assert text == (tmp_path / "a.yaml").read_text() and text != rg.maps.to_ros_path(plain)


def test_each_goal_has_its_own_heading(tmp_path):
    goals = "[[goal]]\npoint = [3.0, 2.0]\nheading = 2.5\n[[goal]]\npoint = [1.0, 2.0]\nheading = -1.0\n"
    (tmp_path / "a.toml").write_text(HEAD + "starts = [[3.5, 2.0], [0.5, 2.0]]\n" + goals)
    paths = json.loads(call("path", tmp_path / "a.toml", "--json").stdout)["paths"]
    assert [path["goal_heading"] for path in paths] == [2.5, -1.0]


def test_the_option_gives_all_goal_points_a_tolerance(tmp_path):
    text = HEAD + 'goal = [{ point = [3.0, 1.5] }]\nstarts = [[0.5, 1.5]]\n[[obstacle]]\nshape = "circle"\n'
    (tmp_path / "a.toml").write_text(text + "centre = [3.0, 1.5]\nradius = 0.3\n")
    assert call("path", tmp_path / "a.toml").exit_code == 2
    for words in ((), ("--goal", "3.0,1.6")):
        done = call("path", tmp_path / "a.toml", *words, "--goal-tolerance", "0.5")
        assert done.exit_code == 0, done.stderr
    wrong = call("path", tmp_path / "a.toml", "--goal", "1,1", "--cells", "--goal-tolerance", "0.5")
    assert wrong.exit_code == 2 and "applies to goals that are points" in wrong.stderr


def test_scenes_keep_tolerance_and_heading_in_their_document():
    scene = rg.Scene(AXES, goals=(rg.GoalPoint((1.0, 1.0), 0.2, 0.5), rg.GoalPoint((2.0, 1.0))))
    document = document_of(scene)
    assert document["goal"] == [{"point": [1.0, 1.0], "tolerance": 0.2, "heading": 0.5}, {"point": [2.0, 1.0]}]
    again = build_scene(document, "scene", Path())
    assert again.goals == scene.goals and repr(again.goals[1]) == "GoalPoint(point=(2.0, 1.0))"


@pytest.mark.parametrize(("text", "message"), [
    ("[[goal]]\npoint = [1, 1]\ntolerance = -1\n", "tolerance"),
    ("[[start]]\npoint = [1, 1]\ntolerance = 1\n[[goal]]\npoint = [1, 1]\n", "no other key goes with point"),
    ("[[goal]]\ncell = [1, 1]\ntolerance = 1\n", "no other key goes with cell"),
])  # fmt: skip
def test_invalid_tolerances_are_rejected(text, message):
    with pytest.raises(rg.InputError, match=message):
        rg.parse_scene(HEAD + text)


def test_headings_of_robots_that_turn_are_rejected():
    robot = rg.PolygonRobot(((-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)))
    scene = rg.Scene((*AXES, robot.turning_axis(8)), robot=robot, goals=(rg.GoalPoint((1.0, 1.0), heading=1.0),))
    with pytest.raises(rg.InputError, match=r"goal\[0\].heading: this robot has a heading of its own"):
        rg.build_space(scene)


def test_messages_about_blocked_goals_name_a_tolerance_that_reaches_a_free_place(tmp_path):
    rng = np.random.default_rng(5)
    for _ in range(8):
        x, y = rng.uniform((2.75, 1.25), (3.25, 1.75)).round(3).tolist()
        text = HEAD + 'starts = [[0.5, 1.5]]\n[[obstacle]]\nshape = "circle"\ncentre = [3.0, 1.5]\nradius = 0.4\n'
        (tmp_path / "a.toml").write_text(text)
        blocked = call("path", tmp_path / "a.toml", "--goal", f"{x},{y}")
        assert blocked.exit_code == 2 and "--goal-tolerance" in blocked.stderr, blocked.stderr
        tolerance = blocked.stderr.split("--goal-tolerance ")[1].split()[0]
        words = ("path", tmp_path / "a.toml", "--goal", f"{x},{y}", "--goal-tolerance", tolerance)
        assert call(*words).exit_code == 0
