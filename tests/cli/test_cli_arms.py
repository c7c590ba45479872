"""Robots from URDF files on the command line: verdicts of cells, timed and tested paths, and messages for ROS."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import resgrid as rg


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch) -> None:
    """Share the proofs of cells among the tests of a session, but not with the user."""
    monkeypatch.setenv("RESGRID_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def scara(scenes: Path, tmp_path: Path) -> Path:
    """The shipped scene with few cells."""
    file = tmp_path / "scara.toml"
    text = (scenes / "scara.toml").read_text().replace("../robots", str(scenes.parent / "robots"))
    file.write_text(text.replace("cells = [48, 48]", "cells = [24, 24]"))
    return file


def times_of(message) -> list[float]:
    return [p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] * 1e-9 for p in message["points"]]


@pytest.mark.slow
def test_run_writes_timed_and_tested_trajectories(call, scara, tmp_path) -> None:
    folder = tmp_path / "out"
    result = call("run", scara, "--no-check", "-o", folder)
    assert result.exit_code == 0, result.stderr
    assert "proven free" in result.stdout and "undecided" in result.stdout and "%" in result.stdout
    assert result.stdout.count("no collision, ") == 2 and "m from contact" in result.stdout
    data = json.loads((folder / "summary.json").read_text())
    verdicts = data["verdicts"]
    assert verdicts["proven"] is True
    assert sum(verdicts[f"{kind}_cells"] for kind in ("free", "collision", "undecided")) == 24 * 24
    space = rg.build_space(rg.read_scene(scara))
    assert space.undecided is not None and verdicts["undecided_cells"] == space.undecided.sum()
    assert {"page.png", "robot.png", "cells.png"} <= set(data["files"])
    for number, path in enumerate(data["paths"]):
        assert path["collision"] is None and path["workspace_clearance"] > 0
        assert path["short"]["length"] <= path["streamline"]["length"]
        message = yaml.safe_load((folder / f"trajectory_{number}.yaml").read_text())
        record = json.loads((folder / f"trajectory_{number}.json").read_text())
        rows = list(csv.DictReader((folder / f"trajectory_{number}.csv").read_text().splitlines()))
        assert message["joint_names"] == ["shoulder", "elbow"]
        assert times_of(message)[-1] == pytest.approx(path["duration"])
        np.testing.assert_array_equal([p["positions"][1] for p in message["points"]], record["elbow"])
        assert [float(row["tool_z"]) for row in rows] == record["tool_z"] == pytest.approx([0.035] * len(rows))
        assert np.abs(record["shoulder_rate"]).max() <= 6.5 and np.abs(record["elbow_rate"]).max() <= 11.0
        assert {f"trajectory_{number}.{end}" for end in ("yaml", "csv", "json")} <= set(data["files"])


def test_path_writes_a_joint_trajectory_within_the_limits_of_the_file(call, scara, tmp_path) -> None:
    file = tmp_path / "path.yaml"
    result = call("path", scara, "--shorten", "-o", file, "--fixed-joints")
    assert result.exit_code == 0, result.stderr
    messages = list(yaml.safe_load_all(file.read_text()))
    assert [m["joint_names"] for m in messages] == [["shoulder", "elbow", "quill"]] * 2
    assert {p["positions"][2] for m in messages for p in m["points"]} == {-0.12}
    slow = call("path", scara, "--shorten", "--speed", "0.1", "--json")
    durations = [path["duration"] for path in json.loads(slow.stdout)["paths"]]
    assert durations > [5.0, 5.0]
    plain = json.loads(call("path", scara, "--json").stdout)["paths"]
    assert all("duration" not in path and path["workspace_clearance"] > 0 for path in plain)


def test_options_that_need_joints_name_their_files(call, scara, lesson, tmp_path) -> None:
    wrong = call("path", scara, "-o", tmp_path / "path.csv", "--fixed-joints")
    assert wrong.exit_code == 2 and "--fixed-joints applies to .yaml files of robots from URDF files" in wrong.stderr
    assert call("path", lesson, "--fixed-joints").exit_code == 2
    assert "--rate needs a timed path: add --speed" in call("path", lesson, "--rate", "5").stderr


def test_sampling_of_centres_is_labelled_as_unproven(call, answer, scara) -> None:
    text = call("info", scara, "--set", "sampling=centre").stdout
    assert "unproven      sampling = 'centre' tests only the centres of cells" in text
    data = answer("info", scara, "--set", "sampling=centre")
    assert data["verdicts"]["proven"] is False and data["verdicts"]["undecided_cells"] == 0
    proven = answer("info", scara)["verdicts"]
    assert proven["free_cells"] <= data["verdicts"]["free_cells"]


def test_a_path_that_collides_is_a_negative_answer(call, scara, tmp_path) -> None:
    """The tool passes through a thin wall on the x axis, of which the centres of all cells stay clear."""
    scene = rg.read_scene(scara)
    thin = rg.Box((0.36, -0.4, 0.0), (0.361, 0.4, 0.2))
    robot, axes = scene.robot, scene.robot.axes((6, 6))
    space = rg.ConfigurationSpace(axes, np.zeros((6, 6)), robot=robot)
    hit = rg.check_collisions(rg.Polyline([(-1.2, 0.0), (1.2, 0.0)], space), [thin])
    assert hit is not None and hit.obstacle == 0 and hit.names is not None and hit.names[1].startswith("obstacle[0]")
    file = tmp_path / "thin.toml"
    text = scara.read_text()
    head, goal = text[: text.index("[[obstacle]]")], "[[goal]]\njoints = [1.9, 0.1]\n"
    box = '[[obstacle]]\nshape = "box"\nlower = [0.2, 0.0, 0.0]\nupper = [0.6, 0.001, 0.2]\n\n'
    file.write_text(head.replace("starts = [[-1.2, -0.6], [-0.4, 1.6]]", "starts = [[-1.9, 0.1]]") + box + goal)
    result = call("path", file, "--set", "sampling=centre", "--set", "grid.cells=10", "--json")
    (path,) = json.loads(result.stdout)["paths"]
    assert result.exit_code == 1 and path["outcome"] == "reached"
    assert path["collision"]["bodies"][1].startswith("obstacle[0]") and path["workspace_clearance"] == 0.0


@pytest.mark.slow
def test_pictures_and_decks_of_arms_are_made(call, scara, tmp_path) -> None:
    assert call("plot", scara, "--what", "robot", "-o", tmp_path / "robot.png").exit_code == 0
    assert call("plot", scara, "-o", tmp_path / "page.png").exit_code == 0
    assert call("compile", scara, "-o", tmp_path / "scara.cir").exit_code == 0


@pytest.mark.usefixtures("without_pictures")
def test_a_joint_without_a_limit_leaves_the_paths_untimed(call, scara, tmp_path) -> None:
    robot = tmp_path / "scara.urdf"
    robot.write_text((Path(rg.read_scene(scara).robot.file)).read_text().replace('velocity="6.5"', 'velocity="0"'))
    text = scara.read_text().replace(str(Path(rg.read_scene(scara).robot.file)), str(robot))
    file = tmp_path / "unlimited.toml"
    file.write_text(text)
    result = call("run", file, "--no-check", "-o", tmp_path / "out")
    assert result.exit_code == 0 and "no velocity limit for shoulder" in result.stderr
    assert not list((tmp_path / "out").glob("trajectory*"))
    file.write_text(text.replace("acceleration = [10.0]", "velocity = [1.0]"))
    assert call("run", file, "--no-check", "-o", tmp_path / "out").exit_code == 0
    assert len(list((tmp_path / "out").glob("trajectory*"))) == 6


def test_the_clearance_of_a_planar_arm_is_given_in_metres_too(answer, scenes) -> None:
    paths = answer("path", scenes / "three_link.toml")["paths"]
    assert all(path["workspace_clearance"] > 0 and "collision" not in path for path in paths)
