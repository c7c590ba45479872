"""Common mistakes of beginners: one message each, with a remedy that works, and no written file.

Tests internals: `resgrid._internal.validation`.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

import resgrid as rg
from resgrid._internal.validation import with_article

HEAD = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


@pytest.fixture
def working_folder(tmp_path, monkeypatch, scenes):
    """Return the working folder, with a scene, a ROS map of 3 m x 2 m and a benchmark map."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lesson.toml").write_text((scenes / "lesson.toml").read_text())
    cell = np.full((20, 30), 254, np.uint8)
    cell[5:15, 15], cell[:3] = 0, 205
    Image.fromarray(cell).save("map.pgm")
    (tmp_path / "map.yaml").write_text(HEAD)
    for name in ("elbow.urdf", "recorded.mcap", "cells.csv"):
        (tmp_path / name).write_text("0,1\n")
    (tmp_path / "arena.map").write_text("type octile\nheight 2\nwidth 4\nmap\n....\n....\n")
    (tmp_path / "arena.scen").write_text("version 1\n0\tmaps/other.map\t4\t2\t0\t0\t3\t1\t4\n")
    return tmp_path


MISTAKES = {
    "compile lesson.toml -o deck.png": ["-o deck.png: the name of a deck must end in .cir"],
    "path map.yaml": ["map.yaml: there is no goal; give --goal X,Y (in Python: goal=(x, y) of read_scene)"],
    "path map.yaml --goal 0.5,0.5": ["map.yaml: there is no start; give --start X,Y"],
    "path lesson.toml --cells": ["--cells applies to places", "leave it out, or add --goal, --start, --via"],
    "solve lesson.toml --cells": ["and none is given: leave it out, or add --goal, --start\n"],
    "path lesson.toml --cells --via 1.5,2": ["--via 1.5,2: with --cells, give whole numbers (cell indices)"],
    "path lesson.toml --cells --via 9,2": ["via[0]: cell [9, 2] is not in the grid of 8 x 8 cells"],
    "path lesson.toml --set starts=[]": ["add starts = [[...]] to the scene, or give --start X,Y"],
    "path lesson.toml --set starts=[1,2]": ["must be a point, as in starts = [[1, 2]]"],
    "path map.yaml --goal 0.5,0.5 --start 0.5,2.9": ["outside the grid", "with x and y exchanged it lies inside"],
    "path map.yaml --goal 0.5,0.5 --start 0,5,2,9": ["needs 2 coordinates", "decimals have a point"],
    "path map.yaml --goal 0.5 0.5 --start 1,1": ["by commas", "--help"],
    "path map.yaml --goal 0.5,0.5 --start 1,1 --map-dialect ros2": ["it may be nav2 or"],
    "path map.yaml --goal 0.5,0.5 --start 1,1 --set grid.cells=9": ["a map has cells of its own"],
    "path map.yaml --goal 0.5,0.5 --start -1.5 -0.5": ["No such option '-0'", "as --start=-1.5,2"],
    "path map.yaml --goal 0.5,0.5 --start 1,1 --k 99%": ["expected a number from 0 to 1, such as 0.9"],
    "path map.yaml --goal 0.5,0.5 --start 1,1 --speed fast": ["expected one number, or numbers separated by commas"],
    "path map.yaml --goal 0.5,0.5 --start 1,1 -o path.txt": ["must end in .csv, .json, .npz or .yaml"],
    "path map.yaml --goal 1.55,1 --start 1,1": ["lies in an obstacle", "that a start can reach, the nearest is (1."],
    "path map.yaml --goal 1,1.95 --start 1,1": ["lies in unknown space", "--unknown free"],
    "path map.yaml --goal 1.3,1 --start 1,1 --robot-radius 20cm": ["in the unit of the axes, such as 0.2 for 20 cm"],
    "path map.yaml --goal 1.3,1 --start 1,1 --robot-radius inf": ["'inf' is not finite", "such as 0.2"],
    "path map.yaml --goal 1.3,1 --start 1,1 --threads two": ["'two' is not a whole number; give digits only"],
    "control map.yaml --goal 1.3,1 --start 1,1 --speed fast": ["'fast' is not a number", "without unit"],
    "path map.yaml --goal 1.3,1 --start 1,1 --robot-radius 0.3": ["too near to an obstacle", "radius smaller"],
    "--json path lesson.toml": ["options follow the command, as in: resgrid run SCENE --json"],
    "-v run lesson.toml": ["options follow the command, as in: resgrid run SCENE -v"],
    "path https://example.com/a.toml": ["https://example.com/a.toml: addresses are not opened; save the file"],
    "path http://example.com/a.yaml": ["error: http://example.com/a.yaml: addresses are not opened; save the file"],
    "chip lesson.toml --at-least 95%": ["'95%' is not a number"],
    "info elbow.urdf": ["this is a robot, not a scene; write a scene with [robot]"],
    "run recorded.mcap": ["use 'resgrid stream'"],
    "run cells.csv": ["save the cells as an array with np.save"],
    "run lesson.toml --no-check -o map.yaml/lesson": ["map.yaml is a file, not a folder; name another folder"],
    "completion": ["Choose from: bash, zsh, fish"],
    "live lesson.toml --no-browser --host 300.1.1.1": ["give an address of this computer, such as --host 127.0.0.1"],
}


@pytest.mark.parametrize("words", MISTAKES)
def test_a_common_mistake_has_one_message_and_exit_code_2(call, working_folder, words):
    before = set(working_folder.iterdir())
    result = call(*words.split())
    assert result.exit_code == 2 and (result.stdout == "" or "--json" in words)
    assert result.stderr.startswith("resgrid: error: ") and result.stderr.count("resgrid: error") == 1
    for word in MISTAKES[words]:
        assert word in result.stderr
    assert set(working_folder.iterdir()) == before


def test_a_smaller_radius_is_proposed_only_if_a_point_robot_fits(call, working_folder):
    rejected = call("path", "map.yaml", "--goal", "1,1.95", "--start", "1,1", "--robot-radius", "0.3")
    assert rejected.exit_code == 2 and "unknown space" in rejected.stderr and "radius" not in rejected.stderr
    rejected = call("path", "map.yaml", "--goal", "1.55,1", "--start", "1,1", "--robot-radius", "0.1")
    assert rejected.exit_code == 2 and "in an obstacle" in rejected.stderr and "radius" not in rejected.stderr
    freed = call("path", "map.yaml", "--goal", "1.3,1", "--start", "1,1", "--robot-radius", "0.3")
    assert "radius smaller" in freed.stderr
    assert call("path", "map.yaml", "--goal", "1.3,1", "--start", "1,1").exit_code == 0


def test_a_proposed_smaller_radius_frees_the_goal(call, working_folder):
    for goal, helps in (("1.55,1", False), ("1.3,1", True)):
        words = f"path map.yaml --goal {goal} --start 1,1 --robot-radius"
        assert ("radius smaller" in call(*words.split(), "0.3").stderr) is helps
        assert (call(*words.split(), "0.0001").exit_code == 0) is helps


def test_a_map_larger_than_the_memory_gets_the_remedy_for_maps(call, working_folder, monkeypatch):
    monkeypatch.setattr("resgrid._internal.memory.available_memory", lambda: 4000)
    rejected = call("path", "map.yaml", "--goal", "0.5,0.5", "--start", "1,1")
    assert rejected.exit_code == 4
    assert "--crop known --coarsen 2 leaves 15 x 9 cells" in rejected.stderr and "radius" not in rejected.stderr
    assert "larger cells" not in rejected.stderr
    scene = call("path", "lesson.toml")
    assert scene.exit_code == 4 and "take fewer, larger cells" in scene.stderr


def test_keys_and_files_without_effect_are_reported(call, working_folder):
    words = ("path", "map.yaml", "--goal", "0.5,0.5", "--start", "1,1", "--set", "map.headings=9")
    assert "ignored: map.headings: this robot does not turn" in call(*words).stderr
    message = call("path", "map.pgm", "--goal", "5,5", "--start", "9,9").stderr
    assert "map.yaml" in message
    message = call("path", "arena.map", "--queries", "arena.scen").stderr
    assert "these queries are for the map 'other.map', not for 'arena.map'" in message


def test_unknown_options_raise_type_error_with_the_closest_name(scenes):
    study = rg.study(rg.read_scene(scenes / "lesson.toml"))
    for ask, message in (
        (lambda: study.yields(trails=3), r"^yields\(\) has no option 'trails'; did you mean 'trials'\?$"),
        (lambda: study.settling(bit=3), r"^settling\(\) has no option 'bit'; did you mean 'bits'"),
        (lambda: study.power(foo=1), r"^power\(\) has no option 'foo'"),
        (lambda: study.yields(3), r"^yields\(\) takes no arguments by position, got 1; give these by name: starts"),
        (
            lambda: rg.circuit.WarmStart(boundery="x"),
            r"^WarmStart\(\) has no option 'boundery'; did you mean 'boundary'",
        ),
        (lambda: rg.plan(study.scene, K=1), r"^plan\(\) has no option 'K'; did you mean 'k'\?$"),
        (lambda: rg.plan(study.scene, boundry="x"), r"^plan\(\) has no option 'boundry'; did you mean 'boundary'"),
        (
            lambda: rg.Scene((rg.Axis("x", 0, 1, 3),), gaols=()),
            r"^Scene\(\) has no option 'gaols'; did you mean 'goals'",
        ),
    ):
        with pytest.raises(TypeError, match=message):
            ask()
    with pytest.raises(TypeError, match=r"^study\(\) has no option 'boundery'; did you mean 'boundary'"):
        rg.study(study.scene, boundery="x")


def test_messages_use_the_correct_article_before_type_names():
    names = ("int", "ndarray", "Axis", "unit", "Field", "float", "ufunc", "Arm", "user", "list")
    assert [with_article(name).split()[0] for name in names] == ["an", "an", "an", "a", "a", "a", "a", "an", "a", "a"]
    with pytest.raises(rg.InputError, match=r"^an int has no picture"):
        rg.draw(3)
    with pytest.raises(rg.InputError, match=r"lengths = 3 must be a list of finite numbers above 0"):
        rg.Arm(3)


def test_an_angle_that_looks_like_degrees_is_reported(call, scenes):
    arm = (scenes / "problem_two_goals.toml", "--set", "grid.cells=20")
    message = call("info", *arm, "--start", "90,0").stderr
    assert (
        message
        == "starts[0]: theta_1 = 90 is an angle of 14.3 turns; give angles in radians (90 degrees are 1.5708 rad)\n"
    )
    assert call("info", *arm, "--start", "1.5708,0").stderr == ""


def test_a_deck_on_standard_input_names_the_missing_option(call):
    deck = "* divider\nV1 in 0 5\nR1 in 0 1k\n.end\n"
    assert "if it is a deck, add --read-as ngspice" in call("solve", "-", piped=deck).stderr
    assert call("solve", "-", "--read-as", "ngspice", piped=deck).exit_code == 0
    assert "--read-as" not in call("path", "-", piped=deck).stderr


def test_the_sidecar_of_a_deck_names_the_deck(call, working_folder):
    assert call("compile", "lesson.toml", "-o", "deck.cir").exit_code == 0
    for commands in ("deck.cir.ngspice", "deck.cir.verify"):
        rejected = call("check", commands)
        assert rejected.exit_code == 2 and "the deck is the file without this suffix" in rejected.stderr
    rejected = call("check", "deck.cir.json")
    assert rejected.exit_code == 2 and rejected.stderr.endswith("check the deck: resgrid check deck.cir\n")


def test_an_intermediate_place_in_an_obstacle_does_not_name_the_tolerance_of_goals(call, working_folder):
    words = ("path", "map.yaml", "--goal", "0.5,0.5", "--start", "1,1", "--via", "1.55,1")
    assert call(*words).stderr.endswith("the nearest is (1.45, 1.05)\n")


def test_intermediate_places_are_cells_with_the_option_for_cells(call, working_folder):
    in_metres = ("path", "map.yaml", "--goal", "0.55,0.55", "--start", "1.05,1.05", "--via", "2.35,0.35", "--json")
    in_cells = ("path", "map.yaml", "--cells", "--goal", "5,5", "--start", "10,10", "--via", "23,3", "--json")
    (wanted,), (found,) = (json.loads(call(*words).stdout)["paths"] for words in (in_metres, in_cells))
    assert [leg["kind"] for leg in found["legs"]] == ["via", "goal"]
    assert found["legs"][0]["length"] == pytest.approx(wanted["legs"][0]["length"], rel=1e-9)
    assert np.abs(np.array(found["points"]) - [2.35, 0.35]).max(axis=1).min() < 1e-9


def test_an_empty_deck_has_one_message(call, working_folder):
    (working_folder / "empty.cir").write_text("* empty\n.end\n")
    result = call("check", "empty.cir")
    assert result.exit_code == 2 and result.stderr.count("no voltage source touches ground") == 1


def test_a_map_with_too_many_parts_names_a_smaller_division(call, working_folder, monkeypatch):
    monkeypatch.setattr("resgrid._internal.memory.available_memory", lambda: 10**7)
    words = ("path", "map.yaml", "--goal", "0.5,0.5", "--start", "1,1", "--refine")
    rejected = call(*words, "100")
    assert rejected.exit_code == 4 and rejected.stderr.endswith("; --refine 5 leaves 150 x 100 cells\n")
    assert call(*words, "5").exit_code == 0
    solving = call(*words, "20")
    assert solving.exit_code == 4 and solving.stderr.endswith("; --refine 7 leaves 210 x 140 cells\n")
    assert call(*words, "7").exit_code == 0


def test_goal_cells_get_places_when_a_finer_grid_is_proposed(call, working_folder):
    result = call("path", "lesson.toml", "--robot-radius", "0.5")
    assert result.exit_code == 1 and "goal at (6.5, 1.5) in place of cells" in result.stdout
    finer = [option for axis in "01" for option in ("--set", f"grid.axes.{axis}.cells=16")]
    assert call("path", "lesson.toml", "--robot-radius", "0.5", *finer, "--goal", "6.5,1.5").exit_code == 0


def test_options_of_a_function_do_not_include_its_return_value(scenes):
    path = rg.plan(rg.read_scene(scenes / "lesson.toml")).path((0.5, 6.5))
    with pytest.raises(TypeError, match=r"it takes path, velocity_limits, acceleration_limits, tolerance, masks$"):
        rg.time_parameterize(path, quick=1)


@pytest.mark.parametrize(
    ("key", "remedy"), [("obstacle", "write [[obstacle]] before every obstacle"), ("chip", "join")]
)
def test_a_repeated_table_of_a_scene_has_a_remedy(call, working_folder, key, remedy):
    text = (working_folder / "lesson.toml").read_text().replace("[[obstacle]]", "[obstacle]")
    if key == "chip":
        text = (working_folder / "lesson.toml").read_text() + "[chip]\nmismatch = 0.1\n"
    (working_folder / "twice.toml").write_text(text)
    rejected = call("info", "twice.toml")
    assert (
        rejected.exit_code == 2 and f"Cannot declare ('{key}',) twice" in rejected.stderr and remedy in rejected.stderr
    )


def test_an_announcement_without_hidden_obstacles_is_reported(call, working_folder):
    message = "ignored: announce: the scene has no hidden obstacles\n"
    assert call("control", "lesson.toml", "--announce", "--steps", "2").stderr == message
    rejected = call("control", "lesson.toml", "--announce", "--wavefront", "front.gif")
    assert rejected.exit_code == 2 and "add a [[hidden]] table, or leave it out" in rejected.stderr
    assert not (working_folder / "front.gif").exists()
    hidden = '[[hidden]]\nshape = "circle"\ncentre = [2.5, 6.5]\nradius = 0.4\n'
    text = (working_folder / "lesson.toml").read_text()
    (working_folder / "hidden.toml").write_text(text + hidden)
    assert call("control", "hidden.toml", "--announce", "--steps", "2").stderr == ""


@pytest.mark.parametrize("options", [("--method", "petsc"), ("--ranks", "3"), ("--launcher", "srun -n 2")])
def test_options_of_distributed_solutions_are_rejected_for_decks(call, working_folder, options):
    (working_folder / "divider.cir").write_text("* divider\nV1 in 0 5\nR1 in 0 1k\n.end\n")
    rejected = call("solve", "divider.cir", *options)
    assert rejected.exit_code == 2 and "are for scenes; remove them" in rejected.stderr


def test_the_picture_of_a_circuit_is_that_of_the_chosen_weight(call, working_folder, monkeypatch):
    drawn = []
    monkeypatch.setattr("resgrid.draw", drawn.append)
    monkeypatch.setattr("resgrid.plot.figures.render_figure", lambda *_: b"")
    words = ("plot", "lesson.toml", "--what", "circuit", "-o", "circuit.png", "--k")
    for k in ("0,1", "1,0"):
        assert call(*words, k).exit_code == 0
    assert [len(op.netlist.current_amps) > 0 for op in drawn] == [True, False]  # the uniform drive has current sources
    rejected = call(*words, "0.5")
    assert rejected.exit_code == 2 and "in place of --k" in rejected.stderr
    assert call(*words[:-1], "--boundary", "neumann").exit_code == 0
