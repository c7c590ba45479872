"""The golden decks: the command line writes identical bytes, and ngspice agrees with their sidecars."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
GOLDEN = PROJECT / "netlists"
DECKS = sorted(GOLDEN.glob("*.cir"))


@pytest.fixture(scope="session")
def recipes() -> list[list[str]]:
    """Return the command lines of ``make golden``."""
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    lines = subprocess.run(
        ["make", "--dry-run", "golden", "GOLDEN=."], cwd=PROJECT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    return [shlex.split(line)[1:] for line in lines if "resgrid compile " in line]


def test_every_golden_deck_has_a_command_in_the_makefile(recipes):
    assert {Path(words[-1]).name for words in recipes} == {deck.name for deck in DECKS}
    assert len(DECKS) >= 5


@pytest.mark.parametrize("deck", DECKS, ids=lambda deck: deck.stem)
def test_the_command_line_writes_the_golden_deck_unchanged(call, recipes, tmp_path, deck):
    recipe = next(words for words in recipes if Path(words[-1]).name == deck.name)
    made = tmp_path / deck.name
    scene = PROJECT / recipe[1]
    result = call(recipe[0], scene, *recipe[2:-1], made)
    assert result.exit_code == 0, result.stderr
    for suffix in ("", ".ngspice", *((".chip", ".pattern") if "--form" in recipe else ())):
        assert Path(f"{made}{suffix}").read_bytes() == Path(f"{deck}{suffix}").read_bytes()
    new, old = (json.loads(Path(f"{file}.json").read_text()) for file in (made, deck))
    assert new["nodes"].keys() == old["nodes"].keys()
    for name, node in old["nodes"].items():
        assert new["nodes"][name]["cell"] == node["cell"]
        assert new["nodes"][name]["voltage"] == pytest.approx(node["voltage"], rel=0, abs=1e-12)
    for key in ("sha256", "dialect", "title", "left_out", "blocks"):
        assert new[key] == old[key]


@pytest.mark.parametrize("deck", DECKS, ids=lambda deck: deck.stem)
def test_ngspice_agrees_with_the_sidecar(answer, deck):
    if shutil.which("ngspice") is None:
        pytest.fail("ngspice is not installed: run scripts/install_ngspice.sh")
    data = answer("check", deck)
    assert data["agrees"] is True
    assert data["reference"] == "sidecar"
    assert data["max_relative_error"] <= 1e-12
    assert data["nodes"] == len(json.loads(Path(f"{deck}.json").read_text())["nodes"])
