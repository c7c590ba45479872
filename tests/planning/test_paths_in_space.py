"""Paths of a robot in space: collisions, clearance, shortcuts, certificates, velocity limits, and messages for ROS.

Tests internals: `resgrid.robots.urdf`, `resgrid.planning.workspace`, `resgrid.planning.motion_limits`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import hypot, inf, pi, tau
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.hand_made_robot import FORE, HEIGHT, THICKNESS, UPPER, HandMadeRobot

import resgrid as rg
from resgrid.planning.workspace import sample_path

ROBOT = HandMadeRobot()
SPACE = rg.ConfigurationSpace(ROBOT.axes((20, 24)), np.zeros((20, 24)), robot=ROBOT)
POST = rg.Box((0.3, 0.55, 0.0), (0.4, 0.65, 1.0))


@pytest.fixture(scope="session")
def examples(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of the examples; proofs of cells are not stored for the user."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RESGRID_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield scenes.parent


def test_workspace_paths_are_those_of_the_tool_in_space() -> None:
    robot = HandMadeRobot(tool="hand")
    space = rg.ConfigurationSpace(robot.axes(8), np.zeros((8, 8)), robot=robot)
    path = rg.Polyline([(0.0, 0.0), (pi / 2, 0.0), (pi / 2, pi / 2)], space)
    whole = UPPER + FORE
    expected = [(whole, 0, HEIGHT), (0, whole, HEIGHT), (-FORE, UPPER, HEIGHT)]
    np.testing.assert_allclose(rg.planning.workspace_path(path), expected, atol=1e-12)


def test_clearance_and_collision_of_a_turning_arm_have_their_closed_form() -> None:
    far = rg.Box((1.0, -1.0, 0.0), (1.2, 1.0, 1.0))
    sweep = rg.Polyline([(-0.5, 0.0), (0.5, 0.0)], SPACE)
    reach = hypot(UPPER + FORE, THICKNESS / 2)
    assert rg.planning.workspace_clearance(sweep, [far], step=1e-3) == pytest.approx(1.0 - reach, abs=1e-5)
    assert rg.check_collisions(sweep, [far]) is None
    assert rg.planning.workspace_clearance(sweep, [far, POST], step=1e-2) > 0.05
    wall = rg.Box((0.0, 0.45, 0.0), (1.0, 1.0, 1.0))
    hit = rg.check_collisions(rg.Polyline([(0.0, 0.0), (0.2, 0.0), (1.2, 0.0)], SPACE), [far, wall], step=1e-3)
    assert hit is not None and (hit.part, hit.obstacle, hit.names) == (2, 1, ("forearm", "obstacle[1]"))
    tip = (UPPER + FORE) * np.sin(hit.configuration[0]) + THICKNESS / 2 * np.cos(hit.configuration[0])
    assert hit.segment == 1 and tip == pytest.approx(0.45, abs=2e-3) and tip >= 0.45
    assert rg.planning.workspace_clearance(rg.Polyline([hit.configuration], SPACE), [wall]) == 0.0


def test_collisions_of_the_robot_with_itself_count() -> None:
    robot = HandMadeRobot(drop=0.15)
    space = rg.ConfigurationSpace(robot.axes(8), np.zeros((8, 8)), robot=robot)
    fold = rg.Polyline([(0.0, 0.0), (0.0, 3.1)], space)
    hit = rg.check_collisions(fold, [], step=1e-3)
    assert hit is not None and (hit.obstacle, hit.names) == (None, ("forearm", "column"))
    assert rg.planning.workspace_clearance(fold, []) == 0.0


def test_a_trajectory_is_tested_along_its_own_motion() -> None:
    corner = rg.Polyline([(0.0, 0.0), (0.5, 0.0), (0.5, 1.0)], SPACE)
    motion = rg.time_parameterize(corner, velocity_limits=1.0, acceleration_limits=1.0, tolerance=0.2)
    positions, segment = sample_path(motion, 0.01)
    assert len(positions) == len(segment) and segment.max() == len(motion.times) - 2
    moved = ROBOT.travel(positions[:-1], positions[1:])
    assert moved.max() <= 0.01 * (1 + 1e-9)
    np.testing.assert_allclose(positions[[0, -1]], corner.points[[0, 2]])
    assert np.linalg.norm(positions - [0.5, 0.0], axis=1).min() > 0.02  # the blend leaves out the corner
    wall = rg.Box((0.0, 0.45, 0.0), (1.0, 1.0, 1.0))
    assert rg.check_collisions(motion, [wall]) is not None
    assert rg.planning.workspace_clearance(motion, [wall]) == 0.0
    still = rg.time_parameterize(rg.Polyline([(0.0, 0.0)], SPACE))
    assert rg.check_collisions(still, [wall]) is None
    assert rg.planning.workspace_path(still).shape == (1, 3)


def test_paths_in_a_space_with_a_continuous_joint_cross_its_seam() -> None:
    cell = np.zeros(SPACE.shape)
    cell[:, 12] = rg.Cell.OBSTACLE
    cell[10, 4] = rg.Cell.GOAL
    space = SPACE.with_cells(cell)
    path = rg.plan(space, boundary="neumann").path((0.0, 2.5))
    rg.certify(path)
    short = rg.shortcut(path)
    rg.certify_collision_free(short)
    motion = rg.time_parameterize(short)
    assert path.outcome is rg.Outcome.REACHED
    assert motion.positions[-1, 1] > pi and np.abs(np.diff(motion.positions, axis=0)).max() < pi


def test_velocity_limits_are_those_of_the_file_or_of_the_robot() -> None:
    path = rg.Polyline([(0.0, 0.0), (1.0, 0.5), (1.0, 2.5)], SPACE)
    np.testing.assert_allclose(rg.time_parameterize(path).times, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(rg.time_parameterize(path, velocity_limits=0.5).times, [0.0, 2.0, 6.0])
    fast = HandMadeRobot(velocity=(2.0,), acceleration=(1.0, 4.0))
    space = rg.ConfigurationSpace(fast.axes((20, 24)), np.zeros((20, 24)), robot=fast)
    motion = rg.time_parameterize(rg.Polyline(path.points, space))
    assert np.abs(motion.velocities).max() <= 2.0 and (np.abs(motion.accelerations) <= [1.0, 4.0]).all()
    assert not motion.velocities[0].any()


def test_missing_velocity_limits_matter_only_for_joints_that_move() -> None:
    robot = HandMadeRobot(speeds=(inf, 0.5))
    space = rg.ConfigurationSpace(robot.axes(8), np.zeros((8, 8)), robot=robot)
    assert rg.time_parameterize(rg.Polyline([(0.1, 0.0), (0.1, 1.0)], space)).duration == pytest.approx(2.0)
    with pytest.raises(rg.InputError, match="no velocity limit for shoulder; give velocity_limits"):
        rg.time_parameterize(rg.Polyline([(0.0, 0.0), (0.1, 1.0)], space))
    zero = HandMadeRobot(speeds=(1.0, 0.0))
    assert zero.velocity_limits.tolist() == [1.0, inf]
    plain = rg.ConfigurationSpace([rg.Axis("x", 0, 1, 4)], np.zeros(4))
    with pytest.raises(rg.InputError, match="a PointRobot has no velocity limits of its own; give velocity_limits"):
        rg.time_parameterize(rg.Polyline([(0.1,), (0.9,)], plain))
    with pytest.raises(rg.InputError, match="velocity needs one number for each of the 2 moving joints"):
        HandMadeRobot(velocity=(1.0, 2.0, 3.0))


def message_of(motion, tmp_path, **options) -> dict:
    return yaml.safe_load(rg.save(motion, tmp_path / "motion.yaml", **options).read_text())


def times_of(message) -> list[float]:
    return [p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] * 1e-9 for p in message["points"]]


def test_a_joint_trajectory_has_the_form_of_the_ros_message(tmp_path) -> None:
    """Names and types of trajectory_msgs/JointTrajectory, its JointTrajectoryPoint and builtin_interfaces/Duration."""
    path = rg.Polyline([(0.0, 3.0), (0.5, 3.5), (1.0, 3.5)], SPACE)
    motion = rg.time_parameterize(path, acceleration_limits=1.0)
    message = message_of(motion, tmp_path)
    assert list(message) == ["header", "joint_names", "points"]
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert message["joint_names"] == ["shoulder", "elbow joint"]
    for point in message["points"]:
        assert list(point) == ["positions", "velocities", "accelerations", "effort", "time_from_start"]
        assert all(type(value) is float for value in point["positions"] + point["velocities"])
        assert point["accelerations"] == point["effort"] == []
        assert list(point["time_from_start"]) == ["sec", "nanosec"]
        assert all(type(value) is int for value in point["time_from_start"].values())
        assert 0 <= point["time_from_start"]["nanosec"] < 10**9
    np.testing.assert_array_equal([p["positions"] for p in message["points"]], motion.positions)
    np.testing.assert_array_equal([p["velocities"] for p in message["points"]], motion.velocities)
    np.testing.assert_allclose(times_of(message), motion.times, atol=1e-9)


def test_cubic_splines_through_a_joint_trajectory_are_the_motion(tmp_path) -> None:
    from scipy.interpolate import CubicHermiteSpline

    motion = rg.time_parameterize(
        rg.Polyline([(0.0, 0.0), (0.5, 0.8), (1.0, 0.2)], SPACE), acceleration_limits=1.0, tolerance=0.1
    )
    message = message_of(motion, tmp_path)
    spline = CubicHermiteSpline(
        times_of(message), [p["positions"] for p in message["points"]], [p["velocities"] for p in message["points"]]
    )
    times = np.linspace(0.0, motion.duration, 500)
    np.testing.assert_allclose(spline(times), motion.at(times)[0], atol=1e-8)


def test_a_joint_trajectory_without_acceleration_limits_has_positions_only(tmp_path) -> None:
    motion = rg.time_parameterize(rg.Polyline([(0.0, 0.0), (0.5, 0.8), (1.0, 0.2)], SPACE))
    message = message_of(motion, tmp_path)
    assert all(point["velocities"] == [] for point in message["points"])
    sampled = message_of(motion.resampled(50.0), tmp_path)
    assert len(sampled["points"]) > 20 and sampled["points"][3]["velocities"] == []


def test_fixed_joints_are_added_on_request(tmp_path) -> None:
    robot = HandMadeRobot(at={"wrist": -0.5, "finger": 0.02})
    space = rg.ConfigurationSpace(robot.axes(8), np.zeros((8, 8)), robot=robot)
    motion = rg.time_parameterize(rg.Polyline([(0.0, 0.0), (0.5, 0.8)], space), acceleration_limits=1.0)
    message = message_of(motion, tmp_path, fixed_joints=True)
    assert message["joint_names"] == ["shoulder", "elbow joint", "wrist", "finger"]
    assert message["points"][-1]["positions"] == [0.5, 0.8, -0.5, 0.02]
    assert all(p["velocities"][2:] == [0.0, 0.0] for p in message["points"])
    with pytest.raises(rg.InputError, match=r"fixed_joints applies to \.yaml files of robots from URDF files"):
        rg.save(motion, tmp_path / "motion.csv", fixed_joints=True)


def test_times_of_a_joint_trajectory_increase_by_at_least_one_nanosecond(tmp_path) -> None:
    points = [(0.0, 0.0), (0.5, 0.0), (0.5 + 1e-11, 0.0), (1.0, 0.0), (1.0 + 1e-11, 0.0)]
    message = message_of(rg.time_parameterize(rg.Polyline(points, SPACE)), tmp_path)
    assert (np.diff(times_of(message)) > 0.5e-9).all()
    assert message["points"][-1]["positions"] == [1.0 + 1e-11, 0.0]


def test_a_path_without_times_has_no_joint_trajectory(tmp_path) -> None:
    with pytest.raises(rg.InputError, match="a JointTrajectory needs times: give a trajectory"):
        rg.save(rg.Polyline([(0.0, 0.0), (0.5, 0.8)], SPACE), tmp_path / "motion.yaml")
    plane = rg.ConfigurationSpace([rg.Axis("x", 0, 1, 4)], np.zeros(4))
    motion = rg.time_parameterize(rg.Polyline([(0.1,), (0.9,)], plane), velocity_limits=1.0)
    with pytest.raises(rg.InputError, match="holds the joints of a robot from a URDF file, not a point"):
        rg.maps.to_ros_trajectory(motion)


def test_tables_have_the_position_of_the_tool(tmp_path) -> None:
    motion = rg.time_parameterize(rg.Polyline([(0.0, 0.0), (0.5, 0.8)], SPACE))
    header = rg.save(motion, tmp_path / "motion.csv").read_text().splitlines()[0]
    names = ["t", "shoulder", "elbow_joint", "tool_x", "tool_y", "tool_z", "shoulder_rate", "elbow_joint_rate"]
    assert header.split(",") == ["path", "k", "outcome", *names]
    record = json.loads(rg.save(motion, tmp_path / "motion.json").read_text())
    assert record["tool_z"] == pytest.approx([HEIGHT, HEIGHT])
    assert record["elbow_joint"][-1] == 0.8 and tau > record["elbow_joint"][-1]


def test_undecided_cells_are_the_reason_of_a_failure_that_they_cause() -> None:
    cell = np.zeros(SPACE.shape)
    cell[6], cell[15], cell[0, 3] = rg.Cell.OBSTACLE, rg.Cell.OBSTACLE, rg.Cell.GOAL
    undecided = np.zeros(SPACE.shape, bool)
    undecided[6, 4] = True
    space = rg.ConfigurationSpace(SPACE.axes, cell, robot=ROBOT, undecided=undecided)
    planner = rg.plan(space, boundary="neumann")
    reason = planner.path(cell=(10, 3)).reason
    assert reason is not None and "undecided cells separate the start from every goal: use more cells" in reason
    assert "obstacles separate the start" in str(planner.path(cell=(17, 3)).reason)
    assert "the start lies in an undecided cell" in str(planner.path(cell=(6, 4)).reason)
    assert "the start lies in an obstacle" in str(planner.path(cell=(6, 5)).reason)


@pytest.mark.parametrize(
    ("name", "moving", "cells", "start", "goal"),
    [
        ("elbow", ("turn",), 24, (-2.5,), (2.3,)),
        ("scara", ("shoulder", "quill"), (24, 8), (-1.9, -0.01), (-0.4, -0.1)),
        ("elbow", ("turn", "shoulder", "elbow"), 12, (-2.5, 0.6, 0.3), (2.3, 0.7, 0.4)),
        ("four", ("turn", "shoulder", "elbow", "wrist"), 8, (-0.9, 0.2, 0.2, 0.2), (2.7, 0.2, 0.2, 0.2)),
    ],
)
def test_paths_in_proven_cells_do_not_collide(examples, name, moving, cells, start, goal) -> None:
    """Streamlines, shortcuts and motions of robots with one to four joints; a continuous joint crosses its seam."""
    robot = rg.URDFRobot(str(examples / "robots" / f"{name}.urdf"), moving=moving)
    obstacles = (rg.Box((0.3, 0.1, 0.0), (0.5, 0.2, 0.6)),)
    scene = rg.Scene(robot.axes(cells), robot=robot, obstacles=obstacles, goals=(rg.GoalJoints(goal, goal),))
    space = rg.build_space(scene)
    path = rg.plan(space, boundary="neumann").path(start)
    assert path.outcome is rg.Outcome.REACHED
    rg.certify(path)
    short = rg.shortcut(path)
    rg.certify_collision_free(short)
    motion = rg.time_parameterize(short, acceleration_limits=2.0)
    assert (np.abs(motion.velocities) <= robot.velocity_limits * (1 + 1e-12)).all()
    assert np.abs(np.diff(motion.positions[:, 0])).max() < pi
    if name == "elbow":
        assert motion.positions[-1, 0] < -pi  # the seam is on the way
    for way in (path, short, motion):
        assert rg.check_collisions(way, obstacles, step=5e-3) is None
        assert rg.planning.workspace_clearance(way, obstacles) > 0


def test_a_path_to_a_pose_of_the_tool_ends_with_the_tool_there(examples) -> None:
    scene = rg.read_scene(examples / "scenes" / "scara.toml")
    goal = rg.GoalPose((0.3, 0.2, 0.035), radius=0.01)
    scene = scene.replace(goal=goal)
    paths = rg.plan(scene).paths()
    assert [str(path.outcome) for path in paths] == ["reached", "reached"]
    for path in paths:
        end = rg.planning.workspace_path(rg.shortcut(path))[-1]
        assert np.linalg.norm(end - goal.position) <= goal.radius + 1e-9
