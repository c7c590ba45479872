"""The example scripts: each runs without warnings and writes a picture; the lesson compared with known values."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

import resgrid as rg

PROJECT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((PROJECT / "examples").glob("*/*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: f"{script.parent.name}/{script.stem}")
def test_every_example_runs_alone_and_writes_a_picture(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    pictures = [file for file in (tmp_path / "out").iterdir() if file.suffix in {".png", ".gif"}]
    assert pictures and all(file.stat().st_size > 5000 for file in pictures)
    assert "assert " in script.read_text()


def test_examples_cover_the_19_figures_of_1992() -> None:
    names = " ".join(file.read_text() for file in EXAMPLES if file.parent.name == "figures_1992")
    titles = [line for line in names.splitlines() if line.startswith("Figure")]
    numbers: set[int] = set()
    for title in titles:
        first, _, last = (
            title.split(":")[0].removeprefix("Figures ").removeprefix("Figure ").replace("and", "to").partition(" to ")
        )
        numbers |= set(range(int(first), int(last or first) + 1))
    assert numbers == set(range(1, 20))


@pytest.mark.slow
def test_the_lesson_prints_the_expected_counts_and_potential(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    known = runpy.run_path(str(PROJECT / "examples" / "first" / "lesson.py"))
    # 56 free cells: 64 less 7 obstacle cells and a goal.
    assert "56 free cells, 140 resistors" in capsys.readouterr().out
    assert known["above_goal"] == pytest.approx(0.573718, abs=1e-6)


def test_the_lessons_random_walk_has_the_stated_probability() -> None:
    """The grid of Tarassenko & Blake as a random walk, solved by iteration without a circuit."""
    import numpy as np

    space = rg.build_space(rg.read_scene(PROJECT / "examples" / "scenes" / "lesson.toml"))
    walls = np.pad(space.cell, 1, constant_values=rg.Cell.OBSTACLE)
    chance = (walls == rg.Cell.GOAL).astype(float)
    free = walls == rg.Cell.FREE
    for _ in range(2000):
        mean = sum(np.roll(chance, shift, axis) for axis in (0, 1) for shift in (1, -1)) / 4
        chance[free] = mean[free]
    assert chance[7, 3] == pytest.approx(1 - 0.573718, abs=1e-6)
