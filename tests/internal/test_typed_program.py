"""Types of the package as another program sees them (``py.typed`` and ``__init__.pyi``), checked by mypy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import resgrid

RIGHT = '''
"""A program with complete type annotations."""

import numpy as np
from numpy.typing import NDArray

import resgrid as rg


def shortest(path: str, start: tuple[float, float]) -> float:
    planner = rg.plan(rg.read_scene(path))
    streamline: rg.Streamline = planner.path(start)
    return streamline.length


def voltages(space: rg.ConfigurationSpace) -> NDArray[np.float64]:
    netlist: rg.Netlist = rg.compile_space(space, boundary="neumann", resistance=1e4)
    point: rg.OperatingPoint = rg.solve(netlist)
    return point.voltage


def message(error: rg.InputError) -> ValueError:
    return error


version: str = rg.__version__
'''

WRONG = """
import resgrid as rg

rg.solve(5)
rg.plan(rg.read_scene("a.toml"), colour="red")
length: str = rg.Axis("x", 0.0, 1.0, 4).lower
rg.streamlin
"""


def run_mypy(folder: Path, program: str) -> subprocess.CompletedProcess[str]:
    (folder / "program.py").write_text(program)
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", "", "--cache-dir", "../mypy", "program.py"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=500, check=False)


def test_a_program_with_annotations_passes_mypy_in_strict_mode(tmp_path: Path) -> None:
    done = run_mypy(tmp_path, RIGHT)
    assert done.returncode == 0, done.stdout + done.stderr


def test_mypy_reports_wrong_calls_of_a_program(tmp_path: Path) -> None:
    done = run_mypy(tmp_path, WRONG)
    found = [line for line in done.stdout.splitlines() if line.startswith("program.py:")]
    assert {int(line.split(":")[1]) for line in found if "error:" in line} == {4, 5, 6, 7}, done.stdout + done.stderr


def test_the_package_is_marked_as_typed() -> None:
    folder = Path(resgrid.__file__).parent
    assert (folder / "py.typed").is_file()
    assert (folder / "__init__.pyi").is_file()
