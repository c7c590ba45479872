"""The reference lists exactly what is public, and its sessions run as they are printed."""

from __future__ import annotations

import doctest
import re
import shutil
from pathlib import Path

import pytest

import resgrid as rg

PROJECT = Path(__file__).resolve().parents[1]
API = PROJECT / "docs" / "reference" / "api"
PAGES = sorted(page for page in API.glob("*.rst") if page.stem != "index")


def listed(page: Path) -> list[str]:
    """Names of the page's first table; the second holds what is never made by hand."""
    table = page.read_text().split("\nAt work\n")[0].split(".. autosummary::\n")[1]
    return re.findall(r"^(?:   ~|\.\. py:data:: )resgrid\.(\w+)$", table, re.MULTILINE)


def test_the_reference_lists_every_public_name_once_and_nothing_else() -> None:
    names = [name for page in PAGES for name in listed(page)]
    assert sorted(names) == sorted(rg.__all__)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_name_of_a_page_is_used_in_its_session(page: Path) -> None:
    session = " ".join(re.findall(r"^ +(?:>>>|\.\.\.) (.*)$", "\n".join(p.read_text() for p in PAGES), re.MULTILINE))
    assert set(listed(page)) <= set(re.findall(r"\brg\.(\w+)", session))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_session_of_a_page_runs_as_printed(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(PROJECT / "examples" / "scenes", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testfile(str(page), module_relative=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert tried > 0 and failed == 0


def test_every_public_name_has_an_example() -> None:
    parser = doctest.DocTestParser()
    bare = [name for name in rg.__all__ if not parser.get_examples(getattr(rg, name).__doc__ or "")]
    assert bare == ["__version__"]
