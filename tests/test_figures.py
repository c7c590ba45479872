"""The figures of Connolly & Grupen (1992): the numbers behind the pictures, and that all are there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from test_examples import load


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, float]]:
    folder = tmp_path_factory.mktemp("figures")
    return folder, load("figures").main(folder)


def test_there_are_thirteen_figures_and_a_curve(made) -> None:
    names = {path.name for path in made[0].iterdir()}
    assert names == {f"figure_{number:02}.png" for number in range(1, 14)} | {"clearance_against_k.png"}


def test_the_numbers_tell_the_papers_story(made) -> None:
    numbers = made[1]
    json.dumps(numbers)
    assert numbers["goals"] == 2  # one in each band
    assert numbers["streamlines"] > 100
    assert numbers["clearance_0.99"] > numbers["clearance_0.5"] > numbers["clearance_0.01"] > 0
    assert numbers["largest_fall"] < 0.5  # cells: the mean clearance does not fall as k grows
    assert (numbers["upper"], numbers["lower"]) == (1, 2)
    assert numbers["cut_off"] == pytest.approx(1 / 6, abs=0.02)
    assert numbers["paths"] == 1
