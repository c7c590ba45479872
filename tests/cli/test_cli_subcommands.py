"""Answers of each subcommand, against the library and numbers by hand."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

import resgrid as rg


def read(file: Path) -> dict[str, np.ndarray]:
    with np.load(file) as arrays:
        return dict(arrays)


def test_solve_prints_and_writes_the_solution_of_the_library(answer, room, tmp_path):
    data = answer("solve", room, "-o", tmp_path / "field.npz")
    # 6 x 5 cells minus five obstacles and one goal; five free cells are enclosed by the wall.
    assert data["free_cells"] == 24
    assert data["unreachable_cells"] == 5
    assert data["nodes"] == 24 + 3  # ground and both rails
    assert data["kcl_residual"] < 1e-12
    assert 2**-52 <= data["entry_error"] < 1e-15
    assert set(data["seconds"]) >= {"assemble", "factor", "substitute", "read"}
    assert data["solver"] == "direct"
    op = rg.solve(rg.compile_space(rg.build_space(rg.read_scene(room))))
    assert data["power"] == pytest.approx(op.power)
    arrays = read(tmp_path / "field.npz")
    field = rg.field(op)
    for key in ("potential", "log_drop", "cell"):
        expected = field.space.cell if key == "cell" else getattr(field, key)
        np.testing.assert_array_equal(arrays[key], expected)
    assert np.all(arrays["log_drop"][5] == -np.inf)


def test_path_prints_every_outcome_with_a_message(answer, call, room):
    data = answer("path", room, code=1)
    reached, lost = data["paths"]
    assert reached["outcome"] == "reached" and reached["goal"] == 0 and reached["k"] == 1
    assert reached["start"] == [0.5, 0.5] == reached["points"][0]
    steps = np.diff(reached["points"], axis=0)
    assert reached["length"] == pytest.approx(np.linalg.norm(steps, axis=1).sum())
    assert np.all(np.abs(np.diff(reached["cells"], axis=0)).sum(axis=1) == 1)
    assert lost["outcome"] == "no_path" and lost["goal"] is None and "open a passage" in lost["message"]
    assert lost["log_duration"] is None  # NaN in Python
    assert "no_path" in call("path", room).stdout
    blocked = answer("path", room, "--start", "4.5,2.5", code=1)["paths"][0]
    assert blocked["outcome"] == "start_blocked"
    walled = answer("path", room, "--goal", "5.5,2.5", "--start", "0.5,0.5", code=1)["paths"][0]
    assert walled["outcome"] == "no_path"


def test_starts_in_dead_ends_reach_the_goal_with_both_drives(answer, tmp_path):
    cell = np.zeros((3, 40), dtype=np.uint8)
    cell[0, 1:] = 1  # an L: the goal in one corner, the long dead end behind the other
    cell[1, 3:] = 1
    np.save(tmp_path / "branch.npy", cell)
    words = ("path", tmp_path / "branch.npy", "--goal", "0.5,0.5", "--boundary", "neumann")
    starts = ("--start", "2.5,0.5", "--start", "2.5,39.5")
    for drive in ("start", "uniform"):
        outcomes = [path["outcome"] for path in answer(*words, "--drive", drive, *starts)["paths"]]
        assert outcomes == ["reached", "reached"]


def test_every_start_with_drive_start_has_its_own_circuit(answer, room):
    words = ("path", room, "--boundary", "neumann", "--drive", "start")
    data = answer(*words, "--start", "0.5,0.5", "--start", "2.5,4.5", "--start", "3.5,3.5")
    assert [path["outcome"] for path in data["paths"]] == ["reached"] * 3
    assert data["paths"][2]["length"] == 0
    assert answer("path", room, "--k", "0", "--drive", "start", "--start", "0.5,0.5")["paths"][0]["k"] == 0
    data = answer(*words, "--start", "5.5,0.5", "--start", "4.5,0.5", code=1)
    assert [path["outcome"] for path in data["paths"]] == ["no_path", "start_blocked"]


def test_paths_of_blends_equal_those_of_the_library(answer, lesson):
    paths = answer("path", lesson, "--k", "0,0.5", "--k", "1")["paths"]
    assert [path["k"] for path in paths] == [0, 0.5, 1]
    scene = rg.read_scene(lesson)
    space = rg.build_space(scene)
    fields = [rg.field(rg.solve(rg.compile_space(space, boundary=b))) for b in ("dirichlet", "neumann")]
    for path in paths:
        line = rg.streamline(rg.blend(*fields, path["k"]), start=scene.starts[0])
        assert path["length"] == pytest.approx(line.length, rel=1e-12)


@pytest.mark.parametrize(("place", "cells"), [("2.5,3.5", False), ("2,3", True)])
def test_starts_are_coordinates_or_cells(answer, room, place, cells):
    words = ("path", room, "--start", place, *(["--cells"] if cells else []))
    path = answer(*words)["paths"][0]
    assert path["start"] == [2.5, 3.5] and path["cells"][0] == [2, 3]


def test_paths_on_a_turned_map_are_in_world_coordinates(answer, tmp_path):
    pixels = np.full((4, 6), 254, dtype=np.uint8)
    (tmp_path / "map.pgm").write_bytes(b"P5\n6 4\n255\n" + pixels.tobytes())
    (tmp_path / "map.yaml").write_text(
        "image: map.pgm\nresolution: 1\norigin: [10, 20, 1.5707963267948966]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    # A quarter turn: the map's x runs along the world's y, its y against the world's x.
    path = answer("path", tmp_path / "map.yaml", "--start", "9.5,20.5", "--goal", "6.5,25.5")["paths"][0]
    assert path["outcome"] == "reached"
    assert path["cells"][0] == [0, 0]
    np.testing.assert_allclose(path["points"][0], [9.5, 20.5], atol=1e-12)
    goal = np.array(path["points"][-1])
    assert np.all(np.abs(goal - [6.5, 25.5]) <= 0.5 + 1e-9)


@pytest.mark.parametrize("suffix", [".csv", ".json", ".npz"])
def test_paths_are_written_in_the_format_of_the_suffix(call, room, tmp_path, suffix):
    file = tmp_path / f"paths{suffix}"
    assert call("path", room, "-o", file).exit_code == 1  # the second start has no path
    if suffix == ".csv":
        rows = list(csv.DictReader(io.StringIO(file.read_text())))
        assert set(rows[0]) == {"path", "k", "outcome", "x", "y"}
        points = [(float(row["x"]), float(row["y"])) for row in rows if row["path"] == "0"]
        assert rows[-1]["outcome"] == "no_path"
    elif suffix == ".json":
        points = json.loads(file.read_text())["paths"][0]["points"]
    else:
        points = read(file)["points_0"]
    line = rg.streamline(rg.field(rg.solve(rg.compile_space(rg.build_space(rg.read_scene(room))))), start=(0.5, 0.5))
    np.testing.assert_array_equal(points, line.points)
    assert call("path", room, "-o", "-").stdout.startswith("path,k,outcome,x,y\n0,1.0,reached,0.5,0.5\n")


def test_scenes_and_maps_are_read_from_standard_input(answer, room, tmp_path):
    expected = answer("path", room, code=1)["paths"]
    assert answer("path", "-", code=1, piped=room.read_text())["paths"] == expected
    np.save(tmp_path / "map.npy", np.zeros((3, 3), dtype=np.uint8))
    words = ("path", "-", "--goal", "0.5,0.5", "--start", "2.5,2.5")
    assert answer(*words, piped=(tmp_path / "map.npy").read_bytes())["paths"][0]["outcome"] == "reached"


def test_map_options_change_how_a_map_is_read(answer, tmp_path):
    (tmp_path / "swamp.map").write_text("type octile\nheight 1\nwidth 3\nmap\n.S.\n")
    words = ("info", tmp_path / "swamp.map")
    assert answer(*words)["obstacle_cells"] == 0
    assert answer(*words, "--passable", ".")["obstacle_cells"] == 1
    grey = bytes([0, 255, 128])
    (tmp_path / "grey.pgm").write_bytes(b"P5\n3 1\n255\n" + grey)
    assert answer("info", tmp_path / "grey.pgm", "--threshold", "200")["obstacle_cells"] == 2
    epic = answer("info", tmp_path / "grey.pgm", "--format", "epic", "--spacing", "0.5", "--origin", "1,2")
    assert (epic["obstacle_cells"], epic["goal_cells"], epic["free_cells"]) == (1, 1, 1)
    assert [axis["lower"] for axis in epic["axes"]] == [1, 2] and epic["axes"][0]["upper"] == 2.5
    yaml = "image: grey.pgm\nresolution: 1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    (tmp_path / "map.yaml").write_text(yaml)
    assert answer("info", tmp_path / "map.yaml")["obstacle_cells"] == 2
    assert answer("info", tmp_path / "map.yaml", "--unknown", "free")["obstacle_cells"] == 1
    assert answer("info", tmp_path / "map.yaml", "--map-dialect", "ros1", "--lethal", "90")["free_cells"] == 1


def test_options_override_keys_of_the_scene(answer, call, lesson):
    assert answer("solve", lesson, "--boundary", "neumann")["chip"] == "neumann"
    assert answer("solve", lesson, "--k", "0")["chip"] == "neumann"
    walls = answer("solve", lesson, "--boundary", "wall", "--set", "chip.wall_resistance=33k")
    rails = answer("solve", lesson)
    assert walls["power"] < rails["power"]
    assert answer("solve", lesson, "--resistance", "20k")["power"] == pytest.approx(rails["power"] / 2)
    assert answer("solve", lesson, "--set", "supply=2")["power"] == pytest.approx(rails["power"] * 4)
    # An open edge leaves out the 32 contacts around the grid.
    assert rails["resistors"] - answer("solve", lesson, "--edge", "open")["resistors"] == 32
    assert rails["resistors"] - answer("solve", lesson, "--edge", "open,obstacle")["resistors"] == 16
    assert "two circuits" in call("solve", lesson, "--k", "0.5").stderr


def test_the_boundary_option_overrides_blends_and_drives_of_the_scene(answer, scenes, tmp_path):
    file = tmp_path / "driven.toml"
    text = (scenes / "lesson.toml").read_text()
    file.write_text(text.replace('boundary = "dirichlet"', 'boundary = "neumann"\ndrive = "uniform"\nk = [0, 1]'))
    assert len(answer("path", file)["paths"]) == 2
    assert len(answer("path", file, "--boundary", "dirichlet")["paths"]) == 1


def test_compile_prints_or_writes_the_same_deck(answer, call, lesson, tmp_path):
    deck = tmp_path / "chip.cir"
    data = answer("compile", lesson, "--boundary", "neumann", "-o", deck)
    assert data["deck"] == str(deck) and data["current_sources"] == 56 and data["resistors"] == 88
    assert call("compile", lesson, "--boundary", "neumann").stdout_bytes == deck.read_bytes()
    assert call("compile", lesson, "--boundary", "neumann", "-o", "-").stdout_bytes == deck.read_bytes()
    nodes = json.loads(Path(data["sidecar"]).read_text())["nodes"]
    assert max(node["voltage"] for node in nodes.values()) == pytest.approx(1.0, abs=1e-12)  # the drive is scaled
    assert "no SPICE dialect" in call("compile", lesson, "--dialect", "spike").stderr
    assert "did you mean 'ngspice'?" in call("compile", lesson, "--dialect", "ngspce").stderr


def test_check_compares_deck_scene_and_simulator(answer, call, lesson, tmp_path):
    deck = tmp_path / "chip.cir"
    assert call("compile", lesson, "-o", deck).exit_code == 0
    assert answer("check", deck)["reference"] == "sidecar"
    data = answer("check", lesson)
    assert data["reference"] == "solve" and data["agrees"] and data["simulator"] == "ngspice" and data["nodes"] == 58
    assert answer("check", lesson, "--deck", deck)["reference"] == "scene"
    text = deck.read_text()
    line = next(line for line in text.splitlines() if line.startswith("r_2_0_3_0 "))
    deck.write_text(text.replace(line, line.replace("10000.0", "10100.0")))
    data = answer("check", deck, code=1)
    assert not data["agrees"] and any("lines" in finding for finding in data["findings"])
    assert data["worst"][0].keys() == {"node", "expected", "got"}
    assert answer("check", lesson, "--deck", deck, code=1)["agrees"] is False
    assert "DISAGREES" in call("check", deck).stdout
    assert call("check", deck, "--deck", deck).exit_code == 2
    assert call("check", deck, "--k", "1").exit_code == 2
    assert call("check", lesson, "--tolerance", "7").exit_code == 2
    (tmp_path / "chip.cir.json").unlink()
    assert answer("check", deck)["reference"] == "solve"


@pytest.mark.usefixtures("without_pictures")
def test_a_missing_simulator_exits_with_3(call, lesson, monkeypatch, tmp_path):
    monkeypatch.setenv("RESGRID_NGSPICE", "no-such-ngspice")
    result = call("check", lesson)
    assert result.exit_code == 3 and "apt-get install ngspice" in result.stderr
    result = call("run", lesson, "-o", tmp_path / "out")
    assert result.exit_code == 0 and "not simulated" in result.stdout
    assert call("run", lesson, "-o", tmp_path / "out", "--check").exit_code == 3
    assert call("info", "--versions").exit_code == 0


def test_info_describes_scene_schema_and_versions(answer, call, room):
    data = answer("info", room)
    assert data["shape"] == [6, 5] and data["cells"] == 30 and data["goals"] == 1
    assert (data["free_cells"], data["obstacle_cells"], data["unreachable_cells"]) == (24, 5, 5)
    assert data["memory_bytes"] > 0 and data["nodes"] == 27
    assert "Room: 6 x 5 = 30 cells" in call("info", room).stdout
    schema = json.loads(call("info", "--schema").stdout)
    assert schema["properties"]["boundary"]
    assert answer("info", "--versions")["versions"]["numpy"] == np.__version__
    assert call("info").exit_code == 2 and call("info", room, "--schema").exit_code == 2


def test_queries_of_a_benchmark_file_have_one_path_each(answer, call, tmp_path):
    (tmp_path / "a.map").write_text("type octile\nheight 2\nwidth 4\nmap\n..@.\n..@.\n")
    rows = ["0\ta.map\t4\t2\t0\t0\t1\t1\t1.4", "0\ta.map\t4\t2\t0\t0\t3\t0\t9", "0\ta.map\t4\t2\t0\t0\t2\t0\t9"]
    (tmp_path / "a.scen").write_text("version 1\n" + "\n".join(rows) + "\n")
    words = ("path", tmp_path / "a.map", "--queries", tmp_path / "a.scen")
    data = answer(*words, code=1)
    assert [path["outcome"] for path in data["paths"]] == ["reached", "no_path", "goal_blocked"]
    assert answer(*words, "--limit", "1")["paths"][0]["length"] == pytest.approx(0.5**0.5)
    assert "1 of 3 paths" in call(*words).stdout
    (tmp_path / "b.map").write_text("type octile\nheight 1\nwidth 1\nmap\n.\n")
    assert call("path", tmp_path / "b.map", "--queries", tmp_path / "a.scen").exit_code == 2


def test_messages_are_written_to_standard_error(call, room, tmp_path):
    loud = call("solve", room, "-v", "-o", tmp_path / "a.npz")
    quiet = call("solve", room, "-q", "-o", tmp_path / "b.npz")
    assert loud.stdout == quiet.stdout != ""
    assert "solve the dirichlet chip: " in loud.stderr and "wrote" in loud.stderr
    assert quiet.stderr == ""


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """Write a grey image of 12 x 8 cells: white, with a black wall that has a gap at the bottom, and a grey dot."""
    from PIL import Image

    rows = np.full((8, 12), 255, dtype=np.uint8)
    rows[:6, 6] = 0
    rows[6, 2] = 90
    file = tmp_path / "hall.png"
    Image.fromarray(rows).save(file)
    return file


def test_info_and_plot_accept_a_map_without_a_goal(answer, call, picture, tmp_path):
    data = answer("info", picture)
    assert data["map"]["greys"] == [[0, 127, "obstacle"], [128, 255, "free"]]
    assert data["goals"] == 0 and "--goal" in data["no_circuit"]
    rows = data["sketch"]  # two letters a cell, the top row of the picture first
    assert rows == [
        ("............##.........."),
        *["............##.........."] * 5,
        "....##..................",
        "." * 24,
    ]
    text = call("info", picture).stdout
    assert "y points up" in text and "0 to 127 obstacle" in text and "....##...." in text
    assert call("plot", picture, "--what", "space", "-o", tmp_path / "hall_space.png").exit_code == 0
    assert call("plot", picture, "-o", tmp_path / "page.png").exit_code == 2  # a potential needs one


def test_info_lists_thresholds_and_unknown_cells_of_a_ros_map(answer, picture):
    text = "image: hall.png\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    file = picture.with_name("hall.yaml")
    file.write_text(text)
    described = answer("info", file)["map"]
    # By the definition of the format, the darkness (255 - grey) / 255 against both thresholds, strictly.
    darkness = (255 - np.arange(256)) / 255
    for low, high, kind in described["greys"]:
        for grey in range(low, high + 1):
            expected = "obstacle" if darkness[grey] > 0.65 else "free" if darkness[grey] < 0.25 else "unknown"
            assert kind == expected, grey
    assert described["unknown_cells"] == 1 and described["unknown_as"] == "obstacle"  # the dot of grey 90
    assert answer("info", file, "--unknown", "free")["map"]["unknown_as"] == "free"


def test_a_goal_in_a_grey_obstacle_reports_its_value_and_the_nearest_free_place(call, picture):
    message = call("info", picture, "--goal", "2.5,1.5").stderr
    assert "grey value is 90" in message and "from 128" in message and "nearest is (" in message
    x, y = map(float, message.partition("nearest is (")[2].partition(")")[0].split(","))
    assert call("info", picture, "--goal", f"{x},{y}").exit_code == 0
    assert call("info", picture, "--goal", "2.5,1.5", "--threshold", "90").exit_code == 0


def test_robot_radius_enlarges_obstacles(answer, call, picture):
    assert (
        answer("info", picture, "--robot-radius", "1.2")["obstacle_cells"] > answer("info", picture)["obstacle_cells"]
    )
    assert "robot.radius" in call("info", picture, "--robot-radius", "-1").stderr


def test_quiet_with_an_output_file_prints_no_text(call, room, tmp_path):
    file = tmp_path / "path.csv"
    assert call("path", room, "--start", "0.5,0.5", "-q", "-o", file).output == ""
    assert file.exists()
    assert "reached" in call("path", room, "--start", "0.5,0.5", "-q").stdout
    assert call("control", room, "--start", "0.5,0.5", "-q", "-o", tmp_path / "log.csv").output == ""


def test_unknown_subcommands_and_values_are_answered_with_valid_ones(call, room, tmp_path):
    assert "Did you mean 'control'?" in call("contrl", room).stderr
    assert call("contrl", room).exit_code == 2
    for words, choices in (
        (("plot", room, "-o", tmp_path / "a.png", "--what", "spac"), "'space'"),
        (("control", room, "--settle", "fast"), "'jacobi'"),
        (("control", room, "--response", "none"), "'admittance'"),
    ):
        result = call(*words)
        assert result.exit_code == 2 and choices in result.stderr


@pytest.mark.slow
def test_animate_draws_only_the_first_of_several_runs(call, room, tmp_path):
    from PIL import Image

    small = room.with_name("small.toml")
    small.write_text(room.read_text().replace("[5.5, 4.5]", "[1.5, 1.5]"))
    result = call("control", small, "--animate", tmp_path / "a.gif", "--speed", "3")
    assert "only the first of several runs is drawn" in result.stderr and result.exit_code == 0, result.stderr
    with Image.open(tmp_path / "a.gif") as picture:
        assert picture.n_frames > 2


def test_decks_are_read_from_standard_input_with_read_as(call, answer, room) -> None:
    deck = call("compile", room, "-o", "-").stdout
    assert answer("solve", "-", "--read-as", "ngspice", piped=deck)["nodes"] == answer("solve", room)["nodes"]
    assert call("convert", "-", "--read-as", "ngspice", "-o", "-", piped=deck).stdout.startswith("*")
    assert call("check", "-", "--read-as", "ngspice", "--rules", piped=deck).exit_code == 0
    rejected = call("check", "-", "--read-as", "ngspice", piped=deck)
    assert rejected.exit_code == 2 and "a deck from standard input" in rejected.stderr
    wrong = call("solve", "-", "--read-as", "ngspice", piped="* title\nr1 a 0 what\n.end\n")
    assert wrong.exit_code == 2 and ":2:" in wrong.stderr and "tmp" not in wrong.stderr
