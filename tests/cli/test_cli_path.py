"""The subcommand path: shortened and timed paths in output and files, measured again with numpy and shapely."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest
import shapely
import yaml

import resgrid as rg


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


@pytest.mark.slow
def test_length_and_clearance_of_a_shortened_path_equal_those_of_its_points(answer, call, scenes, tmp_path):
    """The lengths are computed from the written points; the figures of the streamline are listed separately."""
    plain = answer("path", scenes / "rooms.toml", "--k", "0,1")["paths"]
    space = rg.build_space(rg.read_scene(scenes / "rooms.toml"))
    for keep in ("0", None):
        options = ["path", scenes / "rooms.toml", "--k", "0,1", "--shorten"] + ["--keep-clearance", keep] * bool(keep)
        data = answer(*options, "-o", tmp_path / "paths.json")
        lines = call(*options, "-o", tmp_path / "paths.csv").stdout.splitlines()
        assert (
            json.loads((tmp_path / "paths.json").read_text())["paths"][0]["clearance"] == data["paths"][0]["clearance"]
        )
        rows = rows_of((tmp_path / "paths.csv").read_text())
        for number, (before, after, line) in enumerate(zip(plain, data["paths"], lines, strict=True)):
            points = np.array([(float(row["x"]), float(row["y"])) for row in rows if row["path"] == str(number)])
            length, clearance = np.linalg.norm(np.diff(points, axis=0), axis=1).sum(), clearance_from(points, space)
            assert after["length"] == pytest.approx(length) == after["short"]["length"]
            assert after["clearance"] == pytest.approx(clearance, abs=1e-9) == after["short"]["clearance"]
            assert after["streamline"] == {"length": before["length"], "clearance": before["clearance"]}
            assert f"length {length:.6g} m, clearance {after['clearance']:.4g} m (streamline: length" in line
            assert length <= before["length"]
            if keep is None:
                assert after["clearance"] >= before["clearance"] / 2 - 1e-9 > 0


def clearance_from(points, space):
    """Return the distance of a polyline from obstacle cells and the grid's border, by shapely."""
    line = shapely.LineString(points)
    cells = np.argwhere(space.cell == rg.Cell.OBSTACLE)
    boxes = shapely.box(*(cells * space.spacing + space.lower).T, *((cells + 1) * space.spacing + space.lower).T)
    border = shapely.box(*space.lower, *space.upper).exterior
    return min(shapely.distance(line, boxes).min(), line.distance(border))


@pytest.mark.slow
def test_length_and_clearance_of_a_timed_path_equal_those_of_its_points(answer, scenes, tmp_path):
    """At a low rate the straight lines between the samples cut corners; the figures must include this."""
    space = rg.build_space(rg.read_scene(scenes / "rooms.toml"))
    for more in ((), ("--rate", "50"), ("--rate", "0.7")):
        words = ("--k", "1", "--shorten", "--speed", "0.8", "--acceleration", "1.5", *more)
        for path in answer("path", scenes / "rooms.toml", *words)["paths"]:
            points = np.array(path["points"])
            assert path["length"] == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            assert path["clearance"] == pytest.approx(clearance_from(points, space), abs=1e-9)


def test_a_rate_too_low_to_avoid_obstacles_is_reported(call, scenes):
    words = ("path", scenes / "rooms.toml", "--k", "1", "--shorten", "--speed", "0.8")
    assert "lines between the samples at --rate 0.2 touch an obstacle" in call(*words, "--rate", "0.2").stderr
    assert call(*words, "--rate", "20").stderr == ""


def test_keep_clearance_keeps_the_clearance_or_the_streamline(answer, lesson):
    plain = answer("path", lesson)["paths"][0]
    kept = answer("path", lesson, "--shorten", "--keep-clearance", "0.3")["paths"][0]
    assert kept["clearance"] >= 0.3 - 1e-9 or kept["length"] == pytest.approx(plain["length"])


def test_timed_paths_have_columns_of_times_and_rates_within_the_limits(call, answer, room):
    table = call("path", room, "--speed", "0.5", "--acceleration", "1", "--rate", "20", "-o", "-")
    assert table.exit_code == 1  # the second start has no path
    rows = rows_of(table.stdout)
    assert list(rows[0]) == ["path", "k", "outcome", "t", "x", "y", "x_rate", "y_rate"]
    first = [row for row in rows if row["path"] == "0"]
    times = np.array([float(row["t"]) for row in first])
    np.testing.assert_allclose(np.diff(times)[:-1], 0.05)
    fastest = max(np.hypot(float(row["x_rate"]), float(row["y_rate"])) for row in first)
    assert fastest == pytest.approx(0.5)
    assert [row["t"] for row in rows if row["path"] == "1"] == ["0.0"]
    data = answer("path", room, "--speed", "0.5,0.25", code=1)
    assert data["paths"][0]["duration"] > data["paths"][0]["length"] / np.hypot(0.5, 0.25)


@pytest.mark.parametrize(
    ("name", "words"),
    [("outcome", ("-o", "-")), ("points", ("-o", "paths.npz")), ("t", ("-o", "paths.json", "--speed", "1"))],
)
def test_an_axis_named_as_another_column_exits_with_2(call, room, tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    room.write_text(room.read_text().replace('name = "x"', f'name = "{name}"'))
    result = call("path", room, *words)
    assert result.exit_code == 2
    assert f"axis '{name}' has the name of another column" in result.stderr
    assert not list(tmp_path.glob("paths.*"))
    assert call("path", room).exit_code == 1  # the second start has no path


def test_ros_messages_are_written_for_starts_with_a_path(call, room, tmp_path):
    result = call("path", room, "-o", tmp_path / "plan.yaml", "--shorten")
    assert result.exit_code == 1
    assert "plan.yaml has no path from start (5.5, 4.5), k = 1" in result.stderr
    text = (tmp_path / "plan.yaml").read_text()
    (reached,) = yaml.safe_load_all(text)
    assert "# start (5.5, 4.5), k = 1: no_path" in text.splitlines()
    start = reached["poses"][0]["pose"]["position"]
    assert (start["x"], start["y"]) == (0.5, 0.5)
    assert reached["header"]["frame_id"] == "map"


@pytest.mark.parametrize(("start", "outcome"), [("4.5,2.5", "start_blocked"), ("5.5,4.5", "no_path")])
def test_no_ros_message_is_written_if_no_start_has_a_path(call, room, tmp_path, start, outcome):
    file = tmp_path / "plan.yaml"
    for old in (False, True):
        result = call("path", room, f"--start={start}", "-o", file)
        assert result.exit_code == 1 and outcome in result.stdout
        assert f"{file} is not written, because no path reaches a goal" in result.stderr
        assert "wrote" not in result.stderr
        assert ("older" in result.stderr) == old == file.exists()
        file.write_text("old")
    data = json.loads(call("path", room, f"--start={start}", "-o", file, "--json").stdout)
    assert data["paths"][0]["outcome"] == outcome


@pytest.mark.parametrize("suffix", [".json", ".npz"])
def test_json_and_npz_files_contain_the_timed_columns(call, room, tmp_path, suffix):
    file = tmp_path / f"paths{suffix}"
    call("path", room, "--shorten", "--speed", "1", "-o", file)
    if suffix == ".json":
        columns = json.loads(file.read_text())["paths"][0]["columns"]
        assert columns["t"][0] == 0
        assert len(columns["x"]) == len(columns["t"])
    else:
        with np.load(file) as arrays:
            assert arrays["t_0"].shape == arrays["x_0"].shape == arrays["y_rate_0"].shape


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--speed", "fast"), "--speed 'fast'"),
        (("--speed", "0"), "--speed 0: a limit must be positive"),
        (("--speed", "nan"), "--speed 'nan'"),
        (("--speed", "1,2,3"), "--speed: got 3 numbers for x, y"),
        (("--acceleration", "1"), "--acceleration"),
        (("--rate", "10"), "--rate"),
        (("--speed", "1", "--rate", "0"), "'--rate'"),
        (("--keep-clearance", "1"), "--keep-clearance"),
        (("--shorten", "--keep-clearance", "-1"), "'--keep-clearance'"),
        (("--queries", "some.scen", "--shorten"), "leave out --shorten"),
        (("--queries", "some.scen", "--rate", "9", "--acceleration", "1"), "leave out --acceleration, --rate"),
        (("--queries", "some.scen", "--start", "1,1", "--goal", "2,2"), "leave out --goal, --start"),
        (("--queries", "some.scen", "--cells", "--goal", "2,2"), "leave out --goal"),
        (("--queries", "some.scen", "--goal-tolerance", "2"), "leave out --goal-tolerance"),
        (("--via", "1,1", "--rate", "10"), "leave out --shorten, --speed, --acceleration, --rate"),
        (("--escape", "--acceleration", "1"), "leave out --shorten, --speed, --acceleration, --rate"),
        (("--approximate", "--fixed-joints"), "--fixed-joints, --queries, --method, --ranks and --launcher"),
        (("-o", "paths.txt"), ".csv, .json, .npz or .yaml"),
    ],
)
def test_invalid_path_options_exit_with_2_and_a_message(call, room, words, message):
    result = call("path", room, *words)
    assert result.exit_code == 2
    assert message in result.stderr


@pytest.mark.slow
def test_plot_robot_draws_arms_and_polygons_and_rejects_points(call, scenes, tmp_path, lesson):
    for name in ("problem_two_goals", "turning"):
        assert call("plot", scenes / f"{name}.toml", "--what", "robot", "-o", tmp_path / f"{name}.png").exit_code == 0
        assert (tmp_path / f"{name}.png").stat().st_size > 20_000
    rejected = call("plot", lesson, "--what", "robot", "-o", tmp_path / "lesson.png")
    assert (rejected.exit_code, "point or a disc" in rejected.stderr) == (2, True)


def test_paths_of_arms_have_tip_columns(call, scenes):
    rows = rows_of(call("path", scenes / "problem_two_goals.toml", "-o", "-", "--shorten").stdout)
    for row in (rows[0], rows[-1]):
        angles = float(row["theta_1"]), float(row["theta_2"])
        assert float(row["tip_x"]) == pytest.approx(np.cos(angles).sum(), abs=1e-12)
        assert float(row["tip_y"]) == pytest.approx(np.sin(angles).sum(), abs=1e-12)


@pytest.mark.parametrize(
    ("first_line", "missing"),
    [
        ('boundary = "wall"', ["--set", "chip.wall_resistance=1k"]),
        ('boundary = "wall"', ["--boundary", "dirichlet"]),
        ('boundary = "neumann"\ndrive = "start"', ["--start", "0.5,0.5"]),
        ('drive = "uniform"', ["--set", "boundary=neumann"]),
    ],
)
@pytest.mark.parametrize("is_piped", [True, False])
def test_options_supply_keys_that_a_scene_lacks(first_line, missing, is_piped, call, room, tmp_path):
    text = f"{first_line}\n{room.read_text()}"
    if "drive" in first_line:
        text = text.replace("starts = [[0.5, 0.5], [5.5, 4.5]]\n", "")
    scene = tmp_path / "lacking.toml"
    scene.write_text(text)
    words, piped = (["-"], text) if is_piped else ([scene], None)
    assert call("solve", *words, piped=piped).exit_code == 2
    assert call("solve", *words, *missing, piped=piped).exit_code == 0
    wrong = call("solve", *words, *missing, "--set", "k=3", piped=piped)
    assert wrong.exit_code == 2 and ": k: must be at most 1, got 3" in wrong.stderr
