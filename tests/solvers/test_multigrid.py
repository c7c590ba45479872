"""Multigrid, compared with the direct method and numpy, and the automatic choice between both methods.

Tests internals: `resgrid.circuit.dynamics`, `resgrid.circuit.equations`, `resgrid.solvers`,
`resgrid.solvers.decay_estimate`, `resgrid.solvers.factors`, `resgrid.solvers.laplacian`, `resgrid.solvers.multigrid`,
`resgrid.solvers.progress`, `resgrid.solvers.symbolic`.
"""

import numpy as np
import pytest
from hypothesis import assume, example, given, settings, strategies as st
from support.spaces import serpentine, space_of, spaces

import resgrid as rg
from resgrid.circuit.dynamics import dynamics_of, factor_resolvent
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers import method_choice as methods
from resgrid.solvers.decay_estimate import STRAIGHTNESS, estimate_decades
from resgrid.solvers.factors import factor_multigrid
from resgrid.solvers.laplacian import conductance_statistics
from resgrid.solvers.multigrid import graph_coarsening
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.symbolic import order_by_distance

BOUNDARIES = [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 2.0}]


def estimated_decades(system: Equations) -> float:
    """Estimated orders of magnitude of the potential's decay."""
    return estimate_decades(system.laplacian, conductance_statistics(system.laplacian))


def space_with_boxes(shape: tuple[int, ...], seed: int, share: float = 0.2) -> np.ndarray:
    """Cells with random boxes as obstacles and a goal in the first corner."""
    rng = np.random.default_rng(seed)
    cell = np.zeros(shape, dtype=np.uint8)
    while np.mean(cell) < share:
        low = rng.integers(0, shape)
        size = rng.integers(1, np.array(shape) // 6 + 2)
        cell[tuple(slice(a, a + b) for a, b in zip(low, size, strict=True))] = 1
    cell[(slice(0, 3),) * len(shape)] = 0
    cell[(1,) * len(shape)] = 2
    return cell


def random_netlist(count: int, seed: int) -> rg.Netlist:
    """A connected random graph with resistors over two orders of magnitude and two voltage sources."""
    rng = np.random.default_rng(seed)
    tree = np.stack([np.arange(2, count), rng.integers(1, np.arange(2, count))], axis=1)
    extra = rng.integers(1, count, (2 * count, 2))
    pairs = np.concatenate([tree, extra[extra[:, 0] != extra[:, 1]]])
    conductance = 10.0 ** rng.uniform(-1, 1, len(pairs))
    return rg.Netlist(count, pairs, conductance, np.array([[1, 0], [count - 1, 0]]), np.array([1.0, 0.0]))


@settings(max_examples=60)
@given(spaces(), st.sampled_from(BOUNDARIES))
def test_multigrid_and_direct_agree_on_small_spaces(space: object, options: dict[str, object]) -> None:
    try:
        netlist = rg.compile_space(space, **options)
        direct = rg.solve(netlist, method="direct")
    except rg.CircuitError:
        assume(False)
    multigrid = rg.solve(netlist, method="multigrid")
    assert np.allclose(direct.voltage, multigrid.voltage, rtol=1e-8, atol=0, equal_nan=True)
    if direct.log_drop is not None:
        proved = min(multigrid.entry_error + direct.entry_error, 1e-8)
        assert np.allclose(direct.log_drop, multigrid.log_drop, rtol=1e-15, atol=proved, equal_nan=True)


@pytest.mark.parametrize("shape", [(90, 70), (24, 20, 22), (9, 9, 8, 9)])
@pytest.mark.parametrize("options", BOUNDARIES)
def test_multigrid_agrees_with_direct_entry_by_entry_on_larger_grids(
    shape: tuple[int, ...], options: dict[str, object]
) -> None:
    netlist = rg.compile_space(space_of(space_with_boxes(shape, seed=len(shape))), **options)
    direct, multigrid = rg.solve(netlist, method="direct"), rg.solve(netlist, method="multigrid")
    assert multigrid.method == "multigrid"
    assert multigrid.kcl_residual < 1e-6
    bound = direct.entry_error + multigrid.entry_error
    assert bound <= 2e-8
    assert np.allclose(direct.voltage, multigrid.voltage, rtol=bound + 1e-15, atol=0, equal_nan=True)
    if direct.log_drop is not None:
        assert np.nanmin(np.where(np.isfinite(direct.log_drop), direct.log_drop, 0)) < -5
        assert np.allclose(direct.log_drop, multigrid.log_drop, rtol=1e-15, atol=bound, equal_nan=True)


@pytest.mark.parametrize("seed", range(4))
def test_multigrid_agrees_with_direct_on_netlists_without_a_grid(seed: int) -> None:
    netlist = random_netlist(3000, seed)
    direct, multigrid = rg.solve(netlist, method="direct"), rg.solve(netlist, method="multigrid")
    assert np.allclose(direct.voltage, multigrid.voltage, rtol=1e-9, atol=1e-15, equal_nan=True)
    normwise = rg.solve(netlist, method="multigrid", accuracy="normwise", rtol=1e-10)
    assert np.allclose(direct.voltage, normwise.voltage, atol=1e-7, equal_nan=True)


@settings(max_examples=60)
@example(134)
@given(st.integers(0, 2**32 - 1))
def test_small_netlists_are_solved_to_rounding_accuracy(seed: int) -> None:
    """After a burst that ends in rounding errors, the next one starts with an unrelated residual."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 40))
    tree = [(int(rng.integers(0, k)), k) for k in range(1, count + 1)]
    more = [tuple(sorted(rng.choice(count + 1, 2, replace=False).tolist())) for _ in range(2 * count)]
    conductance = np.append(10.0 ** rng.uniform(-7, -3, len(tree + more)), 1e-4)
    pairs = np.array([*tree, *more, (count, count + 1)])
    system = assemble(rg.Netlist(count + 2, pairs, conductance, np.array([[count + 1, 0]]), np.array([1.0])))
    x = factor_multigrid(system.laplacian).solve(system.drive, rtol=1e-12)
    exact = np.linalg.solve(np.diag(system.laplacian.diagonal) - system.laplacian.edges.toarray(), system.drive)
    np.testing.assert_allclose(x, exact, rtol=0, atol=1e-6)


def test_aggregates_do_not_cross_walls() -> None:
    """Two parallel corridors joined at one end: every aggregate is connected."""
    wall = np.zeros((64, 3), dtype=np.uint8)
    wall[:-1, 1] = 1
    wall[0, 0] = 2
    system = assemble(rg.compile_space(space_of(np.repeat(wall, 3, axis=0)), boundary="neumann"))
    group_of, count = graph_coarsening.grow_aggregates(
        graph_coarsening.Graph(*system.laplacian.as_rows(), system.laplacian.ground), 4, True
    )
    assert count == group_of.max() + 1 < system.size / 2
    for group in range(count):
        members = np.flatnonzero(group_of == group)
        inner = system.laplacian.edges[members][:, members]
        reach = np.linalg.matrix_power((inner.toarray() > 0) + np.eye(len(members)), len(members))
        assert np.all(reach > 0)


def test_auto_selects_multigrid_unless_a_system_is_small_or_rough() -> None:
    little = assemble(rg.compile_space(space_of(space_with_boxes((40, 40), 1))))
    assert methods.choose_method(little.laplacian).method == "direct"
    plane = assemble(rg.compile_space(space_of(space_with_boxes((160, 160), 1)), boundary="neumann"))
    assert methods.choose_method(plane.laplacian).method == "multigrid"
    assert methods.choose_method(plane.laplacian, accuracy="normwise").method == "multigrid"
    volume = assemble(rg.compile_space(space_of(space_with_boxes((32, 32, 32), 1))))
    assert methods.choose_method(volume.laplacian).method == "multigrid"
    rough = rg.compile_space(
        space_of(
            space_with_boxes((32, 32, 32), 1),
            conductivity=10.0 ** np.random.default_rng(0).uniform(-3, 3, (32, 32, 32)),
        )
    )
    assert methods.choose_method(assemble(rough).laplacian).method == "direct"


def test_auto_selects_direct_for_potentials_that_decay_too_far() -> None:
    shaft = np.zeros((1300, 6, 6), dtype=np.uint8)
    shaft[0, 1, 1] = 2
    assert methods.choose_method(assemble(rg.compile_space(space_of(shaft))).laplacian).method == "direct"
    assert (
        methods.choose_method(assemble(rg.compile_space(space_of(shaft), boundary="neumann")).laplacian).method
        == "multigrid"
    )


@pytest.mark.parametrize(("length", "method"), [(300, "multigrid"), (1600, "direct")])
def test_auto_depends_on_the_length_of_wide_corridors(length: int, method: str) -> None:
    corridor = np.zeros((14, 14, length), dtype=np.uint8)
    corridor[5, 5, 0] = 2
    assert methods.choose_method(assemble(rg.compile_space(space_of(corridor))).laplacian).method == method


@pytest.mark.parametrize("width", [3, 8, 21])
@pytest.mark.parametrize("wall", [0.0, 1.0, 30.0, 1e3])
def test_the_estimated_decay_agrees_for_all_wall_resistances(width: int, wall: float) -> None:
    corridor = np.zeros((width, 40 * width), dtype=np.uint8)
    corridor[:, 0] = 2
    netlist = rg.compile_space(space_of(corridor), boundary="wall", resistance=1.0, wall_resistance=wall)
    log_drop = rg.solve(netlist, method="direct").log_drop
    decades = -log_drop[np.isfinite(log_drop)].min() / np.log(10.0)
    assert 0.7 < estimated_decades(assemble(netlist)) / STRAIGHTNESS / decades < 1.8


def test_auto_selects_multigrid_behind_high_wall_resistances() -> None:
    corridor = np.zeros((48, 8000), dtype=np.uint8)
    corridor[:, 0] = 2
    options = {"boundary": "wall", "resistance": 1.0}
    thin = rg.compile_space(space_of(corridor), **options, wall_resistance=0.0)
    thick = rg.compile_space(space_of(corridor), **options, wall_resistance=1e4)
    assert methods.choose_method(assemble(thin).laplacian).method == "direct"
    assert methods.choose_method(assemble(thick).laplacian).method == "multigrid"


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_auto_selects_direct_for_mazes_and_multigrid_for_halls(boundary: str) -> None:
    narrow = assemble(rg.compile_space(space_of(serpentine(40, 120, 4)), boundary=boundary))
    assert methods.choose_method(narrow.laplacian).method == "direct"
    assert order_by_distance(narrow.laplacian) is not None
    hall = np.zeros((80, 800), dtype=np.uint8)
    hall[20, 20] = 2
    assert (
        methods.choose_method(assemble(rg.compile_space(space_of(hall), boundary=boundary)).laplacian).method
        == "multigrid"
    )


def test_multigrid_agrees_with_direct_over_100_orders_of_magnitude() -> None:
    shaft = np.zeros((420, 6, 5), dtype=np.uint8)
    shaft[0, 2, 2] = 2
    netlist = rg.compile_space(space_of(shaft))
    direct, multigrid = rg.solve(netlist, method="direct"), rg.solve(netlist, method="multigrid")
    assert np.nanmin(np.where(np.isfinite(direct.log_drop), direct.log_drop, 0)) < -100 * np.log(10)
    bound = direct.entry_error + multigrid.entry_error
    assert bound <= 2e-8
    assert np.allclose(direct.log_drop, multigrid.log_drop, rtol=1e-15, atol=bound, equal_nan=True)
    assert multigrid.kcl_residual < 1e-6


def test_balancing_makes_currents_of_rough_conductivities_accurate() -> None:
    rng = np.random.default_rng(5)
    space = space_of(space_with_boxes((80, 80), 2), conductivity=10.0 ** rng.uniform(-9, 9, (80, 80)))
    netlist = rg.compile_space(space, boundary="neumann")
    direct, multigrid = rg.solve(netlist, method="direct"), rg.solve(netlist, method="multigrid")
    assert "balance" in multigrid.seconds
    assert max(direct.kcl_residual, multigrid.kcl_residual) < 1e-6
    np.testing.assert_allclose(multigrid.potential, direct.potential, rtol=1e-6)


def test_a_factor_solves_several_right_hand_sides() -> None:
    netlist = rg.compile_space(space_of(space_with_boxes((40, 30), 3)))
    direct, multigrid = rg.factorize(netlist, method="direct"), rg.factorize(netlist, method="multigrid")
    rng = np.random.default_rng(1)
    for _ in range(3):
        rhs = rng.standard_normal(direct.system.size)
        assert np.allclose(direct.solve(rhs), multigrid.solve(rhs, rtol=1e-12), rtol=1e-6, atol=1e-6 * 1e4)


def test_unknown_methods_and_excessive_memory_raise(monkeypatch: pytest.MonkeyPatch) -> None:
    netlist = rg.compile_space(space_of(space_with_boxes((20, 20), 1)))
    with pytest.raises(rg.InputError, match="direct, multigrid"):
        rg.solve(netlist, method="cholesky")
    monkeypatch.setattr("resgrid._internal.memory.available_memory", lambda: 1000)
    with pytest.raises(rg.BudgetError, match="GiB"):
        rg.solve(netlist)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("leak", [1e2, 1e3, 1e4, 1e5, 1e6])
def test_leaks_larger_than_conductances_converge_in_12_iterations(boundary: str, leak: float) -> None:
    """Time steps lead to such circuits; the first iteration gains more digits than single precision has."""
    cell = np.zeros((64, 64), dtype=np.uint8)
    cell[16:32, 21], cell[61, 2] = 1, 2
    netlist = rg.compile_space(space_of(cell), boundary=boundary)
    nodes = netlist.cells.free_node
    dynamics = dynamics_of(
        netlist.replace(
            capacitor_nodes=np.stack([nodes, np.zeros_like(nodes)], axis=1), capacitance=np.full(len(nodes), 1e-12)
        )
    )
    rate = leak * netlist.conductance.max() / 1e-12
    iterative, direct = (factor_resolvent(dynamics, rate, method) for method in ("multigrid", "direct"))
    watch = ProgressMonitor()
    x = iterative.solve(dynamics.drive, rtol=1e-12, watch=watch)
    assert watch.iterations <= 12
    expected = direct.solve(dynamics.drive, rtol=1e-14)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_factorize_builds_the_multigrid_hierarchy(monkeypatch: pytest.MonkeyPatch) -> None:
    plane = rg.compile_space(space_of(space_with_boxes((160, 160), 1)), boundary="neumann")
    factors = rg.factorize(plane, method="multigrid").factors
    monkeypatch.setattr("resgrid.solvers.multigrid.hierarchy.build_hierarchy", lambda _: pytest.fail("coarsened late"))
    assert np.isfinite(factors.solve(np.ones(factors.laplacian.size))).all()
