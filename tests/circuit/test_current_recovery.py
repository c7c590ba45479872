"""Resistor currents of circuits with widely different conductances, against exact fractions and closed forms.

Tests internals: `resgrid.circuit.current_recovery`.
"""

from __future__ import annotations

import warnings
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.cancelling import cancelling_circuit
from support.circuits import exact_currents
from support.fractions_solver import solve_exactly
from support.spaces import serpentine, space_of

import resgrid as rg

_LEAST = Fraction(1, 2**1000)
"""Fraction of the largest current or voltage below which a value may be returned as zero."""


def assert_equals_fractions(netlist: rg.Netlist, point: rg.OperatingPoint) -> None:
    """Compare each current and voltage of a small circuit with its exact value, to a relative error of 1e-15."""
    for found, exact in zip((point.voltage, point.resistor_current), exact_currents(netlist), strict=True):
        largest = max(map(abs, exact))
        for value, wanted in zip(np.nan_to_num(found).tolist(), exact, strict=True):
            most = max(abs(wanted) * Fraction(1, 10**15), largest * _LEAST)
            assert abs(Fraction(value) - wanted) <= most, (value, float(wanted))


@st.composite
def stiff_circuits(draw: st.DrawFn) -> rg.Netlist:
    """Draw a circuit: 2 to 12 nodes, conductances over up to 24 orders of magnitude, voltage and current sources."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, decades = int(rng.integers(2, 13)), draw(st.sampled_from([4.0, 12.0, 24.0]))
    pairs = [(int(rng.integers(0, k)), k) for k in range(1, n)]
    pairs += [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(int(rng.integers(0, 2 * n)))]
    exponent = rng.integers(-1, 2, len(pairs)) if draw(st.booleans()) else rng.uniform(-1, 1, len(pairs))
    part, sources = np.arange(n), []
    for _ in range(int(rng.integers(0, 5))):
        a, b = rng.choice(n, 2, replace=False).tolist()
        b = 0 if rng.random() < 0.7 else b
        if part[a] != part[b]:
            part[part == part[a]] = part[b]
            sources.append((a, b))
    injected = [rng.choice(n, 2, replace=False).tolist() for _ in range(int(rng.integers(not sources, 4)))]
    return rg.Netlist(
        n,
        pairs,
        10.0 ** (decades / 2 * exponent),
        np.reshape(sources, (-1, 2)),
        rng.choice([-1.0, 1.0], len(sources)) * 10.0 ** rng.uniform(-12.0, 4.0, len(sources)),
        current_nodes=np.reshape(injected, (-1, 2)),
        current_amps=10.0 ** rng.uniform(-9, 0, len(injected)),
    )


@settings(max_examples=150)
@given(stiff_circuits(), st.sampled_from(["auto", "direct", "multigrid"]))
@pytest.mark.slow
def test_currents_over_24_orders_of_magnitude_equal_exact_fractions(netlist: rg.Netlist, method: str) -> None:
    try:
        point = rg.solve(netlist, method=method)
    except rg.CircuitError as error:
        assert "touches ground" in str(error)
        return
    assert_equals_fractions(netlist, point)


def circuit_with_rails(
    pairs: list[tuple[int, int]], conductance: list[float], volts: list[float], amps: float = 0.0
) -> rg.Netlist:
    """Return a circuit with voltage sources from nodes 1, 2, ... to ground, and an optional current into node 2."""
    sources = [(node, 0) for node in range(1, len(volts) + 1)]
    injected = {"current_nodes": [(0, 2)], "current_amps": [amps]} if amps else {}
    return rg.Netlist(max(map(max, pairs)) + 1, pairs, conductance, sources, volts, **injected)


@pytest.mark.parametrize(
    "netlist",
    [
        circuit_with_rails([(2, 1), (2, 0)], [1e6, 1e-12], [1.0], 2.27e-9),
        circuit_with_rails([(2, 1), (2, 0)], [1e12, 1e-12], [1.0], 2.27e-9),
        circuit_with_rails([(2, 1), (2, 0)], [1e12, 1e-12], [1.0], 3.4e-8),
        circuit_with_rails([(3, 1), (3, 2), (3, 0)], [1e12, 1e-12, 3e-12], [1.0, 2.0]),
        circuit_with_rails([(3, 1), (3, 2), (3, 0)], [1e6, 1e-6, 3e-6], [1.0, 2.0]),
        circuit_with_rails([(3, 1), (3, 2), (3, 0)], [1e2, 1e-10, 3e-10], [1.0, 2.0]),
        rg.Netlist(  # the large circulating current hides the small currents that determine the potential of the source
            5,
            [(2, 3), (4, 2), (2, 1), (2, 0)],
            [1e12, 3e12, 1e-12, 1e-12],
            source_nodes=[[1, 0], [3, 4]],
            source_volts=[1.0, 1e-6],
        ),
    ],
)
def test_a_strong_resistor_to_a_rail_has_an_exact_current_after_balancing(netlist: rg.Netlist) -> None:
    for method in ("direct", "multigrid"):
        point = rg.solve(netlist, method=method)
        assert_equals_fractions(netlist, point)
        assert "balance" in point.seconds


@pytest.mark.parametrize("method", ["direct", "multigrid"])
def test_currents_in_a_two_cell_wide_dead_end_decay_at_the_exact_rate(method: str) -> None:
    """Beyond the start, currents across a corridor two cells wide decrease by a constant factor per step."""
    cell = np.zeros((2, 200), dtype=np.uint8)
    cell[0, 0] = 2
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(1, 3), edge="open")
    point = rg.solve(netlist, method=method)
    node = netlist.cells.node
    across = {tuple(pair): k for k, pair in enumerate(np.sort(netlist.resistor_nodes, axis=1).tolist())}
    rungs = [across[tuple(sorted((node[0, x], node[1, x])))] for x in range(5, 200)]
    log = point.resistor_log_current[rungs]
    # Falls f across rungs obey f(x-1) - 4 f(x) + f(x+1) = 0; at the closed end f(x-1) = 3 f(x).
    steps = np.arange(len(rungs))[::-1]
    expected = np.log(np.cosh((steps + 0.5) * np.arccosh(2.0)))
    np.testing.assert_allclose(log - log[-1], expected - expected[-1], rtol=1e-9, atol=1e-9)
    assert log[-1] < -230 and point.kcl_residual < 1e-9


def test_currents_in_a_dead_end_decay_at_the_exact_rate_down_to_1e_270() -> None:
    cell = np.zeros((2, 1000), dtype=np.uint8)
    cell[0, 0] = 2
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(0, 1), edge="open")
    point = rg.solve(netlist)
    assert point.kcl_residual < 1e-9
    node = netlist.cells.node
    across = {tuple(pair): k for k, pair in enumerate(np.sort(netlist.resistor_nodes, axis=1).tolist())}
    rungs = [across[tuple(sorted((node[0, x], node[1, x])))] for x in range(5, 1000)]
    amps = np.abs(point.resistor_current[rungs])
    resolved = amps > 0.0
    assert amps[resolved].min() < 1e-270 and not resolved[np.argmin(resolved) :].any()
    steps = -np.diff(np.log(amps[amps > 1e-270]))
    np.testing.assert_allclose(steps, np.arccosh(2.0), rtol=1e-9)


@pytest.mark.parametrize(("width", "length", "wall"), [(12, 400, 0.0), (20, 500, 0.0), (16, 600, 1e5), (8, 300, 3e4)])
@pytest.mark.parametrize("method", ["direct", "multigrid"])
def test_log_drop_of_a_symmetric_corridor_is_symmetric_and_decays_at_the_exact_rate(
    width: int, length: int, wall: float, method: str
) -> None:
    """Currents between the halves are far below rounding error; they must not change the other currents."""
    cell = np.zeros((width, length), dtype=np.uint8)
    cell[width // 2, 3] = 2
    wired = {"boundary": "wall", "wall_resistance": wall} if wall else {}
    point = rg.solve(rg.compile_space(space_of(cell), **wired), method=method)
    log = point.log_drop[point.netlist.cells.node[:, 150 : length - 100]]
    assert point.kcl_residual < 1e-9
    assert "balance" not in point.seconds
    np.testing.assert_allclose(log, log[::-1], rtol=0, atol=1e-8)
    if not wall:  # the slowest mode, sin(pi (i + 1) / (width + 1)) across
        np.testing.assert_allclose(-np.diff(log), np.arccosh(2.0 - np.cos(np.pi / (width + 1))), rtol=1e-8)


@pytest.mark.parametrize("rungs", [60, 91, 125, 129, 400])
@pytest.mark.parametrize("method", ["direct", "multigrid"])
def test_cross_currents_of_a_ladder_decay_at_the_exact_rate_to_its_middle(rungs: int, method: str) -> None:
    """The ends of the ladder are shunted by a resistor each; its currents decrease to 1e-114 of the largest one."""
    upper, lower = np.arange(2, 2 + rungs), np.arange(2 + rungs, 2 + 2 * rungs)
    pairs = np.concatenate(
        [np.stack(ends, axis=1) for ends in ((upper[:-1], upper[1:]), (lower[:-1], lower[1:]), (upper, lower))]
    )
    ties = [[1, upper[0]], [lower[0], 0], [upper[0], upper[-1]], [lower[0], lower[-1]]]
    pairs = np.concatenate([pairs, ties])
    netlist = rg.Netlist(2 + 2 * rungs, pairs, np.ones(len(pairs)), source_nodes=[[1, 0]], source_volts=[1.0])
    point = rg.solve(netlist, method=method)
    assert point.kcl_residual < 1e-6
    across = np.abs(point.resistor_current[2 * rungs - 2 : 3 * rungs - 2])
    resolved = across > 1e-25 * across.max()
    quarter = np.diff(np.log(across[: rungs // 2 - 6][resolved[: rungs // 2 - 6]]))
    np.testing.assert_allclose(quarter, -np.arccosh(2.0), rtol=1e-4)  # f(x-1) - 4 f(x) + f(x+1) = 0


def test_streamlines_in_a_loop_with_almost_zero_current_reach_the_goal() -> None:
    """The loop carries about 1e-19 of the largest current, which is below the rounding error of voltage differences."""
    cell = np.ones((8, 64), dtype=np.uint8)
    cell[3:5, :61] = 0
    cell[0, 30:], cell[7, 30:], cell[:, 63] = 0, 0, 0
    cell[0:3, 30] = cell[5:8, 30] = 0
    cell[3, 59] = 2
    space = space_of(cell)
    point = rg.solve(rg.compile_space(space, boundary="neumann", drive="start", start=(3, 0)))
    assert "balance" in point.seconds and point.kcl_residual < 1e-9
    starts = np.argwhere(space.goal_connected & (cell == 0))
    found = rg.streamlines(rg.field(point), space.centre(starts))
    assert set(np.asarray(found.outcome).tolist()) == {"reached"}


def test_balancing_of_currents_does_not_change_log_drop() -> None:
    """A strong resistor starts the balancing; 30 orders of magnitude further down, log_drop must not change."""
    cell = np.zeros((12, 400), dtype=np.uint8)
    cell[5, 3] = 2
    stiff = np.ones(cell.shape)
    stiff[6, 380:382] = 1e12
    plain, balanced = (
        rg.solve(rg.compile_space(space_of(cell, conductivity=cost))) for cost in (np.ones(cell.shape), stiff)
    )
    assert "balance" in balanced.seconds and "balance" not in plain.seconds
    node = balanced.netlist.cells.node[:, 10:330]
    np.testing.assert_allclose(balanced.log_drop[node], plain.log_drop[node], rtol=0, atol=4e-9)
    assert plain.log_drop[node].min() < -34 * np.log(10.0)


def test_resistors_of_trees_behind_the_start_have_direction_zero() -> None:
    """A tree carries no current, so that its direction must be exactly zero."""
    cell = serpentine(9, 60, 1)
    netlist = rg.compile_space(space_of(cell), boundary="neumann", drive="start", start=(9, 30))
    point = rg.solve(netlist)
    assert 0.4 < np.mean(point.resistor_direction == 0) < 0.6
    assert "balance" not in point.seconds


@pytest.mark.parametrize(("stiff", "weak"), [(1e12, 1e-12), (1.0, 1e-24), (1e3, 1e3)])
@pytest.mark.parametrize("method", ["direct", "multigrid"])
def test_currents_of_islands_between_two_rails_equal_exact_fractions(stiff: float, weak: float, method: str) -> None:
    """Two complete graphs of four nodes, each tied to both rails, at 5 V and 0 V."""
    complete = [(first + i, first + j) for first in (2, 6) for i in range(4) for j in range(i)]
    ties = [(1, 2), (0, 3), (4, 6), (5, 7), (1, 8), (0, 9)]
    conductance = [stiff] * len(complete) + [weak] * len(ties)
    netlist = rg.Netlist(10, complete + ties, conductance, source_nodes=[[1, 0]], source_volts=[5.0])
    assert_equals_fractions(netlist, rg.solve(netlist, method=method))


def test_a_chain_with_a_weak_ground_resistor_has_exact_voltages_and_currents() -> None:
    netlist = rg.Netlist(
        5, [[1, 2], [2, 3], [3, 4], [4, 0]], [1e12, 1e12, 1e12, 1e-12], current_nodes=[[1, 3]], current_amps=[1.0]
    )
    point = rg.solve(netlist)
    np.testing.assert_allclose(point.voltage, [0.0, -2e-12, -1e-12, 0.0, 0.0], rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(point.resistor_current, [-1.0, -1.0, 0.0, 0.0], rtol=1e-6, atol=1e-18)


def test_current_sources_at_a_node_are_summed_exactly() -> None:
    amps = [1e-09, 3.451341256858813e-10, -3.2800583629327586e-08, 3.145544950364485e-08]
    chain = rg.Netlist(4, [[2, 1], [1, 0], [2, 3]], np.ones(3), current_nodes=[[0, 3]] * 4, current_amps=amps)
    exact = float(sum(map(Fraction, amps)))
    np.testing.assert_allclose(rg.solve(chain).resistor_current, [exact, exact, -exact], rtol=1e-12)


def test_dead_ends_of_a_large_mesh_carry_zero_and_keep_the_error_bound_small() -> None:
    """Stubs and rings on single nodes of a mesh have no current; rounding errors of voltages must not create one.

    The mesh is too large for exact integer factors; the error bound of other currents must not include these.
    """
    from resgrid.circuit.current_recovery import recover_currents
    from resgrid.circuit.equations import assemble

    side, rng = 40, np.random.default_rng(0)
    node = np.arange(side * side).reshape(side, side)
    pairs = [*zip(node[1:].ravel(), node[:-1].ravel(), strict=True)]
    pairs += [*zip(node[:, 1:].ravel(), node[:, :-1].ravel(), strict=True)]
    mesh, count = len(pairs), side * side
    for at in rng.choice(side * side, 200, replace=False).tolist():
        pairs += [(at, count), (count, count + 1), (count + 1, at), (count + 1, count + 2)]
        count += 3
    netlist = rg.Netlist(
        count, pairs, rng.uniform(0.5, 2.0, len(pairs)), source_nodes=[[side - 1, 0], [777, 0]], source_volts=[1.0, 0.5]
    )
    found, _ = recover_currents(assemble(netlist))
    assert found is not None
    assert found.error_bound < 1e-9
    assert not np.isfinite(found.entry_error)  # not solved in integers
    assert not found.amps[mesh:].any()
    assert found.amps[:mesh].all()
    point = rg.solve(netlist)
    assert point.resistor_current == pytest.approx(found.amps, rel=1e-9)


def test_dead_ends_at_floating_sources_of_a_large_mesh_have_the_voltage_of_their_node() -> None:
    """Dead ends at both nodes of a floating source, and a resistive path between the nodes, which carries current."""
    side, count = 28, 28 * 28
    node = np.arange(count).reshape(side, side)
    first, second = int(node[3, 3]), int(node[-4, -4])
    pairs = [*zip(node[1:].ravel(), node[:-1].ravel(), strict=True)]
    pairs += [*zip(node[:, 1:].ravel(), node[:, :-1].ravel(), strict=True)]
    pairs += [(first, count), (second, count + 1), (count + 1, count + 2), (count + 2, count + 1)]
    pairs += [(first, count + 3), (count + 3, second), (count + 3, count + 4)]
    netlist = rg.Netlist(
        count + 5, pairs, np.random.default_rng(2).uniform(0.5, 2.0, len(pairs)), source_nodes=[(first, second)],
        source_volts=[1.0], current_nodes=[(0, 300)], current_amps=[0.5],
    )  # fmt: skip
    matrix, size = np.zeros((count + 6, count + 6)), count + 5
    for (i, j), siemens in zip(pairs, netlist.conductance.tolist(), strict=True):
        matrix[[i, j, i, j], [i, j, j, i]] += [siemens, siemens, -siemens, -siemens]
    matrix[[size, size, first, second], [first, second, size, size]] = [1.0, -1.0, 1.0, -1.0]
    matrix[0], matrix[0, 0] = 0.0, 1.0
    rhs = np.zeros(count + 6)
    rhs[[300, size]] = 0.5, 1.0
    exact = np.linalg.solve(matrix, rhs)
    point = rg.solve(netlist)
    np.testing.assert_allclose(point.voltage, exact[:-1], rtol=0.0, atol=1e-12)
    assert point.voltage[[count, count + 1, count + 2]] == pytest.approx(
        point.voltage[[first, second, second]], rel=1e-14
    )
    falls = exact[np.array(pairs)] @ [1.0, -1.0]
    np.testing.assert_allclose(point.resistor_current, netlist.conductance * falls, rtol=0.0, atol=1e-12)
    assert not point.resistor_current[[-7, -6, -5, -4, -1]].any()


@pytest.mark.parametrize("part", range(4))
@pytest.mark.quick_cases(1)
def test_corrections_of_circuits_with_cancelling_currents_equal_exact_fractions(
    part: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Small circuits, corrected in double-double as large ones are."""
    monkeypatch.setattr("resgrid.circuit.current_recovery._FEW_ENTRIES", -1)
    for number in range(150):
        netlist = cancelling_circuit(part, number)
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "[0-9]+ voltage sources form loops")
                point = rg.solve(netlist)
        except (rg.CircuitError, rg.AccuracyError):
            continue
        exact = solve_exactly(netlist)
        assert exact is not None
        for found, wanted in ((point.voltage, exact.voltage), (point.resistor_current, exact.resistor_current)):
            known = [
                (value, float(each)) for value, each in zip(found.tolist(), wanted, strict=True) if each is not None
            ]
            values, expected = np.array(known).reshape(-1, 2).T
            np.testing.assert_allclose(values, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max(initial=0.0))


@pytest.mark.parametrize(("rungs", "at"), [(600, 150), (700, 350)])
def test_currents_of_a_long_ladder_decay_at_the_exact_rate(rungs: int, at: int) -> None:
    """The difference of both rails obeys ``d(i + 1) - 4 d(i) + d(i - 1) = 0``: it decays by 2 - sqrt(3) a rung."""
    first = np.arange(1, 2 * rungs, 2)
    pairs = [*zip(first, first + 1, strict=True), *pairwise(first), *pairwise(first + 1), (0, 1)]
    netlist = rg.Netlist(
        2 * rungs + 1, pairs, np.ones(len(pairs)), source_nodes=[(1 + 2 * at, 2 + 2 * at)], source_volts=[3.3]
    )
    point = rg.solve(netlist)
    assert point.kcl_residual < 1e-9
    current = point.resistor_current[at : at + 100]
    np.testing.assert_allclose(current, 3.3 * (2.0 - np.sqrt(3.0)) ** np.arange(100), rtol=1e-12)
    assert point.resistor_current[-1] == 0.0
