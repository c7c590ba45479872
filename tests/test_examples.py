"""The examples run, write what they say, and print the numbers that can be checked by hand."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def load(name: str) -> ModuleType:
    specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_the_lesson_teaches_what_is_true(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = load("lesson").main(tmp_path / "lesson")
    assert {"lesson.png", "lesson.cir"} <= {path.name for path in (tmp_path / "lesson").iterdir()}
    # 56 free cells: 64 less 7 obstacle cells and a goal.
    assert "56 free cells, 140 resistors" in capsys.readouterr().out
    assert numbers["above_goal"] == pytest.approx(0.573718, abs=1e-6)


def test_the_lessons_drunkard_reaches_the_goal_as_often_as_promised() -> None:
    """Tarassenko & Blake's grid read as a random walk: solved here by brute force, without a circuit."""
    import numpy as np

    import resgrid as rg

    space = rg.sample(rg.read_scene(EXAMPLES / "scenes" / "lesson.toml"))
    walls = np.pad(space.cell, 1, constant_values=rg.Cell.OBSTACLE)
    chance = (walls == rg.Cell.GOAL).astype(float)
    free = walls == rg.Cell.FREE
    for _ in range(2000):
        mean = sum(np.roll(chance, shift, axis) for axis in (0, 1) for shift in (1, -1)) / 4
        chance[free] = mean[free]
    assert chance[7, 3] == pytest.approx(1 - 0.573718, abs=1e-6)


def test_the_careful_blend_keeps_farther_away(tmp_path: Path) -> None:
    results = load("blend").main(tmp_path)
    clearance = [results[k][1] for k in (0.0, 0.5, 1.0)]
    assert clearance == sorted(clearance)
    assert (tmp_path / "blend.png").is_file()


def test_a_pushed_robot_with_a_loop_of_its_own_arrives(tmp_path: Path) -> None:
    numbers = load("control").main(tmp_path)
    assert (tmp_path / "control.png").is_file()
    assert numbers["off"] > 0.3  # metres
    assert numbers["time"] < 25
