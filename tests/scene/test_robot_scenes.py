"""Scenes with arms, discs and turning polygons, and the scenes of the 1992 paper: axes, goals, cells, outcomes.

Tests internals: `resgrid.core.regions`, `resgrid.scene.overrides`, `resgrid.scene.reading`.
"""

import numpy as np
import pytest

import resgrid as rg
from resgrid.core.regions import label_regions
from resgrid.scene.overrides import apply_overrides, document_of
from resgrid.scene.reading import build_scene

ARM = """
schema = 1
[robot]
type = "arm"
links = [{ length = 1.0, width = 0.1 }, { length = 0.8, limits = [-2, 2] }]
[grid]
cells = [24, 20]
"""
GOAL = '[[goal]]\nshape = "circle"\ncentre = [1.0, 1.0]\nradius = 0.2\n'
POLYGON = """
schema = 1
[robot]
type = "polygon"
vertices = [[-0.2, 0], [0.2, 0], [0, 0.3]]
turning_length = 0.5
[grid]
axes = [{ lower = 0, upper = 2, cells = 10 }, { lower = 0, upper = 2, cells = 10 }, { cells = 8 }]
"""


def test_the_axes_of_an_arm_scene_are_those_of_its_joints():
    scene = rg.parse_scene(ARM + GOAL)
    assert isinstance(scene.robot, rg.Arm)
    assert scene.axes == scene.robot.axes((24, 20))
    assert [axis.periodic for axis in scene.axes] == [True, False]
    assert scene.edge == ("periodic", "obstacle")
    named = rg.parse_scene(
        ARM.replace("cells = [24, 20]", 'axes = [{ name = "q", cells = 9 }, { spacing = 0.5 }]') + GOAL
    )
    assert [(axis.name, axis.cells, axis.unit) for axis in named.axes] == [("q", 9, "rad"), ("theta_2", 8, "rad")]
    half = rg.parse_scene(
        ARM.replace("cells = [24, 20]", "axes = [{ lower = 0, upper = 1, cells = 9 }, { cells = 3 }]") + GOAL
    )
    assert not half.axes[0].periodic


def test_goals_in_joint_space_have_the_expected_cells():
    box = rg.parse_scene(ARM + "[[goal]]\njoints_lower = [-0.5, -0.5]\njoints_upper = [0.5, 0.5]\n")
    assert box.goals == (rg.GoalJoints((-0.5, -0.5), (0.5, 0.5)),)
    cells = rg.build_space(box).centre(np.argwhere(rg.build_space(box).cell == 2))
    assert len(cells) == 4 * 6
    assert np.abs(cells).max() <= 0.5 + 1e-12
    one = rg.build_space(rg.parse_scene(ARM + "[[goal]]\njoints = [3.3, 0.1]\n"))  # 3.3 rad is -2.98 rad
    assert np.argwhere(one.cell == 2).tolist() == [[0, 10]]


DISC = """
schema = 1
robot = { type = "disc", radius = 0.2 }
[grid]
cells = 9
axes = [{ name = "x", lower = 0, upper = 3 }, { name = "y", lower = 0, upper = 3, cells = 8 }]
[[goal]]
point = [1, 1]
"""


def test_documents_of_all_robots_round_trip():
    for text in (ARM + GOAL, POLYGON + "[[goal]]\npoint = [1.2, 1.3]\n", DISC, ARM + "[[goal]]\njoints = [1, 1]\n"):
        scene = rg.parse_scene(text)
        again = build_scene(document_of(scene), "s", None)
        assert (again.robot, again.axes, again.goals) == (scene.robot, scene.axes, scene.goals)
    assert isinstance(rg.parse_scene(DISC).robot, rg.DiscRobot)
    assert isinstance(rg.parse_scene(POLYGON + "[[goal]]\npoint = [1.2, 1.3]\n").robot, rg.PolygonRobot)


def test_overrides_change_robots_and_cells():
    scene = apply_overrides(
        rg.parse_scene(ARM + GOAL), {"grid.cells": "8", "robot.links[0].length": "1.5", "goal": "1.5,1.2"}
    )
    assert [axis.cells for axis in scene.axes] == [8, 8]
    assert scene.robot.lengths == (1.5, 0.8)
    assert rg.build_space(scene).goal_count >= 1


def test_build_space_reports_progress_up_to_the_total():
    reported = []
    rg.build_space(rg.parse_scene(ARM + GOAL), progress=lambda done, total: reported.append((done, total)))
    assert reported[-1] == (24 + 480, 24 + 480)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (ARM.replace("length = 1.0", "length = -1.0") + GOAL, "line 5: robot.links[0].length: must be greater than 0"),
        (ARM.replace("width = 0.1", "width = -0.1") + GOAL, "robot.links[0].width: must be at least 0"),
        (ARM.replace("[-2, 2]", "[2, -2]") + GOAL, "line 5: robot.links[1]: limits = [2.0, -2.0] are reversed"),
        (ARM.replace("[-2, 2]", "[1, 1]") + GOAL, "line 5: robot.links[1]: limits = [1.0, 1.0] are equal: the joint"),
        (ARM.replace("length = 1.0,", "lenght = 1.0,") + GOAL, "did you mean 'length'"),
        (ARM.replace('"arm"', '"arms"') + GOAL, "type = 'arms' is unknown: it may be one of point, disc, polygon, arm"),
        (ARM.replace("links = [{", "links = []\nl = [{") + GOAL, "robot.links: needs at least 1 entries"),
        (ARM.replace('"arm"', "3") + GOAL, 'the robot needs type = "point"'),
        (ARM.replace("[24, 20]", "[24, 20, 7]") + GOAL, "grid.cells: needs one number for each of the 2 axes"),
        (ARM.replace("cells = [24, 20]", "axes = [{ cells = 3 }]") + GOAL, "an arm of 2 joints needs 2 axes, got 1"),
        (ARM.replace("cells = [24, 20]", "axes = [{ cells = 3, lower = 0, upper = 1, periodic = true }, { cells = 2 }]")
         + GOAL, "a periodic joint turns by 2 pi"),
        (ARM.replace("cells = [24, 20]", "axes = [{ cells = 3 }, { cells = 2, lower = -3 }]") + GOAL, "limits are"),
        (ARM.replace("[grid]\ncells = [24, 20]", '[map]\nfile = "a.png"') + GOAL, "needs a [grid]"),
        (ARM + GOAL.replace("[1.0, 1.0]", "[2.5, 0.0]"),
         "goal[0]: the goal is 2.3 from the base, the arm reaches 1.8"),
        (ARM + "[[goal]]\npoint = [0.21, 0.0]\n", "goal[0]: the joint limits keep the arm's tip out of this goal"),
        (ARM + "[[goal]]\npoint = [1, 2, 3]\n", "needs 2 coordinates, a place in the plane, got 3"),
        (ARM + "[[goal]]\njoints = [1, 2, 3]\n", "goal[0].joints: needs 2 coordinates, one for each axis, got 3"),
        (ARM + "[[goal]]\njoints = [1, 2.5]\n", "goal[0]: the point [1.0, 2.5] lies outside the grid"),
        (ARM + "[[goal]]\njoints_lower = [1, 1]\njoints_upper = [0, 2]\n", "lower <= upper"),
        (ARM + GOAL + '[[obstacle]]\nshape = "box"\nlower = [1, 1, 1]\nupper = [2, 2, 2]\n', "a place in the plane"),
        (ARM + GOAL + '[[obstacle]]\nshape = "rectangle"\nlower = [0.5, 0.5]\nupper = [2, 2]\n',
         "goal[0]: this goal lies inside an obstacle"),
        (POLYGON.replace("[0, 0.3]]", "[0, -0.3], [0, 0.3]]") + "[[goal]]\npoint = [1, 1]\n", "not simple"),
        (POLYGON.replace(", { cells = 8 }", "") + "[[goal]]\npoint = [1, 1]\n", "needs 3 axes (x, y, theta), got 2"),
        (POLYGON + "[[goal]]\npoint = [1]\n", "needs 2 coordinates (a place in the plane) or 3 (a configuration)"),
        (POLYGON.replace("0.5", "-0.5") + "[[goal]]\npoint = [1, 1]\n", "robot.turning_length: must be greater than 0"),
    ],
)  # fmt: skip
def test_each_error_has_its_message(text, expected):
    with pytest.raises(rg.InputError) as caught:
        rg.build_space(rg.parse_scene(text, "s.toml"))
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value) or "errors" in str(caught.value)


def test_problem_a_has_goal_cells_in_two_connected_regions(scenes):
    scene = rg.read_scene(scenes / "problem_a.toml")
    space = rg.build_space(scene)
    region = label_regions(space.cell != rg.Cell.OBSTACLE, space.periodic)
    assert region.max() == 2  # elbow left and elbow right, without isolated cells
    assert sorted(region[space.cell == rg.Cell.GOAL].tolist()) == [1] * 19 + [2] * 19
    turn = np.sign(np.sin(np.diff(space.centre(np.argwhere(region == 1)), axis=1)))
    assert (turn == turn[0]).all()
    tips = scene.robot.tip(space.goal_points)
    goal = scene.goals[0]
    assert isinstance(goal, rg.Box)
    assert ((tips >= np.subtract(goal.lower, 1e-9)) & (tips <= np.add(goal.upper, 1e-9))).all()


def volume_lost(scene):
    """Fraction of the volume free by cell centres that the conservative rule blocks."""
    sure, centres = (
        rg.build_space(scene.replace(sampling=rule), require_goal=False).cell == rg.Cell.OBSTACLE
        for rule in ("conservative", "centre")
    )
    return (sure & ~centres).sum() / (~centres).sum()


def test_the_conservative_rule_blocks_little_additional_volume(scenes):
    assert 0.002 < volume_lost(rg.read_scene(scenes / "problem_a.toml")) < 0.01
    assert 0.03 < volume_lost(rg.read_scene(scenes / "problem_b.toml")) < 0.06
    assert volume_lost(rg.read_scene(scenes / "voxel_maze.toml")) == 0  # every wall ends on a border of cells


def test_problem_b_separates_a_sixth_of_the_free_cells(scenes):
    scene = rg.read_scene(scenes / "problem_b.toml")
    space = rg.build_space(scene)
    free = space.cell == rg.Cell.FREE
    cut_off = 1 - space.goal_connected.sum() / free.sum()
    assert 0.15 < cut_off < 0.18
    assert [bool(space.goal_connected[tuple(space.locate(start))]) for start in scene.starts] == [True, False, False]
    assert all(free[tuple(space.locate(start))] for start in scene.starts)


@pytest.mark.parametrize("name", ["problem_a", "problem_b", "problem_two_goals", "three_link", "turning", "voxel_maze"])
def test_shipped_robot_scenes_plan_from_every_connected_start(scenes, name):
    scene = rg.read_scene(scenes / f"{name}.toml")
    space = rg.build_space(scene)
    field = rg.field(rg.solve(rg.compile_space(space)))
    outcomes = []
    for start in scene.starts:
        path = rg.streamline(field, start)
        outcomes.append(str(path.outcome))
        if path.outcome == "reached":
            rg.certify(path)
    assert outcomes == (["reached", "no_path", "no_path"] if name == "problem_b" else ["reached"] * len(outcomes))
    if name == "problem_two_goals":
        assert len({rg.streamline(field, start).goal for start in scene.starts}) == 3


def test_goal_points_lie_in_the_goal_and_in_their_cells():
    text = DISC.replace("point = [1, 1]", "cell = [7, 7]") + (
        '[[goal]]\nshape = "circle"\ncentre = [1.0, 1.0]\nradius = 0.25\n[[goal]]\npoint = [0.5, 2.0]\n'
        '[[obstacle]]\nshape = "rectangle"\nlower = [1.6, 0.5]\nupper = [2, 1]\n'
    )
    space = rg.build_space(rg.parse_scene(text))
    goals = np.argwhere(space.cell == rg.Cell.GOAL)
    points = dict(zip(map(tuple, goals.tolist()), space.goal_points, strict=True))
    assert np.isnan(points.pop((7, 7))).all()
    assert np.allclose(points.pop((1, 5)), (0.5, 2.0))
    assert sorted(points) == [(2, 2), (2, 3), (3, 2), (3, 3)]
    for cell, point in points.items():
        assert np.hypot(*(point - (1, 1))) <= 0.25 + 1e-9
        assert (np.abs((point - space.centre(cell)) / space.spacing) <= 0.5 + 1e-9).all()


def test_goals_in_world_coordinates_are_transformed_to_the_map(tmp_path):
    (tmp_path / "map.pgm").write_bytes(b"P5 20 10 255 " + bytes([255]) * 200)
    (tmp_path / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.5\norigin: [3.0, -2.0, 0.7]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    place = rg.read_scene(tmp_path / "map.yaml").frame.to_world((6.1, 2.2))
    (tmp_path / "scene.toml").write_text(
        f'schema = 1\n[map]\nfile = "map.yaml"\n[[goal]]\npoint = {place.tolist()}\n[[obstacle]]\n'
        f'shape = "rectangle"\nlower = [5.0, 1.0]\nupper = [5.0, 2.0]\n'  # a line, turned
    )
    space = rg.build_space(rg.read_scene(tmp_path / "scene.toml"))
    assert np.allclose(space.goal_points, [(6.1, 2.2)])
    line = [(5.0, share) for share in np.linspace(1.0, 2.0, 50)]
    assert (space.cell[tuple(space.locate(line).T)] == rg.Cell.OBSTACLE).all()


@pytest.mark.parametrize("at", ["centre = [1.5, 1.5]\nradius = 0", "centre = [1.2, 1.5]\nradius = 0"])
def test_a_goal_without_area_on_a_cell_border_has_one_region(at):
    text = DISC.replace("cells = 9", "cells = 10").replace("cells = 8", "cells = 10")
    space = rg.build_space(rg.parse_scene(text.replace("point = [1, 1]", f'shape = "circle"\n{at}')))
    assert space.goal_count == 1
    assert np.allclose(space.goal_points[:, 1], 1.5)


def test_a_goal_at_the_upper_end_of_an_axis_lies_in_the_last_cell():
    for cells in (49, 98, 103, 107):
        text = DISC.replace("upper = 3", "upper = 1").replace("radius = 0.2", "radius = 0.002")
        text = text.replace("cells = 9", f"cells = {cells}").replace(", cells = 8", "").replace("[1, 1]", "[1.0, 1.0]")
        space = rg.build_space(rg.parse_scene(text + "", "s.toml"))
        assert np.argwhere(space.cell == rg.Cell.GOAL).tolist() == [[cells - 1, cells - 1]]
        assert np.allclose(space.goal_points, 1.0)
