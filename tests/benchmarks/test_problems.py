"""Circuits of the benchmarks and their equations, compared with scipy's solutions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

import resgrid as rg
from benchmarks.layouts import boxes, maze, passages
from benchmarks.problems import NETLISTS, Problem, equations

PROBLEMS = [
    *(Problem("rectangles", 24, boundary) for boundary in ("dirichlet", "neumann")),
    Problem("boxes", 8, "neumann"),
    Problem("maze", 26, "neumann", width=3),
    *(Problem(kind, 600) for kind in NETLISTS),
]


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)
def test_equations_hold_for_the_operating_point(problem: Problem) -> None:
    netlist = problem.netlist()
    system = equations(netlist)
    voltage = rg.solve(netlist, accuracy="normwise", rtol=1e-12).voltage[system.nodes]
    assert system.residual(voltage) < 1e-8
    np.testing.assert_allclose(voltage, spsolve(system.matrix, system.rhs), rtol=1e-7, atol=1e-12)


def test_equations_contain_only_nodes_with_current() -> None:
    """1 V - a - 0 V; b is connected to 1 V only, c to no element, d to 0 V and a current source."""
    netlist = rg.Netlist(
        node_count=6,
        resistor_nodes=[[1, 2], [2, 0], [1, 3], [5, 0]],
        conductance=[1.0, 3.0, 1.0, 2.0],
        source_nodes=[[1, 0]],
        source_volts=[1.0],
        current_nodes=[[0, 5]],
        current_amps=[4.0],
    )
    system = equations(netlist)
    assert system.nodes.tolist() == [2, 5]
    assert spsolve(system.matrix, system.rhs).tolist() == [0.25, 2.0]


def test_equal_parameters_give_equal_circuits() -> None:
    first, second = (Problem("rectangles", 24, seed=5).netlist() for _ in range(2))
    assert first.conductance.tolist() == second.conductance.tolist()
    assert first.resistor_nodes.tolist() == second.resistor_nodes.tolist()


def test_resistances_deviate_by_the_mismatch() -> None:
    netlist = Problem("rectangles", 24).netlist()
    ratio = 1.0 / (10e3 * netlist.conductance)
    assert 0.9 <= ratio.min() < 0.91
    assert 1.09 < ratio.max() <= 1.1


@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_fifth_of_the_cells_are_obstacles(dimensions: int) -> None:
    space = boxes(32, dimensions, seed=3)
    assert 0.18 < np.mean(space.cell == 1) < 0.35


def test_a_maze_is_a_tree_of_rooms() -> None:
    count = 9
    doors = passages(count, seed=2)
    room = [(i * count + j, k * count + m) for (i, j), (k, m) in doors]
    graph = np.zeros((count**2, count**2))
    graph[tuple(np.array(room).T)] = 1
    assert len(doors) == count**2 - 1
    assert connected_components(graph, directed=False, return_labels=False) == 1


def test_every_free_cell_of_a_maze_is_connected_to_the_goal() -> None:
    space = maze(40, 3, seed=1)
    assert space.goal_connected.sum() == np.count_nonzero(space.cell == 0)
