from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from resgrid.cli import main

Call = Callable[..., Result]


@pytest.fixture
def call() -> Call:
    """Run a command line in this process."""

    def run(*words: object, piped: str | bytes | None = None) -> Result:
        result = CliRunner().invoke(main, [str(word) for word in words], input=piped, prog_name="resgrid")
        assert isinstance(result.exception, SystemExit | None), result.exception
        return result

    return run


@pytest.fixture
def answer(call: Call) -> Callable[..., dict[str, Any]]:
    """Run a command line with ``--json`` and read its one object."""

    def run(*words: object, code: int = 0, piped: str | bytes | None = None) -> dict[str, Any]:
        result = call(*words, "--json", piped=piped)
        assert result.exit_code == code, result.stderr
        data: dict[str, Any] = json.loads(result.stdout, parse_constant=pytest.fail)
        assert data["schema"] == 1
        return data

    return run


@pytest.fixture
def lesson(scenes: Path) -> Path:
    return scenes / "lesson.toml"


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """A scene of 6 x 5 cells whose one wall leaves a pocket on the right."""
    file = tmp_path / "room.toml"
    file.write_text(ROOM)
    return file


ROOM = """schema = 1
title = "Room"
starts = [[0.5, 0.5], [5.5, 4.5]]
[grid]
axes = [
  { name = "x", lower = 0, upper = 6, cells = 6 },
  { name = "y", lower = 0, upper = 5, cells = 5 },
]
[[obstacle]]
shape = "rectangle"
lower = [4, 0]
upper = [5, 5]
[[goal]]
cell = [3, 3]
"""
