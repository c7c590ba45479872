"""The command that installs the packages of an extra, against pyproject.toml.

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
def test_the_install_command_lists_the_packages_of_the_extra(extra: str) -> None:
    words = shlex.split(install_command(extra))
    assert words[:4] == [sys.executable, "-m", "pip", "install"]
    assert sorted(words[4:]) == sorted(EXTRAS[extra])


def test_the_install_command_of_an_uninstalled_checkout_contains_its_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> list[str]:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr("resgrid._internal.extras.metadata.requires", absent)
    assert install_command("live").endswith(shlex.quote(f"{PROJECT}[live]"))
