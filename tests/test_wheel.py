"""The wheel in an empty environment: declared requirements, files, and runs of shipped scenes."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tomllib
import venv
import zipfile
from email.parser import Parser
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

PROJECT = Path(__file__).resolve().parents[1]
DECLARED = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
SCENES = sorted(file.stem for file in (PROJECT / "examples" / "scenes").glob("*.toml"))
FOREIGN = {"petsc4py": "comes with the system", "IPython": "is there in a notebook"}
"""Packages without a requirement, with the reason."""

COMPILED = """
import sys
import numba.core.event as event

with event.install_recorder("numba:compile") as recorder:
    from resgrid.cli import main
    try:
        main(sys.argv[1:])
    except SystemExit as end:
        assert not end.code
print(len(recorder.buffer))
"""


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel built from this checkout."""
    pytest.importorskip("hatchling", reason="hatchling builds the wheel; it is in the extra 'dev'")
    folder = tmp_path_factory.mktemp("wheel")
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder]
    subprocess.run(words, cwd=PROJECT, check=True, capture_output=True)
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="session")
def program(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment with the wheel; its dependencies come from the current environment."""
    folder = tmp_path_factory.mktemp("empty") / "env"
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    words = [sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", "--no-compile"]
    subprocess.run([*words, "-q", "--disable-pip-version-check", wheel], check=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    needed = {str(metadata.distribution(Requirement(each).name).locate_file("")) for each in DECLARED["dependencies"]}
    (packages / "borrowed.pth").write_text("\n".join(sorted(needed)))
    return python


def run(program: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the environment's Python in an empty folder, isolated from the checkout."""
    environment = {
        "PATH": str(program.parent),
        "HOME": str(program.parents[1]),
        "PYTHONNOUSERSITE": "1",
        "NO_COLOR": "1",
    }
    return subprocess.run(
        [program, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=600
    )


def test_the_wheel_declares_the_projects_requirements(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        head = Parser().parsestr(archive.read(name).decode())
    required = [Requirement(text) for text in head.get_all("Requires-Dist", [])]
    plain = {str(each) for each in required if each.marker is None}
    assert plain == {str(Requirement(text)) for text in DECLARED["dependencies"]}
    assert set(head.get_all("Provides-Extra", [])) == set(DECLARED["optional-dependencies"])
    for each in required:
        if each.marker is None:
            assert each.specifier.contains(metadata.version(each.name), prereleases=True), each


@pytest.mark.slow
def test_requirements_cover_all_imports() -> None:
    extras = ("bags", "dask", "geotiff", "layout", "live", "mpi", "notebook", "parsl", "robots", "viewer")
    texts = [*DECLARED["dependencies"], *(text for name in extras for text in DECLARED["optional-dependencies"][name])]
    direct = {Requirement(text).name for text in texts}
    needed = {_plain(Requirement(text).name) for name in direct for text in metadata.requires(name) or ()}
    needed |= set(map(_plain, direct))
    homes = metadata.packages_distributions()
    for file in (PROJECT / "resgrid").rglob("*.py"):
        for package in _imported(file) - {"resgrid", *FOREIGN, *sys.stdlib_module_names}:
            assert needed & set(map(_plain, homes.get(package, [package]))), f"{file.name} imports {package}"


def _plain(name: str) -> str:
    """Return the normalized name of a distribution."""
    return name.lower().replace("-", "_").replace(".", "_")


def _imported(file: Path) -> set[str]:
    """Return the packages that a file imports, at its top or in functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module)
    return {name.partition(".")[0] for name in names}


def test_the_wheel_contains_every_file_of_the_package(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    package = [file for file in (PROJECT / "resgrid").rglob("*.*") if "__pycache__" not in file.parts]
    assert {str(file.relative_to(PROJECT)) for file in package} <= held
    assert {f"resgrid/scene/examples/{name}.toml" for name in SCENES} <= held


@pytest.mark.slow
def test_the_wheel_runs_a_shipped_scene_in_an_empty_folder(program: Path, tmp_path: Path) -> None:
    words = ("run", "lesson", "--no-check")
    done = run(program, tmp_path, str(program.with_name("resgrid")), *words, "--json")
    assert done.returncode == 0, done.stderr
    data: dict[str, Any] = json.loads(done.stdout)
    assert {path["outcome"] for path in data["paths"]} == {"reached"}
    assert "site-packages" in done.stderr and str(PROJECT) not in done.stderr
    assert (tmp_path / "out" / "lesson" / "paths.csv").is_file()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    again = run(program, tmp_path, "-c", COMPILED, *words)  # uses the kernels compiled by the first run
    assert (again.returncode, again.stdout.splitlines()[-1]) == (0, "0"), again.stderr


@pytest.mark.slow
def test_python_m_resgrid_runs_the_command_line(program: Path, tmp_path: Path) -> None:
    done = run(program, tmp_path, "-m", "resgrid", "--version")
    assert (done.returncode, done.stdout.split()[-1]) == (0, DECLARED["version"])
    listed = run(program, tmp_path, "-m", "resgrid", "info", "--examples", "--json")
    files = [Path(row["file"]) for row in json.loads(listed.stdout)["examples"]]
    assert [file.stem for file in files] == SCENES
    assert all(file.is_relative_to(program.parents[1]) for file in files)
    wrong = run(program, tmp_path, "-m", "resgrid", "rooms")
    assert wrong.returncode == 2 and "run rooms" in wrong.stderr


def test_a_missing_extra_is_named_with_the_command_for_its_environment(program: Path, tmp_path: Path) -> None:
    code = "import sys; sys.modules['uvicorn'] = None; from resgrid.cli import main; main(['live', '--no-browser'])"
    done = run(program, tmp_path, "-c", code)
    assert done.returncode == 3
    assert f"{program} -m pip install" in done.stderr and "starlette" in done.stderr
