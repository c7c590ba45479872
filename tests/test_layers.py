"""Layers of the package: import directions, and declared imports of internals in tests."""

from __future__ import annotations

import ast
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
    contract = next(c for c in settings["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    listed = {name.strip(" ()") for layer in contract["layers"] for name in layer.split("|")}
    modules = {
        f"resgrid.{path.stem}"
        for path in (PROJECT / "resgrid").iterdir()
        if (path.suffix == ".py" and path.stem != "__init__") or (path / "__init__.py").exists()
    }
    assert modules <= listed


def test_tests_that_import_internals_declare_them() -> None:
    for file in sorted((PROJECT / "tests").rglob("test_*.py")):
        tree = ast.parse(file.read_text())
        imports = [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.module]
        modules = {node.module for node in imports if node.module and node.module.startswith("resgrid.")}
        said = ast.get_docstring(tree) or ""
        assert not modules or "Tests internals: " in said, f"{file.name}: list {', '.join(sorted(modules))}"
