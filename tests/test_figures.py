"""Scenes of Connolly & Grupen (1992) and in three dimensions: exact collision tests along the paths.

The figures' own numbers are asserted by `examples/figures_1992`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import resgrid as rg


@pytest.mark.parametrize("k", [0.0, 0.01, 0.5, 0.99, 1.0])
@pytest.mark.quick_cases(2)
def test_paths_of_problem_a_have_no_collision_for_every_k(scenes: Path, planner, k: float) -> None:
    """All connected cells reach a goal; paths of a sample of cells are tested with exact geometry."""
    scene = rg.read_scene(scenes / "problem_a.toml")
    space, at = planner.space, planner.at(k)
    everywhere = space.centre(np.argwhere(space.goal_connected))
    assert set(at.ends(everywhere).outcome) == {"reached"}
    for start in everywhere[::397]:
        path = at.path(start)
        rg.certify(path)
        assert rg.check_collisions(path, scene.obstacles, step=5e-3) is None
        short = rg.shortcut(path, rounds=20)
        assert rg.check_collisions(short, scene.obstacles, step=5e-3) is None


@pytest.fixture(scope="module")
def planner(scenes: Path):
    return rg.plan(rg.read_scene(scenes / "problem_a.toml"), k=0.5)


@pytest.mark.parametrize("name", ["three_link", "turning"])
def test_paths_and_motions_in_three_dimensions_have_no_collision(scenes: Path, name: str) -> None:
    scene = rg.read_scene(scenes / f"{name}.toml")
    planner = rg.plan(scene)
    paths = [path for path in planner.paths() if path.outcome == rg.Outcome.REACHED]
    assert paths
    for path in paths:
        short = rg.shortcut(path)
        motion = rg.time_parameterize(short, velocity_limits=1.0, acceleration_limits=2.0)
        for way in (path, short, rg.Polyline(motion.sample(50)[1], path.space)):
            assert rg.check_collisions(way, scene.obstacles) is None
