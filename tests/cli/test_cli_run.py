"""The subcommands run and plot: one complete folder with paths, pictures and checked decks; pictures of every kind.

Tests internals: `resgrid._internal.files`.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

import resgrid as rg
from resgrid._internal.files import whole_folder


def names(folder: Path) -> set[str]:
    return {file.name for file in folder.iterdir()}


@pytest.mark.slow
def test_run_writes_all_results_into_one_folder(answer, lesson, tmp_path):
    folder = tmp_path / "deep" / "out"
    data = answer("run", lesson, "-o", folder)
    deck = {"dirichlet.cir", "dirichlet.cir.json", "dirichlet.cir.ngspice", "dirichlet.cir.verify", "dirichlet.npz"}
    assert names(folder) == {"page.png", "circuit.png", "paths.csv", "paths.json", "summary.json"} | deck
    assert set(data["files"]) == names(folder)
    assert names(tmp_path / "deep") == {"out"}
    assert [path["outcome"] for path in data["paths"]] == ["reached"]
    assert data["chips"][0]["check"]["agrees"] is True and data["chips"][0]["check"]["nodes"] == 58
    summary = json.loads((folder / "summary.json").read_text())
    assert summary == {key: value for key, value in data.items() if key != "folder"}
    with np.load(folder / "dirichlet.npz") as arrays:
        assert arrays["cell"].shape == (8, 8)
    assert (folder / "page.png").read_bytes().startswith(b"\x89PNG")
    assert answer("check", folder / "dirichlet.cir")["agrees"]


@pytest.mark.slow
def test_blends_have_two_decks_and_one_page_each(call, lesson, tmp_path):
    folder = tmp_path / "out"
    result = call("run", lesson, "--k", "0,0.5,1", "--no-check", "-o", folder)
    assert result.exit_code == 0, result.stderr
    assert {"page_k_0.png", "page_k_0.5.png", "page_k_1.png", "paths.png"} <= names(folder)
    assert {"dirichlet.cir", "neumann.cir"} <= names(folder)
    assert "not simulated: --no-check" in result.stdout and str(folder) in result.stdout
    assert result.stdout.count("reached goal 0") == 3


@pytest.mark.slow
def test_a_second_run_replaces_its_files_and_keeps_other_files(call, lesson, tmp_path):
    folder = tmp_path / "out"
    assert call("run", lesson, "--k", "0,1", "--no-check", "-o", folder).exit_code == 0
    (folder / "notes.txt").write_text("mine")
    assert call("run", lesson, "--no-check", "-o", folder).exit_code == 0
    assert "page_k_0.png" not in names(folder) and "neumann.cir" not in names(folder)
    assert (folder / "notes.txt").read_text() == "mine"
    assert {"page.png", "dirichlet.cir"} <= names(folder)


@pytest.mark.usefixtures("without_pictures")
def test_a_manipulated_summary_does_not_remove_files_outside_the_folder(call, lesson, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (tmp_path / "precious.txt").write_text("mine")
    (folder / "summary.json").write_text('{"files": ["../precious.txt", "..", "", 3]}')
    assert call("run", lesson, "--no-check", "-o", folder).exit_code == 0
    assert (tmp_path / "precious.txt").exists()


def test_a_start_without_a_path_exits_with_1_and_writes_the_folder(call, room, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = call("run", room)
    assert result.exit_code == 1
    assert "no_path" in result.stdout and (tmp_path / "out" / "room" / "page.png").exists()


def test_a_start_that_cannot_drive_writes_the_page_without_a_deck(call, room, tmp_path):
    words = ("--boundary", "neumann", "--drive", "start", "--start", "5.5,0.5", "-o", tmp_path / "out")
    assert call("run", room, *words).exit_code == 1
    assert names(tmp_path / "out") == {"page.png", "paths.csv", "paths.json", "summary.json"}


def test_a_scene_without_starts_exits_with_0(call, lesson, tmp_path):
    result = call("run", lesson, "--set", "starts=[]", "--no-check", "-o", tmp_path / "out")
    assert result.exit_code == 0 and "--start X,Y" in result.stdout
    assert "paths.csv" not in names(tmp_path / "out")


@pytest.mark.usefixtures("without_pictures")
def test_runs_on_ros_maps_write_ros_messages(answer, call, ros_map, tmp_path):
    folder = tmp_path / "out"
    words = ("run", ros_map, "--goal", "0.7,0.5", "--no-check", "-o", folder)
    data = answer(*words, "--start", "0.1,0.1", "--start", "0.45,0.1", code=1)
    assert "paths.yaml" in data["files"] and set(data["files"]) == names(folder)
    text = (folder / "paths.yaml").read_text()
    (message,) = yaml.safe_load_all(text)
    assert "# start (0.45, 0.1), k = 1: start_blocked" in text
    last = message["poses"][-1]["pose"]["position"]
    assert (last["x"], last["y"]) == pytest.approx((0.7, 0.5))
    call("path", ros_map, "--goal", "0.7,0.5", "--start", "0.1,0.1", "-o", tmp_path / "one.yaml")
    assert yaml.safe_load((tmp_path / "one.yaml").read_text()) == message
    assert call(*words, "--start", "0.45,0.1").exit_code == 1
    assert "paths.yaml" not in names(folder)


@pytest.fixture
def ros_map(tmp_path):
    """Write a map of 0.8 m x 0.6 m with a wall that has a gap at the top, and an unknown corner."""
    cell = np.full((6, 8), 254, np.uint8)
    cell[1:, 4], cell[0, 0] = 0, 205
    Image.fromarray(cell).save(tmp_path / "map.pgm")
    head = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n"
    (tmp_path / "map.yaml").write_text(head + "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n")
    return tmp_path / "map.yaml"


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["ring", "voxels"])
def test_periodic_and_voxel_scenes_run_and_agree_with_ngspice(call, scenes, tmp_path, scene):
    words = [f"--set=grid.axes.{axis}.cells=12" for axis in range(2 + (scene == "voxels"))]
    result = call("run", scenes / f"{scene}.toml", *words, "-o", tmp_path / "out")
    assert result.exit_code == 0, result.stdout + result.stderr
    assert "page.png" in names(tmp_path / "out") and "agrees" in result.stdout


@pytest.mark.slow
def test_maps_of_one_and_four_axes_run(call, tmp_path):
    for ndim in (1, 4):
        cell = np.zeros((4,) * ndim, dtype=np.uint8)
        np.save(tmp_path / "map.npy", cell)
        far, near = (",".join([value] * ndim) for value in ("3.5", "0.5"))
        folder = tmp_path / f"out_{ndim}"
        result = call("run", tmp_path / "map.npy", "--goal", near, "--start", far, "-o", folder)
        assert result.exit_code == 0, result.stdout + result.stderr
        assert "page.png" in names(folder)


@pytest.mark.usefixtures("without_pictures")
def test_slow_decks_are_simulated_only_with_the_check_option(call, lesson, tmp_path, monkeypatch):
    monkeypatch.setattr("resgrid.cli.check.MAX_AUTOMATIC_SECONDS", 1e-9)
    deck = tmp_path / "out" / "dirichlet.cir"
    result = call("run", lesson, "-o", tmp_path / "out")
    assert result.exit_code == 0 and "ngspice will take about" in result.stdout.replace("-klu", "")
    assert f"'resgrid check {deck}'" in result.stdout and deck.exists()
    result = call("run", lesson, "--check", "-o", tmp_path / "out")
    assert result.exit_code == 0 and "agrees" in result.stdout


@pytest.mark.usefixtures("without_pictures")
def test_decks_of_other_simulators_are_not_verified(answer, lesson, tmp_path):
    for words, code in (((), 0), (("--check",), 5)):
        data = answer("run", lesson, "--dialect", "xyce", *words, "-o", tmp_path / "out", code=code)
        check = data["chips"][0]["check"]
        assert (check["agrees"], check["verified"], check["as_read"]["agrees"]) == (None, False, True)


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_failure_leaves_no_incomplete_folder(tmp_path, error):
    def fill() -> None:
        with whole_folder(tmp_path / "a" / "b") as made:
            (made / "x").write_text("half")
            raise error

    with pytest.raises(error):
        fill()
    assert list(tmp_path.iterdir()) == []


def test_a_file_does_not_replace_a_folder_of_the_same_name(tmp_path):
    (tmp_path / "out" / "x").mkdir(parents=True)
    with pytest.raises(rg.InputError, match="out"), whole_folder(tmp_path / "out") as made:
        (made / "x").write_text("a file")
    assert (tmp_path / "out" / "x").is_dir() and names(tmp_path) == {"out"}


@pytest.mark.parametrize("kind", ["page", "space", "potential", "currents", "paths", "circuit"])
@pytest.mark.quick_cases(2)
def test_every_picture_is_drawn(call, lesson, tmp_path, kind):
    file = tmp_path / "picture.png"
    assert call("plot", lesson, "--what", kind, "-o", file).exit_code == 0
    assert file.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("kind", ["page", "space", "potential", "currents", "paths"])
def test_single_pictures_have_the_title_of_the_scene(call, lesson, tmp_path, kind):
    file = tmp_path / "picture.svg"
    assert call("plot", lesson, "--what", kind, "-o", file).exit_code == 0
    assert "<!-- Eight by eight -->" in file.read_text()


@pytest.mark.slow
def test_pictures_are_written_in_several_formats_and_invalid_ones_rejected(call, answer, lesson, scenes, tmp_path):
    assert call("plot", lesson, "--what", "space", "-o", "-").stdout_bytes.startswith(b"\x89PNG")
    assert answer("plot", lesson, "-o", tmp_path / "a.svg")["what"] == "page"
    assert "<svg" in (tmp_path / "a.svg").read_text()
    words = [f"--set=grid.axes.{axis}.cells=6" for axis in range(3)]
    for kind in ("slices", "space", "paths"):
        assert call("plot", scenes / "voxels.toml", *words, "--what", kind, "-o", tmp_path / "s.pdf").exit_code == 0
    assert "axes" in call("plot", lesson, "--what", "slices", "-o", tmp_path / "x.png").stderr
    assert (
        "'page' shows up to 4"
        in call("plot", scenes / "voxels.toml", "--what", "currents", "-o", tmp_path / "x.png").stderr
    )
    assert "'page', 'space'" in call("plot", lesson, "--what", "pag", "-o", tmp_path / "x.png").stderr
    assert ".svg" in call("plot", lesson, "-o", tmp_path / "x.bmp").stderr
    assert not (tmp_path / "x.png").exists()
