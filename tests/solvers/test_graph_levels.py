"""Multigrid levels of general netlists, compared with dense matrices: aggregates, row orders, and the cycle.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers`, `resgrid.solvers.laplacian`,
`resgrid.solvers.multigrid`, `resgrid.solvers.multigrid.conjugate_gradients`,
`resgrid.solvers.multigrid.graph_coarsening`, `resgrid.solvers.multigrid.graph_sweeps`,
`resgrid.solvers.multigrid.hierarchy`, `resgrid.solvers.progress`.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy import sparse

import resgrid as rg
from resgrid.circuit.equations import assemble
from resgrid.solvers import ordering_kernels as ordering
from resgrid.solvers.laplacian import Graph, Rows
from resgrid.solvers.multigrid import cycle, graph_coarsening
from resgrid.solvers.multigrid.conjugate_gradients import iterate
from resgrid.solvers.multigrid.graph_coarsening import coarsen_down
from resgrid.solvers.multigrid.graph_sweeps import Graphs, ascend_graph, work_space
from resgrid.solvers.multigrid.hierarchy import build_hierarchy
from resgrid.solvers.progress import ProgressMonitor

GRAPHS = {"nodes": st.integers(2, 60), "per_node": st.floats(0.6, 8.0), "seed": st.integers(0, 2**31)}


def random_graph(nodes: int, per_node: float, seed: int, decades: float = 2.0) -> Graph:
    """Random conductances, some parallel, with a few leaks; the graph may be disconnected."""
    rng = np.random.default_rng(seed)
    ends = rng.integers(0, nodes, (max(int(nodes * per_node), 1), 2))
    ends = ends[ends[:, 0] != ends[:, 1]]
    g = 10.0 ** rng.uniform(-decades / 2, decades / 2, len(ends))
    upper = sparse.coo_array((g, tuple(ends.T)), shape=(nodes, nodes)).tocsr()
    rows = (upper + upper.T).tocsr()
    rows.sort_indices()
    leak = np.where(rng.random(nodes) < 0.2, 10.0 ** rng.uniform(-2, 1, nodes), 0.0)
    leak[0] = 1.0
    return Graph(rows.indptr.astype(np.int32), rows.indices.astype(np.int32), rows.data, leak)


def packed_netlist(graph: Graph) -> tuple[Graphs, NDArray[np.int32]]:
    return graph_coarsening.pack_netlist(Rows(*graph[:3]), graph.leak, 1.0)


def dense(graph: Graph) -> NDArray[np.float64]:
    coupling = sparse.csr_array((graph.conductance, graph.indices, graph.indptr), shape=(graph.size,) * 2).toarray()
    return np.diag(coupling.sum(axis=1) + graph.leak) - coupling


@settings(max_examples=60)
@given(**GRAPHS, window=st.integers(1, 80))
def test_rows_are_ordered_by_a_proper_colouring(nodes: int, per_node: float, seed: int, window: int) -> None:
    graph = random_graph(nodes, per_node, seed)
    order = graph_coarsening.order_by_colour(graph.indptr, graph.indices, window)
    assert np.array_equal(np.sort(order), np.arange(nodes))
    colour, _ = graph_coarsening._colours(graph.indptr, graph.indices)
    assert np.all(np.diff(colour[order]) >= 0)
    row = np.repeat(np.arange(nodes), np.diff(graph.indptr))
    assert not np.any(colour[row] == colour[graph.indices])


def test_rows_of_a_window_are_ordered_by_length() -> None:
    graph = random_graph(500, 4.0, 3)
    order = graph_coarsening.order_by_colour(graph.indptr, graph.indices, 10**6)
    colour, _ = graph_coarsening._colours(graph.indptr, graph.indices)
    length = np.minimum(np.diff(graph.indptr), 31)[order]
    assert np.all((np.diff(length) >= 0) | (np.diff(colour[order]) > 0))


@settings(max_examples=25)
@given(**GRAPHS, strict=st.booleans())
def test_aggregates_are_connected_and_their_sums_conserve_conductance(
    nodes: int, per_node: float, seed: int, strict: bool
) -> None:
    graph = random_graph(nodes, per_node, seed)
    aggregate, count = graph_coarsening.grow_aggregates(graph, 4, strict)
    assert np.array_equal(np.unique(aggregate), np.arange(count))
    summed = dense(Graph(*graph_coarsening.aggregate_graph(graph, aggregate, count)))
    spread = np.eye(count)[aggregate]
    assert np.allclose(summed, spread.T @ dense(graph) @ spread, rtol=1e-12, atol=1e-12)
    coupled = dense(graph) < 0
    for group in range(count):
        members = np.flatnonzero(aggregate == group)
        assert len(members) <= 6 or not strict
        assert len(members) > 1 or strict or not coupled[members].any()
        within = np.linalg.matrix_power(coupled[np.ix_(members, members)] + np.eye(len(members)), len(members))
        assert np.all(within > 0)


@settings(max_examples=40)
@given(**GRAPHS)
def test_a_renumbered_graph_has_the_same_matrix(nodes: int, per_node: float, seed: int) -> None:
    graph = random_graph(nodes, per_node, seed)
    graph = graph._replace(conductance=graph.conductance.astype(np.float32))
    moved, number = ordering.renumber(*graph)
    assert np.array_equal(np.sort(number), np.arange(nodes))
    np.testing.assert_allclose(dense(Graph(*moved))[np.ix_(number, number)], dense(graph), rtol=1e-6, atol=1e-6)


def test_renumbering_reduces_the_distance_of_neighbours() -> None:
    side = 40
    mesh = np.random.default_rng(0).permutation(side * side).reshape(side, side)
    ends = np.concatenate([np.stack([mesh[1:].ravel(), mesh[:-1].ravel()]),
                           np.stack([mesh[:, 1:].ravel(), mesh[:, :-1].ravel()])], axis=1)  # fmt: skip
    upper = sparse.coo_array((np.ones(ends.shape[1]), tuple(ends)), shape=(side * side,) * 2).tocsr()
    rows = (upper + upper.T).tocsr()
    indptr, indices = rows.indptr.astype(np.int32), rows.indices.astype(np.int32)
    moved, _ = ordering.renumber(indptr, indices, rows.data.astype(np.float32), np.ones(side * side))
    assert ordering.far_fraction(indptr, indices) > 0.7
    assert ordering.far_fraction(*moved[:2]) < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_packed_levels_contain_the_permuted_matrix(seed: int) -> None:
    graph = random_graph(2000, 4.0, seed)
    levels, slot = packed_netlist(graph)
    n, order = graph.size, np.argsort(slot)
    assert np.array_equal(slot[order], np.arange(n))
    matrix = dense(graph)[np.ix_(order, order)]
    begin, middle, end = (part.astype(np.int64) for part in (levels.indptr[:n], levels.middle[:n], levels.indptr[1:]))
    for row in range(0, n, 97):
        entries = levels.indices[begin[row] : end[row]]
        assert np.allclose(-matrix[row, entries], levels.conductance[begin[row] : end[row]], rtol=1e-6)
        assert len(entries) == np.count_nonzero(matrix[row] < 0)
        assert np.array_equal(entries < row, np.arange(begin[row], end[row]) < middle[row])
    assert np.allclose(levels.inverse[:n] * np.diag(matrix), np.diag(matrix) > 0, rtol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_one_cycle_without_inner_steps_is_symmetric_and_positive(seed: int) -> None:
    graph = random_graph(400, 3.0, seed)
    packed, _ = packed_netlist(graph)
    work = work_space(packed)
    assert len(packed.first) > 2
    columns = np.empty((graph.size, graph.size))
    for node in range(graph.size):
        work.b[: graph.size + 1] = 0.0
        work.b[1 + node] = 1.0
        cycle.run_cycle(packed, work, np.inf, 0)
        columns[:, node] = work.x[1 : graph.size + 1]
    scale = np.abs(columns).max()
    assert np.allclose(columns, columns.T, rtol=1e-4, atol=1e-5 * scale)
    assert np.linalg.eigvalsh(0.5 * (columns + columns.T)).min() > 0


def test_ascend_graph_returns_the_product_and_energies_of_the_matrix() -> None:
    graph = random_graph(600, 4.0, 1)
    packed, slot = packed_netlist(graph)
    work, n, order = work_space(packed), graph.size, np.argsort(slot)
    rng = np.random.default_rng(0)
    work.b[1 : n + 1], work.x[:] = rng.random(n), rng.random(len(work.x))
    given = work.b[1 : n + 1].copy()
    injected, energy, along = ascend_graph(packed, 0, work.b[1:], work.x[1:], given, work.change, work.v[:n])
    x = work.x[1 : n + 1]
    true = dense(graph)[np.ix_(order, order)] @ x
    assert np.allclose(work.v[:n], true, atol=1e-4 * np.abs(true).max())
    assert energy == pytest.approx(float(x @ true), rel=1e-4)
    assert injected == along == pytest.approx(float(x @ given), rel=1e-5)


def test_inverse_matrix_equals_numpy() -> None:
    graph = random_graph(50, 3.0, 2)
    graph.leak[:] += 0.1
    assert np.allclose(graph_coarsening.inverse_matrix(graph), np.linalg.inv(dense(graph)), rtol=1e-4, atol=1e-6)


def test_a_graph_of_5000_components_agrees_with_direct() -> None:
    """Coarse levels of 5000 cliques are nodes without neighbours and do not shrink."""
    corner = np.arange(5)
    pairs = np.stack(np.triu_indices(5, 1), axis=1)
    nodes = 1 + (5 * np.arange(5000)[:, None] + corner).ravel()
    ends = 1 + (5 * np.arange(5000)[:, None, None] + pairs).reshape(-1, 2)
    held = np.stack([nodes[::5], np.zeros(5000, dtype=np.int64)], axis=1)
    netlist = rg.Netlist(
        node_count=25_001,
        resistor_nodes=np.concatenate([ends, held]),
        conductance=np.random.default_rng(0).uniform(0.1, 1.0, len(ends) + len(held)),
        current_nodes=np.stack([np.zeros(5000, dtype=np.int64), nodes[2::5]], axis=1),
        current_amps=np.ones(5000),
    )
    direct = rg.solve(netlist, method="direct", accuracy="normwise")
    multigrid = rg.solve(netlist, method="multigrid", accuracy="normwise", rtol=1e-12)
    assert np.allclose(direct.voltage, multigrid.voltage, rtol=1e-9)


def hubs(seed: int) -> rg.Netlist:
    """A few nodes with hundreds of neighbours, which are connected by random conductances."""
    rng = np.random.default_rng(seed)
    ends = np.concatenate([rng.integers(1, 4000, (9000, 2)),
                           np.stack([rng.integers(1, 6, 3000), rng.integers(6, 4000, 3000)], axis=1)])  # fmt: skip
    ends = ends[ends[:, 0] != ends[:, 1]]
    return rg.Netlist(
        node_count=4000,
        resistor_nodes=np.concatenate([ends, [[3999, 0], [17, 0]]]),
        conductance=10.0 ** rng.uniform(-3, 3, len(ends) + 2),
        current_nodes=np.array([[0, 33], [44, 0]]),
        current_amps=np.array([1.0, 0.25]),
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.quick_cases(2)
def test_netlists_with_hubs_agree_with_direct(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    netlist = hubs(seed)
    direct = rg.solve(netlist, method="direct")
    for far in (-1.0, 1.0):
        monkeypatch.setattr(graph_coarsening, "_FAR", far)
        multigrid = rg.solve(netlist, method="multigrid")
        assert np.allclose(direct.voltage, multigrid.voltage, rtol=1e-9, atol=1e-15, equal_nan=True)


def test_results_are_reproducible_to_the_bit() -> None:
    netlist = hubs(9)
    first, second = (rg.solve(netlist, method="multigrid", accuracy="normwise") for _ in range(2))
    assert np.array_equal(first.voltage, second.voltage, equal_nan=True)


def test_a_guess_reduces_the_number_of_iterations() -> None:
    system = assemble(hubs(2))
    hierarchy = build_hierarchy(system.laplacian)
    b = system.feed + system.injected
    cold, warm = ProgressMonitor(), ProgressMonitor()
    x, residual = iterate(system.laplacian, hierarchy, b, 1e-8, None, cold)
    assert residual <= 1e-8 * np.linalg.norm(b)
    near = x * (1 + 1e-5 * np.random.default_rng(0).random(len(x)))
    again, _ = iterate(system.laplacian, hierarchy, b, 1e-8, near, warm)
    assert warm.iterations < cold.iterations
    assert np.abs(x - again).max() < 1e-6 * np.abs(x).max()


def test_levels_shrink_on_netlists_of_every_kind() -> None:
    for graph in (random_graph(5000, 2.0, 0), random_graph(5000, 8.0, 1, 12.0), random_graph(3000, 20.0, 2)):
        levels, steps = coarsen_down(graph)
        sizes = np.array([level.size for level in levels])
        assert len(steps) == len(levels) - 1
        assert np.all(sizes[1:] < 0.8 * sizes[:-1])
