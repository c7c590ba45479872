"""Compressed rows of the Laplacian, compared with sums of the resistors by scipy.

Tests internals: `resgrid.circuit.equations`, `resgrid.core.netlist`.
"""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy import sparse
from support.spaces import space_of

import resgrid as rg
from resgrid.circuit.equations import Equations, assemble
from resgrid.core.netlist import GROUND


def netlist_of(pairs: NDArray[np.int64], conductance: NDArray[np.float64], nodes: int) -> rg.Netlist:
    """A circuit with the first node at 1 V and the last node at 0 V."""
    return rg.Netlist(
        node_count=nodes,
        resistor_nodes=pairs,
        conductance=conductance,
        source_nodes=np.array([[1, GROUND], [nodes - 1, GROUND]]),
        source_volts=np.array([1.0, 0.0]),
    )


def summed_by_scipy(system: Equations) -> NDArray[np.float64]:
    """Coupling matrix of the conductances between rows, summed by scipy."""
    row, g = system.unknown[system.netlist.resistor_nodes], system.netlist.conductance
    a, b = row[np.all(row >= 0, axis=1) & (row[:, 0] != row[:, 1])].T
    g = g[np.all(row >= 0, axis=1) & (row[:, 0] != row[:, 1])]
    ends = (np.concatenate([a, b]), np.concatenate([b, a]))
    return sparse.coo_array((np.concatenate([g, g]), ends), shape=(system.size, system.size)).toarray()


@given(st.integers(4, 40), st.integers(0, 2**32 - 1), st.sampled_from([1, 3, 12]))
def test_compressed_rows_are_sorted_and_equal_scipys_sums(nodes: int, seed: int, crowd: int) -> None:
    rng = np.random.default_rng(seed)
    line = np.stack([np.arange(1, nodes - 1), np.arange(2, nodes)], axis=1)
    pairs = np.concatenate([line, rng.integers(0, nodes, (crowd * nodes, 2))])
    pairs = rng.permutation(pairs[pairs[:, 0] != pairs[:, 1]])
    system = assemble(netlist_of(pairs, rng.uniform(0.5, 2.0, len(pairs)), nodes))
    held, expected = system.laplacian.with_rows(), summed_by_scipy(system)
    coupling = held.edges
    assert not coupling.nnz or np.shares_memory(held.as_rows().indices, coupling.indices)
    assert coupling.has_canonical_format
    column = coupling.indices.copy()
    coupling.has_sorted_indices = False
    coupling.sort_indices()
    np.testing.assert_array_equal(coupling.indices, column)
    np.testing.assert_allclose(coupling.toarray(), expected, rtol=1e-14)


@pytest.mark.parametrize("shape", [(9, 8), (6, 5, 7), (4, 3, 4, 5)])
def test_rows_of_a_grid_share_memory_with_the_edges(shape: tuple[int, ...]) -> None:
    cell = (np.random.default_rng(2).random(shape) < 0.1).astype(np.uint8)
    cell[(0,) * len(shape)] = 2
    system = assemble(rg.compile_space(space_of(cell)))
    held = system.laplacian.with_rows()
    assert np.shares_memory(held.edges.data, held.as_rows().data)
    np.testing.assert_allclose(system.laplacian.edges.toarray(), summed_by_scipy(system), rtol=1e-14)
