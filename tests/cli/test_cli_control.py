"""The subcommand control: output, logs, pictures, reproducibility and rejected input."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from PIL import Image
from support.hidden import hidden_room

ROOM = hidden_room(k="[0.98, 1.0]", radius=0.2)


@pytest.fixture
def hidden(tmp_path):
    file = tmp_path / "hidden.toml"
    file.write_text(ROOM)
    return file


def test_every_run_is_printed_with_its_outcome_and_figures(answer, call, hidden) -> None:
    (run,) = answer("control", hidden)["runs"]
    assert (run["outcome"], run["goal"], run["k"]) == ("arrived", 0, 0.98)
    assert run["start"] == [4.2, 7.2]
    assert run["cells_learnt"] > 0
    assert run["resolves"] > 0
    assert sum(run["modes"].values()) == run["steps"] + 1
    assert run["modes"]["learning"] == run["resolves"]
    assert run["penetration"] == 0
    assert "cells learnt in" in call("control", hidden).stdout
    both = answer("control", hidden, "--k", "0.5", "--k", "1", "--start", "4.2,7.2", "--start", "1,7")["runs"]
    assert [(run["k"], run["start"][0]) for run in both] == [(0.5, 4.2), (0.5, 1), (1, 4.2), (1, 1)]


@pytest.mark.parametrize("name", ["t", "mode", "contact_x", "y_rate"])
def test_an_axis_named_as_another_column_exits_with_2(call, hidden, tmp_path, name) -> None:
    hidden.write_text(ROOM.replace('name = "x"', f'name = "{name}"'))
    result = call("control", hidden, "-o", tmp_path / "log.csv")
    assert result.exit_code == 2
    assert f"axis '{name}' has the name of another column" in result.stderr
    assert not (tmp_path / "log.csv").exists()


def test_runs_that_do_not_arrive_exit_with_1(answer, call, hidden) -> None:
    (run,) = answer("control", hidden, "--steps", 5, code=1)["runs"]
    assert run["outcome"] == "out_of_steps"
    done = call("control", hidden, "--no-learn", "--friction", "1", "--response", "admittance", "--start", "3.2,7.2")
    assert done.exit_code == 1
    assert "stalled" in done.stdout
    walled = hidden.with_name("walled.toml")
    walled.write_text(ROOM.replace("[2.5, 3.0]", "[0.0, 3.0]").replace("[6.2, 4.0]", "[8.0, 4.0]"))
    (run,) = answer("control", walled, code=1)["runs"]
    assert run["outcome"] == "no_path"
    covered = hidden.with_name("covered.toml")
    covered.write_text(ROOM.replace("[2.5, 3.0]", "[3.9, 0.4]").replace("[6.2, 4.0]", "[4.6, 1.2]"))
    (run,) = answer("control", covered, code=1)["runs"]
    assert run["outcome"] == "goal_blocked"
    assert "cover every goal" in call("control", covered, "--announce").stderr


def test_csv_and_npz_logs_contain_every_step(call, answer, hidden, tmp_path) -> None:
    table = list(csv.DictReader(io.StringIO(call("control", hidden, "--pushes", 4, "-o", "-").stdout)))
    file = tmp_path / "log.npz"
    (run,) = answer("control", hidden, "--pushes", 4, "-o", file)["runs"]
    with np.load(file) as log:
        assert len(table) == run["steps"] + 1 == len(log["time_0"])
        for name, column in (
            ("t", log["time_0"]),
            ("x", log["configuration_0"][:, 0]),
            ("y_rate", log["velocity_0"][:, 1]),
        ):
            assert [float(row[name]) for row in table] == column.tolist()
        names = log["mode_names"]
        assert [row["mode"] for row in table] == names[log["mode_0"]].tolist()
        counts = np.bincount(log["contact_step_0"], minlength=len(table))
        assert [int(row["contacts"]) for row in table] == counts.tolist()
        assert log["learnt_0"].sum() == run["cells_learnt"]
        assert log["push_0"].any()
    touched = [row for row in table if row["contacts"] != "0"]
    assert touched
    assert all(row["body"] == "0" and row["force_x"] for row in touched)


def test_the_log_of_a_turned_map_is_in_world_coordinates(call, tmp_path) -> None:
    grid = np.full((40, 60), 254, np.uint8)
    grid[10:30, 25:30] = 0
    Image.fromarray(grid).save(tmp_path / "m.pgm")
    keys = "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "m.yaml").write_text(f"image: m.pgm\nresolution: 0.1\norigin: [1.0, 2.0, 0.5]\n{keys}")
    done = call("control", tmp_path / "m.yaml", "--goal", "4.6,6.5", "--start", "1.5,4", "--k", "0.98", "-o", "-")
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    way = np.array([[float(row["x"]), float(row["y"])] for row in rows])
    times = np.array([float(row["t"]) for row in rows])
    rates = np.array([[float(row["x_rate"]), float(row["y_rate"])] for row in rows])
    np.testing.assert_allclose(way[0], (1.5, 4.0))
    assert np.hypot(*(way[-1] - (4.6, 6.5))) < 0.1
    np.testing.assert_allclose(np.diff(way, axis=0), rates[:-1] * np.diff(times)[:, None], atol=1e-9)


def test_runs_are_reproducible_by_their_seed(call, hidden, tmp_path) -> None:
    logs = [
        call("control", hidden, "--noise", "0.2", "--pushes", 3, "--seed", seed, "-o", "-").stdout for seed in (1, 1, 2)
    ]
    assert logs[0] == logs[1] != logs[2]


def test_picture_writes_a_png_file(call, hidden, tmp_path) -> None:
    assert call("control", hidden, "--picture", tmp_path / "run.png").exit_code == 0
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    assert call("control", hidden, "--picture", tmp_path / "run.txt").exit_code == 2


@pytest.mark.slow
def test_animate_writes_a_gif_file(call, hidden, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("resgrid.cli.control.FRAMES", 3)
    file = tmp_path / "run.gif"
    done = call("control", hidden, "--animate", file)
    assert done.exit_code == 0
    assert f"wrote {file}" in done.stderr
    with Image.open(file) as picture:
        assert picture.n_frames > 2


@pytest.mark.slow
def test_wavefront_writes_a_gif_of_announced_obstacles(call, hidden, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("resgrid.cli.control.FRAMES", 3)
    file = tmp_path / "front.gif"
    assert call("control", hidden, "--announce", "--wavefront", file).exit_code == 0
    with Image.open(file) as picture:
        assert picture.n_frames == 3


@pytest.mark.slow
def test_runs_with_settling_grids_arrive_or_stall_by_their_pace(answer, hidden) -> None:
    (run,) = answer("control", hidden, "--settle", "sor", "--pace", 30)["runs"]
    assert run["outcome"] == "arrived"
    (run,) = answer("control", hidden, "--announce", "--pace", 1e-4, code=1)["runs"]
    assert run["outcome"] == "stalled"
    assert run["modes"]["waiting"] > 10
    assert run["cells_learnt"] == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--start", "nan,1"], "finite"),
        (["--start", "4.2,3.5"], "inside hidden[0]"),
        (["--start", "40,3.5"], "outside"),
        (["--admittance", "1,2,0,1"], "not symmetric"),
        (["--admittance", "1,2,3"], "give 1 number, 2 for a diagonal, or 4"),
        (["--admittance", "1,-1"], "not positive definite"),
        (["--push", "1,2,nan,0"], "finite"),
        (["--push", "1,2,0"], "force of 2 entries"),
        (["--push", "1,0,0,1"], "lasts longer than 0 s"),
        (["--push-size", "inf"], "--push-size"),
        (["--bias", "a"], "numbers"),
        (["--noise", "1,2,3"], "noise"),
        (["--friction", "nan"], "friction"),
        (["--speed", "-1"], "speed"),
        (["--response", "flee"], "'flee' is not one of 'equipotential', 'admittance'"),
        (["--settle", "gauss"], "'gauss' is not one of 'chip', 'jacobi', 'sor'"),
        (["--settle", "chip", "--pace", "0"], "pace"),
        (["--animate", "x.txt"], ".gif or .mp4"),
        (["--wavefront", "x.gif"], "add --announce"),
        (["-o", "x.txt"], ".csv, .json or .npz"),
        (["-o", "-", "--json"], "standard output"),
        (["--k", "2"], "k"),
        (["--drive", "start", "--boundary", "neumann"], "uniform"),
    ],
)
def test_invalid_control_options_exit_with_2_and_one_message(call, hidden, words, says) -> None:
    done = call("control", hidden, *words)
    assert done.exit_code == 2
    assert says in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("error:") == 1


def test_control_rejects_scenes_without_a_start_or_with_three_axes(call, hidden, scenes) -> None:
    hidden.write_text(ROOM.replace("starts = [[4.2, 7.2]]\n", ""))
    assert "there is no start" in call("control", hidden).stderr
    assert "a scene in the plane" in call("control", scenes / "voxels.toml").stderr


def test_options_override_keys_of_the_control_table(answer, hidden) -> None:
    hidden.write_text(hidden.read_text() + "\n[control]\nspeed = 0.5\nk = 0.9\n")
    default = answer("control", hidden)["runs"][0]
    assert default["k"] == 0.9
    slower = answer("control", hidden, "--speed", 0.25)["runs"][0]
    assert slower["time"] > 1.5 * default["time"]
    assert answer("control", hidden, "--set", "control.k=0.8")["runs"][0]["k"] == 0.8


def test_a_start_in_an_obstacle_is_an_outcome_and_other_starts_run(answer, scenes) -> None:
    """The exit code is 1, as for the subcommand path."""
    starts = ("--start", "2.5,4.5", "--start", "7.5,0.5")
    runs = answer("control", scenes / "lesson.toml", *starts, "--k", 1, code=1)["runs"]
    assert [run["outcome"] for run in runs] == ["start_blocked", "arrived"]
    assert runs[0]["time"] == 0 and "obstacle in the map" in runs[0]["message"]
