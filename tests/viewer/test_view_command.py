"""The subcommands ``resgrid live`` and ``resgrid plot`` with an arm from a URDF file."""

from __future__ import annotations

import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.cli import COMMAND, call
from support.pages import PATIENCE

FEW = ("--set", "grid.cells=[16, 16]")


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.quick_cases(1)
def test_live_shows_an_arm_in_the_3d_view_and_exits_with_0_at_a_signal(end, scenes: Path) -> None:
    import_module("viser")
    options = ["live", str(scenes / "scara.toml"), *FEW, "--no-browser", "--port", "0"]
    with subprocess.Popen([*COMMAND, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("the page is at http://127.0.0.1:")
        process.send_signal(end)
        output, complaints = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "Traceback" not in complaints and "viser" not in output


@pytest.mark.parametrize(
    ("option", "message"), [(("--host", "0.0.0.0"), "serves this computer only"), (("--read-only",), "no such mode")]
)
def test_options_of_the_live_page_are_refused_for_arms(option, message: str, scenes: Path) -> None:
    result = call("live", scenes / "scara.toml", *FEW, "--no-browser", *option)
    assert result.exit_code == 2 and message in result.stderr


def test_without_viser_live_names_the_command_that_installs_it(monkeypatch, scenes: Path) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    result = call("live", scenes / "scara.toml", *FEW, "--no-browser")
    assert result.exit_code == 3 and "pip install" in result.stderr and "viser" in result.stderr


@pytest.mark.parametrize("what", ["page", "space", "paths", pytest.param("robot", marks=pytest.mark.slow)])
def test_plot_draws_arms_and_their_spaces(what: str, scenes: Path, tmp_path: Path) -> None:
    result = call("plot", scenes / "scara.toml", *FEW, "--what", what, "-o", tmp_path / "arm.png")
    assert result.exit_code == 0, result.stderr
    with Image.open(tmp_path / "arm.png") as image:
        assert np.ptp(np.asarray(image.convert("L")).astype(int)) > 200


@pytest.mark.slow
def test_run_draws_the_arm_its_path_and_its_cells(scenes: Path, tmp_path: Path) -> None:
    result = call("run", scenes / "scara.toml", *FEW, "--no-check", "-o", tmp_path / "out")
    assert result.exit_code in (0, 1), result.stderr
    assert {"page.png", "robot.png", "cells.png"} <= {file.name for file in (tmp_path / "out").iterdir()}
