"""Small voltages and currents that remain after large ones cancel, against exact fractions.

``RESGRID_CIRCUITS`` sets the number of random circuits, ``RESGRID_SEED`` their seed.
"""

from __future__ import annotations

import os
import warnings
from fractions import Fraction

import numpy as np
import pytest
from support.cancelling import cancelling_circuit
from support.fractions_solver import Value, solve_exactly

import resgrid as rg

_RELATIVE_ERROR = Fraction(1, 10**15)
"""Promised relative error of every voltage and every current in circuits of few nodes."""

_FLOOR = Fraction(1, 2**1000)
"""Fraction of the largest voltage or current below which a value may be returned as zero."""


def assert_exact(netlist: rg.Netlist, point: rg.OperatingPoint) -> None:
    exact = solve_exactly(netlist)
    assert exact is not None
    _assert_close(point.voltage, exact.voltage)
    through = exact.resistor_current + exact.source_current
    _assert_close(np.concatenate([point.resistor_current, point.source_current]), through)
    assert point.kcl_residual < 1e-9


def _assert_close(found: np.ndarray, wanted: list[Value]) -> None:
    largest = max((abs(value) for value in wanted if value is not None), default=Fraction(0))
    for value, exact in zip(found.tolist(), wanted, strict=True):
        assert np.isnan(value) == (exact is None)
        if exact is not None:
            assert abs(Fraction(value) - exact) <= max(_RELATIVE_ERROR * abs(exact), _FLOOR * largest), (
                value,
                float(exact),
            )


@pytest.mark.parametrize("part", range(8))
def test_random_circuits_with_cancelling_currents_equal_exact_fractions(part: int) -> None:
    seed, count = int(os.environ.get("RESGRID_SEED", "0")), int(os.environ.get("RESGRID_CIRCUITS", "400"))
    for number in range(part, count, 8):
        netlist = cancelling_circuit(seed, number)
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "[0-9]+ voltage sources form loops")
                point = rg.solve(netlist, method=("auto", "direct", "multigrid")[number % 3])
        except rg.CircuitError as error:
            exact = solve_exactly(netlist)
            assert exact is None or (
                "no resistor or voltage source touches ground" in str(error) and not any(exact.voltage)
            )
            continue
        assert_exact(netlist, point)


def test_resistors_behind_current_sources_that_cancel_carry_exactly_zero() -> None:
    """Two sources of 1 mA cancel at node 2, so that its parallel resistors carry zero current."""
    netlist = rg.Netlist(
        4, [[3, 1], [1, 2], [1, 0], [3, 0], [2, 1], [3, 0]], [0.0882, 0.0185, 0.003, 0.00343, 0.0135, 0.000179],
        current_nodes=[[1, 0], [3, 2], [2, 0], [3, 0], [3, 0], [3, 0]],
        current_amps=[1.0, 1e-3, 1e-3, -4.67, 1.3e-24, -10.567],
    )  # fmt: skip
    point = rg.solve(netlist)
    assert_exact(netlist, point)
    assert point.resistor_direction[[1, 4]].tolist() == [0, 0]


def test_a_voltage_source_carries_the_small_difference_of_large_currents() -> None:
    netlist = rg.Netlist(
        4, [[2, 3], [0, 1]], [1.0, 1.0], [[1, 0], [2, 1], [2, 3]], [1.0, 1.0, 1.0],
        current_nodes=[[3, 0]], current_amps=[-2e-13],
    )  # fmt: skip
    point = rg.solve(netlist)
    assert_exact(netlist, point)
    assert point.source_current[1] == 2e-13


@pytest.mark.parametrize("weak", [1e-5, 1.0, 50.0])
def test_a_weak_resistor_parallel_to_a_strong_one_carries_its_exact_current(weak: float) -> None:
    netlist = rg.Netlist(
        4, [[1, 0], [2, 1], [2, 1], [3, 2]], [1e-12, weak, 1e12, 1.0], current_nodes=[[3, 0]], current_amps=[-0.072]
    )
    point = rg.solve(netlist)
    assert_exact(netlist, point)
    assert point.resistor_direction.tolist() == [1, 1, 1, 1]


def test_weak_resistors_determine_the_voltage_of_strongly_coupled_nodes() -> None:
    """Weak resistors put nodes 2 and 4 at 0 V, while 1e13 A flow among their neighbours."""
    netlist = rg.Netlist(
        9, [[0, 1], [1, 2], [1, 3], [2, 4], [0, 5], [2, 6], [1, 7], [5, 8], [0, 6]],
        [1e-12, 1e12, 1e-12, 1e12, 1.0, 1e12, 1e12, 1e12, 1e-12],
        [[7, 6], [0, 5]], [22.27, 1.917], current_nodes=[[0, 5]], current_amps=[-0.07],
    )  # fmt: skip
    point = rg.solve(netlist)
    assert_exact(netlist, point)
    assert point.voltage[[2, 4]].tolist() == [0.0, 0.0]


def test_currents_of_balanced_current_sources_in_a_floating_part_are_exact() -> None:
    netlist = rg.Netlist(
        7, [[1, 0], [2, 3], [3, 4], [4, 2], [5, 4], [5, 6]], [1.0, 1.0, 2.0, 4.0, 1e-12, 3.0],
        [[1, 0], [5, 6]], [1.0, 2.0], current_nodes=[[2, 3], [0, 4], [2, 0]], current_amps=[0.3, 0.1, 0.1],
    )  # fmt: skip
    point = rg.solve(netlist)
    assert point.floating.tolist() == [2, 3, 4, 5, 6]
    assert_exact(netlist, point)


@pytest.mark.parametrize("reach", [1, 2])
def test_a_net_current_into_a_floating_part_raises_circuit_error(reach: int) -> None:
    netlist = rg.Netlist(
        4, [[1, 0], [2, 3]], [1.0, 1.0], [[1, 0]], [1.0],
        current_nodes=[[0, 2], [2, 3]][:reach], current_amps=[1e-3, 1.0][:reach],
    )  # fmt: skip
    with pytest.raises(rg.CircuitError, match=r"inject 0.001 A into node node_2 and the nodes connected to it"):
        rg.solve(netlist)


def test_weak_resistors_determine_the_voltage_of_a_large_strongly_coupled_mesh() -> None:
    """The mesh is symmetric under a half turn: opposite nodes have opposite voltages."""
    side = 40
    mesh = 1 + np.arange(side * side).reshape(side, side)
    sides = ((mesh[1:], mesh[:-1]), (mesh[:, 1:], mesh[:, :-1]))
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in sides])
    ties = [[mesh[0, 0], 0], [mesh[-1, -1], 0], [mesh[0, -1], 0], [mesh[-1, 0], 0]]
    source = [[mesh[7, 11], mesh[-8, -12]]]
    conductance = np.append(np.full(len(pairs), 1e12), [1e-12] * 4)
    point = rg.solve(rg.Netlist(side * side + 1, np.concatenate([pairs, ties]), conductance, source, [22.3]))
    volts = point.voltage[1:]
    np.testing.assert_allclose(volts, -volts[::-1], rtol=1e-12, atol=0)
    np.testing.assert_allclose(point.resistor_current[-4:] * 1e12, volts[np.subtract(ties, 1)[:, 0]], rtol=1e-12)


def test_small_source_currents_of_large_circuits_keep_their_digits() -> None:
    """A source between two others carries 2e-13 A, while each neighbour carries 1 A."""
    chain = np.arange(4, 30_000)
    netlist = rg.Netlist(
        30_000, np.concatenate([[[2, 3], [0, 1]], np.stack([chain, np.append(0, chain[:-1])], axis=1)]),
        np.ones(len(chain) + 2), [[1, 0], [2, 1], [2, 3]], [1.0, 1.0, 1.0],
        current_nodes=[[3, 0], [0, 29_999]], current_amps=[-2e-13, 1e-3],
    )  # fmt: skip
    assert rg.solve(netlist).source_current == pytest.approx([-1.0, 2e-13, -1.0], rel=1e-12)


def test_currents_below_the_range_of_doubles_do_not_disturb_others() -> None:
    """A source of 1 nV on 1 V drives 1 nA, while the currents along a ladder decrease to 1e-372 A."""
    resistors = [(2, 1, 1.0)]
    for node in range(3, 19):
        resistors += [(node - 1 if node > 3 else 1, node, 1e-12), (node, 0, 1e12)]
    netlist = rg.Netlist(
        19,
        [resistor[:2] for resistor in resistors],
        [resistor[2] for resistor in resistors],
        source_nodes=[[1, 0], [2, 1]],
        source_volts=[1.0, 1e-9],
    )
    point = rg.solve(netlist)
    assert point.resistor_current[0] == 1e-9
    assert point.source_current[1] == -1e-9
    rungs = point.resistor_log_current[2::2] / np.log(10.0)
    assert rungs == pytest.approx(-12.0 - 24.0 * np.arange(16), rel=1e-12)


def test_currents_near_the_smallest_double_are_solved() -> None:
    """Currents of 1e-312 A are subnormal, so that Kirchhoff's current law is not a useful test."""
    resistors = [(5, 4, 1.0), (4, 1, 2e12), (5, 1, 1e12), (0, 3, 0.1), (2, 3, 1e11), (5, 3, 1e12), (9, 4, 1e-12)]
    resistors += [(1, 4, 1e-12), (6, 2, 0.1), (7, 2, 1.0), (7, 3, 1e11), (8, 0, 0.1), (9, 0, 2e-12)]
    netlist = rg.Netlist(
        10,
        [resistor[:2] for resistor in resistors],
        [resistor[2] for resistor in resistors],
        source_nodes=[[1, 0], [2, 1]],
        source_volts=[1e-300, 0.0],
    )
    exact = solve_exactly(netlist)
    assert exact is not None
    current = [float(amps or 0) for amps in exact.resistor_current]
    assert rg.solve(netlist).resistor_current == pytest.approx(current, rel=1e-15, abs=1e-323)


@pytest.mark.parametrize("volts", [1.0, 1e-250, 1e-290])
def test_voltages_down_to_1e_290_have_full_relative_accuracy(volts: float) -> None:
    """A floating source on a chain of 1e-12 S with a dead end."""
    netlist = rg.Netlist(
        8,
        [[4, 3], [1, 5], [5, 6], [7, 0], [6, 4], [2, 7], [3, 2]],
        [1e-12, 3.0, 1.0, 1e12, 1e-12, 1.0, 1.0],
        source_nodes=[[5, 3]],
        source_volts=[volts],
    )
    point = rg.solve(netlist)
    assert_exact(netlist, point)
    assert point.entry_error < 1e-15
