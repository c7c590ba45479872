"""Chains, trees, rings and hubs, solved directly, against exact fractions and known answers."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import dense_solution, ladder, random_grid
from support.spaces import serpentine, space_of

from resgrid.circuit.equations import Equations, assemble
from resgrid.circuit.solve import solve
from resgrid.compiler import compile_space
from resgrid.netlist import Netlist
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.extended import Scaled
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.monitor import Watch


def grounded(pairs: np.ndarray, conductance: np.ndarray) -> Equations:
    """Nodal equations of resistors with a current into node 1."""
    count = int(pairs.max()) + 1
    return assemble(Netlist(count, pairs, conductance, current_nodes=[[0, 1]], current_amps=[1.0]))


def factored(system: Equations) -> Factor:
    """The factor that is chosen: a direct one."""
    factor = factor_laplacian(system.laplacian, "auto")
    assert factor.name == "direct"
    return factor


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
def test_series_parallel_circuits_keep_the_digits_of_double_double(
    circuit: tuple[np.ndarray, np.ndarray], seed: int
) -> None:
    system = grounded(*circuit)
    factor = factored(system)
    rng = np.random.default_rng(seed)
    rhs = 10.0 ** rng.uniform(-30, 30, system.size) * (rng.random(system.size) < 0.5)
    rhs[int(rng.integers(system.size))] = 1.0
    watch = Watch()
    found, error = factor.solve_nonnegative(rhs, watch=watch)
    far = largest_error(found, exact(system, rhs))
    assert far <= max(watch.bound, 1e-29)
    conductance = circuit[1]
    assert conductance.max() > 1e4 * conductance.min() or far < 1e-25
    assert error < 1e-23


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
    found, error = factored(system).solve_nonnegative(rhs)
    assert largest_error(found, exact(system, rhs)) < 1e-13
    assert error < 1e-15
    signed = rng.standard_normal(system.size)
    expected = np.array([float(x) for x in exact(system, signed)])
    assert np.allclose(factored(system).solve(signed, rtol=1e-14), expected, rtol=0, atol=1e-6 * np.abs(expected).max())


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
    found, _ = factored(system).solve_nonnegative(np.ones(n))
    k = np.arange(1, n + 1, dtype=object)
    expected = k * (2 * n + 1 - k) // 2
    assert np.array_equal(found.plain, expected.astype(float))
    assert np.abs(found.lo).max() < 1e-26 * found.hi.max()


def test_corridors_of_width_one_and_two_are_factored() -> None:
    for width in (1, 2):
        for boundary in ("dirichlet", "neumann"):
            system = assemble(compile_space(space_of(serpentine(9, 40, width)), boundary=boundary))
            assert factor_laplacian(system.laplacian, "auto").name == "direct"


def test_two_hubs_joined_a_hundred_thousand_times() -> None:
    """Neither hub's row is searched at each elimination, and parallel resistors end as one."""
    count = 100_000
    middle = np.arange(3, count + 3)
    pairs = np.concatenate([np.stack([middle, hub + 0 * middle], axis=1) for hub in (1, 2)] + [[[2, 0]]])
    system = grounded(pairs, np.append(np.full(2 * count, 2.0), 1.0))
    found, _ = factor_laplacian(system.laplacian, "direct").solve_nonnegative(system.injected)
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
    factor = factored(system)
    found, _ = factor.solve_nonnegative(system.injected)
    assert found.plain[0] == pytest.approx(1 / 900, rel=1e-15)


def test_a_corridor_between_two_rooms_along_which_conductances_would_underflow() -> None:
    """The potential falls by 1,000 decades, against continued fractions of the corridor's own ladder."""
    cell = np.ones((1800, 7), dtype=np.uint8)
    cell[:12, :] = cell[-12:, :] = cell[:, 3] = 0
    cell[5, 5] = 2
    netlist = compile_space(space_of(cell))
    drop = solve(netlist).log_drop
    along = drop[netlist.cells.node[100:1700, 3]]
    # A cell between two others and two walls: 4 u_i = u_(i-1) + u_(i+1), so that it falls by 2 + sqrt(3) a cell.
    assert drop[np.isfinite(drop)].min() < -1000 * np.log(10)
    np.testing.assert_allclose(np.diff(along), -np.log(2 + np.sqrt(3)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("width", [1, 2])
def test_a_dead_end_carries_no_current(width: int) -> None:
    """Beyond the start a corridor is flat: what differences rounding leaves there are noise."""
    cell = serpentine(9, 60, width)
    row, column = 4 * (width + 1) + 1, 30
    netlist = compile_space(space_of(cell), boundary="neumann", drive="start", start=(row, column))
    point = solve(netlist)
    assert 0.4 < np.mean(point.resistor_direction == 0) < 0.6
