"""Shipped scenes: found by name from every folder; files of the same name have precedence.

Tests internals: `resgrid.scene.shipped`.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import answer, call

import resgrid as rg
from resgrid.scene.shipped import shipped_scene, shipped_scenes


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_every_scene_file_is_shipped(scenes: Path) -> None:
    assert sorted(shipped_scenes()) == sorted(file.stem for file in scenes.glob("*.toml"))


@pytest.mark.parametrize("name", ["rooms", "rooms.toml", Path("rooms")])
def test_a_shipped_scene_is_read_by_its_name(name: str | Path, scenes: Path) -> None:
    assert rg.read_scene(name).source == str(scenes / "rooms.toml")
    assert rg.read_scene(name, k=0.5).k == (0.5,)


def test_a_file_has_precedence_over_a_shipped_scene(tmp_path: Path, scenes: Path) -> None:
    (tmp_path / "rooms.toml").write_text((scenes / "lesson.toml").read_text())
    assert shipped_scene("rooms.toml") is None
    assert rg.read_scene("rooms.toml").title == "Eight by eight"
    assert rg.read_scene("rooms").title == "Rooms"
    (tmp_path / "lesson").mkdir()
    assert rg.read_scene("lesson").title == "Eight by eight"


@pytest.mark.parametrize("name", ["./rooms.toml", "scenes/rooms", "rooms.yaml", "", ".", "-", "Rooms.TOML"])
def test_other_names_are_file_names(name: str) -> None:
    assert shipped_scene(name) is None
    with pytest.raises(rg.InputError):
        rg.read_scene(name)


def test_the_command_line_reports_the_shipped_scene_it_reads(scenes: Path) -> None:
    result = call("info", "rooms")
    assert result.exit_code == 0 and f"reading the shipped scene {scenes / 'rooms.toml'}" in result.stderr
    assert "shipped" not in call("info", scenes / "rooms.toml").stderr
    assert "shipped" not in call("info", "rooms", "-q").stderr
    assert answer("info", "lesson.toml")["title"] == "Eight by eight"


def test_a_misspelt_name_gives_a_suggestion() -> None:
    result = call("info", "romms.toml")
    assert result.exit_code == 2 and "did you mean 'rooms'?" in result.stderr
    assert "check the name and the folder" in call("info", "nothing.toml").stderr


def test_info_examples_lists_shipped_scenes() -> None:
    listed = answer("info", "--examples")["examples"]
    assert [row["name"] for row in listed] == list(shipped_scenes())
    assert all(Path(row["file"]).is_file() and row["title"] for row in listed)
    assert "resgrid run" in call("info", "--examples").stdout
    assert call("info", "rooms", "--examples").exit_code == 2
