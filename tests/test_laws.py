"""Physical laws on random spaces; networkx, dense solutions and harmonic polynomials as references."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg

BOUNDARIES = [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 2.0}]


def solved(space: rg.ConfigurationSpace, **options: object) -> rg.OperatingPoint:
    try:
        return rg.solve(rg.compile_space(space, resistance=1.0, **options))
    except rg.CircuitError:
        assume(False)
        raise


@pytest.mark.parametrize("shape", [(20, 17), (6, 7, 5)])
def test_a_harmonic_polynomial_is_reproduced(shape: tuple[int, ...]) -> None:
    """x^2 - y^2 is harmonic also on the grid, so that its boundary values determine it everywhere."""
    index = np.indices(shape)
    value = (index[0] ** 2 - index[1] ** 2).astype(float)
    border = np.zeros(shape, dtype=bool)
    for axis, size in enumerate(shape):
        border |= (index[axis] == 0) | (index[axis] == size - 1)
    if len(shape) == 3:
        value = value + 3.0 * index[2]
    node = 1 + np.arange(value.size).reshape(shape)
    pairs = [np.stack([node.take(range(n - 1), a).ravel(), node.take(range(1, n), a).ravel()], 1)
             for a, n in enumerate(shape)]  # fmt: skip
    pairs = np.concatenate(pairs)
    pinned = node[border]
    netlist = rg.Netlist(
        value.size + 1,
        pairs,
        np.full(len(pairs), 1e-4),
        np.stack([pinned, np.zeros_like(pinned)], 1),
        value[border],
    )
    point = rg.solve(netlist)
    assert np.abs(point.voltage[1:] - value.ravel()).max() < 1e-11


@settings(max_examples=60)
@given(spaces(), st.sampled_from(BOUNDARIES))
def test_potentials_obey_the_maximum_principle_without_local_minima(
    space: rg.ConfigurationSpace, options: dict[str, object]
) -> None:
    point = solved(space, **options)
    volts = point.voltage
    assert np.nanmin(volts) >= 0.0
    if "boundary" not in options or options["boundary"] == "wall":
        assert np.nanmax(volts) <= 1.0
    outflow = np.zeros(len(volts), dtype=bool)
    a, b = point.netlist.resistor_nodes.T
    outflow[a[point.resistor_direction > 0]] = True
    outflow[b[point.resistor_direction < 0]] = True
    cell_map = point.netlist.cells
    driven = np.setdiff1d(cell_map.free_node, np.concatenate([point.undriven, point.floating]))
    carries = np.zeros(len(volts), dtype=bool)
    carries[np.concatenate([a[point.resistor_direction != 0], b[point.resistor_direction != 0]])] = True
    assert np.all(outflow[driven] | ~carries[driven])


@settings(max_examples=40)
@given(spaces(), st.sampled_from(BOUNDARIES), st.floats(1e-3, 1e6))
def test_scaling_all_resistances_keeps_voltages(
    space: rg.ConfigurationSpace, options: dict[str, object], factor_: float
) -> None:
    one = solved(space, **options)
    scaled = dict(options)
    if "wall_resistance" in scaled:
        scaled["wall_resistance"] = float(scaled["wall_resistance"]) * factor_
    other = rg.solve(rg.compile_space(space, resistance=factor_, **scaled))
    assert np.allclose(one.voltage, other.voltage, rtol=1e-9, atol=0.0, equal_nan=True)
    assert one.power == pytest.approx(other.power * factor_, rel=1e-9)


@settings(max_examples=40)
@given(spaces(), st.integers(0, 2**32 - 1))
def test_solutions_obey_superposition(space: rg.ConfigurationSpace, seed: int) -> None:
    netlist = rg.compile_space(space, resistance=1.0)
    try:
        factors = rg.factorize(netlist)
    except Exception:
        assume(False)
    rng = np.random.default_rng(seed)
    n = factors.system.size
    p, q = rng.random(n), rng.random(n)
    together = factors.solve(2.0 * p - 3.0 * q)
    assert np.allclose(together, 2.0 * factors.solve(p) - 3.0 * factors.solve(q), atol=1e-9)


@settings(max_examples=40)
@given(spaces(), st.sampled_from(BOUNDARIES))
def test_currents_into_all_rails_sum_to_the_drive_and_power_balances(
    space: rg.ConfigurationSpace, options: dict[str, object]
) -> None:
    point = solved(space, **options)
    netlist = point.netlist
    injected = netlist.current_amps.sum()
    assert point.source_current.sum() == pytest.approx(injected, abs=1e-12 * (1 + np.abs(point.source_current).max()))
    delivered = -np.sum(netlist.source_volts * point.source_current)
    delivered += np.sum(netlist.current_amps * point.voltage[netlist.current_nodes[:, 1]])
    assert point.power == pytest.approx(delivered, rel=1e-9)


@settings(max_examples=25)
@given(st.integers(2, 25), st.integers(0, 2**32 - 1))
def test_voltages_agree_with_networkx_resistance_distance(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = nx.gnp_random_graph(count, 0.4, seed=int(seed % 2**31))
    graph.add_edges_from((i, i + 1) for i in range(count - 1))
    for a, b in graph.edges:
        graph.edges[a, b]["resistance"] = float(10 ** rng.uniform(-2, 2))
    expected = nx.resistance_distance(graph, 0, count - 1, weight="resistance")
    netlist = rg.Netlist.from_networkx(graph)
    point = rg.solve(netlist.replace(current_nodes=np.array([[0, count - 1]]), current_amps=np.ones(1)))
    assert point.voltage[count - 1] == pytest.approx(expected, rel=1e-9)


@settings(max_examples=30)
@given(spaces(), st.sampled_from(BOUNDARIES))
def test_merged_and_cell_rails_give_equal_voltages(space: rg.ConfigurationSpace, options: dict[str, object]) -> None:
    merged = solved(space, **options)
    single = solved(space, rails="cells", **options)
    first, second = merged.netlist.cells.node, single.netlist.cells.node
    both = (first >= 0) & (second >= 0)
    assert np.allclose(merged.voltage[first[both]], single.voltage[second[both]], atol=1e-12, equal_nan=True)


@settings(max_examples=30)
@given(spaces(), st.sampled_from(BOUNDARIES))
def test_both_accuracies_agree_with_a_dense_solution(space: rg.ConfigurationSpace, options: dict[str, object]) -> None:
    point = solved(space, **options)
    normwise = rg.solve(point.netlist, accuracy="normwise")
    assert np.allclose(point.voltage, normwise.voltage, atol=1e-8, equal_nan=True)
    assert np.allclose(point.voltage, dense(point.netlist, point.voltage), atol=1e-9, equal_nan=True)


def dense(netlist: rg.Netlist, voltage: np.ndarray) -> np.ndarray:
    """Modified nodal analysis with a dense matrix, without floating nodes."""
    keep = np.flatnonzero(~np.isnan(voltage) & (np.arange(len(voltage)) > 0))
    place = np.full(len(voltage), -1)
    place[keep] = np.arange(len(keep))
    n, s = len(keep), len(netlist.source_volts)
    matrix, rhs = np.zeros((n + s, n + s)), np.zeros(n + s)
    for (a, b), g in zip(place[netlist.resistor_nodes], netlist.conductance, strict=True):
        for i, j in ((a, b), (b, a)):
            if i >= 0:
                matrix[i, i] += g
                if j >= 0:
                    matrix[i, j] -= g
    for k, ((a, b), volts) in enumerate(zip(place[netlist.source_nodes], netlist.source_volts, strict=True)):
        for i, sign in ((a, 1.0), (b, -1.0)):
            if i >= 0:
                matrix[i, n + k] += sign
                matrix[n + k, i] += sign
        rhs[n + k] = volts
    for (a, b), amps in zip(place[netlist.current_nodes], netlist.current_amps, strict=True):
        if a >= 0:
            rhs[a] -= amps
        if b >= 0:
            rhs[b] += amps
    solution = np.linalg.lstsq(matrix, rhs, rcond=None)[0]
    full = np.full(len(voltage), np.nan)
    full[0] = 0.0
    full[keep] = solution[:n]
    return full


def test_normalize_drive_scales_to_the_supply() -> None:
    from resgrid.circuit.solve import normalize_drive

    cell = np.zeros((9, 5))
    cell[0, 0] = 2
    netlist = rg.compile_space(space_of(cell), boundary="neumann", supply=3.0, goal_voltage=1.0)
    scaled = rg.solve(normalize_drive(netlist, rg.solve(netlist)))
    assert np.nanmax(scaled.voltage) == pytest.approx(4.0)


@pytest.mark.parametrize("supply", [1.0, -2.0])
def test_a_normwise_solution_has_the_same_field(supply: float) -> None:

    cell = np.zeros((7, 6))
    cell[1, 1], cell[4, 2:5] = 2, 1
    netlist = rg.compile_space(space_of(cell), supply=supply, goal_voltage=0.5)
    exact, rough = rg.field(rg.solve(netlist)), rg.field(rg.solve(netlist, accuracy="normwise"))
    assert rough.log_drop is None
    assert np.allclose(exact.potential, rough.potential, atol=1e-9)
    for axis in range(2):
        assert np.allclose(exact.face_current(axis), rough.face_current(axis), atol=1e-9)
