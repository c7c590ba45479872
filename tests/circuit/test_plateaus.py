"""Stiffly joined nodes, whose differences cannot be told: their height is right, or the answer is refused."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import eliminated

from resgrid.circuit.solve import solve
from resgrid.errors import AccuracyError, CircuitError
from resgrid.netlist import Netlist


def islands(stiff: float, weak: float) -> Netlist:
    """Two complete graphs of four nodes beside each other, each tied to both rails at 5 V and 0 V."""
    complete = [(first + i, first + j) for first in (2, 6) for i in range(4) for j in range(i)]
    ties = [(1, 2), (0, 3), (4, 6), (5, 7), (1, 8), (0, 9)]
    conductance = [stiff] * len(complete) + [weak] * len(ties)
    return Netlist(10, complete + ties, conductance, source_nodes=[[1, 0]], source_volts=[5.0])


@pytest.mark.parametrize(("stiff", "weak"), [(1e12, 1e-12), (1.0, 1e-24), (1e3, 1e3)])
def test_islands_between_two_rails(stiff: float, weak: float) -> None:
    netlist = islands(stiff, weak)
    point = solve(netlist, method="direct")
    np.testing.assert_allclose(point.voltage[2:].mean(), 2.5, rtol=1e-7)
    assert point.kcl_residual <= 1e-6
    if stiff > weak:
        np.testing.assert_allclose(point.voltage[2:], 2.5, rtol=1e-7)
        with pytest.raises(AccuracyError, match="not direction-safe: at node"):
            solve(netlist, method="multigrid")
    else:
        np.testing.assert_allclose(solve(netlist, method="multigrid").voltage, point.voltage, rtol=1e-9)


def test_a_stiff_loop_around_a_floating_source_is_refused() -> None:
    """What circulates in it drowns what holds its height: half a volt, by ties of 1e-12 S to either rail."""
    netlist = Netlist(
        5,
        [(2, 3), (4, 2), (2, 1), (2, 0)],
        [1e12, 3e12, 1e-12, 1e-12],
        source_nodes=[[1, 0], [3, 4]],
        source_volts=[1.0, 1e-6],
    )
    for method in ("direct", "multigrid"):
        with pytest.raises(AccuracyError, match="currents of both signs nearly cancel"):
            solve(netlist, method=method)


def test_balanced_currents_in_a_chain_that_is_hardly_grounded() -> None:
    netlist = Netlist(
        5, [[1, 2], [2, 3], [3, 4], [4, 0]], [1e12, 1e12, 1e12, 1e-12], current_nodes=[[1, 3]], current_amps=[1.0]
    )
    point = solve(netlist)
    np.testing.assert_allclose(point.voltage, [0.0, -2e-12, -1e-12, 0.0, 0.0], rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(point.resistor_current, [-1.0, -1.0, 0.0, 0.0], rtol=1e-6, atol=1e-18)


def exact_voltages(netlist: Netlist) -> np.ndarray:
    """By elimination in exact arithmetic; ground alone is held."""
    n = netlist.node_count - 1
    a = [[Fraction(0)] * n for _ in range(n)]
    b = [Fraction(0)] * n
    for (i, j), g in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
        for here, there in ((i, j), (j, i)):
            if here:
                a[here - 1][here - 1] += Fraction(g)
                if there:
                    a[here - 1][there - 1] -= Fraction(g)
    for (i, j), amps in zip(netlist.current_nodes.tolist(), netlist.current_amps.tolist(), strict=True):
        for node, sign in ((i, -1), (j, 1)):
            if node:
                b[node - 1] += sign * Fraction(amps)
    return np.array([0.0, *map(float, eliminated(a, b))])


@settings(max_examples=150)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 3.0, 12.0]), st.sampled_from(["direct", "multigrid"]))
def test_currents_of_both_signs_are_right_or_refused(seed: int, decades: float, method: str) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    tree = [(int(rng.integers(0, k)), k) for k in range(1, n)]
    more = [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(int(rng.integers(0, 2 * n)))]
    conductance = 10.0 ** rng.choice([-decades, 0.0, decades], len(tree) + len(more))
    pairs = [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(int(rng.integers(1, 4)))]
    netlist = Netlist(n, tree + more, conductance, current_nodes=pairs, current_amps=np.ones(len(pairs)))
    try:
        point = solve(netlist, method=method)
    except (AccuracyError, CircuitError) as error:
        assert decades == 12.0 or isinstance(error, CircuitError)
        return
    exact = exact_voltages(netlist)
    np.testing.assert_allclose(point.voltage, exact, rtol=0, atol=2e-6 * np.abs(exact).max())
