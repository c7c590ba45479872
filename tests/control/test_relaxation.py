"""Grids that settle while a robot moves: three emulations, against operating point, transient and eigenvectors.

Tests internals: `resgrid.control.plant`, `resgrid.control.relaxation`, `resgrid.control.simulation`,
`resgrid.core.netlist`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given, settings, strategies as st
from support.hidden import controlled, hiding, square

import resgrid as rg
from resgrid.control.plant import make_plant
from resgrid.control.relaxation import TICK, Relaxation, RelaxingGrid, field_now
from resgrid.control.simulation import announce_hidden
from resgrid.core.netlist import GROUND

BLOCK = rg.Box((2.0, 3.0), (6.5, 4.0))


def announced_simulation(
    relaxation: Relaxation, before: rg.ConfigurationSpace, after: rg.ConfigurationSpace
) -> rg.control.Simulation:
    plant = make_plant(rg.PointRobot(), after.axes, [])
    return rg.control.Simulation(
        controlled(after, 1.0), plant, relaxation=relaxation, before=controlled(before, 1.0).field
    )


def space_with_wall(cells: int = 16) -> rg.ConfigurationSpace:
    space = square(cells)
    cell = np.array(space.cell)
    cell[4 : cells - 3, cells // 2] = rg.Cell.OBSTACLE
    return rg.ConfigurationSpace(space.axes, cell)


@pytest.mark.parametrize(("method", "steps"), [("jacobi", 20_000), ("sor", 3000), ("chip", 60_000)])
@pytest.mark.parametrize("k", [1.0, 0.98, 0.0])
def test_all_emulations_settle_at_the_operating_point(method: str, steps: int, k: float) -> None:
    before, after = square(), space_with_wall()
    grid = RelaxingGrid(Relaxation(method, pace=steps / 10), controlled(before, k).field)
    assert grid.distance == 0.0
    grid.change(after)
    assert grid.distance > 0.05
    grid.advance(10.0)
    shown, true = grid.field, controlled(after, k).field
    np.testing.assert_allclose(shown.potential, true.potential, rtol=1e-5, atol=1e-9)
    for axis in range(2):
        np.testing.assert_allclose(shown.face_current(axis), true.face_current(axis), rtol=1e-4, atol=1e-8)


def test_the_chip_emulation_equals_the_transient_of_the_netlist() -> None:
    """The transient has other resistances, capacitances and methods; potentials must agree."""
    before, after = square(), space_with_wall()
    resistance, capacitance = 10e3, 1e-13
    chips = []
    for space in (before, after):
        netlist = rg.compile_space(space, resistance=resistance)
        free = netlist.cells.free_node
        pairs = np.stack([free, np.full_like(free, GROUND)], axis=1)
        chips.append(netlist.replace(capacitor_nodes=pairs, capacitance=np.full(len(free), capacitance)))
    times = np.array([1.0, 4.0, 16.0])
    fine = rg.circuit.transient(chips[1], times * resistance * capacitance, initial=rg.solve(chips[0]), tolerance=1e-8)
    grid = RelaxingGrid(Relaxation("chip", pace=0.05), controlled(before, 1.0).field)
    grid.change(after)
    now = 0.0
    for row, time in enumerate(times):
        grid.advance((time - now) / 0.05)
        now = time
        node = chips[1].cells.node
        np.testing.assert_allclose(grid.field.potential, fine.voltage[row][node], atol=1e-3)


def test_a_jacobi_sweep_replaces_each_value_by_the_mean_of_its_neighbours() -> None:
    before, after = square(10), space_with_wall(10)
    grid = RelaxingGrid(Relaxation("jacobi", pace=1.0), controlled(before, 1.0).field)
    phi = np.array(rg.field(rg.solve(rg.compile_space(before))).potential)
    grid.change(after)
    for _ in range(3):
        grid.advance(1.0)
        rails = np.where(after.cell == rg.Cell.OBSTACLE, 1.0, np.where(after.cell == rg.Cell.GOAL, 0.0, phi))
        wide = np.pad(rails, 1, constant_values=1.0)
        mean = (wide[2:, 1:-1] + wide[:-2, 1:-1] + wide[1:-1, 2:] + wide[1:-1, :-2]) / 4
        phi = np.where(after.cell == rg.Cell.FREE, mean, rails)
        np.testing.assert_allclose(grid.field.potential, phi, rtol=1e-12)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.sampled_from(["jacobi", "sor", "chip"]), st.floats(0.01, 50.0))
def test_settling_fields_have_no_current_into_obstacles_and_keep_the_rail_voltages(seed, method, pace) -> None:
    rng = np.random.default_rng(seed)
    cell = np.where(rng.random((9, 8)) < 0.2, rg.Cell.OBSTACLE, rg.Cell.FREE).astype(np.uint8)
    cell[4, 4] = rg.Cell.GOAL
    axes = [rg.Axis("x", 0, 9, 9, periodic=True), rg.Axis("y", 0, 8, 8)]
    before = rg.ConfigurationSpace(axes, cell)
    after = rg.ConfigurationSpace(axes, np.where((rng.random((9, 8)) < 0.2) & (cell == 0), np.uint8(1), cell))
    assume(before.goal_connected.any())  # otherwise no cell is driven
    grid = RelaxingGrid(Relaxation(method, pace=pace), controlled(before, 1.0).field)
    grid.change(after)
    for _ in range(4):
        grid.advance(1.0)
        field = grid.field
        inside = field.potential[np.isfinite(field.potential)]
        assert np.all(inside <= 1.0)
        assert method == "sor" or np.all(inside >= 0.0)
        wall = after.cell == rg.Cell.OBSTACLE
        for axis in range(2):
            low = np.moveaxis(field.face_direction[axis], axis, 0)[:-1]
            high = np.moveaxis(field.face_direction[axis], axis, 0)[1:]
            blocked_cells = np.moveaxis(wall, axis, 0)
            assert np.all(low[blocked_cells] <= 0)
            assert np.all(high[blocked_cells] >= 0)


def test_field_now_of_an_operating_point_equals_its_field() -> None:
    netlist = rg.compile_space(space_with_wall(), boundary="wall", wall_resistance=2e4)
    point = rg.solve(netlist)
    shown, true = field_now(netlist, point.voltage), rg.field(point)
    np.testing.assert_allclose(shown.potential, true.potential, rtol=1e-12, atol=1e-15)
    for axis in range(2):
        np.testing.assert_allclose(shown.face_current(axis), true.face_current(axis), rtol=1e-6, atol=1e-12)
    with pytest.raises(rg.InputError, match="not compiled from a space"):
        field_now(netlist.replace(cell_map=None), point.voltage)


def test_a_slow_robot_never_waits_and_a_fast_one_stalls_after_its_patience() -> None:
    """A slow robot takes the same time as on a settled grid."""
    sim = hiding([BLOCK], robot=rg.PointRobot(), learn=False)
    world = announce_hidden(sim, Relaxation("chip"))
    slow, usual, fast = (replace(world, relaxation=Relaxation("chip", pace=p)).run((4.1, 7.3)) for p in (500, 15, 5e-3))
    settled = replace(world, relaxation=None, before=None).run((4.1, 7.3))
    assert slow.ending is usual.ending is settled.ending is rg.control.TerminationReason.ARRIVED
    assert slow.time[-1] == pytest.approx(settled.time[-1], rel=0.05)
    assert rg.control.ControlMode.WAITING not in slow.mode
    assert fast.ending is rg.control.TerminationReason.STALLED
    waited = np.diff(fast.time)[fast.mode[:-1] == rg.control.ControlMode.WAITING].sum()
    assert waited * sim.controller.speed / sim.space.spacing.min() >= Relaxation().patience - 1.0


def test_a_robot_waits_at_zero_velocity_until_the_grid_has_settled() -> None:
    sim = announce_hidden(hiding([BLOCK], robot=rg.PointRobot(), learn=False), Relaxation("jacobi", pace=1.5))
    run = replace(sim, relaxation=replace(sim.relaxation, patience=1e4)).run((4.1, 7.3))
    assert run.ending is rg.control.TerminationReason.ARRIVED
    assert run.penetration == 0.0
    assert np.all(sim.space.cell[tuple(sim.space.locate(run.configuration).T)] != rg.Cell.OBSTACLE)
    assert rg.control.ControlMode.WAITING in run.mode
    waits = run.mode == rg.control.ControlMode.WAITING
    assert np.all(run.velocity[waits] == 0.0)
    impatient = replace(sim, relaxation=replace(sim.relaxation, pace=1e-3, patience=2.0)).run((4.1, 7.3))
    assert impatient.ending is rg.control.TerminationReason.STALLED
    assert "waiting" in impatient.message


def test_learning_with_a_settling_grid_arrives_and_learns_only_true_obstacles() -> None:
    sim = replace(hiding([rg.Box((3.0, 3.0), (5.5, 4.0))]), relaxation=Relaxation("chip", pace=20.0))
    run = sim.run((4.1, 7.3))
    assert run.ending is rg.control.TerminationReason.ARRIVED
    assert run.lessons
    assert run.penetration == 0
    assert not np.any(run.learnt & (sim.plant.true_space(sim.space).cell != rg.Cell.OBSTACLE))


def test_the_wavefront_spreads_and_its_distance_decreases() -> None:
    front = rg.control.wavefront(
        announced_simulation(Relaxation(pace=1.0), square(), space_with_wall()), np.array([0.0, 0.2, 1.0, 500.0])
    )
    assert front.potential.shape == (4, 16, 16)
    assert np.all(np.diff(front.distance) < 0)
    change = np.abs(front.potential - front.first)
    reached = [(change[row] > 1e-3).sum() for row in range(3)]
    assert reached == sorted(reached)
    assert reached[0] < reached[-1]
    for times in ([1.0, 0.0], [np.nan], []):
        with pytest.raises(rg.InputError, match="ascending"):
            rg.control.wavefront(announced_simulation(Relaxation(), square(), space_with_wall()), np.array(times))
    with pytest.raises(rg.InputError, match="one grid"):
        rg.control.wavefront(announced_simulation(Relaxation(), square(12), space_with_wall(16)), np.array([1.0]))
    with pytest.raises(rg.InputError, match="no change was announced"):
        rg.control.wavefront(hiding([BLOCK]), np.array([1.0]))


def settled_after(relaxation: Relaxation, before: rg.ConfigurationSpace, after: rg.ConfigurationSpace) -> float:
    """Return the sweeps, or multiples of ``R C``, until all potentials are within half a 10-bit step of the end."""
    front = rg.control.wavefront(announced_simulation(relaxation, before, after), TICK * np.arange(2000))
    outside = np.flatnonzero(front.distance > 0.5 / 2**10)
    assert outside[-1] < len(front.cells) - 1
    return float(front.cells[outside[-1] + 1] * relaxation.pace)


@pytest.mark.slow
def test_settle_times_of_the_emulations_have_the_expected_ratios() -> None:
    """A Jacobi sweep of cells with four neighbours is an explicit Euler step of R C / 4."""
    paces = {"jacobi": 5.0, "sor": 5.0, "chip": 1.0}
    times = {
        method: settled_after(Relaxation(method, pace), square(), space_with_wall()) for method, pace in paces.items()
    }
    assert times["jacobi"] == pytest.approx(4 * times["chip"], rel=0.25)
    assert times["sor"] < 0.5 * times["jacobi"]


def test_invalid_settle_options_and_covered_goals_raise_input_error(scenes: Path) -> None:
    scene = rg.read_scene(scenes / "lesson.toml")
    for options, says in (({"settle": "gauss"}, "settle"), ({"pace": 0.0}, "pace"), ({"pace": np.nan}, "pace")):
        with pytest.raises(rg.InputError, match=says):
            rg.simulation(scene, **options)
    with pytest.raises(rg.InputError, match="cover every goal"):
        announce_hidden(hiding([rg.Box((4.0, 0.5), (4.5, 1.0))], robot=rg.PointRobot()), Relaxation())


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.sampled_from(["jacobi", "sor", "chip"]), st.floats(0.3, 30.0))
@example(193, "jacobi", 1.0)
@example(1183, "sor", 1.0)
@pytest.mark.slow
def test_a_patient_robot_arrives_without_entering_obstacles(seed, method, pace) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0.5, 6.0, (3, 2))
    boxes = [rg.Box(tuple(low), tuple(low + rng.uniform(0.3, 1.7, 2))) for low in corners]
    sim = hiding(boxes, robot=rg.PointRobot(), learn=False)
    truth = sim.plant.true_space(sim.space)
    starts = np.argwhere(truth.goal_connected)
    if not truth.goal_count or not len(starts):
        return
    world = announce_hidden(sim, Relaxation(method, pace=pace, patience=1e5))
    run = world.run(truth.centre(starts[rng.integers(len(starts))]))
    assert run.ending is rg.control.TerminationReason.ARRIVED, run.message
    assert run.penetration == 0.0
    assert np.all(truth.cell[tuple(truth.locate(run.configuration).T)] != rg.Cell.OBSTACLE)


@pytest.mark.slow
@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_settle_time_is_within_5_percent_of_the_eigenvector_solution(seed) -> None:
    """The reference uses the eigenvectors of a grid of 1 ohm and 1 farad that is assembled here."""
    rng = np.random.default_rng(seed)
    size = 10
    cell = np.zeros((size, size), np.uint8)
    cell[tuple(rng.integers(1, size - 1, 2))] = rg.Cell.GOAL
    changed = cell.copy()
    row, column = rng.integers(0, size - 4, 2)
    changed[row : row + 2, column : column + 4] |= np.uint8(cell[row : row + 2, column : column + 4] == 0)

    def grid(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        free = cells.ravel() == rg.Cell.FREE
        matrix, drive = 4.0 * np.eye(size**2), np.zeros(size**2)
        for at in range(size**2):
            for other, inside in ((at - size, at >= size), (at + size, at < size**2 - size), (at - 1, at % size),
                                  (at + 1, (at + 1) % size)):  # fmt: skip
                if inside:
                    matrix[at, other] -= cells.ravel()[other] == rg.Cell.FREE
                    drive[at] += cells.ravel()[other] == rg.Cell.GOAL
        return matrix[np.ix_(free, free)], drive[free]

    first, end = np.zeros(size**2), grid(changed)
    first[cell.ravel() == 0] = np.linalg.solve(*grid(cell))
    away = first[changed.ravel() == 0] - np.linalg.solve(*end)
    rates, ways = np.linalg.eigh(end[0])
    times = np.linspace(0, 120, 4001)
    distance = np.abs((np.exp(-np.outer(times, rates)) * (ways.T @ away)) @ ways.T).max(axis=1)
    assume(distance[0] > 0.01)
    settled = times[np.flatnonzero(distance > 0.5 / 2**10)[-1]]
    axes = [rg.Axis("x", 0, size, size), rg.Axis("y", 0, size, size)]
    spaces = rg.ConfigurationSpace(axes, cell), rg.ConfigurationSpace(axes, changed)
    assert settled_after(Relaxation(pace=0.5), *spaces) == pytest.approx(settled, rel=0.05)
