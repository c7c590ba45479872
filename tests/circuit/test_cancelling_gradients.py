"""Derivatives by sources that remain after large adjoint voltages cancel, against exact fractions.

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
"""Promised relative error of every derivative by a source in circuits of few nodes."""


def _assert_close(found: np.ndarray, wanted: list[Value]) -> None:
    for value, exact in zip(found.tolist(), wanted, strict=True):
        assert np.isnan(value) == (exact is None)
        if exact is not None:
            assert abs(Fraction(value) - exact) <= _RELATIVE_ERROR * abs(exact) + Fraction(5e-324), (
                value,
                float(exact),
            )


def _exact_adjoint(netlist: rg.Netlist, weights: np.ndarray) -> tuple[list[Value], list[Value]]:
    """Return the voltages and the source currents for injected currents `weights`, with all sources set to zero."""
    driven = np.flatnonzero(weights)
    adjoint = solve_exactly(
        netlist.replace(
            source_volts=0.0 * netlist.source_volts,
            current_nodes=np.stack([0 * driven, driven], axis=1),
            current_amps=weights[driven],
        )
    )
    assert adjoint is not None
    return adjoint.voltage, adjoint.source_current


def _check_derivatives(netlist: rg.Netlist, rng: np.random.Generator) -> int:
    """Check the derivatives of a random sum of node voltages; return the number of checked current sources."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ voltage sources form loops")
        try:
            op = rg.solve(netlist)
        except rg.CircuitError:
            return 0
        places = np.setdiff1d(np.arange(1, netlist.node_count), op.floating)
        if not places.size:
            return 0
        weights, chosen = np.zeros(netlist.node_count), rng.choice(places, min(3, places.size), replace=False)
        weights[chosen] = rng.choice([1.0, -1.0, 2.0], chosen.size)
        found = rg.gradient(op, weights)
    volts, amps = _exact_adjoint(netlist, weights)
    _assert_close(found.voltage, amps)
    _assert_close(found.injection, volts)
    compared = 0
    for value, (source, target) in zip(found.current.tolist(), netlist.current_nodes.tolist(), strict=True):
        if volts[source] is not None and volts[target] is not None:
            _assert_close(np.array([value]), [volts[target] - volts[source]])
            compared += 1
    return compared


@pytest.mark.parametrize("part", range(4))
def test_derivatives_by_sources_equal_exact_fractions(part: int) -> None:
    seed, count = int(os.environ.get("RESGRID_SEED", "0")), int(os.environ.get("RESGRID_CIRCUITS", "160"))
    numbers = range(part, count, 4)
    compared = sum(_check_derivatives(cancelling_circuit(seed, k), np.random.default_rng([seed, k])) for k in numbers)
    assert compared > count / 8


def test_derivatives_of_circuits_with_extreme_conductances_equal_exact_fractions() -> None:
    for number in range(60):
        netlist, rng = cancelling_circuit(5, number), np.random.default_rng(number)
        siemens = 10.0 ** rng.uniform(-140, 140, len(netlist.conductance))
        _check_derivatives(netlist.replace(conductance=siemens, source_volts=np.sign(netlist.source_volts)), rng)


def test_seeds_of_very_different_size_have_accurate_derivatives() -> None:
    netlist = rg.Netlist(4, [[0, 1], [2, 1]], [1.0, 1.0], source_nodes=[[3, 2]], source_volts=[0.0])
    found = rg.circuit.pullback(rg.solve(netlist), voltage=[0.0, -3e252, 2e65, 5e-272])
    assert found.voltage.tolist() == [5e-272]


def test_a_current_source_between_strongly_coupled_nodes_has_its_small_derivative() -> None:
    """Two nodes with 1e12 S between them share 1e-12 S to ground; the derivative is the difference of two voltages."""
    netlist = rg.Netlist(
        3, [(1, 2), (1, 0), (2, 0)], [1e12, 1e-12, 3e-12], current_nodes=[(1, 2), (0, 1)], current_amps=[0.0, 1e-12]
    )
    found = rg.gradient(rg.solve(netlist), "voltage", at=1)
    volts, _ = _exact_adjoint(netlist, np.array([0.0, 1.0, 0.0]))
    assert volts[1] is not None and volts[2] is not None and volts[1] != volts[2]
    assert found.current[0] == pytest.approx(float(volts[2] - volts[1]), rel=1e-15)


def test_the_value_of_a_weighted_sum_keeps_its_digits_where_voltages_nearly_cancel() -> None:
    op = rg.solve(rg.Netlist(4, [[0, 1], [1, 2], [2, 3]], [1.0, 1.0, 1e12], source_nodes=[[3, 1]], source_volts=[1.0]))
    expected = float(1 / (1 + Fraction(10) ** 12))
    for found in (rg.gradient(op, [0.0, 0.0, -1.0, 1.0]), rg.circuit.pullback(op, voltage=[0.0, 0.0, -1.0, 1.0])):
        assert found.value == pytest.approx(expected, rel=1e-15, abs=0.0)


def test_the_value_of_a_weighted_sum_of_huge_terms_has_the_right_sign() -> None:
    ends = [[1, 2], [1, 5], [5, 6]]
    op = rg.solve(rg.Netlist(7, ends, [1.0, 1.0, 1.0], source_nodes=[[0, 5]], source_volts=[7e168]))
    assert rg.gradient(op, [0.0, 0.0, 5e236, 0.0, 0.0, 0.0, -5e281]).value == np.inf
    assert rg.gradient(op, [0.0, 0.0, -5e236, 0.0, 0.0, 0.0, 5e236]).value == 0.0
