"""Refinement and read-off: every node is judged by its own currents, whatever its size beside others."""

from fractions import Fraction

import numpy as np
import pytest
from spaces import serpentine, space_of

from resgrid.compiler import compile_space
from resgrid.nodal import methods, readout, refine
from resgrid.nodal.methods import factor_system
from resgrid.nodal.refine_kernels import residual
from resgrid.nodal.scaled import Scaled, power
from resgrid.nodal.solve import solve
from resgrid.nodal.system import NodalSystem, assemble
from resgrid.space import ConfigurationSpace

EXACT = 1e-13
"""The largest share of a node's currents by which KCL may be violated."""


def scattered(shape: tuple[int, ...], seed: int) -> ConfigurationSpace:
    """Single obstacle cells here and there, the goal in the middle."""
    cell = (np.random.default_rng(seed).random(shape) < 0.08).astype(np.uint8)
    cell[tuple(size // 2 for size in shape)] = 2
    return space_of(cell)


def imbalance(system: NodalSystem, rhs: np.ndarray, found: Scaled) -> float:
    """Largest violation of KCL relative to the currents at a row, in exact arithmetic."""
    value = [
        (Fraction(float(hi)) + Fraction(float(lo))) * Fraction(2) ** (256 * int(e))
        for hi, lo, e in zip(found.hi, found.lo, found.exponent, strict=True)
    ]
    coupling, worst = system.coupling, Fraction(0)
    for i in range(system.size):
        flows = [Fraction(float(rhs[i])), -Fraction(float(system.excess[i])) * value[i]]
        for k in range(coupling.indptr[i], coupling.indptr[i + 1]):
            flows.append(Fraction(float(coupling.data[k])) * (value[coupling.indices[k]] - value[i]))
        worst = max(worst, abs(sum(flows, Fraction(0))) / sum((abs(flow) for flow in flows), Fraction(0)))
    return float(worst)


@pytest.mark.parametrize("shape", [(40, 30), (12, 10, 9)])
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann", "wall"])
@pytest.mark.parametrize("method", ["direct", "multigrid"])
def test_currents_balance_at_every_node_in_exact_arithmetic(shape: tuple[int, ...], boundary: str, method: str) -> None:
    options = {"wall_resistance": 1e6} if boundary == "wall" else {}
    system = assemble(compile_space(scattered(shape, 3), boundary=boundary, **options))
    rhs = system.rails.to_low if system.rails is not None else system.injected
    found, _ = factor_system(system, method, reduce=False).solve_nonnegative(rhs)
    assert imbalance(system, rhs, found) < 1.01 * EXACT


def test_currents_balance_where_potentials_leave_the_range_of_a_double() -> None:
    system = assemble(compile_space(space_of(serpentine(9, 120, 3))))
    assert system.rails is not None
    found, error = factor_system(system, "multigrid").solve_nonnegative(system.rails.to_low)
    assert found.log.min() / np.log(10) < -330
    assert error < EXACT
    # After some thirty passes rows that were right before may be off by more roundings.
    assert imbalance(system, system.rails.to_low, found) < 4 * EXACT


def test_a_start_behind_which_nothing_flows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no current flows its rounding is no scale: there voltages are equal to thirty digits."""
    monkeypatch.setattr(methods, "may_reduce", lambda _: False)
    space = space_of(serpentine(7, 60, 3))
    netlist = compile_space(space, boundary="neumann", drive="start", start=(9, 30))
    direct, multigrid = (solve(netlist, method=method) for method in ("direct", "multigrid"))
    assert np.any(direct.resistor_direction == 0)
    assert np.array_equal(direct.resistor_direction, multigrid.resistor_direction)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann", "wall"])
def test_exponents_change_nothing_where_they_are_not_needed(boundary: str, monkeypatch: pytest.MonkeyPatch) -> None:
    options = {"wall_resistance": 1e5} if boundary == "wall" else {}
    netlist = compile_space(scattered((50, 40), 4), boundary=boundary, **options)
    plain = solve(netlist)
    monkeypatch.setattr(readout, "_LEAST_EXPONENT", 1)
    scaled = solve(netlist)
    assert np.array_equal(plain.resistor_direction, scaled.resistor_direction)
    flows = plain.resistor_direction != 0
    error = plain.resistor_log_current[flows] - scaled.resistor_log_current[flows]
    assert np.abs(error).max() < 1e-13
    assert np.allclose(plain.source_current, scaled.source_current, rtol=1e-12, atol=0)
    assert plain.power == pytest.approx(scaled.power, rel=1e-13)
    assert scaled.kcl_residual < 1e-12
    assert plain.kcl_residual < 1e-12


def test_powers_are_those_of_two() -> None:
    exponent = np.array([-100, -5, -4, -3, -1, 0, 1, 3])
    assert np.array_equal(power(exponent), np.exp2(256.0 * exponent))
    assert np.all(np.isinf(power(np.array([4, 5, 99]))))


def test_what_lower_parts_leave_of_values_that_are_gone_is_right() -> None:
    """Two nodes, joined and held by 1 S each, whose values have cancelled but for the last bits of a double."""
    indptr, indices, one = np.array([0, 1, 2], np.int32), np.array([1, 0], np.int32), np.ones(2)
    none, hi, lo, left = np.empty(0, np.int64), np.zeros(2), np.array([0.0, 5e-324]), np.ones(2)
    rows = np.empty(0, np.int32)
    found = residual(indptr, indices, one, one, np.zeros(2), none, hi, lo, none, True, 1e-20, 1.0, rows, left, none)
    assert (found.backward, found.left, found.largest) == (0.0, 0.0, 0.0)
    assert not left.any()


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_around_few_corrections_residuals_are_those_of_all_rows(boundary: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An inverse that is off at some rows, and turns to them alone from its second pass on."""
    system = assemble(compile_space(scattered((60, 50), 8), boundary=boundary))
    rhs = system.rails.to_low if system.rails is not None else system.injected
    inverse = np.linalg.inv(np.diag(system.degree) - system.coupling.toarray())
    late = np.random.default_rng(1).random(system.size) < 0.01
    own = np.linalg.inv(np.linalg.inv(inverse)[np.ix_(late, late)])

    def answer() -> tuple[Scaled, float]:
        passes = 0

        def approximate(m: np.ndarray, e: np.ndarray, _: float) -> refine.Numbers:
            nonlocal passes
            passes += 1
            x = (inverse @ m) * np.where(late, 1.001, 1.0)
            if passes > 1:
                x = np.zeros_like(m)
                x[late] = own @ m[late]
            return x, np.zeros_like(e)

        return refine.refine(system, rhs, approximate, 1e-20)

    around, error = answer()
    monkeypatch.setattr(refine, "_FEW", system.size + 1)
    of_all, least_error = answer()
    assert np.array_equal(around.hi, of_all.hi)
    assert np.array_equal(around.lo, of_all.lo)
    assert least_error <= error < 1e-12
