"""Voltages at time 0+ of a transient, against exact fractions and an infinitesimal Euler step by mpmath."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.dynamics import random_dynamics

import resgrid as rg


@pytest.mark.parametrize("ratio", [1e8, 1e12, 1e15, 1e17])
def test_initial_voltage_of_a_weakly_tied_island_is_exact(ratio: float) -> None:
    netlist = rg.Netlist(
        5, [[2, 3], [1, 2], [3, 0], [1, 4]], [1.0, 1 / ratio, 2 / ratio, 1e-3], source_nodes=[[1, 0]],
        source_volts=[1.0], capacitor_nodes=[[4, 0]], capacitance=[1e-12],
    )  # fmt: skip
    found = rg.circuit.transient(netlist, [0.0, 1e-12, 1e-9, 1e-6])
    assert found.voltage[:, 2] == pytest.approx(np.full(4, (2 + ratio) / (2 + 3 * ratio)), rel=1e-14)


@pytest.mark.parametrize("weak", [1e-9, 1e-12, 1e-16, 1e-20])
def test_initial_voltages_of_capacitors_in_series_divide_exactly(weak: float) -> None:
    netlist = rg.Netlist(
        4, [[2, 3]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0],
        capacitor_nodes=[[1, 2], [2, 3], [3, 0]], capacitance=[weak, 1e-6, weak],
    )  # fmt: skip
    found = rg.circuit.transient(netlist, [0.0]).voltage[0]
    share = weak / (2e-6 + weak)
    assert found[2:] == pytest.approx([0.5 + 0.5 * share, 0.5 - 0.5 * share], rel=1e-14)


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), decades=st.sampled_from([1.0, 6.0]))
def test_initial_voltages_of_random_circuits_equal_an_infinitesimal_euler_step(seed: int, decades: float) -> None:
    netlist = random_dynamics(seed, side=4, decades=decades)
    before = np.random.default_rng(seed).uniform(-1, 1, netlist.node_count)
    before[0] = 0.0
    wanted = _after_infinitesimal_step(netlist, before)
    found = rg.circuit.transient(netlist, [0.0], initial=before).voltage[0]
    assert np.abs(found - wanted).max() < 1e-13 * np.ptp(wanted)


def _after_infinitesimal_step(netlist: rg.Netlist, before: np.ndarray) -> np.ndarray:
    """Return the voltages after one backward Euler step of 1e-80 s in 200 digits; all voltage sources are grounded."""
    with mpmath.workdps(200):
        n, h = netlist.node_count, mpmath.mpf(10) ** -80
        matrix, rhs = mpmath.zeros(n), mpmath.zeros(n, 1)
        for pairs, values, factor in (
            (netlist.resistor_nodes, netlist.conductance, h),
            (netlist.capacitor_nodes, netlist.capacitance, mpmath.mpf(1)),
        ):
            for (i, j), value in zip(pairs.tolist(), values.tolist(), strict=True):
                entry = mpmath.mpf(value) * factor
                for row, sign, other in ((i, 1, j), (j, 1, i)):
                    matrix[row, row] += sign * entry
                    matrix[row, other] -= sign * entry
        for (i, j), value in zip(netlist.capacitor_nodes.tolist(), netlist.capacitance.tolist(), strict=True):
            charge = mpmath.mpf(value) * (mpmath.mpf(before[i]) - mpmath.mpf(before[j]))
            rhs[i] += charge
            rhs[j] -= charge
        for (i, j), amps in zip(netlist.current_nodes.tolist(), netlist.current_amps.tolist(), strict=True):
            rhs[i] -= h * mpmath.mpf(amps)
            rhs[j] += h * mpmath.mpf(amps)
        known = {0: 0.0}
        for (plus, minus), volts in zip(netlist.source_nodes.tolist(), netlist.source_volts.tolist(), strict=True):
            known[plus if minus == 0 else minus] = volts if minus == 0 else -volts
        for node, volts in known.items():
            for column in range(n):
                matrix[node, column] = mpmath.mpf(column == node)
            rhs[node] = mpmath.mpf(volts)
        return np.array(mpmath.lu_solve(matrix, rhs).T.tolist()[0], dtype=np.float64)


def test_initial_voltages_from_the_own_operating_point_are_unchanged() -> None:
    netlist = random_dynamics(3)
    op = rg.solve(netlist)
    assert rg.circuit.transient(netlist, [0.0], initial=op).voltage[0] == pytest.approx(op.voltage, abs=1e-14)


def test_initial_voltages_lost_to_rounding_raise_accuracy_error() -> None:
    # 0.1 + 0.2 - 0.3 A is a rounding error of about 5e-17 A, which 2e-18 S turn into volts.
    netlist = rg.Netlist(
        5, [[1, 2], [2, 3], [3, 0], [4, 0]], [1.0, 1.0, 2e-18, 1.0], current_nodes=[[3, 1], [3, 1], [1, 3]],
        current_amps=[0.1, 0.2, 0.3], capacitor_nodes=[[4, 0]], capacitance=[1.0],
    )  # fmt: skip
    with pytest.raises(rg.AccuracyError, match="0\\+"):
        rg.circuit.transient(netlist, [0.0])
