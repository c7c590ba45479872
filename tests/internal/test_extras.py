"""A missing extra is named with the command that installs its packages.

Tests internals: `resgrid._internal.extras`.
"""

from __future__ import annotations

import shlex
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from resgrid._internal.extras import install_command

PROJECT = Path(__file__).resolve().parents[2]
EXTRAS = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


@pytest.mark.parametrize("extra", ["dask", "live", "mpi", "notebook", "parsl"])
def test_the_command_names_the_packages_for_this_python(extra: str) -> None:
    words = shlex.split(install_command(extra))
    assert words[:4] == [sys.executable, "-m", "pip", "install"]
    assert sorted(words[4:]) == sorted(EXTRAS[extra])


def test_a_checkout_that_is_not_installed_names_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> list[str]:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr("resgrid._internal.extras.metadata.requires", absent)
    assert install_command("live").endswith(shlex.quote(f"{PROJECT}[live]"))
