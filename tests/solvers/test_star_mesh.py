"""Elimination of nodes with at most two neighbours, against exact fractions and against factors of the whole."""

from dataclasses import replace
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import sparse
from support.circuits import dense_solution, ladder, random_grid
from support.spaces import serpentine, space_of, spaces

from resgrid.circuit.equations import Equations, assemble
from resgrid.circuit.solve import solve
from resgrid.compiler import compile_space
from resgrid.errors import BudgetError, CircuitError
from resgrid.netlist import Netlist
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.extended import Scaled
from resgrid.solvers.factor import Factor
from resgrid.solvers.laplacian import count_connections
from resgrid.solvers.monitor import Watch
from resgrid.solvers.star_mesh import ReducedFactor, may_shrink, shrink


def grounded(pairs: np.ndarray, conductance: np.ndarray) -> Equations:
    """Nodal equations of resistors with a current into node 1."""
    count = int(pairs.max()) + 1
    return assemble(Netlist(count, pairs, conductance, current_nodes=[[0, 1]], current_amps=[1.0]))


def reduced(system: Equations, method: str = "direct") -> ReducedFactor:
    """A factor behind star-mesh elimination, whether it pays or not."""
    (mesh, core), make = shrink(system.laplacian), partial(factor_laplacian, method=method, reduce=False)
    return ReducedFactor(system.laplacian, mesh, make(core) if core else None)


def shrinks(system: Equations) -> bool:
    """Whether elimination may take a fair share of the rows."""
    return may_shrink(system.laplacian, count_connections(system.laplacian))


def exact(system: Equations, rhs: np.ndarray) -> list[Fraction]:
    """The solution in fractions, by elimination of the dense matrix."""
    n = system.size
    A = [[-Fraction(float(g)) for g in row] for row in system.laplacian.edges.toarray()]
    for i in range(n):
        A[i][i] = Fraction(float(system.laplacian.ground[i])) - sum(A[i])
    b = [Fraction(float(value)) for value in rhs]
    for i in range(n):
        for j in range(i + 1, n):
            if A[j][i]:
                factor = A[j][i] / A[i][i]
                A[j] = [p - factor * q for p, q in zip(A[j], A[i], strict=True)]
                b[j] -= factor * b[i]
    for i in range(n - 1, -1, -1):
        b[i] = (b[i] - sum(A[i][j] * b[j] for j in range(i + 1, n))) / A[i][i]
    return b


def largest_error(found: Scaled, expected: list[Fraction]) -> float:
    """Largest relative error; values within the range of fractions of integers, which is all."""
    error = Fraction(0)
    for hi, lo, e, x in zip(found.hi, found.lo, found.exponent, expected, strict=True):
        value = (Fraction(float(hi)) + Fraction(float(lo))) * Fraction(2) ** (256 * int(e))
        error = max(error, abs(value - x) / x if x else abs(value))
    return float(error)


@st.composite
def series_parallel(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """A tree with doubled, subdivided and parallel resistors over 24 decades, grounded somewhere: it must vanish."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pairs = [(1, int(rng.integers(0, 1)))]
    for node in range(2, draw(st.integers(2, 14))):
        kind = draw(st.sampled_from(["leaf", "split", "ring", "double"]))
        a, b = pairs[int(rng.integers(len(pairs)))]
        if kind == "leaf":
            pairs.append((node, a))
        else:
            pairs += [(a, node), (node, b)]
            if kind == "split":
                pairs.remove((a, b))
            if kind == "double":
                pairs.append((a, node))
    decades = draw(st.sampled_from([0.0, 2.0, 12.0]))
    return rng.permutation(np.array(pairs)), 10.0 ** rng.uniform(-decades, decades, len(pairs))


@settings(max_examples=150)
@given(series_parallel(), st.integers(0, 99))
def test_series_parallel_circuits_vanish_and_keep_thirty_digits(
    circuit: tuple[np.ndarray, np.ndarray], seed: int
) -> None:
    system = grounded(*circuit)
    factor = reduced(system)
    assert factor.name == "elimination"
    rng = np.random.default_rng(seed)
    rhs = 10.0 ** rng.uniform(-30, 30, system.size) * (rng.random(system.size) < 0.5)
    rhs[int(rng.integers(system.size))] = 1.0
    found, error = factor.solve_nonnegative(rhs)
    assert largest_error(found, exact(system, rhs)) < 1e-29
    assert error < 1e-29


@settings(max_examples=80)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0, 4.0]))
def test_what_has_a_core_is_right_entry_by_entry(seed: int, decades: float) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 14))
    pairs = [(node, int(rng.integers(0, node))) for node in range(1, count)]
    pairs += [tuple(rng.choice(count, 2, replace=False).tolist()) for _ in range(count)]
    system = grounded(np.array(pairs), 10.0 ** rng.uniform(-decades, decades, len(pairs)))
    rhs = rng.random(system.size) * (rng.random(system.size) < 0.7)
    rhs[0] = 1.0
    found, error = reduced(system).solve_nonnegative(rhs)
    assert largest_error(found, exact(system, rhs)) < 1e-13
    assert error < 1e-15
    signed = rng.standard_normal(system.size)
    expected = np.array([float(x) for x in exact(system, signed)])
    assert np.allclose(reduced(system).solve(signed, rtol=1e-14), expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@settings(max_examples=60)
@given(spaces(), st.sampled_from(["dirichlet", "neumann", "wall"]))
def test_reduced_and_whole_systems_agree_on_spaces(space: object, boundary: str) -> None:
    options = {"wall_resistance": 3.0} if boundary == "wall" else {}
    try:
        system = assemble(compile_space(space, boundary=boundary, **options))
    except CircuitError:
        return
    if not system.size:
        return
    rhs = system.rails.to_low if system.rails is not None else np.abs(system.injected)
    whole, _ = factor_laplacian(system.laplacian, "direct", reduce=False).solve_nonnegative(rhs)
    for method in ("direct", "multigrid"):
        watch = Watch()
        found, error = reduced(system, method).solve_nonnegative(rhs, watch=watch)
        assert np.allclose(found.log, whole.log, rtol=0, atol=min(watch.bound, 1e-8) + 1e-13 * system.size)
        # Nothing is proved where no current flows.
        assert watch.bound < 1e-8 or error < 1e-13


@pytest.mark.parametrize("make", [ladder, lambda: random_grid(3), lambda: random_grid(4, side=9, drive=False)])
def test_operating_points_agree_with_the_dense_reference(make: object) -> None:
    netlist = make()
    point, dense = solve(netlist), dense_solution(netlist)
    assert np.allclose(point.voltage, dense.voltage, rtol=1e-11)
    assert np.allclose(point.source_current, dense.source_current, rtol=1e-9, atol=1e-15)


def test_a_chain_of_a_hundred_thousand_resistors_is_right_to_the_last_digit() -> None:
    """With 1 A into every node of a chain of 1 S, the node at distance k of n is at k (2 n + 1 - k) / 2 volts."""
    n = 100_000
    pairs = np.stack([np.arange(1, n + 1), np.arange(n)], axis=1)
    system = grounded(pairs, np.ones(n))
    found, _ = reduced(system).solve_nonnegative(np.ones(n))
    k = np.arange(1, n + 1, dtype=object)
    expected = k * (2 * n + 1 - k) // 2
    assert np.array_equal(found.plain, expected.astype(float))
    assert np.abs(found.lo).max() < 1e-26 * found.hi.max()


def test_corridors_trees_and_mazes_of_width_one_and_two_vanish() -> None:
    for width in (1, 2):
        for boundary in ("dirichlet", "neumann"):
            system = assemble(compile_space(space_of(serpentine(9, 40, width)), boundary=boundary))
            factor = factor_laplacian(system.laplacian, "auto")
            assert factor.name == "elimination"


def test_two_hubs_joined_a_hundred_thousand_times() -> None:
    """Neither hub's row is searched at each elimination, and parallel resistors end as one."""
    count = 100_000
    middle = np.arange(3, count + 3)
    pairs = np.concatenate([np.stack([middle, hub + 0 * middle], axis=1) for hub in (1, 2)] + [[[2, 0]]])
    system = grounded(pairs, np.append(np.full(2 * count, 2.0), 1.0))
    factor = reduced(system)
    assert factor.name == "elimination"
    found, _ = factor.solve_nonnegative(system.injected)
    assert found.plain[0] == pytest.approx(1.0 + 1.0 / count, rel=1e-15)
    assert found.plain[1] == pytest.approx(1.0, rel=1e-15)


def test_hubs_within_hubs_need_another_pass() -> None:
    """Chains of chains: bundles of 60 parallel paths of two resistors replace every resistor, twice over."""
    pairs = np.array([[1, 0]])
    for _ in range(2):
        first = int(pairs.max()) + 1
        middle = first + np.arange(60 * len(pairs))
        ends = np.repeat(pairs, 60, axis=0)
        pairs = np.concatenate([np.stack([ends[:, 0], middle], axis=1), np.stack([middle, ends[:, 1]], axis=1)])
    system = grounded(pairs, np.full(len(pairs), 1.0))
    factor = reduced(system)
    assert factor.name == "elimination"
    found, _ = factor.solve_nonnegative(system.injected)
    assert found.plain[0] == pytest.approx(1 / 900, rel=1e-15)


def test_a_long_leaking_chain_between_two_meshes_is_cut_where_its_conductance_would_underflow() -> None:
    """Two rooms at the ends of a corridor along which the potential falls by 1,000 decades."""
    cell = np.ones((1800, 7), dtype=np.uint8)
    cell[:12, :] = cell[-12:, :] = cell[:, 3] = 0
    cell[5, 5] = 2
    system = assemble(compile_space(space_of(cell)))
    assert system.rails is not None
    _, core = shrink(system.laplacian)
    assert core is not None
    assert core.size < 12 * 7 * 2 + 30
    assert core.edges.data.min() > 1e-70
    found, error = reduced(system).solve_nonnegative(system.rails.to_low)
    whole, _ = factor_laplacian(system.laplacian, "direct", reduce=False).solve_nonnegative(system.rails.to_low)
    assert whole.log.min() < -1000 * np.log(10)
    assert np.abs(found.log - whole.log).max() < 1e-12
    assert error < 1e-15


def test_the_core_is_a_system_of_its_own() -> None:
    """Its conductances are those of the whole, seen from the rows that are left."""
    wheel = [(i, i % 6 + 1) for i in range(1, 7)] + [(i, 7) for i in range(1, 7)]
    pairs = np.array([*wheel, (8, 1), (9, 8), (9, 0), (10, 3), (11, 10)])
    netlist = Netlist(12, pairs, np.arange(1.0, len(pairs) + 1), current_nodes=[[0, 11]], current_amps=[2.0])
    system = assemble(netlist)
    mesh, core = shrink(system.laplacian)
    assert core is not None
    assert core.size == 7
    series = 1 / sum(1 / netlist.conductance[-5:-2])
    assert core.ground.sum() == pytest.approx(series, rel=1e-15)
    matrix = (sparse.diags_array(core.diagonal) - core.edges).toarray()
    whole = (sparse.diags_array(system.laplacian.diagonal) - system.laplacian.edges).toarray()
    schur = np.linalg.inv(np.linalg.inv(whole)[np.ix_(mesh.kept, mesh.kept)])
    assert np.allclose(matrix, schur, rtol=1e-10, atol=1e-12 * np.abs(schur).max())


def test_open_rooms_and_conductances_out_of_range_are_left_alone() -> None:
    room = np.zeros((60, 60))
    room[0, 0] = 2
    system = assemble(compile_space(space_of(room)))
    assert not shrinks(system)
    assert factor_laplacian(system.laplacian, "auto").name != "elimination"
    pairs = np.array([[1, 0], [1, 2], [2, 0]])
    assert shrinks(grounded(pairs, np.ones(3)))
    assert not shrinks(grounded(pairs, np.array([1.0, 1e-100, 1.0])))


def test_a_part_that_nothing_grounds_is_left_to_the_method() -> None:
    system = grounded(np.array([[1, 0], [1, 2]]), np.ones(2))
    _, core = shrink(replace(system.laplacian, ground=np.zeros(2)))
    assert core is not None
    assert core.size == 1
    assert core.ground[0] == 0


def test_a_core_is_named_after_the_method_that_solves_it() -> None:
    rng = np.random.default_rng(0)
    cell = (rng.random((80, 80)) < 0.37).astype(np.uint8)
    cell[40, 40] = 2
    system = assemble(compile_space(space_of(cell), boundary="neumann"))
    rhs = system.injected
    factors: list[Factor] = [factor_laplacian(system.laplacian, method) for method in ("direct", "multigrid")]
    assert [factor.name for factor in factors] == ["direct", "multigrid"]
    assert all(isinstance(factor, ReducedFactor) and factor.laplacian.size == system.size for factor in factors)
    direct, multigrid = (factor.solve_nonnegative(rhs)[0].plain for factor in factors)
    assert np.allclose(direct, multigrid, rtol=1e-12, atol=0)
    whole, _ = factor_laplacian(system.laplacian, "direct", reduce=False).solve_nonnegative(rhs)
    assert np.allclose(direct, whole.plain, rtol=1e-13, atol=0)


def test_no_memory_for_elimination_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    system = assemble(ladder(100))
    monkeypatch.setattr("resgrid.budget.available_memory", lambda: 1000)
    with pytest.raises(BudgetError, match="elimination"):
        factor_laplacian(system.laplacian, "auto")


@pytest.mark.parametrize("decades", [16, 20, 24])
def test_a_triangle_of_strong_resistors_on_a_weak_one_keeps_its_currents(decades: int) -> None:
    """Equal resistors, fed at two corners, and tied to ground at one of them: divided by symmetry, whatever the tie."""
    strong, weak = 10.0 ** (decades / 2), 10.0 ** (-decades / 2)
    amps = np.array([3.386e-4, 1.898e-5])
    netlist = Netlist(
        4,
        np.array([[2, 3], [3, 1], [3, 2], [1, 0]]),
        np.array([strong, strong, strong, weak]),
        current_nodes=np.array([[0, 1], [0, 2]]),
        current_amps=amps,
    )
    # All of it leaves at corner 1; what is fed at 2 comes through the two parallel resistors, and on through one.
    expected = [amps[1] / 2, amps[1], -amps[1] / 2, amps.sum()]
    np.testing.assert_allclose(solve(netlist).resistor_current, expected, rtol=1e-6)
