"""The API reference: completeness compared with ``__all__``, and its sessions as doctests."""

from __future__ import annotations

import doctest
import inspect
import operator
import re
import shutil
from pathlib import Path

import pytest

import resgrid as rg

PROJECT = Path(__file__).resolve().parents[1]
API = PROJECT / "docs" / "reference" / "api"
PAGES = sorted(page for page in API.glob("*.rst") if page.stem != "index")


SLOW = {"chips", "control", "decks", "fields", "hardware", "live", "pictures"}
"""Pages whose sessions take more than one second."""

NAMESPACES = [name for name in rg.__all__ if inspect.ismodule(getattr(rg, name))]


def public_names() -> set[str]:
    """Dotted public names of ``rg`` and of its packages."""
    own = set(rg.__all__) - set(NAMESPACES)
    return own | {f"{package}.{name}" for package in NAMESPACES for name in getattr(rg, package).__all__}


def listed_names(page: Path) -> list[str]:
    """Dotted names in the tables of a page."""
    tables = page.read_text().split("\nExamples\n")[0]
    return re.findall(r"^(?:   ~|\.\. py:data:: )resgrid\.([\w.]+)$", tables, re.MULTILINE)


def test_the_reference_lists_every_public_name_once() -> None:
    names = [name for page in PAGES for name in listed_names(page)]
    assert len(names) == len(set(names))
    assert public_names() - set(names) == set()
    for name in names:
        operator.attrgetter(name)(rg)


def test_every_function_of_a_page_is_used_in_its_session() -> None:
    session = " ".join(re.findall(r"^ +(?:>>>|\.\.\.) (.*)$", "\n".join(p.read_text() for p in PAGES), re.MULTILINE))
    used = set(re.findall(r"\brg\.([\w.]+)", session))
    functions = {name for name in public_names() if name.split(".")[-1].islower() and name != "__version__"}
    assert {name for name in functions if not any(f"{one}.".startswith(f"{name}.") for one in used)} == set()


@pytest.mark.parametrize(
    "page", [pytest.param(page, id=page.stem, marks=[pytest.mark.slow] * (page.stem in SLOW)) for page in PAGES]
)
def test_sessions_of_a_page_have_the_printed_output(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(PROJECT / "examples", tmp_path, dirs_exist_ok=True)
    shutil.copytree(PROJECT / "examples" / "robots", tmp_path / "scenes" / "robots")
    monkeypatch.chdir(tmp_path / "scenes")
    failed, tried = doctest.testfile(str(page), module_relative=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert tried > 0 and failed == 0


def test_every_public_name_has_an_example() -> None:
    parser = doctest.DocTestParser()
    values = {name: operator.attrgetter(name)(rg) for name in public_names() | set(NAMESPACES)}
    bare = {name for name, value in values.items() if not parser.get_examples(value.__doc__ or "")}
    assert bare == {"__version__"}
