"""Warm starts after changes of a space, against solutions of the new space from scratch.

Tests internals: `resgrid.circuit.equations`, `resgrid.circuit.warm_start`.
"""

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

import resgrid as rg
from resgrid.circuit.equations import assemble
from resgrid.circuit.warm_start import _boxes_around

WIRINGS = (
    {"boundary": "dirichlet"},
    {"boundary": "dirichlet", "edge": "open", "supply": -3.0, "goal_voltage": 1.0},
    {"boundary": "neumann", "resistance": 1e3},
    {"boundary": "wall", "wall_resistance": 3e5},
)


def random_plane(shape, seed, periodic=False):
    """Return a space with random rectangles and a goal in the middle."""
    rng = np.random.default_rng(seed)
    cell = np.zeros(shape, dtype=np.uint8)
    for _ in range(int(0.02 * cell.size / 8)):
        low = [int(rng.integers(n)) for n in shape]
        cell[tuple(slice(a, a + int(rng.integers(1, 6))) for a in low)] = rg.Cell.OBSTACLE
    middle = tuple(n // 2 for n in shape)
    cell[tuple(slice(m - 1, m + 2) for m in middle)] = rg.Cell.FREE
    cell[middle] = rg.Cell.GOAL
    axes = [rg.Axis(f"q{a}", 0.0, 1.0 + a, n, periodic=periodic) for a, n in enumerate(shape)]
    return rg.ConfigurationSpace(axes, cell, conductivity=rng.uniform(0.5, 2.0, shape))


def assert_equals_fresh(point, space, wiring):
    """Assert that voltages equal a fresh solution, and that only cells with an unknown have a voltage."""
    netlist = rg.compile_space(space, **wiring)
    system = assemble(netlist)
    node = netlist.cells.node
    solved = (node >= 0) & (system.unknown[node] >= 0)
    assert np.array_equal(np.isfinite(point.voltage), solved)
    fresh = rg.solve(netlist, accuracy="normwise", rtol=1e-12).voltage[node]
    span = np.ptp(np.append(fresh[solved], wiring.get("goal_voltage", 0.0)))
    assert np.abs(point.voltage - fresh)[solved].max() <= 1e-5 * span
    assert point.backward_error <= 1e-8


def changed(space, rng, kind):
    """Return the space with other kinds or conductivities of some cells near a random one."""
    cell = space.cell.copy()
    at = np.array([rng.integers(n) for n in space.shape])
    near = np.clip(at + rng.integers(-5, 6, (10, space.ndim)), 0, np.array(space.shape) - 1)
    keep = cell == rg.Cell.GOAL
    if kind == "conductivity":
        cost = space.conductivity.copy()
        cost[tuple(near.T)] *= 3.0
        return rg.ConfigurationSpace(space.axes, cell, conductivity=cost)
    cell[tuple(near.T)] = {"walls": rg.Cell.OBSTACLE, "freed": rg.Cell.FREE, "goals": rg.Cell.GOAL}.get(kind, 0)
    if kind == "goal moved":
        cell[keep] = rg.Cell.FREE
        cell[tuple(near[0])] = rg.Cell.GOAL
    else:
        cell[keep] = rg.Cell.GOAL
    return space.with_cells(cell)


@pytest.mark.parametrize("wiring", WIRINGS, ids=lambda wiring: wiring["boundary"])
@settings(max_examples=6, deadline=None)
@example(seed=196, kinds=["goal moved", "goals", "freed"])
@given(
    seed=st.integers(0, 2**32 - 1),
    kinds=st.lists(st.sampled_from(["walls", "freed", "goals", "goal moved", "conductivity"]), min_size=1, max_size=4),
)
@pytest.mark.quick_cases(2)
def test_warm_starts_after_random_changes_equal_solutions_from_scratch(wiring, seed, kinds):
    rng = np.random.default_rng(seed)
    space = random_plane((48, 61), seed % 7)
    warm = rg.circuit.WarmStart(**wiring)
    warm.solve(space)
    for kind in kinds:
        space = changed(space, rng, kind)
        if space.goal_connected.any():
            assert_equals_fresh(warm.solve(space), space, wiring)
            continue
        with pytest.raises(rg.CircuitError, match="nothing is driven") as fresh:
            rg.solve(rg.compile_space(space, **wiring))
        with pytest.raises(rg.CircuitError) as raised:
            warm.solve(space)
        assert str(raised.value) == str(fresh.value)


@pytest.fixture
def windows_always(monkeypatch):
    """Use windows on grids of any size."""
    monkeypatch.setattr("resgrid.circuit.warm_start._SMALL", 0)


@pytest.mark.usefixtures("windows_always")
@pytest.mark.parametrize("wiring", WIRINGS, ids=lambda wiring: wiring["boundary"])
@pytest.mark.parametrize("shape", [(90, 70), (15, 18, 14)], ids=str)
def test_solutions_in_windows_equal_solutions_from_scratch(wiring, shape):
    rng = np.random.default_rng(9)
    space = random_plane(shape, 4)
    warm = rg.circuit.WarmStart(**wiring)
    warm.solve(space)
    kept = 0
    for kind in ("walls", "freed", "goals", "conductivity", "goal moved", "walls", "freed"):
        space = changed(space, rng, kind)
        point = warm.solve(space)
        kept += not point.fresh
        assert_equals_fresh(point, space, wiring)
    assert kept


@pytest.mark.usefixtures("windows_always")
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_warm_starts_on_periodic_spaces_equal_solutions_from_scratch(boundary):
    rng, wiring = np.random.default_rng(5), {"boundary": boundary}
    space = random_plane((64, 48), 2, periodic=True)
    warm = rg.circuit.WarmStart(**wiring)
    warm.solve(space)
    for kind in ("walls", "freed", "walls", "goals"):
        space = changed(space, rng, kind)
        assert_equals_fresh(warm.solve(space), space, wiring)


def divided_plane(gap, goal=(5, 5)):
    """Return a plane of 40 x 40 cells with a wall across that has gaps at the given cells."""
    cell = np.zeros((40, 40), dtype=np.uint8)
    cell[20] = rg.Cell.OBSTACLE
    cell[20, list(gap)] = rg.Cell.FREE
    cell[goal] = rg.Cell.GOAL
    return rg.ConfigurationSpace([rg.Axis("x", 0.0, 1.0, 40), rg.Axis("y", 0.0, 1.0, 40)], cell)


@pytest.mark.usefixtures("windows_always")
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("gaps", [((3,), (3, 30), (30,)), ((9,), (), (30,)), ((), (12, 13), ())], ids=str)
def test_opening_and_closing_gaps_in_a_wall_gives_the_solution_from_scratch(boundary, gaps):
    warm = rg.circuit.WarmStart(boundary=boundary)
    for gap in gaps:
        space = divided_plane(gap)
        assert_equals_fresh(warm.solve(space), space, {"boundary": boundary})


def enclose(cell, low, high):
    """Put walls around a box of cells."""
    walls = np.zeros_like(cell, dtype=bool)
    walls[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    walls[tuple(slice(a + 1, b - 1) for a, b in zip(low, high, strict=True))] = False
    cell[walls] = rg.Cell.OBSTACLE


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("low, keeps", [((30, 30), True), ((3, 3), False)], ids=["a corner", "the goal"])
def test_walls_that_isolate_a_part_give_the_solution_from_scratch(boundary, low, keeps):
    before = divided_plane(range(40))
    warm = rg.circuit.WarmStart(boundary=boundary)
    warm.solve(before)
    cell = before.cell.copy()
    enclose(cell, low, (low[0] + 5, low[1] + 5))
    after = before.with_cells(cell)
    point = warm.solve(after)
    assert_equals_fresh(point, after, {"boundary": boundary})
    assert point.fresh != keeps


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_changes_of_cells_without_free_neighbours_give_the_solution_from_scratch(boundary):
    cell = (np.indices((30, 30)).sum(axis=0) % 2).astype(np.uint8)
    cell[:8][cell[:8] == rg.Cell.OBSTACLE] = rg.Cell.GOAL
    cell[15:] = rg.Cell.FREE
    cell[20, 20] = rg.Cell.GOAL
    space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 1.0, 30), rg.Axis("y", 0.0, 1.0, 30)], cell)
    warm = rg.circuit.WarmStart(boundary=boundary)
    warm.solve(space)
    for place, code in (((4, 4), 1), ((4, 4), 2), ((4, 4), 0), ((10, 10), 1), ((10, 10), 0)):
        cell[place] = code
        after = space.with_cells(cell)
        assert_equals_fresh(warm.solve(after), after, {"boundary": boundary})


def test_warm_starts_with_a_driven_start_cell_equal_solutions_from_scratch():
    wiring = {"boundary": "neumann", "drive": "start", "start": (35, 35)}
    warm = rg.circuit.WarmStart(**wiring)
    for gap in ((3,), (3, 20), (20,)):
        assert_equals_fresh(warm.solve(divided_plane(gap)), divided_plane(gap), wiring)


def test_other_sizes_and_a_single_row_are_solved_from_scratch():
    warm = rg.circuit.WarmStart(boundary="neumann")
    line = rg.ConfigurationSpace([rg.Axis("x", 0.0, 1.0, 30)], [2, *[0] * 29])
    for space in (divided_plane((3,)), random_plane((48, 61), 0), line, line):
        point = warm.solve(space)
        assert point.fresh
        assert_equals_fresh(point, space, {"boundary": "neumann"})


def test_a_warm_start_needs_fewer_iterations_for_the_same_operating_point():
    before = random_plane((340, 330), 1)
    warm = rg.circuit.WarmStart(boundary="neumann")
    first = warm.solve(before)
    cell = before.cell.copy()
    cell[170:172, 150:155] = rg.Cell.OBSTACLE
    point = warm.solve(before.with_cells(cell))
    assert not point.fresh
    assert point.iterations < first.iterations
    op = point.operating_point()
    fresh = rg.solve(point.netlist, accuracy="normwise", rtol=1e-12)
    assert np.allclose(op.voltage, fresh.voltage, rtol=0.0, atol=1e-6 * fresh.voltage.max(), equal_nan=True)
    assert op.iterations == point.iterations
    assert point.operating_point("direction").kcl_residual <= 1e-6


@pytest.mark.usefixtures("windows_always")
@pytest.mark.parametrize("goal", [(96, 96), (96, 97), (96, 99)])
def test_goals_near_the_border_of_a_window_give_the_solution_from_scratch(goal):
    """The correction outside the window uses a mode that ignores goals there."""
    cell = np.zeros((256, 256), dtype=np.uint8)
    cell[100:110, 140:150] = rg.Cell.OBSTACLE
    cell[goal] = rg.Cell.GOAL
    before = rg.ConfigurationSpace([rg.Axis(name, 0.0, 1.0, 256) for name in "xy"], cell)
    warm = rg.circuit.WarmStart(boundary="neumann")
    first = warm.solve(before)
    freed = cell.copy()
    freed[100:110, 140] = rg.Cell.FREE
    point = warm.solve(before.with_cells(freed))
    assert not point.fresh
    assert point.iterations < first.iterations
    fresh = rg.solve(point.netlist, accuracy="normwise", rtol=1e-12)
    expected = fresh.voltage[point.netlist.cells.node]
    assert np.nanmax(np.abs(point.voltage - expected)) <= 1e-7 * np.nanmax(expected)


def test_a_warm_start_solves_from_scratch_after_an_error():
    warm = rg.circuit.WarmStart()
    warm.solve(divided_plane((3,)))
    with pytest.raises(rg.InputError, match="no goal cell"):
        warm.solve(divided_plane((3,)).with_cells(np.zeros((40, 40), dtype=np.uint8)))
    point = warm.solve(divided_plane((4,)))
    assert point.fresh
    assert_equals_fresh(point, divided_plane((4,)), {})


def test_warm_start_rejects_rails_cells():
    with pytest.raises(rg.InputError, match="merged"):
        rg.circuit.WarmStart(rails="cells")


def test_warm_start_rejects_invalid_spaces_and_progress():
    with pytest.raises(rg.InputError, match="must be a ConfigurationSpace"):
        rg.circuit.WarmStart().solve("rooms.toml")
    with pytest.raises(rg.InputError, match="progress = 1 must be"):
        rg.circuit.WarmStart().solve(divided_plane((3,)), progress=1)


def test_windows_of_changes_are_merged_where_they_overlap():
    """Three changes; only the windows of the last two overlap."""
    changed = np.zeros((400, 400), dtype=bool)
    changed[[8, 300, 330], [8, 300, 330]] = True
    boxes = _boxes_around(changed)
    assert boxes is not None and len(boxes) == 2


def test_the_multigrid_hierarchy_is_rebuilt_after_large_changes():
    """Regression: after changes over many orders of magnitude the iteration with old levels stagnated."""
    rng = np.random.default_rng(19)
    shape, warm = (26, 65), rg.circuit.WarmStart(boundary="neumann", edge="open")
    axes = [rg.Axis("x", 0.0, 26.0, 26), rg.Axis("y", 0.0, 65.0, 65)]
    cell, cost = np.zeros(shape, dtype=np.uint8), 10.0 ** rng.uniform(-1, 1, shape)
    cell[3, 3] = rg.Cell.GOAL
    for _ in range(25):
        at = tuple(slice(int(rng.integers(n)), None) for n in shape)
        near = tuple(slice(part.start, part.start + 3) for part in at)
        cost[near] *= 10.0 ** (6 * rng.standard_normal())
        point = warm.solve(rg.ConfigurationSpace(axes, cell.copy(), cost.copy()))
        assert point.backward_error <= 1e-8


@pytest.mark.parametrize("boundary, seed", [("neumann", 20), ("neumann", 22), ("dirichlet", 20)])
def test_voltages_over_many_orders_of_magnitude_equal_a_direct_solution(boundary, seed):
    """Regression: guesses with small residuals but large errors were accepted."""
    rng = np.random.default_rng(seed)
    shape, wiring = (26, 65), {"boundary": boundary, "edge": "open" if boundary == "neumann" else "obstacle"}
    axes = [rg.Axis("x", 0.0, 26.0, 26), rg.Axis("y", 0.0, 65.0, 65)]
    cell, cost = np.zeros(shape, dtype=np.uint8), 10.0 ** rng.uniform(-1, 1, shape)
    cell[3, 3] = rg.Cell.GOAL
    warm = rg.circuit.WarmStart(**wiring)
    for _ in range(9):
        at = [int(rng.integers(n)) for n in shape]
        near = tuple(slice(first, first + 3) for first in at)
        cost[near] = np.clip(cost[near] * 10.0 ** (3 * rng.standard_normal()), 1e-15, 1e15)
        space = rg.ConfigurationSpace(axes, cell, cost.copy())
        netlist = rg.compile_space(space, **wiring)
        exact = rg.solve(netlist, method="direct").voltage[netlist.cells.node]
        point = warm.solve(space)
        solved = np.isfinite(point.voltage)
        assert np.abs(point.voltage - exact)[solved].max() <= 1e-6 * np.abs(exact[solved]).max()


@pytest.mark.usefixtures("windows_always")
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_cells_freed_inside_a_large_obstacle_give_the_solution_from_scratch(boundary):
    before = divided_plane(range(40), goal=(35, 35))
    cell = np.pad(before.cell, ((0, 80), (0, 80)), constant_values=rg.Cell.FREE)
    axes = [rg.Axis(name, 0.0, 1.0, 120) for name in "xy"]
    warm = rg.circuit.WarmStart(boundary=boundary)
    for low, high, kind in ((0, 0, 0), (70, 120, rg.Cell.OBSTACLE), (118, 120, rg.Cell.FREE)):
        cell[low:high, low:high] = kind
        space = rg.ConfigurationSpace(axes, cell.copy())
        assert_equals_fresh(warm.solve(space), space, {"boundary": boundary})
