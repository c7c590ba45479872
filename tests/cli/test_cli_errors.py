"""Invalid input: one message, the documented exit code, and no incomplete files."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

SUBCOMMANDS = {
    "run": ("-o", "out"),
    "compile": ("-o", "deck.cir"),
    "solve": ("-o", "field.npz"),
    "path": ("-o", "paths.csv"),
    "plot": ("-o", "picture.png"),
    "check": (),
    "convert": ("-o", "deck.cir"),
    "info": (),
}
AXIS = '{ name = "%s", lower = 0, upper = 4, cells = 4 }'
GRID = f"grid = {{ axes = [{AXIS % 'x'}, {AXIS % 'y'}] }}\n"
GOAL = "[[goal]]\ncell = [3, 3]\n"
START = "starts = [[0.5, 0.5]]\n"
HEAD = "schema = 1\n"

BAD_SCENES = {
    "typo": (HEAD + "boundery = 'dirichlet'\n" + START + GRID + GOAL, 2, ["line 2", "boundery", "did you mean"]),
    "no_toml": (HEAD + "title = \n", 2, ["not TOML", "line 2"]),
    "empty": ("", 2, ["schema"]),
    "nan": (HEAD + "starts = [[nan, 1]]\n" + GRID + GOAL, 2, ["starts", "finite"]),
    "start_outside": (HEAD + "starts = [[9, 9]]\n" + GRID + GOAL, 2, ["starts[0]", "outside the grid"]),
    "no_goal": (HEAD + START + GRID, 2, ["no goal", "[[goal]]"]),
    "goal_in_obstacle": (
        HEAD + START + GRID + "[[obstacle]]\nshape = 'rectangle'\nlower = [2, 2]\nupper = [4, 4]\n" + GOAL,
        2,
        ["goal[0]", "obstacle"],
    ),
    "goal_outside": (HEAD + START + GRID + "[[goal]]\ncell = [9, 9]\n", 2, ["goal[0]"]),
    "huge": (
        HEAD + START + GRID.replace("cells = 4", "cells = 1000000") + GOAL,
        4,
        ["1e+12 cells", "GiB"],
    ),
    "absent_map": (HEAD + START + "[[goal]]\ncell = [0, 0]\n[map]\nfile = 'nowhere.png'\n", 2, ["nowhere.png"]),
    "drive_on_rails": (HEAD + "drive = 'uniform'\n" + START + GRID + GOAL, 2, ["drive", "neumann"]),
    "wall_without_value": (HEAD + "boundary = 'wall'\n" + START + GRID + GOAL, 2, ["wall_resistance"]),
    "nothing_driven": (
        HEAD
        + "boundary = 'neumann'\n"
        + START
        + GRID
        + "[[obstacle]]\nshape = 'rectangle'\nlower = [0, 0]\nupper = [3, 4]\n[[obstacle]]\nshape = 'rectangle'\n"
        + "lower = [3, 0]\nupper = [4, 3]\n"
        + GOAL,
        2,
        ["nothing is driven"],
    ),
}


def assert_error(result, code, words):
    assert result.exit_code == code, (result.stdout, result.stderr)
    assert result.stdout == ""
    assert result.stderr.startswith("resgrid: error: ")
    assert "Traceback" not in result.stderr
    for word in words:
        assert word in result.stderr


INCOMPLETE = ("no_goal", "nothing_driven")
"""Scenes without a circuit, which `info` describes."""

PLANNING = ("run", "path", "plot")
"""Subcommands for which an undriven circuit is an outcome (tests/planning/test_degenerate.py)."""


@pytest.mark.parametrize(
    ("subcommand", "name"),
    [
        (subcommand, name)
        for subcommand in SUBCOMMANDS
        for name in BAD_SCENES
        if not ((subcommand == "info" and name in INCOMPLETE) or (subcommand in PLANNING and name == "nothing_driven"))
    ],
)
def test_invalid_scenes_are_rejected_by_every_subcommand(call, tmp_path, monkeypatch, subcommand, name):
    text, code, words = BAD_SCENES[name]
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(text)
    assert_error(call(subcommand, "scene.toml", *SUBCOMMANDS[subcommand]), code, words)
    assert [file.name for file in Path().iterdir()] == ["scene.toml"], "an incomplete file remains"


@pytest.mark.parametrize("name", INCOMPLETE)
def test_info_describes_scenes_without_a_circuit(answer, tmp_path, name):
    (tmp_path / "scene.toml").write_text(BAD_SCENES[name][0])
    data = answer("info", tmp_path / "scene.toml")
    assert data["cells"] == 16 and data["memory_bytes"] is None and data["no_circuit"]


def test_a_broken_scene_lists_all_its_errors(call, tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(HEAD + "k = 7\nboundery = 1\n" + GRID)
    message = call("path", file).stderr
    assert "k" in message and "boundery" in message and "line 2" in message and "line 3" in message


FILES = {
    "truncated.pgm": (b"P5\n100 100\n255\n" + bytes(50), ["truncated.pgm"]),
    "absurd.pgm": (b"P5\n1000000000 1000000000\n255\n", ["absurd.pgm"]),
    "garbage.png": (bytes(range(256)) * 9, ["garbage.png"]),
    "garbage.toml": (bytes(range(128, 256)) * 9, ["garbage.toml", "UTF-8"]),
    "garbage": (bytes(range(128, 256)), ["garbage"]),
    "empty.map": (b"", ["empty.map"]),
    "short.map": (b"type octile\nheight 3\nwidth 3\nmap\n...\n", ["short.map", "rows"]),
    "list.yaml": (b"- 1\n- 2\n", ["list.yaml"]),
    "lost.yaml": (
        b"image: lost.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n",
        ["lost.pgm"],
    ),
    "empty.npy": (b"", ["empty.npy"]),
    "pickle.npy": (b"\x93NUMPY\x01\x00v\x00{'descr': '|O'", ["pickle.npy"]),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("subcommand", ["run", "path"])
def test_damaged_maps_exit_with_2(call, tmp_path, monkeypatch, subcommand, name):
    monkeypatch.chdir(tmp_path)
    data, words = FILES[name]
    Path(name).write_bytes(data)
    result = call(subcommand, name, "--goal", "1,1", "--start", "2,2", *SUBCOMMANDS[subcommand])
    assert_error(result, 2, words)
    assert [file.name for file in Path().iterdir()] == [name]


def test_a_call_without_arguments_prints_the_help_and_exits_with_2(call):
    result = call()
    assert result.exit_code == 2 and result.stderr.startswith("Usage: resgrid") and result.stdout == ""


def test_directories_and_absent_files_exit_with_2(call, tmp_path):
    for subcommand in ("path", "info", "compile"):
        assert_error(call(subcommand, tmp_path), 2, [str(tmp_path)])
        assert_error(call(subcommand, tmp_path / "no.toml"), 2, ["no.toml", "no such file"])
    assert_error(call("check", tmp_path / "no.cir"), 2, ["no.cir"])


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no folder without write permission for all users")
@pytest.mark.parametrize(("subcommand", "target"), [("compile", "a.cir"), ("run", "out"), ("solve", "a.npz")])
def test_read_only_target_folders_exit_with_2(call, room, subcommand, target):
    assert_error(call(subcommand, room, "-o", f"/proc/{target}"), 2, ["cannot write", "/proc"])


def test_denied_permission_exits_with_2(call, room, monkeypatch):
    """The error is raised artificially, because permissions do not apply to root."""

    def deny(self: Path, *_: object, **__: object) -> bytes:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))

    monkeypatch.setattr(Path, "read_bytes", deny)
    monkeypatch.setattr(Path, "open", deny)
    assert_error(call("path", room), 2, ["permission denied"])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--start", "abc"], ["--start", "numbers"]),
        (["--start", "nan,1"], ["finite"]),
        (["--start", "1"], ["start[0]", "2 coordinates"]),
        (["--start", "1e400,1"], ["finite"]),
        (["--start", "0.5,0.5", "--cells"], ["whole numbers"]),
        (["--start", "99,0", "--cells"], ["[99, 0]"]),
        (["--goal", "4.5,2.5"], ["goal[0]", "obstacle"]),
        (["--goal", ""], ["--goal"]),
        (["--k", "2"], ["k[0]"]),
        (["--k", "x"], ["--k"]),
        (["--k", "nan"], ["--k"]),
        (["--boundary", "dirichle"], ["did you mean 'dirichlet'"]),
        (["--drive", "strat", "--boundary", "neumann"], ["did you mean 'start'"]),
        (["--edge", "shut"], ["edge"]),
        (["--edge", "open,open,open"], ["edge"]),
        (["--resistance", "0"], ["chip.resistance"]),
        (["--resistance", "10 kilo"], ["chip.resistance"]),
        (["--set", "garbage"], ["KEY=VALUE"]),
        (["--set", "=3"], ["KEY=VALUE"]),
        (["--set", "chip.resistence=3"], ["did you mean 'resistance'"]),
        (["--set", "path=3"], ["path"]),
        (["--set", "chip=3"], ["chip"]),
        (["--set", "obstacle.7.lower=[1, 2]"], ["obstacle"]),
        (["--set", "a.b.c=\x00"], ["a"]),
        (["--set", "title.x=1"], ["title"]),
        (["--set", "grid.axes=[]"], ["grid.axes"]),
        (["--format", "jpeg2000"], ["format"]),
        (["--threshold", "many"], ["--threshold"]),
        (["--nonsense"], ["--nonsense"]),
        (["extra"], ["extra"]),
        (["-o", "paths.xls"], [".csv"]),
        (["-o", ""], ["-o", "empty"]),
        (["--k", "0.5", "--drive", "start"], ["k = 0.5", "drive = 'uniform'"]),
        (["-o", "-", "--json"], ["--json"]),
    ],
)
def test_invalid_path_options_exit_with_2(call, room, words, expected):
    result = call("path", room, *words)
    assert result.exit_code == 2
    assert "Traceback" not in result.stderr and "internal error" not in result.stderr
    for word in expected:
        assert word in result.stderr


@pytest.mark.parametrize(
    "subcommand", [subcommand for subcommand in SUBCOMMANDS if subcommand not in ("check", "info")]
)
def test_targets_that_cannot_be_written_exit_with_2(call, room, tmp_path, subcommand):
    suffix = {"compile": ".cir", "convert": ".cir", "solve": ".npz", "path": ".csv", "plot": ".png", "run": ""}[
        subcommand
    ]
    folder = tmp_path / f"folder{suffix}"
    if subcommand == "run":
        folder.write_text("a file")
    else:
        folder.mkdir()
    before = sorted(tmp_path.rglob("*"))
    result = call(subcommand, room, "-o", folder)
    assert result.exit_code == 2
    assert folder.name in result.stderr
    assert sorted(tmp_path.rglob("*")) == before
    if subcommand != "run":
        result = call(subcommand, room, "-o", tmp_path / "absent" / f"x{suffix}")
        assert result.exit_code == 2 and "absent" in result.stderr


TARGETS = [(subcommand, *option) for subcommand, option in SUBCOMMANDS.items() if option and subcommand != "run"] + [
    ("layout", "-o", "chip.gds"),
    ("control", "-o", "log.csv"),
    ("control", "--picture", "run.png"),
    ("control", "--animate", "run.gif"),
    ("control", "--wavefront", "front.gif"),
]


@pytest.mark.parametrize(("subcommand", "option", "name"), TARGETS)
def test_invalid_targets_are_rejected_before_the_input_is_read(call, tmp_path, subcommand, option, name):
    assert_error(call(subcommand, "no.toml", option, tmp_path / "absent" / name), 2, ["no folder", "absent"])
    (tmp_path / name).mkdir()
    assert_error(call(subcommand, "no.toml", option, tmp_path / name), 2, ["directory"])
    assert_error(call(subcommand, "no.toml", option, " "), 2, [option, "empty"])


@pytest.mark.parametrize(("subcommand", "option", "name"), TARGETS)
def test_the_input_file_is_not_overwritten(call, tmp_path, subcommand, option, name):
    """The target is the input itself or a link to it."""
    (tmp_path / name).write_text("the only copy")
    (tmp_path / f"link{Path(name).suffix}").symlink_to(tmp_path / name)
    for target in tmp_path.iterdir():
        assert_error(call(subcommand, tmp_path / name, option, target), 2, [option, "the input"])
    assert (tmp_path / name).read_text() == "the only copy"


@pytest.mark.parametrize("options", [("--read-as", "xyce"), ("--root", ".")])
@pytest.mark.parametrize("subcommand", ["solve", "check", "info", "convert"])
def test_deck_options_are_rejected_for_scenes(call, room, tmp_path, subcommand, options):
    target = ("-o", tmp_path / SUBCOMMANDS[subcommand][1]) if SUBCOMMANDS[subcommand] else ()
    assert_error(call(subcommand, room, *options, *target), 2, ["not a deck", "--read-as"])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["path", "--limit", "3"], ["--limit", "--queries"]),
        (["solve", "--worst", "3"], ["--worst", "decks"]),
        (["solve", "--raw", "ascii"], ["--raw", "decks"]),
        (["chip", "--only", "power", "--at-least", "0.9"], ["--at-least", "yield"]),
        (["chip", "--only", "power", "--sweep", "mismatch=0,1", "--sweep", "readout.bits=4,8"], ["sweep"]),
    ],
)
def test_options_without_effect_are_rejected(call, room, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    assert_error(call(words[0], room, *words[1:]), 2, expected)
    assert [file.name for file in tmp_path.iterdir()] == ["room.toml"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["info", "--schema", "--set", "k=0.5", "--map-dialect", "nav2"], ["no input", "--set, --map-dialect"]),
        (["info", "--versions", "--read-as", "xyce"], ["no input", "--read-as"]),
        (["live", "--goal", "1,1", "--no-browser"], ["no input", "--goal"]),
        (["path", "ROOM", "--via", "1,1", "--ranks", "3"], ["several legs", "--ranks"]),
        (["solve", "DECK", "--raw", "ascii"], ["--raw ascii", "add -o FILE.raw"]),
        (["solve", "DECK", "--raw", "ascii", "-o", "x.csv"], ["--raw ascii", ".raw"]),
        (["check", "DECK", "--read-as", "xyce"], ["sidecar", "leave out --read-as"]),
        (["check", "x.gds", "--read-as", "xyce"], ["a board or layout, not a deck", "--read-as"]),
        (["check", "x.kicad_pcb", "--root", "."], ["a board or layout, not a deck", "--root"]),
    ],
)
def test_options_of_other_inputs_are_rejected(call, room, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    assert call("compile", room, "-o", "deck.cir").exit_code == 0
    names = {"ROOM": room, "DECK": "deck.cir"}
    assert_error(call(*(names.get(word, word) for word in words)), 2, expected)


def test_map_options_are_rejected_for_scenes_without_a_map(call, room):
    assert_error(call("path", room, "--threshold", "4"), 2, ["no map", "threshold"])
    result = call("path", "-", "--threshold", "4", piped=room.read_text())
    assert_error(result, 2, ["no map", "threshold"])


def test_an_error_with_the_json_option_is_a_json_object(call, tmp_path):
    result = call("path", tmp_path / "no.toml", "--json")
    data = json.loads(result.stdout)
    assert result.exit_code == 2 == data["exit_code"]
    assert data["schema"] == 1 and "no.toml" in data["error"] and data["kind"] == "InputError"


def test_an_internal_error_exits_with_70_and_debug_prints_the_traceback(call, room, monkeypatch):
    def broken(*_args, **_more):
        raise ZeroDivisionError("oops")

    monkeypatch.setattr("resgrid.build_space", broken)
    plain, debug = call("path", room), call("path", room, "--debug")
    assert plain.exit_code == debug.exit_code == 70
    assert "Traceback" not in plain.stderr and "ZeroDivisionError: oops" in plain.stderr and "--debug" in plain.stderr
    assert "Traceback" in debug.stderr


def test_a_map_array_of_nan_exits_with_2(call, tmp_path):
    np.save(tmp_path / "map.npy", np.full((3, 3), np.nan))
    assert_error(call("path", tmp_path / "map.npy", "--goal", "1,1", "--start", "2,2"), 2, ["map.npy"])


@pytest.mark.parametrize("subcommand", [subcommand for subcommand in SUBCOMMANDS if subcommand != "run"])
@pytest.mark.parametrize("source", [".", "/"])
def test_the_folders_dot_and_slash_are_rejected_as_input(call, subcommand, source, tmp_path):
    options = (SUBCOMMANDS[subcommand][0], tmp_path / SUBCOMMANDS[subcommand][1]) if SUBCOMMANDS[subcommand] else ()
    assert_error(call(subcommand, source, *options), 2, ["directory"])
    assert not list(tmp_path.iterdir())


def test_a_device_file_is_rejected_as_a_deck(call, room):
    assert_error(call("check", room, "--deck", os.devnull), 2, ["device", "give a file"])


@pytest.mark.parametrize("form", ["flat", "cells"])
def test_deck_names_may_contain_unicode_letters(call, room, tmp_path, form):
    deck = tmp_path / "grün ☃.cir"
    result = call("compile", room, "--form", form, "-o", deck)
    assert result.exit_code == 0, result.stderr
    result = call("solve", deck)
    assert result.exit_code == 0, result.stderr
