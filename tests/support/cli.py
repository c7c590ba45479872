"""Run the command line in this process or in a separate one."""

from __future__ import annotations

import json
import sys
from typing import Any

import pytest
from click.testing import CliRunner, Result

from resgrid.cli import main

COMMAND = [sys.executable, "-c", "from resgrid.cli import main; main(prog_name='resgrid')"]

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
"""A scene of 6 x 5 cells with one wall that encloses a region on the right."""


def call(*words: object, piped: str | bytes | None = None) -> Result:
    """Run a command line in this process."""
    result = CliRunner().invoke(main, [str(word) for word in words], input=piped, prog_name="resgrid")
    assert isinstance(result.exception, SystemExit | None), result.exception
    return result


def answer(*words: object, code: int = 0, piped: str | bytes | None = None) -> dict[str, Any]:
    """Run a command line with ``--json`` and read its one object."""
    result = call(*words, "--json", piped=piped)
    assert result.exit_code == code, result.stdout[-2000:] + result.stderr
    data: dict[str, Any] = json.loads(result.stdout, parse_constant=pytest.fail)
    assert data["schema"] == 1
    return data
