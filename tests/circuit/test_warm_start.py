"""Circuits of a space that changes have the voltages that fresh ones have.

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


def plane(shape, seed, periodic=False):
    """Random rectangles, the goal in the middle."""
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


def assert_as_fresh(point, space, wiring):
    """Voltages cell by cell are those of a fresh solution, and only cells that are solved for have one."""
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
    """Some cells of other kinds near a random one, or other conductivities."""
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
@settings(max_examples=12, deadline=None)
@example(seed=196, kinds=["goal moved", "goals", "freed"])
@given(
    seed=st.integers(0, 2**32 - 1),
    kinds=st.lists(st.sampled_from(["walls", "freed", "goals", "goal moved", "conductivity"]), min_size=1, max_size=4),
)
def test_random_changes_as_fresh(wiring, seed, kinds):
    rng = np.random.default_rng(seed)
    space = plane((48, 61), seed % 7)
    warm = rg.circuit.WarmStart(**wiring)
    warm.solve(space)
    for kind in kinds:
        space = changed(space, rng, kind)
        if space.goal_connected.any():
            assert_as_fresh(warm.solve(space), space, wiring)
            continue
        with pytest.raises(rg.CircuitError, match="nothing is driven") as fresh:
            rg.solve(rg.compile_space(space, **wiring))
        with pytest.raises(rg.CircuitError) as refused:
            warm.solve(space)
        assert str(refused.value) == str(fresh.value)


@pytest.fixture
def windows_always(monkeypatch):
    """Windows on grids of any size."""
    monkeypatch.setattr("resgrid.circuit.warm_start._SMALL", 0)


@pytest.mark.usefixtures("windows_always")
@pytest.mark.parametrize("wiring", WIRINGS, ids=lambda wiring: wiring["boundary"])
@pytest.mark.parametrize("shape", [(90, 70), (15, 18, 14)], ids=str)
def test_windows_as_fresh(wiring, shape):
    rng = np.random.default_rng(9)
    space = plane(shape, 4)
    warm = rg.circuit.WarmStart(**wiring)
    warm.solve(space)
    kept = 0
    for kind in ("walls", "freed", "goals", "conductivity", "goal moved", "walls", "freed"):
        space = changed(space, rng, kind)
        point = warm.solve(space)
        kept += not point.fresh
        assert_as_fresh(point, space, wiring)
    assert kept


@pytest.mark.usefixtures("windows_always")
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_rings_as_fresh(boundary):
    rng, wiring = np.random.default_rng(5), {"boundary": boundary}
    space = plane((64, 48), 2, periodic=True)
    warm = rg.circuit.WarmStart(**wiring)
    warm.solve(space)
    for kind in ("walls", "freed", "walls", "goals"):
        space = changed(space, rng, kind)
        assert_as_fresh(warm.solve(space), space, wiring)


def room(door, goal=(5, 5)):
    """A plane of 40 x 40 with a wall across, open at some cells of it."""
    cell = np.zeros((40, 40), dtype=np.uint8)
    cell[20] = rg.Cell.OBSTACLE
    cell[20, list(door)] = rg.Cell.FREE
    cell[goal] = rg.Cell.GOAL
    return rg.ConfigurationSpace([rg.Axis("x", 0.0, 1.0, 40), rg.Axis("y", 0.0, 1.0, 40)], cell)


@pytest.mark.usefixtures("windows_always")
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("doors", [((3,), (3, 30), (30,)), ((9,), (), (30,)), ((), (12, 13), ())], ids=str)
def test_doors_that_open_and_close(boundary, doors):
    warm = rg.circuit.WarmStart(boundary=boundary)
    for door in doors:
        space = room(door)
        assert_as_fresh(warm.solve(space), space, {"boundary": boundary})


def boxed_in(cell, low, high):
    """Walls around a box of cells."""
    walls = np.zeros_like(cell, dtype=bool)
    walls[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    walls[tuple(slice(a + 1, b - 1) for a, b in zip(low, high, strict=True))] = False
    cell[walls] = rg.Cell.OBSTACLE


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("low, keeps", [((30, 30), True), ((3, 3), False)], ids=["a corner", "the goal"])
def test_walls_that_cut_a_part_off(boundary, low, keeps):
    before = room(range(40))
    warm = rg.circuit.WarmStart(boundary=boundary)
    warm.solve(before)
    cell = before.cell.copy()
    boxed_in(cell, low, (low[0] + 5, low[1] + 5))
    after = before.with_cells(cell)
    point = warm.solve(after)
    assert_as_fresh(point, after, {"boundary": boundary})
    assert point.fresh != keeps


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_cells_change_where_no_free_cell_has_a_free_neighbour(boundary):
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
        assert_as_fresh(warm.solve(after), after, {"boundary": boundary})


def test_a_start_that_drives():
    wiring = {"boundary": "neumann", "drive": "start", "start": (35, 35)}
    warm = rg.circuit.WarmStart(**wiring)
    for door in ((3,), (3, 20), (20,)):
        assert_as_fresh(warm.solve(room(door)), room(door), wiring)


def test_other_sizes_and_grids_without_two_colours_start_afresh():
    warm = rg.circuit.WarmStart(boundary="neumann")
    line = rg.ConfigurationSpace([rg.Axis("x", 0.0, 1.0, 30)], [2, *[0] * 29])
    for space in (room((3,)), plane((48, 61), 0), line, line):
        point = warm.solve(space)
        assert point.fresh
        assert_as_fresh(point, space, {"boundary": "neumann"})


def test_few_iterations_and_the_same_circuit():
    before = plane((340, 330), 1)
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
def test_a_goal_at_the_rim_of_a_window(goal):
    """The surroundings follow along a mode that knows of no goal among them."""
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


def test_an_error_leaves_nothing_behind():
    warm = rg.circuit.WarmStart()
    warm.solve(room((3,)))
    with pytest.raises(rg.InputError, match="no goal cell"):
        warm.solve(room((3,)).with_cells(np.zeros((40, 40), dtype=np.uint8)))
    point = warm.solve(room((4,)))
    assert point.fresh
    assert_as_fresh(point, room((4,)), {})


def test_rails_of_cells_are_refused():
    with pytest.raises(rg.InputError, match="merged"):
        rg.circuit.WarmStart(rails="cells")


def test_what_is_no_space_is_refused():
    with pytest.raises(rg.InputError, match="must be a ConfigurationSpace"):
        rg.circuit.WarmStart().solve("rooms.toml")
    with pytest.raises(rg.InputError, match="progress = 1 must be"):
        rg.circuit.WarmStart().solve(room((3,)), progress=1)


def test_changes_in_several_places_are_joined_where_their_windows_meet():
    """Two places apart, and a third that meets the second one alone."""
    changed = np.zeros((400, 400), dtype=bool)
    changed[[8, 300, 330], [8, 300, 330]] = True
    boxes = _boxes_around(changed)
    assert boxes is not None and len(boxes) == 2


def test_levels_that_do_not_serve_any_more_are_made_anew():
    """Goals, walls and conductivities over many decades: old levels stagnated, and no answer came."""
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
def test_voltages_over_many_decades(boundary, seed):
    """Guesses with small residuals and large errors were taken, and steps of strong conductances for the last ones."""
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
def test_cells_freed_where_nothing_conducts(boundary):
    before = room(range(40), goal=(35, 35))
    cell = np.pad(before.cell, ((0, 80), (0, 80)), constant_values=rg.Cell.FREE)
    axes = [rg.Axis(name, 0.0, 1.0, 120) for name in "xy"]
    warm = rg.circuit.WarmStart(boundary=boundary)
    for low, high, kind in ((0, 0, 0), (70, 120, rg.Cell.OBSTACLE), (118, 120, rg.Cell.FREE)):
        cell[low:high, low:high] = kind
        space = rg.ConfigurationSpace(axes, cell.copy())
        assert_as_fresh(warm.solve(space), space, {"boundary": boundary})
