"""Imports only point downwards."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]


def test_imports_only_point_downwards(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("lint-imports")
    run = subprocess.run(
        [program, "--cache-dir", tmp_path], cwd=PROJECT, capture_output=True, text=True, timeout=300, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert " kept, 0 broken" in run.stdout


def test_every_module_has_its_layer() -> None:
    settings = tomllib.loads((PROJECT / "pyproject.toml").read_text())
    house = next(c for c in settings["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    listed = {name.strip(" ()") for layer in house["layers"] for name in layer.split("|")}
    modules = {
        f"resgrid.{path.stem}"
        for path in (PROJECT / "resgrid").iterdir()
        if (path.suffix == ".py" and path.stem != "__init__") or (path / "__init__.py").exists()
    }
    assert modules <= listed
