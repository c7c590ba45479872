"""Circuits with conductances, voltages and currents near the ends of the range of doubles.

The reference solves the nodal equations in fractions.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
import pytest

import resgrid as rg

ULP = 5e-324
OPTIONS = [(accuracy, method) for accuracy in ("direction", "normwise") for method in ("auto", "direct", "multigrid")]


@pytest.fixture(autouse=True)
def numeric_warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def exact(netlist: rg.Netlist) -> list[Fraction]:
    """Return the node voltages of a circuit of resistors and current sources, by Gaussian elimination in fractions."""
    size = netlist.node_count - 1
    rows = [[Fraction(0)] * (size + 1) for _ in range(size)]
    for ends, siemens in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
        for i, j in (ends, ends[::-1]):
            if i:
                rows[i - 1][i - 1] += Fraction(siemens)
                if j:
                    rows[i - 1][j - 1] -= Fraction(siemens)
    for (source, target), amps in zip(netlist.current_nodes.tolist(), netlist.current_amps.tolist(), strict=True):
        for node, signed in ((source, -amps), (target, amps)):
            if node:
                rows[node - 1][size] += Fraction(signed)
    for k in range(size):
        pivot = next(row for row in range(k, size) if rows[row][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for row in range(size):
            if row != k and (factor := rows[row][k] / rows[k][k]):
                rows[row] = [a - factor * b for a, b in zip(rows[row], rows[k], strict=True)]
    return [Fraction(0)] + [rows[k][size] / rows[k][k] for k in range(size)]


@pytest.mark.parametrize(("accuracy", "method"), OPTIONS)
@pytest.mark.parametrize("seed", range(12))
def test_voltages_and_currents_of_extreme_circuits_are_exact(seed: int, accuracy: str, method: str) -> None:
    rng = np.random.default_rng(seed)
    nodes = int(rng.integers(3, 9))
    tree = [[node, int(rng.integers(node))] for node in range(1, nodes)]
    ends = tree + [rng.choice(nodes, 2, replace=False).tolist() for _ in range(nodes // 2)]
    siemens = rng.choice([1e-120, 1e-60, 1e-12, 1.0, 1e60, 1e120], len(ends))
    amps = rng.choice([1e-60, 1.0, -1e60], 2)
    netlist = rg.Netlist(nodes, ends, siemens, current_nodes=[[0, nodes - 1], [1, 2]], current_amps=amps)
    volts = exact(netlist)
    falls = [volts[a] - volts[b] for a, b in ends]
    currents = [float(Fraction(g) * fall) for g, fall in zip(siemens.tolist(), falls, strict=True)]
    point = rg.solve(netlist, accuracy=accuracy, method=method)
    np.testing.assert_allclose(point.voltage, [float(each) for each in volts], rtol=4e-16, atol=0)
    np.testing.assert_allclose(point.resistor_current, currents, rtol=4e-16, atol=0)
    heat = sum((Fraction(g) * fall * fall for g, fall in zip(siemens.tolist(), falls, strict=True)), Fraction(0))
    assert point.power == pytest.approx(float(heat), rel=1e-15)
    assert point.kcl_residual < 1e-12


@pytest.mark.parametrize(("accuracy", "method"), OPTIONS)
@pytest.mark.parametrize("siemens", [ULP, 1e-310, 1e-300, 1e300])
def test_a_divider_of_extreme_resistors_halves_the_voltage(siemens: float, accuracy: str, method: str) -> None:
    divider = rg.Netlist(3, [[1, 2], [2, 0]], [siemens, siemens], source_nodes=[[1, 0]], source_volts=[2.0])
    point = rg.solve(divider, accuracy=accuracy, method=method)
    assert point.voltage.tolist() == [0.0, 2.0, 1.0]
    assert point.resistor_current.tolist() == [siemens, siemens]
    assert point.source_current.tolist() == [-siemens]


def test_a_current_through_a_subnormal_conductance_is_refused_only_if_the_voltage_overflows() -> None:
    ladder = rg.Netlist(3, [[1, 0], [2, 1]], [1e-310, 1.0], current_nodes=[[0, 2]], current_amps=[1e-12])
    assert rg.solve(ladder).voltage[1] == pytest.approx(float(Fraction(1e-12) / Fraction(1e-310)), rel=1e-15)
    with pytest.raises(rg.CircuitError, match="a voltage exceeds"):
        rg.solve(ladder.replace(current_amps=[1.0]))


def test_a_known_voltage_is_exact_beside_subnormal_conductances() -> None:
    """The current source drives its current through the voltage source alone."""
    shorted = rg.Netlist(
        3, [[2, 0], [1, 0]], [2e-308, 2e-308], source_nodes=[[0, 1]], source_volts=[-1e-310],
        current_nodes=[[0, 1]], current_amps=[-1e-13],
    )  # fmt: skip
    point = rg.solve(shorted)
    assert point.voltage.tolist() == [0.0, 1e-310, 0.0]
    assert point.source_current.tolist() == [1e-13]


def test_logarithms_of_currents_below_the_range_of_doubles_keep_their_digits() -> None:
    weak = rg.Netlist(3, [[1, 2], [2, 0]], [1e-200, 1.0], source_nodes=[[1, 0]], source_volts=[1e-200])
    point = rg.solve(weak)
    np.testing.assert_allclose(point.resistor_log_current, -400 * math.log(10), rtol=1e-15)
    assert point.resistor_direction.tolist() == [1, 1]
    assert point.log_drop is not None
    assert point.log_drop[2] == pytest.approx(-1e-200, rel=1e-12)


@pytest.mark.slow
def test_a_mesh_of_1024_nodes_with_extreme_conductances_obeys_kirchhoffs_laws() -> None:
    """The sums of exact currents at the nodes, and of voltages along resistors, in fractions."""
    rng, side = np.random.default_rng(4), 32
    node = np.arange(side * side).reshape(side, side)
    ends = np.concatenate(
        [np.stack([node[1:], node[:-1]], -1).reshape(-1, 2), np.stack([node[:, 1:], node[:, :-1]], -1).reshape(-1, 2)]
    )
    siemens = 10.0 ** rng.uniform(-120, 120, len(ends))
    netlist = rg.Netlist(side * side, ends, siemens, source_nodes=[[side * side - 1, 0]], source_volts=[1.0])
    op = rg.solve(netlist)
    net, through = ([Fraction(0)] * netlist.node_count for _ in range(2))
    for (first, second), amps in zip(ends.tolist(), op.resistor_current.tolist(), strict=True):
        for end, signed in ((first, -amps), (second, amps)):
            net[end] += Fraction(signed)
            through[end] += abs(Fraction(signed))
    assert all(abs(a) <= b / 10**15 for a, b in zip(net[1:-1], through[1:-1], strict=True))
    falls = op.voltage[ends[:, 0]] - op.voltage[ends[:, 1]]
    apart = np.abs(falls) > 1e-9 * np.abs(op.voltage[ends]).max(axis=1)
    assert np.allclose(op.resistor_current[apart], (siemens * falls)[apart], rtol=1e-6, atol=0.0)
    assert (op.voltage[1:-1] > 0.0).all() and (op.voltage < 1.0 + 1e-15).all()


@pytest.mark.parametrize(("siemens", "volts"), [((1e39, 1.0), 3.5), ((1e-275, 1e234), -1.0), ((1e-5, 1e4), -1.0)])
def test_nodes_on_one_rail_have_its_log_drop_and_potential(siemens: tuple[float, float], volts: float) -> None:
    op = rg.solve(rg.Netlist(3, [[0, 1], [2, 1]], siemens, source_nodes=[[1, 0]], source_volts=[volts]))
    assert op.voltage.tolist() == [0.0, volts, volts]
    assert op.log_drop is not None and op.potential is not None
    assert op.log_drop[2] == op.log_drop[1] == (-np.inf if volts > 0 else 0.0)
    assert op.potential[2] == op.potential[1] == (1.0 if volts > 0 else 0.0)
    found = rg.gradient(op, of="collision_probability", at=2)
    assert found.value == op.potential[2]


def test_a_current_between_voltages_that_differ_only_in_their_third_double_is_exact() -> None:
    netlist = rg.Netlist(
        5, [[2, 4], [4, 3]], [2.0, 2.0], source_nodes=[[1, 0], [2, 1], [3, 2]], source_volts=[6e-32, 6e103, 2e-128]
    )
    np.testing.assert_allclose(rg.solve(netlist).resistor_current, [-2e-128, -2e-128], rtol=1e-15)


@pytest.mark.parametrize(
    ("ends", "siemens", "sources", "volts", "dead"),
    [
        ([[2, 1], [3, 2], [4, 3]], [1.0, 8e298, 2e286], [[2, 3], [0, 1]], [1e300, 0.0], (2, 1)),
        ([[1, 3], [2, 1], [5, 0]], [7e255, 1.0, 4e277], [[3, 1], [5, 2]], [1e300, 1.0], (2, 1)),
    ],
)
def test_currents_of_dead_ends_are_zero_where_another_current_overflows(
    ends: list[list[int]], siemens: list[float], sources: list[list[int]], volts: list[float], dead: tuple[int, int]
) -> None:
    count = 1 + max(max(pair) for pair in ends)
    op = rg.solve(rg.Netlist(count, ends, siemens, source_nodes=sources, source_volts=volts))
    resistor, source = dead
    assert np.isinf(op.resistor_current).any()
    assert op.resistor_current[resistor] == 0.0 == op.source_current[source]
    np.testing.assert_array_equal(np.sign(op.resistor_current), op.resistor_direction)


def test_inner_voltages_of_floating_parts_may_exceed_the_range_of_doubles() -> None:
    ends, current = [[1, 0], [2, 3]], {"current_nodes": [[2, 3]], "current_amps": [1e200]}
    op = rg.solve(rg.Netlist(4, ends, [1.0, 1e-150], **current))
    np.testing.assert_array_equal(op.voltage, [0.0, 0.0, np.nan, np.nan])
    np.testing.assert_array_equal(op.resistor_current, [0.0, -1e200])
    with pytest.raises(rg.CircuitError, match=r"a voltage exceeds 1\.8e308 V"):
        rg.solve(rg.Netlist(4, [[3, 0], [2, 3]], [1.0, 1e-150], **current))
