"""The direct method on chains, trees and irregular networks, compared with exact fractions and dense matrices.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers.factors`, `resgrid.solvers.method_choice`,
`resgrid.solvers.progress`, `resgrid.solvers.scaled`, `resgrid.solvers.symbolic`.
"""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import dense_solution, ladder, random_grid
from support.spaces import serpentine, space_of, spaces

import resgrid as rg
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers.factors import factor_direct
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.scaled import Scaled
from resgrid.solvers.symbolic import order_by_distance, order_by_fill


def grounded(pairs: np.ndarray, conductance: np.ndarray) -> Equations:
    """Nodal equations of resistors with a current into node 1."""
    count = int(pairs.max()) + 1
    return assemble(rg.Netlist(count, pairs, conductance, current_nodes=[[0, 1]], current_amps=[1.0]))


def exact(system: Equations, rhs: np.ndarray) -> list[Fraction]:
    """The solution in fractions, by dense elimination."""
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
    """Largest relative error of scaled values, computed in fractions."""
    error = Fraction(0)
    for hi, lo, e, x in zip(found.hi, found.lo, found.exponent, expected, strict=True):
        value = (Fraction(float(hi)) + Fraction(float(lo))) * Fraction(2) ** (256 * int(e))
        error = max(error, abs(value - x) / x if x else abs(value))
    return float(error)


@st.composite
def series_parallel(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """A grounded tree with doubled, subdivided and parallel resistors over 24 orders of magnitude."""
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
def test_series_parallel_circuits_are_accurate_entry_by_entry(
    circuit: tuple[np.ndarray, np.ndarray], seed: int
) -> None:
    """Includes circuits for which refinement in double-double fails, whose residuals are accurate to 1e-32."""
    system = grounded(*circuit)
    rng = np.random.default_rng(seed)
    rhs = 10.0 ** rng.uniform(-30, 30, system.size) * (rng.random(system.size) < 0.5)
    rhs[int(rng.integers(system.size))] = 1.0
    found, error = factor_direct(system.laplacian).solve_nonnegative(rhs)
    assert largest_error(found, exact(system, rhs)) < 1e-12
    assert error < 1e-13


@settings(max_examples=80)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0, 4.0]))
def test_circuits_with_loops_are_accurate_entry_by_entry(seed: int, decades: float) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 14))
    pairs = [(node, int(rng.integers(0, node))) for node in range(1, count)]
    pairs += [tuple(rng.choice(count, 2, replace=False).tolist()) for _ in range(count)]
    system = grounded(np.array(pairs), 10.0 ** rng.uniform(-decades, decades, len(pairs)))
    rhs = rng.random(system.size) * (rng.random(system.size) < 0.7)
    rhs[0] = 1.0
    factors = factor_direct(system.laplacian)
    found, error = factors.solve_nonnegative(rhs)
    assert largest_error(found, exact(system, rhs)) < 1e-13
    assert error < 1e-15
    signed = rng.standard_normal(system.size)
    expected = np.array([float(x) for x in exact(system, signed)])
    assert np.allclose(factors.solve(signed, rtol=1e-14), expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@settings(max_examples=60)
@given(spaces(), st.sampled_from(["dirichlet", "neumann", "wall"]))
def test_direct_and_multigrid_agree_on_random_spaces(space: object, boundary: str) -> None:
    options = {"wall_resistance": 3.0} if boundary == "wall" else {}
    try:
        system = assemble(rg.compile_space(space, boundary=boundary, **options))
    except rg.CircuitError:
        return
    if not system.size:
        return
    rhs = system.rails.to_low if system.rails is not None else np.abs(system.injected)
    direct, _ = factor_direct(system.laplacian).solve_nonnegative(rhs)
    watch = ProgressMonitor()
    found, error = factor_laplacian(system.laplacian, "multigrid").solve_nonnegative(rhs, watch=watch)
    assert np.allclose(found.log, direct.log, rtol=0, atol=min(watch.bound, 1e-8) + 1e-13 * system.size)
    # There is no error bound where no current flows.
    assert watch.bound < 1e-8 or error < 1e-13


@pytest.mark.parametrize("make", [ladder, lambda: random_grid(3), lambda: random_grid(4, side=9, drive=False)])
def test_operating_points_agree_with_dense_solutions(make: object) -> None:
    netlist = make()
    point, dense = rg.solve(netlist), dense_solution(netlist)
    assert np.allclose(point.voltage, dense.voltage, rtol=1e-11)
    assert np.allclose(point.source_current, dense.source_current, rtol=1e-9, atol=1e-15)


def test_a_chain_of_100000_resistors_equals_its_closed_form() -> None:
    """With 1 A into every node of a chain of 1 S, the node at distance k of n is at k (2 n + 1 - k) / 2 volts."""
    n = 100_000
    pairs = np.stack([np.arange(1, n + 1), np.arange(n)], axis=1)
    system = grounded(pairs, np.ones(n))
    watch = ProgressMonitor()
    found, _ = factor_laplacian(system.laplacian, "auto").solve_nonnegative(np.ones(n), watch=watch)
    k = np.arange(1, n + 1, dtype=object)
    expected = (k * (2 * n + 1 - k) // 2).astype(float)
    assert watch.bound < 4.1e-9
    np.testing.assert_allclose(found.plain, expected, rtol=watch.bound, atol=0)


def test_corridors_of_width_1_and_2_are_solved_directly() -> None:
    for width in (1, 2):
        for boundary in ("dirichlet", "neumann"):
            system = assemble(rg.compile_space(space_of(serpentine(61, 120, width)), boundary=boundary))
            assert system.size > 2000
            for accuracy in ("direction", "normwise"):
                assert factor_laplacian(system.laplacian, "auto", accuracy=accuracy).name == "direct"


def test_two_hubs_with_100000_common_neighbours_are_accurate() -> None:
    count = 100_000
    middle = np.arange(3, count + 3)
    pairs = np.concatenate([np.stack([middle, hub + 0 * middle], axis=1) for hub in (1, 2)] + [[[2, 0]]])
    system = grounded(pairs, np.append(np.full(2 * count, 2.0), 1.0))
    found, _ = factor_laplacian(system.laplacian, "auto").solve_nonnegative(system.injected)
    assert found.plain[0] == pytest.approx(1.0 + 1.0 / count, rel=4e-9)
    assert found.plain[1] == pytest.approx(1.0, rel=4e-9)


def test_nested_parallel_bundles_are_accurate() -> None:
    """In two rounds, bundles of 60 parallel paths of two resistors replace every resistor."""
    pairs = np.array([[1, 0]])
    for _ in range(2):
        first = int(pairs.max()) + 1
        middle = first + np.arange(60 * len(pairs))
        ends = np.repeat(pairs, 60, axis=0)
        pairs = np.concatenate([np.stack([ends[:, 0], middle], axis=1), np.stack([middle, ends[:, 1]], axis=1)])
    system = grounded(pairs, np.full(len(pairs), 1.0))
    found, _ = factor_laplacian(system.laplacian, "auto").solve_nonnegative(system.injected)
    assert found.plain[0] == pytest.approx(1 / 900, rel=1e-15)


def test_both_orderings_agree_over_1000_orders_of_magnitude() -> None:
    """Two rooms at the ends of a corridor along which the potential decreases by 1,000 orders of magnitude."""
    cell = np.ones((1800, 7), dtype=np.uint8)
    cell[:12, :] = cell[-12:, :] = cell[:, 3] = 0
    cell[5, 5] = 2
    system = assemble(rg.compile_space(space_of(cell)))
    assert system.rails is not None
    logs = []
    for order in (order_by_distance, order_by_fill):
        factors = factor_direct(system.laplacian, order(system.laplacian))
        found, error = factors.solve_nonnegative(system.rails.to_low)
        assert error < 1e-15
        logs.append(found.log)
    assert logs[0].min() < -1000 * np.log(10)
    assert np.abs(logs[0] - logs[1]).max() < 1e-12


@pytest.mark.parametrize("decades", [16, 20, 24])
def test_a_triangle_of_stiff_resistors_has_accurate_currents(decades: int) -> None:
    """Equal resistors with currents injected at two corners, one grounded: currents divide by symmetry."""
    strong, weak = 10.0 ** (decades / 2), 10.0 ** (-decades / 2)
    amps = np.array([3.386e-4, 1.898e-5])
    netlist = rg.Netlist(
        4,
        np.array([[2, 3], [3, 1], [3, 2], [1, 0]]),
        np.array([strong, strong, strong, weak]),
        current_nodes=np.array([[0, 1], [0, 2]]),
        current_amps=amps,
    )
    # The total leaves at corner 1; the current injected at 2 divides between the two parallel resistors.
    expected = [amps[1] / 2, amps[1], -amps[1] / 2, amps.sum()]
    np.testing.assert_allclose(rg.solve(netlist).resistor_current, expected, rtol=1e-6)


def test_right_hand_sides_may_span_hundreds_of_orders_of_magnitude() -> None:
    """A current of 1e358 A at one end of a leaky chain hardly changes the voltage at the other end."""
    chain = np.arange(1, 13)
    pairs = np.concatenate([np.stack([chain[:-1], chain[1:]], 1), np.stack([0 * chain, chain], 1)])
    siemens = np.repeat([1.0, 1e30], [11, 12]) * np.random.default_rng(0).uniform(0.5, 2.0, 23)
    system = grounded(pairs, siemens)
    near, far = np.zeros((2, 12))
    near[0], far[-1] = 1e30, 1e-27
    exponent = np.where(far > 0, 5, 0)
    found, error = factor_direct(system.laplacian).solve_nonnegative(Scaled(near + far, 0 * near, exponent))
    expected = [a + 2**1280 * b for a, b in zip(exact(system, near), exact(system, far), strict=True)]
    assert error < 1e-28 and largest_error(found, expected) < 1e-15
