"""The documentation page on decks: its commands run, and their results agree in ngspice."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from support.simulators import verdict

PROJECT = Path(__file__).resolve().parents[2]
PAGE = (PROJECT / "docs" / "reference" / "decks.md").read_text()


def test_the_commands_of_the_page_write_a_deck_that_agrees_in_ngspice(call, tmp_path, monkeypatch):
    lines = re.findall(r"^(?:resgrid|ngspice) .*$", re.search(r"```\{code-cell\}.*?\n(.*?)```", PAGE, re.S)[1], re.M)
    commands = [shlex.split(re.split(r"\||2>&1", line)[0]) for line in lines]
    assert [words[0] for words in commands] == ["resgrid", "resgrid", "ngspice"]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(PROJECT / "examples")
    for words in commands[:2]:
        result = call(*words[1:])
        assert result.exit_code == 0, result.stderr
    assert verdict(tmp_path / commands[2][-1]) == (0, "PASS")
    for file in re.findall(r"^\| `(lesson\S*)`", PAGE, re.M):
        assert (tmp_path / file).is_file()


def test_compile_rejects_form_cells_on_standard_output(call):
    result = call("compile", PROJECT / "examples" / "scenes" / "lesson.toml", "--form", "cells")
    assert result.exit_code == 2
    assert "three files" in result.stderr


def test_verification_decks_of_the_golden_decks_pass_in_ngspice(tmp_path):
    for companion in sorted((PROJECT / "netlists").glob("*.verify")):
        stem = companion.name.removesuffix(".verify")
        for file in companion.parent.glob(f"{stem}*"):
            (tmp_path / file.name).write_bytes(file.read_bytes())
        assert verdict(tmp_path / companion.name) == (0, "PASS")
