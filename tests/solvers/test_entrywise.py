"""Entrywise accuracy of potentials, compared with mpmath arithmetic of sixty digits.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers.method_choice`, `resgrid.solvers.selected_inverse`.
"""

import mpmath
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order
from support.spaces import serpentine, space_of

import resgrid as rg
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.selected_inverse import symmetric_factors


def reference_log(system: Equations, rhs: np.ndarray) -> np.ndarray:
    """Logarithms of the solution, by elimination along the corridor in 60 digits."""
    order = breadth_first_order(
        system.laplacian.edges, int(np.argmax(rhs > 0)), directed=False, return_predecessors=False
    )
    place = np.argsort(order)
    coupling = system.laplacian.edges.tocsr()
    with mpmath.workdps(60):
        rows = []
        for i in order:
            entries = range(coupling.indptr[i], coupling.indptr[i + 1])
            row = {int(place[coupling.indices[k]]): -mpmath.mpf(float(coupling.data[k])) for k in entries}
            row[int(place[i])] = -sum(row.values()) + mpmath.mpf(float(system.laplacian.ground[i]))
            rows.append(row)
        b = [mpmath.mpf(float(rhs[i])) for i in order]
        for i, row in enumerate(rows):
            later = [j for j in row if j > i]
            for j in later:
                factor = rows[j].pop(i) / row[i]
                b[j] -= factor * b[i]
                for k in later:
                    rows[j][k] = rows[j].get(k, mpmath.mpf(0)) - factor * row[k]
        for i in range(len(rows) - 1, -1, -1):
            b[i] = (b[i] - sum(value * b[j] for j, value in rows[i].items() if j > i)) / rows[i][i]
        logs = np.array([float(mpmath.log(value)) for value in b])
    return logs[place]


@pytest.mark.parametrize(
    ("legs", "leg", "width", "decades"),
    [(4, 60, 5, -50), (27, 120, 3, -1000), (20, 120, 2, -900), (30, 120, 1, -2000)],
)
@pytest.mark.quick_cases(2)
def test_the_drop_along_a_serpentine_agrees_with_mpmath(legs: int, leg: int, width: int, decades: int) -> None:
    netlist = rg.compile_space(space_of(serpentine(legs, leg, width)))
    system = assemble(netlist)
    assert system.rails is not None
    expected = reference_log(system, system.rails.to_low)
    point = rg.solve(netlist)
    assert point.log_drop is not None
    solved = system.unknown >= 0
    assert expected.min() / np.log(10) < decades
    _assert_entry_error_holds(point, point.log_drop[solved], expected[system.unknown[solved]])


def test_the_drop_by_multigrid_along_a_serpentine_agrees_with_mpmath() -> None:
    netlist = rg.compile_space(space_of(serpentine(6, 80, 4)))
    system = assemble(netlist)
    assert system.rails is not None
    expected = reference_log(system, system.rails.to_low)
    point = rg.solve(netlist, method="multigrid")
    assert point.method == "multigrid"
    assert point.log_drop is not None
    solved = system.unknown >= 0
    assert expected.min() / np.log(10) < -120
    _assert_entry_error_holds(point, point.log_drop[solved], expected[system.unknown[solved]])


def _assert_entry_error_holds(point: rg.OperatingPoint, log: np.ndarray, exact: np.ndarray) -> None:
    """Assert that `OperatingPoint.entry_error` bounds the error of every entry and is at most 1e-8."""
    assert point.entry_error <= 1e-8
    rounding = 2 * np.spacing(np.abs(exact))  # of both logarithms, which entry_error excludes
    assert np.all(np.abs(log - exact) <= point.entry_error + rounding)


def test_a_surrounding_goal_keeps_small_potentials_accurate() -> None:
    """The mirror image: far from the obstacle phi underflows and u rounds to 1."""
    cell = np.full((5, 1500), 2)
    cell[1:4, 1:-1] = 0
    cell[1:4, 0] = 1
    point = rg.solve(rg.compile_space(space_of(cell), edge="open"))
    assert point.kcl_residual < 1e-11
    field = rg.field(point)
    assert field.potential[2, 5] < 0.1
    # Currents still run from the obstacle outwards where phi is far below 1e-308.
    assert np.all(field.face_direction[1][2, 1:1400] == 1)
    assert field.face_log_current[1][2, 1399] < -1000


@pytest.mark.parametrize("method", ["direct", "multigrid"])
@pytest.mark.parametrize("width", [3, 6])
def test_the_kcl_residual_ignores_parts_without_current(method: str, width: int) -> None:
    """Beyond a driving start all currents are rounding errors, which may violate KCL."""
    space = space_of(serpentine(7, 60, width))
    free = np.argwhere(space.cell == 0)
    netlist = rg.compile_space(space, boundary="neumann", drive="start", start=free[len(free) // 2].tolist())
    point = rg.solve(netlist, method=method)
    assert point.method == method
    assert point.kcl_residual <= 1e-6
    assert point.backward_error <= 1e-12


def test_an_operating_point_belongs_to_its_own_circuit() -> None:
    def netlist(column: int) -> rg.Netlist:
        cell = np.zeros((10, 10), dtype=np.uint8)
        cell[4, column] = 2
        return rg.compile_space(space_of(cell), boundary="neumann")

    point, same, other = rg.solve(netlist(2)), netlist(2), netlist(7)
    assert point.is_of(same)
    assert not point.is_of(other)
    np.testing.assert_array_equal(
        rg.normalize_drive(same, point).current_amps, rg.normalize_drive(point.netlist, point).current_amps
    )
    with pytest.raises(rg.InputError, match="another netlist; solve this one first"):
        rg.normalize_drive(other, point)


def test_conductances_over_24_orders_of_magnitude_give_exact_results() -> None:
    count = 50
    pairs = np.array([(i, i + 1) for i in range(1, count)] + [(count, 0)])
    conductance = np.append(np.full(count - 1, 1e12), 1e-12)
    point = rg.solve(rg.Netlist(count + 1, pairs, conductance, np.array([[1, 0]]), np.array([1.0])))
    assert np.allclose(point.voltage[1:], 1.0, rtol=1e-15)
    assert point.resistor_current[-1] == pytest.approx(1e-12, rel=1e-14)


def test_stiff_chains_on_a_weak_ground_are_exact_without_subtraction() -> None:
    """Factors without subtraction are exact; symmetric factors lose all digits and raise AccuracyError."""
    count = 50
    pairs = np.array([(i, i + 1) for i in range(1, count)] + [(count, 0)])
    netlist = rg.Netlist(
        count + 1,
        pairs,
        np.append(np.full(count - 1, 1e12), 1e-12),
        current_nodes=np.array([[0, 1]]),
        current_amps=np.array([1e-12]),
    )
    point = rg.solve(netlist)
    assert np.all(point.voltage[1:] == 1.0)
    assert np.allclose(point.resistor_current, 1e-12, rtol=1e-6, atol=0)
    assert point.kcl_residual < 1e-6
    system = assemble(netlist)
    volts, _ = factor_laplacian(system.laplacian, "direct").solve_nonnegative(system.drive)
    assert np.allclose(volts.plain, 1.0, rtol=1e-14, atol=0)
    with pytest.raises(rg.AccuracyError, match="orders of magnitude"):
        symmetric_factors(sparse.diags_array(system.laplacian.diagonal) - system.laplacian.edges)
