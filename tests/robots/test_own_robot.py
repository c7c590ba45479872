"""A robot of one's own: one class, and everything else works with it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

import resgrid as rg
from resgrid.errors import InputError
from resgrid.robots import Part, Pose, to_shapely


@dataclass(frozen=True)
class Dumbbell(rg.Robot):
    """Two discs on a massless bar, at (x, y, theta); an arc of theta is an angle of theta / (length / 2)."""

    length: float
    radius: float

    def _ends(self, configurations: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        angle = configurations[:, 2] / (self.length / 2)
        half = self.length / 2 * np.column_stack([np.cos(angle), np.sin(angle)])
        return [configurations[:, :2] - half, configurations[:, :2] + half]

    def parts(self, configurations: NDArray[np.float64]) -> list[Part]:
        return [Part(np.asarray(shapely.points(end)), self.radius) for end in self._ends(configurations)]

    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        step = np.abs(end - start)
        return np.asarray(np.linalg.norm(step[:, :2], axis=1) + step[:, 2])

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        ends = np.concatenate(self._ends(configuration[np.newaxis]))
        return Pose.of_body(np.hstack([ends, ends]), self.radius, configuration, self.length / 2)


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
    for end in ROBOT._ends(chosen * [axis.spacing for axis in AXES]):
        assert shapely.distance(shapely.points(end), solid).min() > ROBOT.radius


def test_it_is_planned_for_replayed_drawn_and_controlled() -> None:
    planner = rg.plan(SCENE)
    path = planner.path(SCENE.starts[0])
    assert path.outcome is rg.Outcome.REACHED
    assert rg.replay(path, ROBOT, OBSTACLES, planner.space) is None
    assert len(rg.draw_robot(path.points, SCENE).patches) > 10
    run = rg.simulation(SCENE).run()
    assert run.ending is rg.Ending.ARRIVED
    assert run.penetration == 0.0
    np.testing.assert_allclose(run.configuration[-1, :2], (2.2, 1.2), atol=0.1)
    assert rg.draw(run)


def test_it_feels_and_learns_what_the_map_does_not_show() -> None:
    scene = replace(SCENE, obstacles=OBSTACLES[:1], hidden=OBSTACLES[1:2])
    run = rg.simulation(scene).run()
    assert run.lessons
    assert run.ending is rg.Ending.ARRIVED, run.message
    assert run.penetration == 0.0


def test_what_a_robot_does_not_say_is_named() -> None:
    class Ghost(rg.Robot):
        def parts(self, configurations: NDArray[np.float64]) -> list[Part]:
            return [Part(np.asarray(shapely.points(configurations[:, :2])), 0.1)]

        def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.asarray(np.linalg.norm(end - start, axis=1))

    with pytest.raises(InputError, match=r"give Ghost a method pose"):
        rg.simulation(replace(SCENE, robot=Ghost())).run()
