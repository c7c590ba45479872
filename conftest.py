"""What the examples in docstrings take for granted: `np`, `rg`, and the project's folder."""

import gc
import os
import sys
from collections.abc import Generator
from pathlib import Path

# Workers of pytest-xdist fill all cores: threads of OpenBLAS would wait for each other.  Set before numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Each of the many processes that tests start would compile all modules again, a quarter of its time.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import numpy as np
import pytest

import resgrid as rg

sys.dont_write_bytecode = False  # keep the rewritten assertions for later runs


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Search for garbage after collection only, and not in the half a million objects that stay until the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep each docstring's examples where its function is defined, not once more where a package exports it."""
    items[:] = [item for item in items if "/__init__.py::resgrid" not in item.nodeid or _is_module(item.nodeid)]


def _is_module(nodeid: str) -> bool:
    """Return whether the examples are those of the package itself: ``resgrid/chip/__init__.py::resgrid.chip``."""
    file, name = nodeid.split("::")
    return file == f"{name.replace('.', '/')}/__init__.py"


@pytest.fixture(autouse=True)
def _reader(request: pytest.FixtureRequest, doctest_namespace: dict[str, object]) -> None:
    """Examples run as a reader types them; what they write goes elsewhere."""
    if isinstance(request.node, pytest.DoctestItem):
        folder = request.getfixturevalue("tmp_path")
        (folder / "examples").symlink_to(Path(__file__).parent / "examples")
        request.getfixturevalue("monkeypatch").chdir(folder)
        doctest_namespace.update(np=np, rg=rg)
