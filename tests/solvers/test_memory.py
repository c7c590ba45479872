"""Memory estimates, compared with the peak traced during a solution.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers.method_choice`, `resgrid.solvers.symbolic`.
"""

import tracemalloc

import numpy as np
import pytest

import resgrid as rg
from resgrid.circuit.equations import assemble
from resgrid.solvers.method_choice import choose_method
from resgrid.solvers.symbolic import order_by_distance


def boxes(shape: tuple[int, ...]) -> rg.ConfigurationSpace:
    """Space with a tenth of the cells in boxes and the goal in a corner."""
    rng, cell = np.random.default_rng(3), np.zeros(shape, dtype=np.uint8)
    while np.mean(cell) < 0.1:
        low = rng.integers(2, shape)
        cell[tuple(slice(a, a + n // 12) for a, n in zip(low, shape, strict=True))] = rg.Cell.OBSTACLE
    cell[(0,) * len(shape)] = rg.Cell.GOAL
    return rg.ConfigurationSpace([rg.Axis("xyz"[k], 0, 1, n) for k, n in enumerate(shape)], cell)


def without_layout(netlist: rg.Netlist) -> rg.Netlist:
    """Return the circuit as a netlist without its cells."""
    return netlist.replace(cell_map=None)


@pytest.mark.parametrize("shape", [(12, 3000), (1500, 5, 5)])
def test_the_estimate_for_factors_of_corridors_bounds_the_peak(shape: tuple[int, ...]) -> None:
    cell = np.zeros(shape, dtype=np.uint8)
    cell[(0,) * len(shape)] = rg.Cell.GOAL
    netlist = rg.compile_space(rg.ConfigurationSpace([rg.Axis("xyz"[k], 0, n, n) for k, n in enumerate(shape)], cell))
    system = assemble(netlist)
    assert order_by_distance(system.laplacian) is not None
    estimate = choose_method(system.laplacian, "direct").memory
    rg.solve(netlist, method="direct")
    tracemalloc.start()
    rg.solve(netlist, method="direct")
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert taken < estimate < 2.5 * taken


def test_the_estimate_for_a_long_shaft_is_linear_in_its_size() -> None:
    """Factors of an open volume of as many cells take ten times as much."""
    shaft = np.zeros((6000, 5, 5), dtype=np.uint8)
    shaft[0, 2, 2] = rg.Cell.GOAL
    axes = [rg.Axis("xyz"[k], 0, n, n) for k, n in enumerate(shaft.shape)]
    system = assemble(rg.compile_space(rg.ConfigurationSpace(axes, shaft)))
    assert choose_method(system.laplacian, "direct").memory < 2000.0 * system.size


@pytest.mark.parametrize("accuracy", ["normwise", "direction"])
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("shape", [(200, 220), (36, 34, 40)])
@pytest.mark.quick_cases(3)
def test_the_estimate_for_multigrid_bounds_the_peak(shape: tuple[int, ...], boundary: str, accuracy: str) -> None:
    netlist = rg.compile_space(boxes(shape), boundary=boundary)
    for circuit in (netlist, without_layout(netlist)):
        estimate = choose_method(assemble(circuit).laplacian, "multigrid", accuracy).memory
        rg.solve(circuit, accuracy=accuracy, method="multigrid")
        tracemalloc.start()
        rg.solve(circuit, accuracy=accuracy, method="multigrid")
        taken = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert taken < estimate < 2.0 * taken
