"""Cells that become obstacles or goals after factoring: the same answer as that of the changed space, compiled anew."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from support.spaces import space_of, spaces

from resgrid.axis import Axis
from resgrid.compiler import compile_space
from resgrid.errors import CircuitError, InputError
from resgrid.nodal import methods
from resgrid.nodal.multigrid.board_setup import compensate
from resgrid.nodal.multigrid.grid_levels import GridLevels
from resgrid.nodal.solve import factor, solve
from resgrid.nodal.update.window import window_depth
from resgrid.nodal.watch import Watch
from resgrid.space import Cell, ConfigurationSpace

BOUNDARIES = [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 7e3}]


def boxes(shape: tuple[int, ...], seed: int, periodic: bool = False) -> ConfigurationSpace:
    """Random boxes as obstacles, the goal in the middle of a free place."""
    rng = np.random.default_rng(seed)
    cell = np.zeros(shape, dtype=np.uint8)
    while np.mean(cell) < 0.15:
        low, side = rng.integers(0, shape), rng.integers(1, np.array(shape) // 6 + 2)
        cell[tuple(slice(a, a + b) for a, b in zip(low, side, strict=True))] = 1
    middle = tuple(size // 2 for size in shape)
    cell[tuple(slice(m - 2, m + 3) for m in middle)] = 0
    cell[middle] = 2
    axes = [Axis("xyzw"[a], 0, n, n, periodic and a == 0) for a, n in enumerate(shape)]
    return ConfigurationSpace(axes, cell)


def changed(space: ConfigurationSpace, cells: np.ndarray, to: int) -> ConfigurationSpace:
    cell = space.cell.copy()
    cell[tuple(cells.T)] = to
    return ConfigurationSpace(space.axes, cell, space.conductivity)


def assert_compensated(grid: GridLevels) -> None:
    """The diagonal of the board for products is that of all places summed anew."""
    true, board = grid.true, grid.board
    red = np.divide(1.0, true.red_inverse, out=np.zeros_like(true.red_inverse), where=true.red_inverse > 0)
    degree = np.stack([red, true.black_degree])
    leak = degree.copy()
    for face, away in zip(true.faces, true.distance.tolist(), strict=True):
        leak[0] -= face
        leak[1] -= np.roll(face, away)
    np.subtract.at(leak, (0, true.link_red), true.links)
    np.subtract.at(leak, (1, true.link_black), true.links)
    leak[leak < 1e-13 * degree] = 0.0
    expected = np.empty_like(true.black_degree)
    compensate(
        board.faces, board.distance, board.margin, board.link_red, board.link_black, board.links, board.red_inverse,
        leak, expected,
    )  # fmt: skip
    np.testing.assert_allclose(grid.exact.black_degree, expected, rtol=1e-13)


def voltage_by_cell(system: object, x: np.ndarray) -> np.ndarray:
    """Voltages of the cells that have a row, NaN elsewhere."""
    node = system.netlist.cells.node.ravel()
    row = np.where(node >= 0, system.unknown[node], -1)
    return np.where(row >= 0, x[row] + system.reference, np.nan)


def free_cells(space: ConfigurationSpace, count: int, seed: int) -> np.ndarray:
    free = np.argwhere(space.goal_connected)
    return np.random.default_rng(seed).permutation(free)[:count]


def assert_same_as_fresh(factors: object, space: ConfigurationSpace, options: dict[str, object]) -> None:
    """Normwise and entrywise."""
    netlist = compile_space(space, **options)
    fresh = solve(netlist, method="direct")
    system = factors.system
    x = factors.solve(system.feed + system.injected, rtol=1e-12)
    found = voltage_by_cell(system, x)
    node = netlist.cells.node.ravel()
    expected = np.where(node >= 0, fresh.voltage[node], np.nan)
    both = np.isfinite(found) & np.isfinite(expected) & (space.cell.ravel() == Cell.FREE)
    assert both.any()
    np.testing.assert_allclose(found[both], expected[both], rtol=0, atol=1e-7 * np.nanmax(np.abs(expected)))
    if system.rails is None or fresh.log_drop is None:
        return
    watch = Watch()
    drop, error = factors.solve_nonnegative(system.rails.to_low, watch=watch)
    # Nothing is proved of cells between goals alone, through which no current flows.
    assert watch.bound < 1e-8 or error < 1e-25
    log_drop = voltage_by_cell(system, drop.log) - system.reference
    expected = np.where(node >= 0, fresh.log_drop[node], np.nan)
    both &= np.isfinite(expected)
    np.testing.assert_allclose(
        log_drop[both], expected[both], rtol=1e-15, atol=min(watch.bound + fresh.entry_error, 1e-8) + 1e-15
    )


@pytest.fixture
def whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is eliminated beforehand."""
    monkeypatch.setattr(methods, "may_reduce", lambda _: False)


@settings(max_examples=60)
@given(
    spaces(),
    st.sampled_from(BOUNDARIES),
    st.sampled_from(["direct", "multigrid"]),
    st.sampled_from([Cell.OBSTACLE, Cell.GOAL]),
    st.integers(1, 4),
    st.integers(0, 1000),
)
def test_small_spaces_after_an_update(
    space: ConfigurationSpace, options: dict[str, object], method: str, to: Cell, count: int, seed: int
) -> None:
    cells = free_cells(space, count, seed)
    assume(len(cells) > 0)
    after = changed(space, cells, to)
    try:
        before = compile_space(space, **options)
        factors = factor(before, method=method)
        solve(compile_space(after, **options))
        updated = factors.update(cells, to)
    except (CircuitError, InputError):
        assume(False)
    assume(updated.system.size > len(updated.change.pinned))
    assert_same_as_fresh(updated, after, options)


@pytest.mark.parametrize("options", BOUNDARIES)
@pytest.mark.parametrize("shape", [(70, 60), (20, 18, 16), (9, 10, 9, 8)])
@pytest.mark.usefixtures("whole")
def test_multigrid_keeps_its_levels_and_finds_the_new_answer(
    shape: tuple[int, ...], options: dict[str, object]
) -> None:
    space = boxes(shape, len(shape), periodic=len(shape) == 2)
    factors = factor(compile_space(space, **options), method="multigrid")
    old = factors.solve(factors.system.feed + factors.system.injected)
    cells = free_cells(space, 6, 1)
    after = changed(space, cells, Cell.OBSTACLE)
    updated = factors.update(cells)
    assert updated.change.reason == ""
    assert_compensated(updated.hierarchy.grid)
    assert_same_as_fresh(updated, after, options)
    right = updated.system.feed + updated.system.injected
    exact = updated.solve(right, rtol=1e-13)
    cold, warm = Watch(), Watch()
    updated.solve(right, rtol=1e-8, watch=cold)
    found = updated.solve(right, rtol=1e-8, guess=old, watch=warm)
    assert warm.iterations < cold.iterations
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-6 * np.abs(exact).max())
    assert updated.change.space(space).cell.tolist() == after.cell.tolist()
    # And again, on top: some become goals.
    more = free_cells(after, 3, 2)
    assert_same_as_fresh(updated.update(more, Cell.GOAL), changed(after, more, Cell.GOAL), options)


def test_directions_end_with_a_burst_that_went_below_rounding() -> None:
    # Six black cells: the third step ends in noise, to which the true residual is not orthogonal.
    cell = np.zeros((4, 2, 2), dtype=np.uint8)
    cell[2, 0, 1], cell[3, 1, 1] = Cell.OBSTACLE, Cell.GOAL
    space = space_of(cell, periodic=(True, False, False))
    cells = np.array([[2, 1, 1], [0, 1, 0], [2, 0, 0], [1, 0, 1]])
    updated = factor(compile_space(space), method="multigrid").update(cells)
    assert_same_as_fresh(updated, changed(space, cells, Cell.OBSTACLE), {})


@pytest.mark.parametrize("options", BOUNDARIES)
@pytest.mark.usefixtures("whole")
def test_boards_cover_what_carries_current_and_are_patched_there(options: dict[str, object]) -> None:
    inner = boxes((70, 60), 2)
    cell = np.pad(inner.cell, ((37, 5), (21, 60)), constant_values=Cell.OBSTACLE)
    pocket = np.array([[3, 4]])
    cell[3, 4] = Cell.FREE if options.get("boundary") == "neumann" else Cell.OBSTACLE
    space = space_of(cell)
    factors = factor(compile_space(space, **options), method="multigrid")
    rows = np.argwhere(np.isfinite(voltage_by_cell(factors.system, factors.system.excess)).reshape(cell.shape))
    covered = [(ends.start, ends.stop) for ends in factors.hierarchy.box]
    assert covered == list(zip(rows.min(axis=0) // 32 * 32, rows.max(axis=0) + 1, strict=True))
    assert covered[0][0] == 32 and covered[1][1] <= 81
    cells = np.concatenate([free_cells(inner, 6, 1) + np.array([37, 21]), pocket[space.cell[3:4, 4] == Cell.FREE]])
    updated = factors.update(cells)
    assert updated.change.reason == ""
    assert_compensated(updated.hierarchy.grid)
    assert_same_as_fresh(updated, changed(space, cells, Cell.OBSTACLE), options)


@pytest.mark.usefixtures("whole")
def test_blocks_around_a_change_are_those_of_the_changed_space() -> None:
    space = boxes((300, 280), 9)
    cells = np.array([[40, 50], [41, 50], [40, 51], [250, 200], [160, 145]])
    assert space.goal_connected[tuple(cells.T)].all()
    updated = factor(compile_space(space), method="multigrid").update(cells)
    assert updated.change.reason == ""
    assert len(updated.windows) == 3
    fresh = factor(compile_space(changed(space, cells, Cell.OBSTACLE)), method="multigrid")
    patched, anew = updated.hierarchy.grid, fresh.hierarchy.grid
    scale = updated.hierarchy.unit / fresh.hierarchy.unit
    np.testing.assert_allclose(scale * patched.true.faces, anew.true.faces, rtol=1e-12)
    assert_compensated(patched)
    depth = window_depth(space.shape, len(anew.boards.margin))
    assert depth == 2
    places = anew.boards.places[depth]
    assert np.array_equal(patched.boards.places, anew.boards.places)
    np.testing.assert_allclose(scale * patched.boards.faces[: 4 * places], anew.boards.faces[: 4 * places], rtol=1e-5)
    for name in ("red_inverse", "black_inverse"):
        for level in ("board", "boards"):
            here, there = (getattr(getattr(grid, level), name)[:places] for grid in (patched, anew))
            alike = (here > 0) == (there > 0)
            assert np.count_nonzero(~alike) <= (len(cells) if level == "board" else 0)
            np.testing.assert_allclose(here[alike] / scale, there[alike], rtol=1e-5)


@pytest.mark.parametrize("options", BOUNDARIES)
@pytest.mark.usefixtures("whole")
def test_a_new_thin_wall_with_a_gap(options: dict[str, object]) -> None:
    space = boxes((120, 110), 8)
    factors = factor(compile_space(space, **options), method="multigrid")
    wall = np.array([[k, 70] for k in range(30, 61) if space.cell[k, 70] == Cell.FREE and k != 44])
    updated = factors.update(wall)
    assert updated.change.reason == ""
    assert_same_as_fresh(updated, changed(space, wall, Cell.OBSTACLE), options)
    old = factors.solve(factors.system.drive)
    watch = Watch()
    updated.solve(updated.system.drive, rtol=1e-8, guess=old, watch=watch)
    assert watch.iterations <= 12


@pytest.mark.parametrize("options", BOUNDARIES)
@pytest.mark.usefixtures("whole")
def test_uneven_rings(options: dict[str, object]) -> None:
    rng = np.random.default_rng(11)
    cell = boxes((64, 48), 11).cell
    axes = [Axis("x", 0, 1, 64, True), Axis("y", 0, 1, 48, True)]
    space = ConfigurationSpace(axes, cell, rng.uniform(0.2, 5.0, cell.shape))
    factors = factor(compile_space(space, **options), method="multigrid")
    cells = np.array([[0, k] for k in range(10, 14) if cell[0, k] == Cell.FREE] + [[63, 47], [20, 0]])
    cells = cells[space.goal_connected[tuple(cells.T)]]
    updated = factors.update(cells)
    assert updated.change.reason == ""
    assert_same_as_fresh(updated, changed(space, cells, Cell.OBSTACLE), options)


@pytest.mark.usefixtures("whole")
def test_changes_all_over_the_grid_are_coarsened_anew() -> None:
    space = boxes((180, 170), 9)
    cells = free_cells(space, 300, 1)
    updated = factor(compile_space(space), method="multigrid").update(cells)
    assert "all over the grid" in updated.change.reason
    assert_same_as_fresh(updated, changed(space, cells, Cell.OBSTACLE), {})


@pytest.mark.usefixtures("whole")
def test_the_factor_before_an_update_is_left_as_it_was() -> None:
    space = boxes((40, 40), 3)
    factors = factor(compile_space(space), method="multigrid")
    right = factors.system.feed + factors.system.injected
    before = factors.solve(right)
    factors.update(free_cells(space, 5, 1)).solve(right)
    assert np.array_equal(factors.solve(right), before)


@pytest.mark.parametrize("options", BOUNDARIES)
@pytest.mark.usefixtures("whole")
def test_a_part_that_is_cut_off_is_told_and_solved(options: dict[str, object]) -> None:
    cell = np.zeros((40, 30), dtype=np.uint8)
    cell[20, 1:] = 1
    cell[5, 5] = 2
    space = space_of(cell)
    factors = factor(compile_space(space, **options), method="multigrid")
    door = np.array([[20, 0]])
    updated = factors.update(door)
    assert "in parts" in updated.change.reason
    after = changed(space, door, Cell.OBSTACLE)
    system = updated.system
    netlist = compile_space(after, **options)
    fresh = solve(netlist)
    found = voltage_by_cell(system, updated.solve(system.feed + system.injected, rtol=1e-12)).reshape(cell.shape)
    np.testing.assert_allclose(found[:20][cell[:20] == 0], fresh.voltage[netlist.cells.node[:20][cell[:20] == 0]])
    with pytest.raises(CircuitError, match="nothing is driven any more"):
        updated.update([[4, 5], [6, 5], [5, 4], [5, 6]])


@pytest.mark.parametrize("options", BOUNDARIES)
@pytest.mark.usefixtures("whole")
def test_rows_that_are_left_without_neighbours_are_solved(options: dict[str, object]) -> None:
    cell = np.full((7, 7), Cell.OBSTACLE, dtype=np.uint8)
    cell[3, 1:6] = cell[1:6, 3] = Cell.FREE
    cell[3, 3] = Cell.GOAL
    space, ends = space_of(cell), np.array([[3, 1], [3, 5], [1, 3], [5, 3]])
    updated = factor(compile_space(space, **options), method="multigrid").update(ends)
    assert_same_as_fresh(updated, changed(space, ends, Cell.OBSTACLE), options)


def test_a_start_behind_the_way_out_drives_nothing() -> None:
    corridor = np.zeros((30, 1), dtype=np.uint8)
    corridor[0] = 2
    netlist = compile_space(space_of(corridor), boundary="neumann", drive="start", start=(29, 0))
    factors = factor(netlist)
    with pytest.raises(CircuitError, match="nothing is driven any more"):
        factors.update([[10, 0]])
    with pytest.raises(InputError, match="driven start"):
        factors.update([[29, 0]])


def test_what_cannot_be_updated_is_refused() -> None:
    cell = np.zeros((12, 12), dtype=np.uint8)
    cell[3, 3], cell[8, 8] = 2, 1
    factors = factor(compile_space(space_of(cell)))
    for cells, to, message in (
        ([[1, 1]], Cell.FREE, "factor the changed space anew"),
        ([[1, 1]], 7, "Cell.OBSTACLE or Cell.GOAL"),
        ([[12, 1]], Cell.OBSTACLE, "not in the grid"),
        ([[1, 1, 1]], Cell.OBSTACLE, "whole numbers"),
        ([[1.5, 1]], Cell.OBSTACLE, "whole numbers"),
        ([[1, 1], [2]], Cell.OBSTACLE, "one length"),
        ([[3, 3]], Cell.OBSTACLE, "goal"),
        ([[8, 8]], Cell.GOAL, "obstacle"),
    ):
        with pytest.raises(InputError, match=message):
            factors.update(cells, to)
    with pytest.raises(InputError, match="merged"):
        factor(compile_space(space_of(cell), rails="cells")).update([[1, 1]])
    nothing = factors.update(np.empty((0, 2), dtype=int))
    assert nothing.change is not None
    assert nothing.system is factors.system
    assert factors.update([[8, 8]]).change.cells.size == 0


@pytest.mark.parametrize("method", ["direct", "multigrid"])
@pytest.mark.parametrize("options", [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 1e12}])
@pytest.mark.usefixtures("whole")
def test_two_threads_find_the_same_digits(method: str, options: dict[str, object]) -> None:
    netlist = compile_space(boxes((50, 45), 4), **options)
    one, two = solve(netlist, method=method), solve(netlist, method=method, threads=2)
    assert np.array_equal(one.voltage, two.voltage, equal_nan=True)
    assert np.array_equal(one.resistor_log_current, two.resistor_log_current)


@pytest.mark.usefixtures("whole")
def test_iterations_errors_and_progress_are_told() -> None:
    netlist = compile_space(boxes((60, 50), 5))
    told: list[tuple[int, float, float | None]] = []
    point = solve(netlist, method="multigrid", accuracy="normwise", progress=lambda *step: told.append(step))
    assert point.iterations == len(told) > 3
    assert [step[0] for step in told] == list(range(1, len(told) + 1))
    assert 0 < point.backward_error <= 1e-10
    assert told[-1][1] < told[0][1]
    assert all(left is None or left >= 0 for _, _, left in told)
    direct = solve(netlist, method="direct")
    assert direct.iterations == 0
    assert 0 <= direct.backward_error < 1e-25


@pytest.mark.usefixtures("whole")
def test_an_interrupt_ends_an_iteration_between_two_steps() -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    for threads in (1, 2):
        with pytest.raises(KeyboardInterrupt):
            solve(
                compile_space(boxes((50, 45), 4), boundary="wall", wall_resistance=1e12),
                method="multigrid",
                threads=threads,
                progress=interrupt,
            )


@pytest.mark.usefixtures("whole")
def test_a_guess_spares_steps_and_a_wrong_one_does_no_harm() -> None:
    for method in ("multigrid", "direct"):
        factors = factor(compile_space(boxes((60, 50), 6)), method=method)
        right = factors.system.feed + factors.system.injected
        x = factors.solve(right, rtol=1e-12)
        watch = Watch()
        assert np.allclose(factors.solve(right, rtol=1e-8, guess=x, watch=watch), x, atol=1e-9)
        assert watch.iterations == 0
        wild = np.random.default_rng(0).standard_normal(len(x))
        assert np.allclose(factors.solve(right, rtol=1e-10, guess=wild), x, atol=1e-6)
    with pytest.raises(InputError, match="guess has shape"):
        factor(compile_space(boxes((60, 50), 6)), method="multigrid").solve(right, guess=x[:-1])
