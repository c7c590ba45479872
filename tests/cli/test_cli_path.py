"""Paths shortened, timed and written from the command line."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest
import yaml


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_shortened_paths_are_no_longer_and_say_so(answer, call, lesson):
    plain, short = answer("path", lesson), answer("path", lesson, "--shorten")
    for before, after in zip(plain["paths"], short["paths"], strict=True):
        assert after["length"] == before["length"]
        assert after["short"]["length"] <= before["length"]
    assert "shortened to" in call("path", lesson, "--shorten").stdout
    kept = answer("path", lesson, "--shorten", "--keep-clearance", "0.3")["paths"][0]["short"]
    assert kept["clearance"] >= 0.3 - 1e-9 or kept["length"] == pytest.approx(plain["paths"][0]["length"])


def test_timed_paths_have_times_and_rates(call, answer, room):
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
def test_an_axis_named_as_another_column_is_refused(call, room, tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    room.write_text(room.read_text().replace('name = "x"', f'name = "{name}"'))
    result = call("path", room, *words)
    assert result.exit_code == 2
    assert f"axis '{name}' has a name that this file needs" in result.stderr
    assert not list(tmp_path.glob("paths.*"))
    assert call("path", room).exit_code == 1  # the second start has no path


def test_a_plan_for_ros_has_one_document_a_path(call, answer, room, tmp_path):
    assert call("path", room, "-o", tmp_path / "plan.yaml", "--shorten").exit_code == 1
    reached, blocked = yaml.safe_load_all((tmp_path / "plan.yaml").read_text())
    assert blocked["poses"] == []
    start = reached["poses"][0]["pose"]["position"]
    assert (start["x"], start["y"]) == (0.5, 0.5)
    assert reached["header"]["frame_id"] == "map"


@pytest.mark.parametrize("suffix", [".json", ".npz"])
def test_files_hold_the_timed_columns(call, room, tmp_path, suffix):
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
        (("--speed", "0"), "--speed 0: a limit is positive"),
        (("--speed", "nan"), "--speed 'nan'"),
        (("--speed", "1,2,3"), "--speed: 3 numbers for x, y"),
        (("--acceleration", "1"), "--acceleration"),
        (("--rate", "10"), "--rate"),
        (("--speed", "1", "--rate", "0"), "'--rate'"),
        (("--keep-clearance", "1"), "--keep-clearance"),
        (("--shorten", "--keep-clearance", "-1"), "'--keep-clearance'"),
        (("--queries", "some.scen", "--shorten"), "leave out --shorten"),
        (("-o", "paths.txt"), ".csv, .json, .npz or .yaml"),
    ],
)
def test_bad_options_are_named(call, room, words, message):
    result = call("path", room, *words)
    assert result.exit_code == 2
    assert message in result.stderr


def test_arms_and_turning_polygons_are_drawn_in_their_workspace(call, scenes, tmp_path, lesson):
    for name in ("problem_two_goals", "turning"):
        assert call("plot", scenes / f"{name}.toml", "--what", "robot", "-o", tmp_path / f"{name}.png").exit_code == 0
        assert (tmp_path / f"{name}.png").stat().st_size > 20_000
    refused = call("plot", lesson, "--what", "robot", "-o", tmp_path / "lesson.png")
    assert (refused.exit_code, "point or a disc" in refused.stderr) == (2, True)


def test_paths_of_arms_tell_where_the_tip_is(call, scenes):
    rows = rows_of(call("path", scenes / "problem_two_goals.toml", "-o", "-", "--shorten").stdout)
    for row in (rows[0], rows[-1]):
        angles = float(row["theta_1"]), float(row["theta_2"])
        assert float(row["tip_x"]) == pytest.approx(np.cos(angles).sum(), abs=1e-12)
        assert float(row["tip_y"]) == pytest.approx(np.sin(angles).sum(), abs=1e-12)


@pytest.mark.parametrize(
    ("said", "missing"),
    [
        ('boundary = "wall"', ["--set", "chip.wall_resistance=1k"]),
        ('boundary = "wall"', ["--boundary", "dirichlet"]),
        ('boundary = "neumann"\ndrive = "start"', ["--start", "0.5,0.5"]),
        ('drive = "uniform"', ["--set", "boundary=neumann"]),
    ],
)
@pytest.mark.parametrize("is_piped", [True, False])
def test_options_may_say_what_a_scene_lacks(said, missing, is_piped, call, room, tmp_path):
    text = f"{said}\n{room.read_text()}"
    if "drive" in said:
        text = text.replace("starts = [[0.5, 0.5], [5.5, 4.5]]\n", "")
    scene = tmp_path / "lacking.toml"
    scene.write_text(text)
    words, piped = (["-"], text) if is_piped else ([scene], None)
    assert call("solve", *words, piped=piped).exit_code == 2
    assert call("solve", *words, *missing, piped=piped).exit_code == 0
    wrong = call("solve", *words, *missing, "--set", "k=3", piped=piped)
    assert wrong.exit_code == 2 and ": k: must be at most 1, got 3" in wrong.stderr
