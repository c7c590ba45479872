"""The designer's page keeps its word: its three commands agree, its Python runs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
from support.simulators import verdict
from support.spaces import space_of

PROJECT = Path(__file__).resolve().parents[2]
PAGE = (PROJECT / "docs" / "reference" / "decks.md").read_text()


def test_three_commands_from_a_scene_to_a_checked_deck(call, tmp_path, monkeypatch):
    commands = [shlex.split(line[2:]) for line in re.search(r"```console\n(.*?)```", PAGE, re.S)[1].splitlines()]
    assert [words[0] for words in commands] == ["resgrid", "resgrid", "ngspice"]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(PROJECT / "examples")
    for words in commands[:2]:
        result = call(*words[1:])
        assert result.exit_code == 0, result.stderr
    assert verdict(tmp_path / commands[2][-1]) == (0, "PASS")
    for file in re.findall(r"^\| `(lesson\S*)`", PAGE, re.M):
        assert (tmp_path / file).is_file()


def test_its_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cell = np.zeros((5, 9), dtype=np.uint8)
    cell[0, 0] = 2
    moved = cell.copy()
    moved[2, 2:5] = 1
    example = re.search(r"```python\n(.*?)```", PAGE, re.S)[1]
    exec(example, {"spaces": [space_of(cell), space_of(moved)]})
    assert ".tran 1e-09 1e-06" in (tmp_path / "move.cir.hspice").read_text()
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".chip", ".cir", ".hspice", ".json", ".pattern"]


def test_tiles_are_not_printed(call):
    result = call("compile", PROJECT / "examples" / "scenes" / "lesson.toml", "--form", "cells")
    assert result.exit_code == 2
    assert "three files" in result.stderr


def test_golden_companions_pass(tmp_path):
    for companion in sorted((PROJECT / "netlists").glob("*.verify")):
        stem = companion.name.removesuffix(".verify")
        for file in companion.parent.glob(f"{stem}*"):
            (tmp_path / file.name).write_bytes(file.read_bytes())
        assert verdict(tmp_path / companion.name) == (0, "PASS")
