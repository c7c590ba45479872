"""Refinement and currents, compared with exact fractions: KCL at every node relative to its own currents.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers`, `resgrid.solvers.laplacian`,
`resgrid.solvers.method_choice`, `resgrid.solvers.progress`, `resgrid.solvers.scaled`.
"""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import eliminated
from support.spaces import serpentine, space_of, spaces

import resgrid as rg
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers import refinement
from resgrid.solvers.laplacian import Graph
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.scaled import Scaled, power


def scattered(shape: tuple[int, ...], seed: int) -> rg.ConfigurationSpace:
    """Random single obstacle cells with the goal in the middle."""
    cell = (np.random.default_rng(seed).random(shape) < 0.08).astype(np.uint8)
    cell[tuple(size // 2 for size in shape)] = 2
    return space_of(cell)


def violations(system: Equations, rhs: np.ndarray, value: list[Fraction]) -> list[Fraction]:
    """Violation of KCL at every row, relative to the currents there, in exact arithmetic."""
    coupling, found = system.laplacian.edges, []
    for i in range(system.size):
        flows = [Fraction(float(rhs[i])), -Fraction(float(system.laplacian.ground[i])) * value[i]]
        for k in range(coupling.indptr[i], coupling.indptr[i + 1]):
            flows.append(Fraction(float(coupling.data[k])) * (value[coupling.indices[k]] - value[i]))
        size = sum((abs(flow) for flow in flows), Fraction(0))
        found.append(abs(sum(flows, Fraction(0))) / size if size else Fraction(0))
    return found


def to_fractions(found: Scaled) -> list[Fraction]:
    return [
        (Fraction(float(hi)) + Fraction(float(lo))) * Fraction(2) ** (256 * int(e))
        for hi, lo, e in zip(found.hi, found.lo, found.exponent, strict=True)
    ]


@pytest.mark.parametrize("shape", [(40, 30), (12, 10, 9)])
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann", "wall"])
@pytest.mark.parametrize("method", ["direct", "multigrid"])
def test_currents_balance_at_every_node_in_exact_arithmetic(shape: tuple[int, ...], boundary: str, method: str) -> None:
    options = {"wall_resistance": 1e6} if boundary == "wall" else {}
    system = assemble(rg.compile_space(scattered(shape, 3), boundary=boundary, **options))
    rhs, watch = system.rails.to_low if system.rails is not None else system.injected, ProgressMonitor()
    found, _ = factor_laplacian(system.laplacian, method).solve_nonnegative(rhs, watch=watch)
    violated = violations(system, rhs, to_fractions(found))
    assert 2 * float(sum(violated)) <= watch.bound < 4.1e-9
    assert max(violated) < 2e-9
    exact, _ = factor_laplacian(system.laplacian, "direct").solve_nonnegative(rhs)
    assert np.abs(found.log - exact.log).max() <= watch.bound + 1e-15


def test_currents_balance_for_potentials_below_the_range_of_doubles() -> None:
    system, watch = assemble(rg.compile_space(space_of(serpentine(9, 120, 3)))), ProgressMonitor()
    assert system.rails is not None
    found, _ = factor_laplacian(system.laplacian, "multigrid").solve_nonnegative(system.rails.to_low, watch=watch)
    assert found.log.min() / np.log(10) < -330
    assert 2 * float(sum(violations(system, system.rails.to_low, to_fractions(found)))) <= watch.bound < 4.1e-9


@settings(max_examples=80)
@given(spaces(max_cells=4, dimensions=(2, 3)), st.integers(0, 2**16), st.floats(-6.0, -1.5))
def test_entry_bound_is_an_upper_bound_of_the_error(space: rg.ConfigurationSpace, seed: int, decades: float) -> None:
    """Perturbed and exact solutions of small circuits with conductances over twelve orders of magnitude."""
    rng = np.random.default_rng(seed)
    try:
        netlist = rg.compile_space(space, boundary="wall", wall_resistance=30.0)
        system = assemble(netlist.replace(conductance=10.0 ** rng.uniform(-6, 6, len(netlist.conductance))))
    except rg.CircuitError:
        return
    if system.rails is None or not 0 < system.size <= 24:
        return
    rhs = system.rails.to_low
    true = rational_solution(system, rhs)
    wrong = [x * (1 + Fraction(float(10.0**decades * rng.uniform(-1, 1)))) for x in true]
    violation = sum(violations(system, rhs, wrong))
    if violation < Fraction(1, 10):
        error = max(abs(a / b - 1) for a, b in zip(wrong, true, strict=True))
        assert error <= refinement.entry_bound(float(violation)) * (1 + 1e-9)


def rational_solution(system: Equations, rhs: np.ndarray) -> list[Fraction]:
    """Return the solution by elimination in exact arithmetic, with row sums as the diagonal."""
    n, coupling = system.size, system.laplacian.edges.toarray()
    a = [[-Fraction(float(g)) for g in row] for row in coupling]
    for i in range(n):
        a[i][i] = Fraction(float(system.laplacian.ground[i])) - sum(a[i], Fraction(0))
    return eliminated(a, [Fraction(float(current)) for current in rhs])


def test_both_methods_agree_on_parts_without_current() -> None:
    """Where no current flows, rounding errors define no scale: voltages are equal to thirty digits."""
    space = space_of(serpentine(7, 60, 3))
    netlist = rg.compile_space(space, boundary="neumann", drive="start", start=(9, 30))
    direct, multigrid = (rg.solve(netlist, method=method) for method in ("direct", "multigrid"))
    assert np.any(direct.resistor_direction == 0)
    assert np.array_equal(direct.resistor_direction, multigrid.resistor_direction)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann", "wall"])
def test_currents_near_the_smallest_double_scale_with_the_sources(boundary: str) -> None:
    options = {"wall_resistance": 1e5} if boundary == "wall" else {}
    netlist = rg.compile_space(scattered((50, 40), 4), boundary=boundary, **options)
    plain = rg.solve(netlist)
    few = np.ldexp(1.0, -700)
    scaled = rg.solve(netlist.replace(source_volts=netlist.source_volts * few, current_amps=netlist.current_amps * few))
    assert np.array_equal(plain.resistor_direction, scaled.resistor_direction)
    flows = plain.resistor_direction != 0
    error = plain.resistor_log_current[flows] - scaled.resistor_log_current[flows] + np.log(few)
    assert np.abs(error).max() < 1e-12
    assert np.allclose(plain.source_current * few, scaled.source_current, rtol=1e-12, atol=0)
    assert scaled.kcl_residual < 1e-12
    assert plain.kcl_residual < 1e-12


def test_power_returns_powers_of_2_to_256() -> None:
    exponent = np.array([-100, -5, -4, -3, -1, 0, 1, 3])
    assert np.array_equal(power(exponent), np.exp2(256.0 * exponent))
    assert np.all(np.isinf(power(np.array([4, 5, 99]))))


def test_cancelled_values_in_lower_parts_have_no_imbalance() -> None:
    """Two nodes, joined and grounded by 1 S each, whose values cancel up to the smallest double."""
    indptr, indices, one = np.array([0, 1, 2], np.int32), np.array([1, 0], np.int32), np.ones(2)
    none, hi, lo, left = np.zeros(2, np.int64), np.zeros(2), np.array([0.0, 5e-324]), np.ones(2)
    matrix = Graph(indptr, indices, one, one)
    found = refinement.imbalance(matrix, (np.zeros(2), none), Scaled(hi, lo, none), (left, none.copy()), floor=1e-20)
    assert (found.backward, found.unconverged, found.log_size) == (0.0, 0.0, -np.inf)
    assert not left.any()
