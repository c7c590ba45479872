"""Published maps (nav2, MovingAI, EPIC): paths, potentials and KCL of all cells, compared with flood fills."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

import resgrid as rg

MAPS = {
    "nav2/turtlebot3/map.yaml": {},
    "nav2/depot.yaml": {},
    "movingai/den312d.map": {},
    "movingai/lak303d.map": {},
    "movingai/Boston_0_256.map": {},
    "movingai/maze-32-32-2.map": {},
    "movingai/random-32-32-20.map": {},
    "movingai/room-32-32-4.map": {},
    "movingai/arena.map": {},
    "epic/c_space.png": {"format": "epic"},
    "epic/maze_1.png": {"format": "epic"},
    "epic/umass_lpr.png": {"format": "epic"},
}
SCENARIOS = ["arena.map", "den312d.map", "lak303d.map", "Boston_0_256.map"]
SCENARIOS_EVEN = ["maze-32-32-2", "random-32-32-20", "room-32-32-4"]


def with_goal(path: Path, **options: str) -> rg.ConfigurationSpace:
    """Space with the goals of the map, or with a goal in a corner of the largest free region."""
    scene = rg.read_scene(path, **options)
    space = rg.build_space(scene, require_goal=False)
    if space.goal_count:
        return space
    labels, _ = ndimage.label(space.cell == rg.Cell.FREE)
    largest = np.argwhere(labels == np.argmax(np.bincount(labels[labels > 0])))
    cell = space.cell.copy()
    cell[tuple(largest[np.argmin(largest.sum(axis=1))])] = rg.Cell.GOAL
    return rg.ConfigurationSpace(space.axes, cell)


def connected(space: rg.ConfigurationSpace) -> np.ndarray:
    """Free cells connected to a goal, by flood fill."""
    free = space.cell != rg.Cell.OBSTACLE
    return ndimage.binary_propagation(space.cell == rg.Cell.GOAL, mask=free) & (space.cell == rg.Cell.FREE)


def lowest_neighbour(height: np.ndarray) -> np.ndarray:
    padded = np.pad(np.where(np.isnan(height), np.inf, height), 1, constant_values=np.inf)
    sides = [np.roll(padded, shift, axis)[1:-1, 1:-1] for axis in (0, 1) for shift in (1, -1)]
    return np.min(sides, axis=0)


def kcl_violation(field: rg.Field, cells: np.ndarray) -> np.ndarray:
    """Net current of every cell over its through-current, from the face currents in log form."""
    logs, signs = [], []
    for axis in range(2):
        for side in (0, 1):
            window = tuple(slice(side, side + n) if a == axis else slice(None) for a, n in enumerate(cells.shape))
            logs.append(field.face_log_current[axis][window])
            signs.append(field.face_direction[axis][window] * (1 if side else -1))
    scale = np.max(logs, axis=0)
    scaled = np.array(signs) * np.exp(np.array(logs) - np.where(np.isfinite(scale), scale, 0.0))
    net, through = scaled.sum(axis=0), np.abs(scaled).sum(axis=0) / 2
    if field.wiring.drive == "uniform":
        drive = (net * np.exp(scale))[cells]
        per_cell = np.median(drive)
        assert per_cell > 0
        net -= per_cell * np.exp(-scale)
    return np.abs(net[cells]) / through[cells]


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "epic/maze_1.png")) for name in MAPS]
)
@pytest.mark.quick_cases(6)
def test_every_connected_cell_reaches_a_goal_by_descent(cases: Path, name: str, boundary: str) -> None:
    space = with_goal(cases / name, **MAPS[name])
    field = rg.field(rg.solve(rg.compile_space(space, boundary=boundary)))
    served = connected(space)
    assert np.array_equal(served, space.goal_connected)
    height = -field.log_drop if field.log_drop is not None else field.potential
    assert np.all(lowest_neighbour(height)[served] < height[served])
    assert kcl_violation(field, served).max() <= 1e-6
    rng = np.random.default_rng(7)
    cells = np.argwhere(served)
    if len(cells) > 15_000:
        cells = cells[rng.choice(len(cells), 5_000)]
        starts = space.lower + (cells + rng.random(cells.shape)) * space.spacing
    else:
        starts = space.centre(cells)
    traces = rg.streamlines(field, starts)
    assert np.all(traces.outcome == "reached")
    for start in starts[rng.choice(len(starts), 15)]:
        path = rg.streamline(field, start)
        rg.certify(path)
        assert np.all(np.diff(height[tuple(path.cells.T)]) < 0)


def _scenario(folder: Path, name: str) -> tuple[Path, Path]:
    return (
        (folder / name, folder / f"{name}.scen")
        if name.endswith(".map")
        else (folder / f"{name}.map", folder / f"{name}-even-1.scen")
    )


@pytest.mark.parametrize("name", SCENARIOS + SCENARIOS_EVEN)
def test_scenario_goals_are_reachable_by_paths_of_at_least_optimal_length(cases: Path, name: str) -> None:
    map_file, scenario = _scenario(cases / "movingai", name)
    queries = rg.maps.read_movingai_scenarios(scenario)
    scene = rg.read_scene(map_file)
    space_at: Callable[[tuple[int, ...]], rg.ConfigurationSpace] = lambda cell: rg.build_space(  # noqa: E731
        scene.replace(goal=rg.GoalCell(cell))
    )
    first = space_at(queries[0].goal)
    parts, _ = ndimage.label(first.cell != rg.Cell.OBSTACLE)
    for query in queries:
        assert parts[query.start] == parts[query.goal] != 0
    for query in queries[:: max(1, len(queries) // 8)]:
        space = space_at(query.goal)
        if query.start == query.goal:
            continue
        field = rg.field(rg.solve(rg.compile_space(space)))
        path = rg.streamline(field, cell=query.start)
        rg.certify(path)
        assert path.length >= query.optimal_length / 1.0824 - 2.0
