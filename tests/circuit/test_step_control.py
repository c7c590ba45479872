"""Step control of transients, against closed forms of circuits with widely separated time scales.

Tests internals: `resgrid.circuit.dynamics`, `resgrid.circuit.stepping`.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import resgrid as rg
from resgrid.circuit.dynamics import dynamics_of, factor_resolvent
from resgrid.circuit.stepping import Method, controlled_steps


def one_pole() -> rg.Netlist:
    """Return 1 V through 1 kohm into 1 nF: a time constant of 1 us."""
    return rg.Netlist(
        3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0], capacitor_nodes=[[2, 0]], capacitance=[1e-9]
    )


@pytest.mark.parametrize("options", [{}, {"step": 1e-4}, {"step": 1e-4, "method": "backward_euler"}])
@pytest.mark.parametrize("weak", [1e-9, 1e-13, 1e-16])
def test_the_charge_of_an_island_is_conserved(weak: float, options: dict[str, object]) -> None:
    netlist = rg.Netlist(
        4, [[2, 3]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0],
        capacitor_nodes=[[1, 2], [2, 3], [3, 0]], capacitance=[weak, 1e-6, weak],
    )  # fmt: skip
    found = rg.circuit.transient(netlist, [0.0, 1e-3, 1e-2], **options)
    assert np.abs(found.voltage[:, 2] + found.voltage[:, 3] - 1.0).max() < 1e-13
    assert found.steps < 200


@pytest.mark.parametrize("leak", [1e-6, 1e-9, 1e-12, 1e-14])
def test_the_charge_between_weakly_tied_islands_decays_exactly(leak: float) -> None:
    netlist = rg.Netlist(
        5, [[1, 0], [2, 1], [4, 3], [3, 0]], [1e-3, 1e3, leak, leak], current_nodes=[[0, 1]], current_amps=[1e-3],
        capacitor_nodes=[[2, 4]], capacitance=[1e-10],
    )  # fmt: skip
    times = np.array([0.0, 1e-9, 1e-6, 1e-3, 1.0])
    found = rg.circuit.transient(netlist, times, initial=[0, 3, 1, -2, 5.0])
    # Node 2 ends at 1 V; the excess voltage of the capacitor drives a current through 1 kohm, 1 mohm and two leaks.
    ohms = 1e3 + 1e-3 + 2 / leak
    current = (1.0 - (-4.0)) / ohms * np.exp(-times / (1e-10 * ohms))
    assert found.voltage[:, 4] == pytest.approx(2 / leak * current, abs=5e-6)
    assert found.steps < 500


def test_strong_currents_within_an_island_do_not_change_its_potential() -> None:
    netlist = rg.Netlist(
        7, [[1, 0], [2, 1], [3, 2], [4, 3], [5, 0], [6, 0]], [2.12e-4, 1.015e-2, 2.67e3, 1.66e-8, 2.75e-12, 1.877e-11],
        current_nodes=[[3, 2], [3, 0]], current_amps=[-0.0569, 0.00216], capacitor_nodes=[[3, 6]],
        capacitance=[1.2e-10],
    )  # fmt: skip
    before = [0, 12.0, 382.7, 197.7, 22.4, 131.6, -192.5]
    found = rg.circuit.transient(netlist, [0.0, 1.0], initial=before)
    node3 = -0.00216 * (1 / 2.12e-4 + 1 / 1.015e-2) + (0.0569 - 0.00216) / 2.67e3
    assert found.voltage[-1, 3] == pytest.approx(node3, abs=1e-4)
    ohms = 1 / 2.12e-4 + 1 / 1.015e-2 + 1 / 2.67e3 + 1 / 1.877e-11
    held = (197.7 + 192.5) - node3
    assert found.voltage[-1, 6] == pytest.approx(-held * np.exp(-1.0 / (1.2e-10 * ohms)), abs=1e-3)


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e-12])
def test_the_tolerance_scales_with_the_voltages_of_a_circuit_without_operating_point(scale: float) -> None:
    amps, ohms, farads = 1e-9 * scale, 1e3, 1e-9
    netlist = rg.Netlist(
        3, [[1, 2]], [1 / ohms], current_nodes=[[0, 1]], current_amps=[amps], capacitor_nodes=[[1, 0], [2, 0]],
        capacitance=[farads, farads],
    )  # fmt: skip
    times = np.linspace(0, 5e-6, 21)
    common, apart = amps * times / farads, amps * ohms / 2 * -np.expm1(-2 * times / (ohms * farads))
    found = rg.circuit.transient(netlist, times)
    error = np.abs(found.voltage[:, 1] - (common + apart) / 2)
    assert (error <= 1e-6 * np.maximum.accumulate(found.voltage.max(axis=1))).all()


@pytest.mark.parametrize("leak", [1e-12, 1e-14, 1e-18])
def test_a_large_final_voltage_does_not_loosen_the_tolerance(leak: float) -> None:
    netlist = rg.Netlist(
        4, [[1, 2], [3, 0]], [1e-3, leak], source_nodes=[[1, 0]], source_volts=[1.0], current_nodes=[[0, 3]],
        current_amps=[1e-9], capacitor_nodes=[[2, 0], [3, 0]], capacitance=[1e-9, 1e-12],
    )  # fmt: skip
    times = np.linspace(0, 5e-6, 21)
    found = rg.circuit.transient(netlist, times)
    assert np.abs(found.voltage[:, 2] + np.expm1(-times / 1e-6)).max() < 1e-6


@settings(max_examples=8)
@given(small=st.integers(-18, -13), tolerance=st.sampled_from([1e-2, 1e-3, 1e-6]), last=st.sampled_from([1e-3, 1.0]))
@pytest.mark.slow
def test_a_fast_mode_is_resolved_with_a_late_last_time(small: int, tolerance: float, last: float) -> None:
    # Both nodes rise together with 1 kohm times the small capacitance; 1 nF between them holds them together.
    farads = 10.0**small
    netlist = rg.Netlist(
        4, [[3, 1], [2, 0]], [1e-3, 1e-6], source_nodes=[[3, 0]], source_volts=[1.0],
        capacitor_nodes=[[1, 2], [2, 0]], capacitance=[1e-9, farads],
    )  # fmt: skip
    end = 1e6 / (1e6 + 1e3)
    tau = 1e3 * end * farads
    times = np.array([0.5, 1, 2, 4]) * tau
    found = rg.circuit.transient(netlist, np.append(times, last), tolerance=tolerance).voltage[:-1, 1]
    # The voltage across 1 nF is at most twice the ratio of the capacitances.
    assert np.abs(found + end * np.expm1(-times / tau)).max() < tolerance + 2 * farads / 1e-9


@pytest.mark.parametrize(
    ("method", "tolerance"),
    [
        ("tr-bdf2", 1e-2),
        ("tr-bdf2", 1e-6),
        ("tr-bdf2", 1e-10),
        ("trapezoidal", 1e-2),
        ("trapezoidal", 1e-6),
        ("trapezoidal", 1e-8),
        ("backward_euler", 1e-1),
        ("backward_euler", 1e-2),
        pytest.param("backward_euler", 1e-4, marks=pytest.mark.slow),
    ],
)
@pytest.mark.quick_cases(4)
def test_every_method_keeps_its_tolerance(method: str, tolerance: float) -> None:
    times = np.linspace(0, 2e-6, 21)
    found = rg.circuit.transient(one_pole(), times, method=method, tolerance=tolerance)
    assert np.abs(found.voltage[:, 2] + np.expm1(-times / 1e-6)).max() < 0.7 * tolerance


@pytest.mark.parametrize(("method", "tolerance"), [("backward_euler", 1e-9), ("trapezoidal", 1e-11)])
def test_a_tolerance_below_rounding_error_raises_accuracy_error(method: str, tolerance: float) -> None:
    with pytest.raises(rg.AccuracyError, match="tr-bdf2"):
        rg.circuit.transient(one_pole(), [1e-6], method=method, tolerance=tolerance)


@pytest.mark.parametrize("method", get_args(Method))
def test_steps_dominated_by_solver_errors_raise_accuracy_error(method: str) -> None:
    dynamics = dynamics_of(one_pole())
    rng = np.random.default_rng(0)

    def noisy(rate: float) -> SimpleNamespace:
        exact = factor_resolvent(dynamics, rate).solve
        return SimpleNamespace(solve=lambda rhs, rtol: exact(rhs, rtol=rtol) + rng.uniform(-1e-4, 1e-4, len(rhs)))

    states = controlled_steps(dynamics, method, np.zeros((2, 1)), np.array([1e-6]), 1e-6, noisy)
    with pytest.raises(rg.AccuracyError, match="rounding"):
        list(states)
