"""Endings of runs with learning in random worlds, against connectivity of the true map.

``RESGRID_WORLDS`` sets the number of worlds.

Tests internals: `resgrid.core.regions`, `resgrid.robots`.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
import shapely
from support.hidden import hiding

import resgrid as rg
from resgrid.core.regions import label_regions
from resgrid.robots import Shape, to_shapely


def with_path(blocked: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Return the cells with a path to a goal cell that is not blocked."""
    region = label_regions(~blocked, np.zeros(cell.ndim, bool))
    return np.asarray((region > 0) & np.isin(region, region[(cell == rg.Cell.GOAL) & (region > 0)]))


def shapes(rng: np.random.Generator) -> list[Shape]:
    """Return one to five boxes and discs; some boxes have their edges on cell borders."""
    found: list[Shape] = []
    for _ in range(rng.integers(1, 6)):
        x, y, w, h = *rng.uniform(0, 8, 2), *rng.uniform(0.1, 2.0, 2)
        if rng.random() < 0.3:
            x, y, w, h = (np.round(2 * value) / 2 for value in (x, y, w + 0.25, h + 0.25))
        found.append(rg.Ball((x, y), w) if rng.random() < 0.3 else rg.Box((x, y), (x + w, y + 2 * h)))
    return found


WORLDS = int(os.environ.get("RESGRID_WORLDS", "16"))
QUICK = 4
"""Number of worlds without the mark `slow`."""


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=[pytest.mark.slow] * (seed >= QUICK)) for seed in range(WORLDS)]
)
@pytest.mark.quick_cases(2)
def test_starts_with_a_path_arrive_and_starts_without_one_end_with_no_path(seed: int) -> None:
    """A path in the conservative map guarantees arrival; no path among partly free cells guarantees NO_PATH."""
    rng = np.random.default_rng(seed)
    hidden = shapes(rng)
    robot = rg.PointRobot() if seed % 2 else rg.DiscRobot(0.3)
    sim = hiding(hidden, robot=robot, k=float(rng.choice([0.1, 0.98, 1.0])), friction=float(rng.uniform(0, 0.6)))
    truth = sim.plant.true_space(sim.space)
    certain = with_path(truth.cell == rg.Cell.OBSTACLE, sim.space.cell)
    solid = shapely.union_all([to_shapely(shape).buffer(robot.radius, quad_segs=64) for shape in hidden])
    x, y = sim.space.axes
    i, j = np.indices(sim.space.shape)
    boxes = shapely.box(x.edges[i], y.edges[j], x.edges[i + 1], y.edges[j + 1])
    possible = with_path(shapely.area(shapely.difference(boxes, solid)) <= 1e-12, sim.space.cell)
    cells = np.argwhere(sim.space.cell == rg.Cell.FREE)[rng.integers(0, 16) :: 23]
    cells = cells[sim.plant.penetration(sim.space.centre(cells)) == 0]
    for cell in cells:
        run = sim.run(sim.space.centre(cell))
        at = tuple(cell)
        assert not np.any(run.learnt & (truth.cell != rg.Cell.OBSTACLE))
        assert run.penetration == 0
        assert len(run.lessons) <= run.learnt.sum()
        if certain[at]:
            assert run.ending is rg.control.TerminationReason.ARRIVED, (at, run.message)
        elif not possible[at]:
            assert run.ending in {rg.control.TerminationReason.NO_PATH, rg.control.TerminationReason.GOAL_BLOCKED}, (
                at,
                run.message,
            )
        if run.ending in {rg.control.TerminationReason.NO_PATH, rg.control.TerminationReason.GOAL_BLOCKED}:
            assert not with_path(run.space.cell == rg.Cell.OBSTACLE, run.space.cell)[at]
