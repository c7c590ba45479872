"""A user-defined robot class: occupancy compared with shapely, planning, control, pictures and the command line.

Tests internals: `resgrid.robots`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from support.dumbbell import Dumbbell

import resgrid as rg
from resgrid.robots import RigidPart, to_shapely

ROBOT = Dumbbell(0.8, 0.12)
OBSTACLES = (rg.Box((1.2, 0.0), (1.4, 0.9)), rg.Ball((1.3, 1.7), 0.2), rg.HalfSpace((0.0, 1.0), 0.02))
AXES = (
    rg.Axis("x", 0.0, 2.6, 26), rg.Axis("y", 0.0, 2.0, 20),
    rg.Axis("theta", 0.0, 2 * np.pi * 0.4, 24, periodic=True),
)  # fmt: skip
SCENE = rg.Scene(
    AXES, robot=ROBOT, obstacles=OBSTACLES, goals=(rg.GoalPoint((2.2, 1.2)),), starts=((0.4, 1.0, 0.0),), k=(0.98,)
)


def test_no_configuration_in_a_free_cell_collides() -> None:
    blocked = ROBOT.occupancy(AXES, OBSTACLES, "conservative")
    centred = ROBOT.occupancy(AXES, OBSTACLES, "centre")
    assert 0.2 < centred.mean() < blocked.mean() < 0.8
    assert not (centred & ~blocked).any()
    rng = np.random.default_rng(0)
    cells = np.argwhere(~blocked)
    chosen = cells[rng.integers(len(cells), size=5000)] + rng.random((5000, 3))
    solid = shapely.union_all([to_shapely(shape) for shape in OBSTACLES])
    for end in ROBOT.ends(chosen * [axis.spacing for axis in AXES]):
        assert shapely.distance(shapely.points(end), solid).min() > ROBOT.radius


@pytest.mark.parametrize("far", [1e3, 1e15, 3e15])
def test_distant_corners_of_obstacles_hide_no_collision(far: float) -> None:
    """Compared with exact fractions: the corners of the edge are so distant that floating-point distances round."""
    below = rg.Polygon(((-far, -far / 2 + 0.3), (2.7 * far, 1.35 * far + 0.3), (2.7 * far, -3 * far)))
    free = np.argwhere(~ROBOT.occupancy(AXES, [below], "conservative"))
    assert len(free) or far > 1e9
    (ax, ay), (bx, by) = (tuple(map(Fraction, corner)) for corner in below.vertices[:2])
    for x, y in np.concatenate(ROBOT.ends((free + 0.5) * [axis.spacing for axis in AXES])).tolist():
        height = (bx - ax) * (Fraction(y) - ay) - (by - ay) * (Fraction(x) - ax)
        assert height > 0 and height**2 > Fraction(ROBOT.radius) ** 2 * ((bx - ax) ** 2 + (by - ay) ** 2)


def test_a_user_defined_robot_is_planned_drawn_and_controlled() -> None:
    planner = rg.plan(SCENE)
    path = planner.path(SCENE.starts[0])
    assert path.outcome is rg.Outcome.REACHED
    assert rg.check_collisions(path, OBSTACLES) is None
    assert len(rg.plot.draw_robot(path.points, SCENE).patches) > 10
    run = rg.simulation(SCENE).run()
    assert run.ending is rg.control.TerminationReason.ARRIVED
    assert run.penetration == 0.0
    np.testing.assert_allclose(run.configuration[-1, :2], (2.2, 1.2), atol=0.1)
    assert rg.draw(run)


def test_a_user_defined_robot_learns_hidden_obstacles() -> None:
    scene = replace(SCENE, obstacles=OBSTACLES[:1], hidden=OBSTACLES[1:2])
    run = rg.simulation(scene).run()
    assert run.lessons
    assert run.ending is rg.control.TerminationReason.ARRIVED, run.message
    assert run.penetration == 0.0


def test_a_missing_method_of_a_robot_is_named() -> None:
    class Ghost(rg.Robot):
        def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:
            return [RigidPart(np.asarray(shapely.points(configurations[:, :2])), 0.1)]

        def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.asarray(np.linalg.norm(end - start, axis=1))

    with pytest.raises(rg.InputError, match=r"implement Ghost.pose"):
        rg.simulation(replace(SCENE, robot=Ghost())).run()


SCENE_FILE = """
schema = 1
title = "Dumbbell"
starts = [[0.4, 1.0, 0.0]]
k = [0.98]
[grid]
axes = [
    { name = "x", lower = 0, upper = 2.6, cells = 26 }, { name = "y", lower = 0, upper = 2, cells = 20 },
    { name = "theta", lower = 0, upper = 2.5132741228718345, cells = 24, periodic = true },
]
[robot]
type = "dumbbell"
length = 0.8
radius = 0.12
[[obstacle]]
shape = "rectangle"
lower = [1.2, 0.0]
upper = [1.4, 0.9]
[[hidden]]
shape = "circle"
centre = [1.3, 1.7]
radius = 0.2
[[goal]]
point = [2.2, 1.2]
"""
REGISTERED = """
import json, sys
from support.dumbbell import Dumbbell
from resgrid.robots import ROBOTS
ROBOTS["dumbbell"] = Dumbbell
from support.cli import call
results = [call(*words) for words in json.loads(sys.argv[1])]
print(json.dumps([[result.exit_code, result.stdout, result.stderr] for result in results]))
"""


@pytest.mark.slow
def test_a_registered_robot_is_available_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE_FILE)
    (tmp_path / "wrong.toml").write_text(SCENE_FILE.replace("radius = 0.12", "radiu = 0.12"))
    lines = [
        ["run", "scene.toml", "-o", "out", "--no-check"],
        ["plot", "scene.toml", "-o", "robot.png", "--what", "robot"],
        ["control", "scene.toml", "--json"],
        ["run", "wrong.toml"],
    ]
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-c", REGISTERED, json.dumps(lines)]
    environment = os.environ | {"PYTHONPATH": path}
    done = subprocess.run(command, check=False, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    ran, plotted, moved, rejected = json.loads(done.stdout)
    assert [ran[0], plotted[0], moved[0], rejected[0]] == [0, 0, 0, 2]
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["schema"] == 1
    assert (tmp_path / "robot.png").exists()
    assert len(json.loads(moved[1])["runs"]) == 1
    assert "did you mean 'radius'?" in rejected[2]
