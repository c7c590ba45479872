"""Estimated orders of magnitude of the potential's decay, compared with networkx and with solutions.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers.decay_estimate`, `resgrid.solvers.laplacian`.
"""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.spaces import serpentine, space_of, spaces

import resgrid as rg
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers.decay_estimate import costs_by_depth, decay, estimate_decades
from resgrid.solvers.laplacian import conductance_statistics

RATE, WALL = np.pi, 0.3
LN10 = np.log(10.0)


def system_between_rails(space: rg.ConfigurationSpace, boundary: str) -> Equations | None:
    """The equations of a space between two rails; None for undriven or other spaces."""
    try:
        system = assemble(rg.compile_space(space, boundary=boundary))
    except rg.CircuitError:
        return None
    return system if system.rails is not None else None


@settings(max_examples=80)
@given(spaces(), st.floats(0.0, 1.0))
def test_the_decay_along_shortest_paths_equals_networkx(space, share):
    system = system_between_rails(space, "dirichlet")
    if system is None:
        return
    low, high = system.rails.to_low > 0, system.rails.to_high > 0
    graph = nx.from_scipy_sparse_array(system.laplacian.edges)
    depth = nx.multi_source_dijkstra_path_length(graph, set(np.flatnonzero(high)), weight=None)
    costs = costs_by_depth(system.size, RATE, WALL)
    parts = nx.multi_source_dijkstra_path_length(
        graph, set(np.flatnonzero(low)), weight=lambda _, to, __: int(costs[depth.get(to, system.size)])
    )
    rest = int(share * system.size)
    found = decay(system.laplacian.as_rows(), (low, high), RATE, WALL, rest)
    ways = sorted(parts.values())
    assert found == max(ways[: system.size - rest], default=0) / 64.0


@pytest.mark.parametrize("width", [1, 3, 8])
def test_the_estimated_decay_agrees_with_solutions_of_corridors(width):
    netlist = rg.compile_space(space_of(serpentine(6, 60, width)))
    drop = rg.solve(netlist).log_drop
    truth = -np.quantile(drop[np.isfinite(drop)], 0.02) / LN10
    laplacian = assemble(netlist).laplacian
    assert 0.9 < estimate_decades(laplacian, conductance_statistics(laplacian)) / truth < 1.8
