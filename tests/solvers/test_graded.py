"""Levels graded by the potential, against direct solutions and dense algebra: all decades at once, slits and all."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from support.levels import matrix_of, preconditioned
from support.spaces import serpentine, space_of, spaces

from resgrid.axis import Axis
from resgrid.circuit.equations import Equations, assemble
from resgrid.circuit.solve import solve
from resgrid.compiler import compile_space
from resgrid.errors import CircuitError
from resgrid.netlist import Netlist
from resgrid.solvers import decay
from resgrid.solvers.decay import foresee_decades
from resgrid.solvers.laplacian import Laplacian, count_connections
from resgrid.solvers.monitor import Watch
from resgrid.solvers.multigrid import h_transform
from resgrid.solvers.multigrid.conjugate_gradients import iterate
from resgrid.solvers.multigrid.h_transform import at_slots, nested_iteration
from resgrid.solvers.multigrid.hierarchy import Hierarchy, build_hierarchy
from resgrid.solvers.multigrid.krylov import scatter_rows
from resgrid.space import ConfigurationSpace


@pytest.fixture(scope="module", autouse=True)
def graded() -> Iterator[None]:
    """Levels are graded however little the potential falls."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decay, "_FAR", 2.0)
        patch.setattr(decay, "_FIXED", 0.0)
        patch.setattr(decay, "_FAR_IN_VOLUMES", 2.0)
        yield


def rooms(size: int = 200) -> NDArray[np.uint8]:
    """Rectangles in a room, its goal in a corner."""
    rng, cell = np.random.default_rng(5), np.zeros((size, size), dtype=np.uint8)
    for _ in range(size**2 // 300):
        i, j = rng.integers(8, size, 2)
        cell[i : i + rng.integers(2, 14), j : j + rng.integers(2, 14)] = 1
    cell[0, 0] = 2
    return cell


def with_slits() -> NDArray[np.uint8]:
    """Two rooms joined by a slit of 30 cells, and another slit of 160 that leads out of the first into nowhere."""
    cell = np.ones((63, 172), dtype=np.uint8)
    cell[1:59, 1:60] = cell[1:59, 90:170] = 0
    cell[20, 60:90] = cell[59:61, 10] = cell[61, 10:170] = 0
    cell[1, 1] = 2
    return cell


def log_potential(netlist: Netlist) -> tuple[Equations, NDArray[np.float64]]:
    """The system of a netlist, and the logarithm of its potential at every row, solved directly."""
    system, point = assemble(netlist), solve(netlist, method="direct")
    assert point.log_drop is not None
    log = np.empty(system.size)
    nodes = np.flatnonzero(system.unknown >= 0)
    log[system.unknown[nodes]] = point.log_drop[nodes]
    return system, log


def after_one_pass(system: Equations, hierarchy: Hierarchy) -> tuple[NDArray[np.float64], int]:
    """The potential after one pass, and its iterations."""
    assert system.rails is not None
    watch, b = Watch(), system.rails.to_low
    x, _ = iterate(system.laplacian, hierarchy, b / b.max(), 1e-11, None, watch)
    return x * b.max(), watch.iterations


def test_one_pass_is_right_in_all_decades_where_plain_levels_are_right_in_the_first_ones() -> None:
    system, log = log_potential(compile_space(space_of(rooms()), boundary="dirichlet"))
    assert log.min() < -15 * np.log(10.0)
    levels = h_transform.scalable(system.laplacian)
    assert levels is not None
    height = np.zeros((2, levels.level.lattice.slots))
    scatter_rows(levels.slot, np.exp(log), 1.0, height.ravel())
    plain, steps = after_one_pass(system, build_hierarchy(system.laplacian))
    assert np.abs(plain / np.exp(log) - 1.0).max() > 1.0
    x, more = after_one_pass(system, levels.scaled(height))
    assert np.abs(x / np.exp(log) - 1.0).max() < 1e-4
    assert more <= steps + 2


def test_what_is_foreseen_falls_as_the_potential_does() -> None:
    system, log = log_potential(compile_space(space_of(rooms(400)), boundary="dirichlet"))
    levels = h_transform.scalable(system.laplacian)
    assert levels is not None
    assert system.rails is not None
    height = nested_iteration(levels, at_slots(levels, system.rails.to_low)).ravel()[levels.slot]
    assert height.min() > 0.0
    off = (np.log(height) - log) / np.log(10.0)
    assert log.min() / np.log(10.0) < -15
    assert abs(np.median(off)) < 0.15
    assert np.abs(np.quantile(off, [0.01, 0.99])).max() < 0.5


@settings(max_examples=40)
@given(spaces(max_cells=14, dimensions=(2, 3)), st.integers(0, 2**16))
def test_coarse_levels_are_galerkins_sums_in_proportion_to_the_height(space: ConfigurationSpace, seed: int) -> None:
    try:
        levels = h_transform.scalable(assemble(compile_space(space, boundary="dirichlet")).laplacian)
    except CircuitError:
        return
    if levels is None:
        return
    level, step = levels.level, levels.steps[0]
    plain = replace(step, stretch=np.ones_like(step.stretch), off_stretch=np.ones_like(step.off_stretch))
    used = levels.unknown.ravel()
    h = np.where(used, np.random.default_rng(seed).uniform(0.7, 1.3, used.size), 0.0).reshape(2, -1)
    fresh = h_transform.lay_out_grid(assemble(compile_space(space, boundary="dirichlet")).laplacian)
    assert fresh is not None
    matrix, fine = matrix_of(fresh[0])
    coarse = h_transform.summed(h_transform.transformed(level, levels.first[0], h), plain, fed=True)
    small, nodes = matrix_of(coarse)
    shares = np.zeros((len(fine), len(nodes)))
    shares[np.arange(len(fine)), np.searchsorted(nodes, step.whole_target.ravel()[fine])] = h.ravel()[fine]
    expected = shares.T @ matrix @ shares
    np.testing.assert_allclose(small, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@settings(max_examples=60)
@given(spaces(max_cells=24, dimensions=(2, 2)), st.floats(0.0, 3.0), st.integers(0, 2**16))
def test_a_cycle_makes_a_potential_better_in_proportion(space: ConfigurationSpace, decades: float, seed: int) -> None:
    """From potentials that are off by up to three decades, block by block; the exact one stays as it is."""
    try:
        netlist = compile_space(space, boundary="dirichlet")
        system, log = log_potential(netlist)
    except CircuitError:
        return
    levels = h_transform.scalable(system.laplacian) if system.rails is not None else None
    if levels is None or not np.isfinite(log).all():
        return
    exact, currents = np.zeros((2, levels.level.lattice.slots)), at_slots(levels, system.rails.to_low)
    scatter_rows(levels.slot, np.exp(log), 1.0, exact.ravel())
    laid = h_transform.lay_out_grid(system.laplacian)
    assert laid is not None
    still = h_transform._improved(laid[0], levels.steps, currents, exact.copy())
    here = levels.unknown
    np.testing.assert_allclose(still[here], exact[here], rtol=1e-9)
    step = levels.steps[0]
    wrong = 10.0 ** np.random.default_rng(seed).uniform(-decades, decades, 2 * step.level.lattice.slots)
    x = exact * wrong[step.whole_target]
    for _ in range(3):
        x = h_transform._improved(laid[0], levels.steps, currents, x)
        assert x[here].min() > 0.0
    assert np.abs(np.log10(x[here] / exact[here])).max() < 0.5 * decades + 1e-9


def test_a_graded_step_is_symmetric_where_it_is_linear() -> None:
    system, log = log_potential(compile_space(space_of(rooms(60)), boundary="dirichlet"))
    levels = h_transform.scalable(system.laplacian)
    assert levels is not None
    height = np.zeros((2, levels.level.lattice.slots))
    scatter_rows(levels.slot, np.exp(0.2 * log), 1.0, height.ravel())
    hierarchy = levels.scaled(height)
    assert hierarchy.grid is not None
    assert len(hierarchy.levels.grids) > 0
    assert len(hierarchy.grid.way.weight) > 0
    used = hierarchy.grid.true.black_degree > 0
    a, b = (np.random.default_rng(1).normal(size=(2, len(used))) * used).astype(np.float32)
    assert b @ preconditioned(hierarchy, a) == pytest.approx(a @ preconditioned(hierarchy, b), rel=1e-3)


def test_a_maze_in_a_volume_is_graded() -> None:
    """A corridor ten cells high and wide, and three hundred long: some sixty decades."""
    plane = np.pad(serpentine(5, 60, 10), 1, constant_values=1)
    cell = np.pad(np.repeat(np.minimum(plane, 1)[None], 10, axis=0), ((1, 1), (0, 0), (0, 0)), constant_values=1)
    cell[(5, *np.argwhere(plane == 2)[0])] = 2
    netlist = compile_space(space_of(cell), boundary="dirichlet")
    found = {}
    for decades in (40.0, np.inf):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(decay, "_FAR_IN_VOLUMES", decades)
            found[decades] = solve(netlist, method="multigrid")
    graded_one, plain = found.values()
    assert_same(graded_one.log_drop, solve(netlist, method="direct").log_drop)
    assert graded_one.log_drop is not None
    assert np.nanmin(graded_one.log_drop) < -30 * np.log(10.0)
    assert graded_one.iterations < 0.75 * plain.iterations


def test_plain_levels_have_their_turn_where_graded_ones_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    netlist = compile_space(space_of(rooms(60)), boundary="dirichlet")
    monkeypatch.setattr(h_transform, "scaled_approximation", lambda *_: lambda m, e, _: (0.0 * m, e))
    assert_same(solve(netlist, method="multigrid").log_drop, solve(netlist, method="direct").log_drop)


def test_coarse_levels_may_fall_lower_than_squares_of_doubles() -> None:
    """A serpentine behind weak walls, which coarse levels take for a longer way down."""
    cell = np.zeros((145, 127), dtype=np.uint8)
    cell[::8], cell[::16, -1], cell[8::16, 0], cell[4, 90] = 1, 0, 0, 2
    axes = (Axis("x", 0.0, 112.42590557036654, 145), Axis("y", 0.0, 224.66565792072865, 127))
    netlist = compile_space(ConfigurationSpace(axes, cell), boundary="wall", wall_resistance=288481.0)
    system = assemble(netlist)
    levels = h_transform.scalable(system.laplacian)
    assert levels is not None
    assert system.rails is not None
    height = nested_iteration(levels, at_slots(levels, system.rails.to_low))
    assert np.isfinite(height).all()
    assert height[levels.unknown].min() >= 0.0


def foreseen(laplacian: Laplacian) -> float:
    """Decades that a potential falls, about."""
    return foresee_decades(laplacian, count_connections(laplacian)).whole


def test_potentials_whose_squares_are_no_doubles_are_not_graded(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[float] = []
    monkeypatch.setattr(h_transform, "scaled_approximation", lambda laplacian, *_: tried.append(foreseen(laplacian)))
    for cell in (rooms(60), with_slits()):
        netlist = compile_space(space_of(cell), boundary="dirichlet")
        assert_same(solve(netlist, method="multigrid").log_drop, solve(netlist, method="direct").log_drop)
    assert len(tried) == 1
    assert tried[0] < decay.MOST_DECADES < foreseen(assemble(netlist).laplacian)


@settings(max_examples=40)
@given(
    st.one_of(spaces(max_cells=30, dimensions=(2, 2)), spaces(max_cells=10, dimensions=(3, 3))),
    st.sampled_from([{"boundary": "dirichlet"}, {"boundary": "wall", "wall_resistance": 30.0}]),
)
def test_graded_multigrid_agrees_with_the_direct_method(space: ConfigurationSpace, options: dict[str, object]) -> None:
    try:
        netlist = compile_space(space, **options)  # type: ignore[arg-type]
        direct = solve(netlist, method="direct")
    except CircuitError:
        return
    assert_same(solve(netlist, method="multigrid").log_drop, direct.log_drop)


def assert_same(one: NDArray[np.float64] | None, other: NDArray[np.float64] | None) -> None:
    assert one is not None
    assert other is not None
    here = np.isfinite(other)
    np.testing.assert_array_equal(np.isfinite(one), here)
    np.testing.assert_allclose(one[here], other[here], rtol=0, atol=1e-8)
