"""Effective resistances: closed forms, exact fractions, pseudo-inverses, laws, terminals and rejected inputs."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import numpy as np
import pytest
from numpy.typing import NDArray

import resgrid as rg

Matrix = NDArray[np.float64]


def network(edges: object, siemens: object = 1.0, **options: object) -> rg.Netlist:
    """Netlist of resistors between the nodes of `edges`, numbered from 0."""
    ends = np.array(edges)
    return rg.Netlist(int(ends.max()) + 1, ends, np.broadcast_to(siemens, len(ends)), **options)  # type: ignore[arg-type]


def grid(rows: int, columns: int) -> rg.Netlist:
    """Grid of 1 ohm resistors; node ``row * columns + column``."""
    node = np.arange(rows * columns).reshape(rows, columns)
    across, down = np.stack([node[:, :-1], node[:, 1:]], -1), np.stack([node[:-1], node[1:]], -1)
    return network(np.concatenate([across.reshape(-1, 2), down.reshape(-1, 2)]))


def by_pseudo_inverse(netlist: rg.Netlist) -> Matrix:
    """Resistances of all pairs of nodes from the pseudo-inverse of the Laplacian matrix."""
    matrix = np.zeros((netlist.node_count, netlist.node_count))
    for (a, b), siemens in zip(netlist.resistor_nodes, netlist.conductance, strict=True):
        matrix[[a, b], [a, b]] += siemens
        matrix[[a, b], [b, a]] -= siemens
    inverse = np.linalg.pinv(matrix)
    return np.asarray(np.diag(inverse)[:, None] + np.diag(inverse) - 2 * inverse)


def exactly(netlist: rg.Netlist, first: int, second: int) -> Fraction:
    """Exact resistance of a pair, by elimination of all other nodes in fractions."""
    rows: list[dict[int, Fraction]] = [{} for _ in range(netlist.node_count)]
    for (a, b), siemens in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
        if a != b:
            rows[a][b] = rows[b][a] = rows[a].get(b, Fraction(0)) + Fraction(siemens)
    for node in sorted(set(range(netlist.node_count)) - {first, second}):
        star = rows[node]
        total = sum(star.values())
        for a in star:
            rows[a].pop(node)
        for a, b in itertools.permutations(star, 2):
            rows[a][b] = rows[a].get(b, Fraction(0)) + star[a] * star[b] / total
        rows[node] = {}
    return 1 / rows[first][second]


def random_network(rng: np.random.Generator, nodes: int, extra: int, decades: float) -> rg.Netlist:
    """Connected network with conductances over a range of orders of magnitude."""
    tree = [(node, int(rng.integers(node))) for node in range(1, nodes)]
    ends = np.array(tree + [tuple(rng.choice(nodes, 2, replace=False)) for _ in range(extra)])
    return network(ends, 10 ** rng.uniform(-decades / 2, decades / 2, len(ends)))


def all_pairs(netlist: rg.Netlist) -> Matrix:
    return rg.effective_resistance(netlist, terminals=range(netlist.node_count)).matrix


@pytest.mark.parametrize("seed", range(20))
def test_resistances_of_random_networks_are_those_of_the_pseudo_inverse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 45))
    netlist = random_network(rng, count, int(rng.integers(0, 90)), 2.0)
    expected = by_pseudo_inverse(netlist)
    np.testing.assert_allclose(all_pairs(netlist), expected, rtol=1e-10, atol=1e-13)
    some = rng.permutation(count)[: min(6, count)].tolist()
    found = rg.effective_resistance(netlist, terminals=some)
    np.testing.assert_allclose(found.matrix, expected[np.ix_(some, some)], rtol=1e-10, atol=1e-13)
    flow = rg.circuit.pair_currents(netlist, some[0], some[1], amps=3.0)
    assert flow.resistance == pytest.approx(expected[some[0], some[1]], rel=1e-10)
    assert flow.power == pytest.approx(np.sum(flow.resistor_current**2 / netlist.conductance), rel=1e-10)
    assert flow.voltage[some[0]] == pytest.approx(3.0 * flow.resistance, rel=1e-10)


@pytest.mark.parametrize("seed", range(6))
def test_each_resistance_is_accurate_over_24_orders_of_magnitude(seed: int) -> None:
    rng = np.random.default_rng(seed)
    netlist = random_network(rng, 11, 10, 24.0)
    every, some = (
        rg.effective_resistance(netlist, terminals=range(11)),
        rg.effective_resistance(netlist, [(0, 5), (5, 7)]),
    )
    assert every.error < 1e-12 and some.error < 1e-11
    for found, wanted in ((every, every.pairs[::5].tolist()), (some, [[0, 5], [5, 7]])):
        for first, second in wanted:
            exact, ends = exactly(netlist, first, second), [nodes.item() for nodes in found.terminals]
            ohms = found.matrix[ends.index(first), ends.index(second)]
            assert abs(Fraction(float(ohms)) - exact) <= Fraction(found.error) * exact


def test_tiny_and_huge_conductances_are_scaled() -> None:
    for size in (1e-300, 1e-200, 1e200, 1e300):
        assert all_pairs(network([[0, 1], [1, 2], [2, 0]], size))[0, 1] * size == pytest.approx(2 / 3, rel=1e-14)


def mesh(side: int, values: list[float], seed: int) -> rg.Netlist:
    """Square mesh with conductances drawn from a list."""
    netlist = grid(side, side)
    return netlist.replace(conductance=np.random.default_rng(seed).choice(values, len(netlist.conductance)))


@pytest.mark.parametrize(
    ("values", "side"), [([1e12, 1e-12], 8), ([1e15, 1e-15], 8), ([1.0, 1e-30, 1e30], 7), ([1e200, 1.0, 1e-200], 4)]
)
def test_resistances_and_reduced_networks_are_accurate_whatever_the_ratio_of_conductances(
    values: list[float], side: int
) -> None:
    for seed in range(3):
        netlist = mesh(side, values, seed)
        pair = [seed, side * side - 2 - seed]
        exact = exactly(netlist, *pair)
        found, reduced = rg.effective_resistance(netlist, [pair]), rg.circuit.reduce_network(netlist, pair)
        assert found.error < 1e-11 and reduced.error < 1e-11
        assert abs(Fraction(float(found.resistance[0])) - exact) <= Fraction(found.error) * exact
        assert abs(Fraction(float(reduced.conductance[0, 1])) * exact - 1) <= Fraction(reduced.error)


@pytest.mark.parametrize(
    ("edges", "siemens", "pair"),
    [
        ([[1, 0], [2, 1]], [9e-276, 5e-297], (0, 2)),
        ([[0, 1], [2, 1]], [5e271, 7e292], (2, 0)),
        ([[0, 1], [0, 2]], [2e275, 1e281], (2, 1)),
        ([[1, 0], [1, 0]], [1.7e308, 1.7e308], (0, 1)),
        ([[0, 1], [1, 2], [2, 3], [3, 4]], [1.0, 1.0, 1e300, 1.0], (0, 4)),
        ([[0, 1], [1, 2], [2, 3]], [1.0, 1e-150, 1e300], (3, 0)),
        ([[0, 1], [1, 2], [2, 3], [3, 0], [3, 4]], [1e-300, 1e300, 1e-300, 2e-300, 1e300], (1, 4)),
    ],
)
def test_resistances_of_extreme_conductances_are_rounded_once_or_bounded(
    edges: list[list[int]], siemens: list[float], pair: tuple[int, int]
) -> None:
    netlist = network(edges, siemens)
    found, exact = rg.effective_resistance(netlist, [pair]), exactly(netlist, *pair)
    assert found.error < 1e-13
    assert abs(Fraction(float(found.resistance[0])) - exact) <= Fraction(found.error) * exact


def test_all_pairs_of_an_extreme_circuit_agree_with_fractions() -> None:
    netlist = mesh(3, [1e-160, 1e160, 1.0, 1e-20], 2)
    found = rg.effective_resistance(netlist.replace(node_count=10), terminals=[0, 4, [5, 7], 8, 9], joined="all")
    assert np.isinf(found.matrix[4, :4]).all() and found.error < 1e-13
    for first, second in ((0, 1), (0, 3), (1, 3)):
        joined = rg.Netlist(9, np.append(netlist.resistor_nodes, [[5, 7]], 0), np.append(netlist.conductance, 1e308))
        exact = exactly(joined, *(int(found.terminals[end][0]) for end in (first, second)))
        assert found.matrix[first, second] == pytest.approx(float(exact), rel=1e-14)


def test_a_reduced_network_keeps_tiny_conductances() -> None:
    ends = [[2, 0], [6, 5], [5, 4], [2, 3], [7, 6], [0, 4], [3, 1], [3, 2]]
    siemens = [1.1441778670468376e-246, 2.3e-218, 8.4e-53, 6.1e-5, 2.4e-209, 1.1e217, 1.2e-240, 3.6e103]
    reduced = rg.circuit.reduce_network(network(ends, siemens), [1, 4, 3])
    assert reduced.conductance[1, 2] == pytest.approx(siemens[0], rel=1e-13) and reduced.error < 1e-13


def test_resistances_beyond_doubles_and_ranges_of_large_circuits_are_rejected() -> None:
    with pytest.raises(rg.CircuitError, match=r"between the nodes node_2 and 0 exceeds 1\.8e308 ohm"):
        rg.effective_resistance(network([[0, 1], [1, 2]], [1e-308, 1e-308]), [(2, 0)])
    with pytest.raises(rg.CircuitError, match=r"exceeds 1\.8e308 S"):
        rg.circuit.reduce_network(network([[0, 1], [0, 1]], [1.7e308, 1.7e308]), [0, 1])
    chain = network(np.stack([np.arange(2500), np.arange(1, 2501)], 1), 1.0)
    siemens = np.where(np.arange(2500) == 7, 1e300, 1.0)
    with pytest.raises(rg.AccuracyError, match=r"span 300 orders of magnitude.* voltage sources of 0 V"):
        rg.effective_resistance(chain.replace(conductance=siemens), [(0, 2500)])
    wire = {"source_nodes": [[7, 8]], "source_volts": [0.0]}
    found = rg.effective_resistance(
        chain.replace(conductance=np.delete(siemens, 7), resistor_nodes=np.delete(chain.resistor_nodes, 7, 0), **wire),
        [(0, 2500)],
    )
    assert found.resistance[0] == pytest.approx(2499, rel=1e-12)


def test_currents_of_pairs_with_extreme_conductances_are_finite_or_rejected() -> None:
    flow = rg.circuit.pair_currents(network([[0, 1], [0, 1]], [1.7e308, 1.7e308]), 1, 0)
    assert flow.resistance == pytest.approx(0.5 / 1.7e308, rel=1e-15) and flow.voltage[1] == flow.resistance
    np.testing.assert_array_equal(flow.resistor_current, [-0.5, -0.5])
    flow = rg.circuit.pair_currents(network([[0, 1], [1, 2], [2, 3]], [1.0, 1e-150, 1e300]), 3, 0)
    assert flow.resistance == pytest.approx(1e150, rel=1e-15)
    weak = network([[0, 1], [1, 2]], [1e-308, 1e-308])
    with pytest.raises(rg.CircuitError, match=r"exceeds 1\.8e308.* check the unit of the smallest"):
        rg.circuit.pair_currents(weak, 2, 0)
    with pytest.raises(rg.CircuitError, match=r"exceeds 1\.8e308.* choose a smaller current"):
        rg.circuit.pair_currents(network([[0, 1]], [1e-200]), 1, 0, amps=1e150)


def test_multigrid_has_a_bound_where_no_current_flows() -> None:
    side = 60
    found = rg.effective_resistance(grid(side, side), [(0, side * side - 1)], method="multigrid")
    direct = rg.effective_resistance(grid(side, side), [(0, side * side - 1)])
    assert found.error < 1e-6 and direct.error < 1e-8
    assert found.resistance[0] == pytest.approx(direct.resistance[0], rel=found.error + direct.error)


def test_closed_forms() -> None:
    count = 7
    nodes = np.arange(count)
    path = all_pairs(network(np.stack([nodes[:-1], nodes[1:]], 1)))
    distance = np.abs(nodes[:, None] - nodes)
    np.testing.assert_allclose(path, distance, rtol=1e-14)
    ring = all_pairs(network(np.stack([nodes, (nodes + 1) % count], 1)))
    np.testing.assert_allclose(ring, distance * (count - distance) / count, rtol=1e-14)
    complete = all_pairs(network(list(itertools.combinations(range(count), 2))))
    np.testing.assert_allclose(complete, 2 / count * (distance > 0), rtol=1e-14)
    cube = network([(a, a ^ bit) for a in range(8) for bit in (1, 2, 4) if a < a ^ bit])
    np.testing.assert_allclose(all_pairs(cube)[0, [1, 3, 7]], [7 / 12, 3 / 4, 5 / 6], rtol=1e-14)
    rungs = 30
    ladder = grid(2, rungs)
    # An infinite ladder has the resistance r = 2 + r / (1 + r) seen from its first rung; 29 cells have its limit.
    limit = np.sqrt(3.0) - 1.0
    assert rg.effective_resistance(ladder, [(0, rungs)]).resistance[0] == pytest.approx(limit, rel=1e-14)


def test_a_grid_has_its_exact_rational_resistances() -> None:
    netlist = grid(6, 5)
    found = rg.effective_resistance(netlist, [(0, 29), (7, 8), (0, 4)])
    expected = [float(exactly(netlist, a, b)) for a, b in ((0, 29), (7, 8), (0, 4))]
    np.testing.assert_allclose(found.resistance, expected, rtol=1e-14)


def test_neighbours_on_a_wide_grid_approach_those_of_the_infinite_lattice() -> None:
    side = 81
    middle = side * (side // 2) + side // 2
    found = rg.effective_resistance(grid(side, side), [(middle, middle + 1), (middle, middle + side + 1)])
    np.testing.assert_allclose(found.resistance, [1 / 2, 2 / np.pi], atol=3e-4)


def test_foster_and_rayleigh() -> None:
    """The sum of ``g R`` over all resistors is ``n - 1``; a larger conductance never raises a resistance."""
    rng = np.random.default_rng(3)
    netlist = random_network(rng, 30, 50, 6.0)
    resistance = all_pairs(netlist)
    a, b = netlist.resistor_nodes.T
    assert np.sum(netlist.conductance * resistance[a, b]) == pytest.approx(29, rel=1e-13)
    larger = netlist.conductance.copy()
    larger[11] *= 3.0
    assert np.all(all_pairs(netlist.replace(conductance=larger)) <= resistance * (1 + 1e-14))
    assert np.all(resistance[:, :, None] <= (resistance[:, None, :] + resistance.T[None]) * (1 + 1e-12))


def test_joined_unconnected_and_equal_terminals() -> None:
    netlist = network([[0, 1], [2, 3], [3, 4]], source_nodes=[[1, 2]], source_volts=[5.0])
    found = rg.effective_resistance(netlist.replace(node_count=6), [(0, 3), (1, 2), (4, 4), (0, 5), ([3, 4], 4)])
    np.testing.assert_allclose(found.resistance, [2.0, 0.0, 0.0, np.inf, 0.0])
    with pytest.raises(rg.CircuitError, match="are joined"):
        rg.circuit.pair_currents(netlist, 1, 2)
    with pytest.raises(rg.CircuitError, match="no resistors connect the nodes node_1 and node_5"):
        rg.circuit.pair_currents(netlist.replace(node_count=6), 1, 5)
    assert np.isnan(rg.effective_resistance(netlist, [(0, 3)]).matrix).sum() == 0


def test_only_the_regions_of_the_pair_are_wires_unless_all_are_joined() -> None:
    path = network([[0, 1], [1, 2], [2, 3], [3, 4]])
    pairs = [(0, 4), (0, [2, 3]), ([2, 3], 4)]
    alone = rg.effective_resistance(path, pairs)
    together = rg.effective_resistance(path, pairs, joined="all")
    np.testing.assert_allclose(alone.resistance, [4, 2, 1])
    np.testing.assert_allclose(together.resistance, [3, 2, 1])
    assert np.isnan(alone.matrix).sum() == 0 and alone.method != "none"


def test_currents_of_a_pair_do_not_depend_on_ground_and_on_regions() -> None:
    netlist = grid(4, 4)
    flow = rg.circuit.pair_currents(netlist, [0, 1], 15)
    back = rg.circuit.pair_currents(netlist, 15, [0, 1])
    np.testing.assert_allclose(flow.resistor_current, -back.resistor_current, atol=1e-15)
    assert flow.node_current[[0, 1, 15]] == pytest.approx([1.0, 1.0, 1.0])
    assert flow.resistance == pytest.approx(rg.effective_resistance(netlist, [([1, 0], 15)]).resistance[0])
    into = np.bincount(netlist.resistor_nodes[:, 1], flow.resistor_current, 16)
    out = np.bincount(netlist.resistor_nodes[:, 0], flow.resistor_current, 16)
    np.testing.assert_allclose((into - out)[2:15], 0.0, atol=1e-15)


def test_cells_masks_and_names_name_terminals() -> None:
    space = rg.build_space(rg.read_scene("lesson"))
    netlist = rg.compile_space(space, boundary="neumann")
    first, second = (int(netlist.cells.node[cell]) for cell in ((6, 2), (1, 1)))
    by_number = rg.effective_resistance(netlist, [(first, second)]).resistance
    by_name = rg.effective_resistance(netlist, [("n_6_2", "n_1_1")]).resistance
    by_cell = rg.effective_resistance(netlist, [((6, 2), (1, 1))], cells=True).resistance
    assert by_number == by_name == by_cell
    mask = np.zeros(space.shape, dtype=np.bool_)
    mask[1, :3] = True
    by_mask = rg.effective_resistance(netlist, [((6, 2), mask)], cells=True).resistance
    by_list = rg.effective_resistance(netlist, [((6, 2), [(1, 0), (1, 1), (1, 2)])], cells=True).resistance
    assert by_mask == by_list < by_cell
    assert rg.circuit.pair_currents(netlist, (6, 2), (1, 1), cells=True).resistance == pytest.approx(by_cell[0])


def test_a_reduced_network_has_the_resistances_of_the_circuit() -> None:
    netlist = random_network(np.random.default_rng(5), 40, 60, 4.0)
    reduced = rg.circuit.reduce_network(netlist, [3, 9, [11, 12], 0])
    found = rg.effective_resistance(netlist, terminals=[3, 9, [11, 12], 0], joined="all")
    again = rg.effective_resistance(reduced.netlist, terminals=[1, 2, 3, 4])
    np.testing.assert_allclose(again.matrix, found.matrix, rtol=1e-13)
    assert reduced.netlist.names_of([1, 4]) == ["node_3", "ground"]
    with pytest.raises(rg.InputError, match="terminals 0 and 1 are joined"):
        rg.circuit.reduce_network(netlist, [3, [3, 4]])
    named = network([[0, 1], [1, 2]], node_names=("0", "ground", "b"))
    assert rg.circuit.reduce_network(named, [0, 1, 2]).netlist.names_of([1, 2, 3]) == ["ground_0", "ground", "b"]


def test_workers_threads_and_methods_give_the_same_resistances() -> None:
    netlist, steps = grid(30, 20), []
    terminals = [0, 37, 211, 400, 599]
    found = rg.effective_resistance(netlist, terminals=terminals, progress=lambda *step: steps.append(step))
    assert steps == [(number, 4) for number in range(1, 5)]
    with ThreadPoolExecutor(2) as pool:
        shared = rg.effective_resistance(netlist, terminals=terminals, executor=pool)
        regions = rg.effective_resistance(netlist, [([0, 1], 37), (5, [211, 212])], executor=pool)
    np.testing.assert_array_equal(shared.resistance, found.resistance)
    alone = rg.effective_resistance(netlist, [([0, 1], 37), (5, [211, 212])])
    np.testing.assert_array_equal(regions.resistance, alone.resistance)
    levels = rg.effective_resistance(netlist, terminals=terminals, method="multigrid", threads=2)
    np.testing.assert_allclose(levels.resistance, found.resistance, rtol=1e-8)
    assert (found.method, levels.method) == ("direct", "multigrid")


@pytest.mark.parametrize(
    ("pairs", "options", "words"),
    [
        ([(0, 9)], {}, "the circuit has no node 9; its nodes are 0 to 3"),
        ([(0, "n_1")], {}, "the circuit has no node 'n_1'"),
        ([(0, [])], {}, r"the terminal \[\] has no nodes"),
        ([(0, 1.5)], {}, "the terminal 1.5 is not a node number"),
        ([3], {}, r"pairs\[0\] = 3 is not a pair of terminals"),
        (None, {}, "give either pairs"),
        ([], {"terminals": []}, "give either pairs"),
        (None, {"terminals": []}, "terminals has no entries; give at least two"),
        (None, {"terminals": [0]}, "terminals has 1 entry; give at least two"),
        (5, {}, "pairs = 5 must be a list, or None"),
        ("ab", {}, "pairs = 'ab' must be a list, or None"),
        (None, {"terminals": 5}, "terminals = 5 must be a list, or None"),
        ([(0, 1)], {"terminals": [0, 1]}, "give either pairs"),
        ([((0, 1), (1, 1))], {"cells": True}, "was not compiled from a space"),
        ([(np.ones(3, dtype=np.bool_), 1)], {}, "a mask of nodes has shape"),
        ([(0, 1)], {"method": "inverse"}, "method = 'inverse' is unknown; it may be one of auto, direct, multigrid"),
    ],
)
def test_rejected_terminals(pairs: object, options: dict[str, object], words: str) -> None:
    with pytest.raises(rg.InputError, match=words):
        rg.effective_resistance(grid(2, 2), pairs, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("joined", ["pair", "all"])
@pytest.mark.parametrize("pairs", [[], (), np.zeros((0, 2), dtype=np.int64)])
def test_no_pairs_give_an_empty_result(pairs: object, joined: object) -> None:
    found = rg.effective_resistance(grid(2, 2), pairs, joined=joined)  # type: ignore[arg-type]
    assert (found.pairs.shape, found.resistance.shape, found.matrix.shape) == ((0, 2), (0,), (0, 0))
    assert (found.error, found.method, found.terminals) == (0.0, "none", ())


def test_rejected_cells_and_circuits() -> None:
    netlist = rg.compile_space(rg.build_space(rg.read_scene("lesson")), boundary="neumann")
    with pytest.raises(rg.InputError, match=r"has no cell \(99, 1\); its cells are \(0, 0\) to \(7, 7\)"):
        rg.effective_resistance(netlist, [((6, 2), (99, 1))], cells=True)
    obstacle = tuple(np.argwhere(netlist.cells.node < 0)[0].tolist())
    with pytest.raises(rg.InputError, match="is an open obstacle, without a node; choose a free cell"):
        rg.effective_resistance(netlist, [((6, 2), obstacle)], cells=True)
    diode = rg.Netlist(2, [], [], nonlinear_nodes=[[0, 1]], nonlinear_current=[1.0], nonlinear_voltage=[1.0])
    with pytest.raises(rg.InputError, match="nonlinear resistors has no effective resistance"):
        rg.effective_resistance(diode, [(0, 1)])
