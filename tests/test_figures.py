"""The figures of Connolly & Grupen (1992): the numbers behind the pictures, and that all are there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.hidden import hidden_room
from test_examples import load

import resgrid as rg


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, float]]:
    folder = tmp_path_factory.mktemp("figures")
    return folder, load("figures").main(folder)


def test_there_are_nineteen_figures_and_what_goes_with_them(made) -> None:
    names = {path.name for path in made[0].iterdir()}
    figures = {f"figure_{number:02}.png" for number in range(1, 20)}
    by_k = {f"figure_{number}_by_k.png" for number in range(15, 19)}
    assert names == figures | by_k | {"clearance.png", "share_container.png", "share_chair.png"}


def test_the_numbers_tell_the_papers_story(made) -> None:
    numbers = made[1]
    json.dumps(numbers)
    assert numbers["goals"] == 2  # one in each band
    assert numbers["streamlines"] > 100
    assert numbers["clearance_0.99"] > numbers["clearance_0.5"] > numbers["clearance_0.01"] > 0
    assert numbers["largest_fall"] < 0.5  # cells: the mean clearance does not fall as k grows
    assert abs(numbers["wall_clearance"]) < 1e-9  # a wall of 0 ohm is Dirichlet, as k = 1
    assert (numbers["upper"], numbers["lower"]) == (1, 2)
    assert numbers["cut_off"] == pytest.approx(1 / 6, abs=0.02)
    assert numbers["paths"] == 1


def test_control_does_as_the_paper_says(made) -> None:
    numbers = made[1]
    assert all(numbers[f"figure_{number}_arrived"] for number in range(15, 20))
    assert numbers["figure_18_from_tip"] > 0.2  # metres: it is the link that touches
    assert numbers["container_learnt"] > 0
    assert numbers["chair_learnt"] > 0
    assert numbers["container_wrong"] == numbers["chair_wrong"] == 0
    assert {numbers[f"{name}_by_k_{figure}"] for name, figure in (("container", 15), ("chair", 17))} == {4}
    assert numbers["container_mostly_neumann"] > 0.5  # of the cells, though k = 0.98
    assert numbers["chair_mostly_neumann"] > 0.4


def test_the_ratio_at_which_arrival_fails_is_found(tmp_path: Path) -> None:
    """In a small room: grids that settle fast enough, and hopeless ones."""
    numbers = load("figures").settling(
        tmp_path, rg.parse_scene(hidden_room(k="[]", left=2.0, right=6.5), "room"), (30.0, 1e6)
    )
    assert {path.name for path in tmp_path.iterdir()} == {"settling.png", "wavefront.png"}
    for method in ("chip", "jacobi", "sor"):
        assert numbers[f"{method}_safe"] == 30.0
        assert numbers[f"{method}_fails"] == 1e6


@pytest.mark.parametrize("k", [0.0, 0.01, 0.5, 0.99, 1.0])
def test_from_every_start_of_problem_a_the_links_themselves_stay_clear(scenes: Path, planner, k: float) -> None:
    """All cells reach a goal; of a spread of them the arm is driven along the path with exact geometry."""
    scene = rg.read_scene(scenes / "problem_a.toml")
    space, at = planner.space, planner.at(k)
    everywhere = space.centre(np.argwhere(space.goal_connected))
    assert set(at.ends(everywhere).outcome) == {"reached"}
    for start in everywhere[::397]:
        path = at.path(start)
        rg.certify(path)
        assert rg.replay(path, scene.obstacles, step=5e-3) is None
        short = rg.shorten(path, rounds=20)
        assert rg.replay(short, scene.obstacles, step=5e-3) is None


@pytest.fixture(scope="module")
def planner(scenes: Path):
    return rg.plan(rg.read_scene(scenes / "problem_a.toml"), k=0.5)


@pytest.mark.parametrize("name", ["three_link", "turning"])
def test_robots_in_three_dimensions_drive_without_a_collision(scenes: Path, name: str) -> None:
    scene = rg.read_scene(scenes / f"{name}.toml")
    planner = rg.plan(scene)
    paths = [path for path in planner.paths() if path.outcome == rg.Outcome.REACHED]
    assert paths
    for path in paths:
        short = rg.shorten(path)
        motion = rg.time_path(short, velocity_limits=1.0, acceleration_limits=2.0)
        for way in (path, short, rg.Polyline(motion.sample(50)[1], path.space)):
            assert rg.replay(way, scene.obstacles) is None
