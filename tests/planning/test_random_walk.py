"""Hitting probabilities and times of random walks: Markov chains, gambler's ruin, simulation, mpmath."""

from typing import Literal

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg

BOUNDARIES = [{}, {"boundary": "wall", "wall_resistance": 3.0}, {"boundary": "neumann"}, {"rails": "cells"}]


def compiled(space: rg.ConfigurationSpace, **options: object) -> rg.Netlist:
    try:
        netlist = rg.compile_space(space, resistance=1.0, **options)
        rg.solve(netlist)
    except rg.CircuitError:
        assume(False)
        raise
    return netlist


def transitions(netlist: rg.Netlist) -> tuple[np.ndarray, np.ndarray]:
    """Dense conductance matrix of all nodes, assembled independently of the solver, and the free nodes."""
    W = np.zeros((netlist.node_count, netlist.node_count))
    for (i, j), g in zip(netlist.resistor_nodes, netlist.conductance, strict=True):
        W[i, j] += g
        W[j, i] += g
    return W, netlist.cells.free_node


@pytest.mark.slow
@settings(max_examples=80)
@given(spaces(max_cells=7), st.sampled_from(BOUNDARIES))
def test_random_walk_results_equal_those_of_an_absorbing_markov_chain(
    space: rg.ConfigurationSpace, options: dict[str, object]
) -> None:
    """The fundamental matrix of Kemeny & Snell (1960), and Doob's transform for walks that succeed."""
    netlist = compiled(space, **options)
    W, free = transitions(netlist)
    degree = W[free].sum(axis=1)
    P = W[np.ix_(free, free)] / degree[:, None]
    fundamental = np.linalg.inv(np.eye(len(free)) - P)
    node_goal = {int(space.goal_region[c]): [] for c in map(tuple, np.argwhere(space.cell == 2))}
    for c in map(tuple, np.argwhere(space.cell == 2)):
        node_goal[int(space.goal_region[c])].append(int(netlist.cells.node[c]))
    found, absorbed = rg.planning.collision_probability(netlist), rg.planning.hitting_probability(netlist)
    at = tuple(np.argwhere((space.cell == 0) & (netlist.cells.node >= 0)).T)
    u = np.zeros(len(free))
    for goal, nodes in node_goal.items():
        reach = fundamental @ (W[np.ix_(free, sorted(set(nodes)))].sum(axis=1) / degree)
        np.testing.assert_allclose(absorbed.probability[goal][at], reach, rtol=1e-7, atol=1e-12)
        u += reach
    np.testing.assert_allclose(found.success[at], u, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found.steps[at], fundamental.sum(axis=1), rtol=1e-7)
    np.testing.assert_allclose(found.time[at], fundamental @ (1 / degree), rtol=1e-7)
    # Given success, the probability of a step from i to j changes by u_j / u_i; u was checked above.
    can = space.goal_connected[at]
    log_u = found.log_success[at][can]
    transformed = P[np.ix_(can, can)] * np.exp(log_u - log_u[:, None])
    inverse = np.linalg.inv(np.eye(can.sum()) - transformed)
    np.testing.assert_allclose(found.steps_given_success[at][can], inverse.sum(axis=1), rtol=1e-6)
    np.testing.assert_allclose(found.time_given_success[at][can], inverse @ (1 / degree[can]), rtol=1e-6)
    assert np.array_equal(np.isnan(found.time_given_success[at]), ~space.goal_connected[at])


def test_random_walk_results_equal_gamblers_ruin() -> None:
    """Feller (1968), XIV.2-3: u = i / N, i (N - i) steps, and (N**2 - i**2) / 3 steps given success."""
    N = 40
    found = rg.planning.collision_probability(rg.compile_space(space_of([1] + [0] * (N - 1) + [2])))
    i = np.arange(1, N)
    np.testing.assert_allclose(found.success[1:-1], i / N, rtol=1e-12)
    np.testing.assert_allclose(found.steps[1:-1], i * (N - i), rtol=1e-12)
    np.testing.assert_allclose(found.steps_given_success[1:-1], (N**2 - i**2) / 3, rtol=1e-12)
    np.testing.assert_allclose(found.time[1:-1], i * (N - i) / 2, rtol=1e-12)
    assert (found.success[-1], found.time[-1], found.time_given_success[-1]) == (1.0, 0.0, 0.0)
    assert (found.success[0], found.time[0]) == (0.0, 0.0) and np.isnan(found.time_given_success[0])


def test_random_walk_results_agree_with_a_simulation() -> None:
    cell = np.zeros((7, 6), dtype=np.uint8)
    cell[3, :4] = 1
    cell[1, 1], cell[5, 4] = 2, 2
    space = space_of(cell, spacing=(1.0, 0.5))
    netlist = rg.compile_space(space, resistance=1.0)
    W, _ = transitions(netlist)
    cumulative = np.cumsum(W / np.maximum(W.sum(axis=1), 1e-300)[:, None], axis=1)
    rng = np.random.default_rng(5)
    start, walks = (5, 1), 40_000
    node, steps = np.full(walks, netlist.cells.node[start]), np.zeros(walks)
    free = np.isin(np.arange(netlist.node_count), netlist.cells.free_node)
    while free[node].any():
        going = np.flatnonzero(free[node])
        draw = rng.random(len(going))
        node[going] = np.minimum((cumulative[node[going]] < draw[:, None]).sum(axis=1), netlist.node_count - 1)
        steps[going] += 1
    found, absorbed = rg.planning.collision_probability(netlist), rg.planning.hitting_probability(netlist)
    won = np.isin(node, netlist.cells.goal_nodes)
    assert abs(won.mean() - found.success[start]) < 4 * np.sqrt(0.25 / walks)
    assert abs(steps.mean() - found.steps[start]) < 4 * steps.std() / np.sqrt(walks)
    assert abs(steps[won].mean() - found.steps_given_success[start]) < 4 * steps[won].std() / np.sqrt(won.sum())
    for goal, goal_node in enumerate(netlist.cells.goal_nodes):
        assert abs((node == goal_node).mean() - absorbed.probability[goal][start]) < 4 * np.sqrt(0.25 / walks)


def test_log_success_is_accurate_where_success_underflows() -> None:
    """A corridor one cell wide, u = 1e-858 at its end, against tridiagonal elimination with forty digits."""
    n = 1500
    cell = np.zeros((n + 1, 1), dtype=np.uint8)
    cell[0] = 2
    found = rg.planning.collision_probability(rg.compile_space(space_of(cell)))
    with mpmath.workdps(40):
        u = _tridiagonal([mpmath.mpf(1)] + [mpmath.mpf(0)] * (n - 1))
        s = _tridiagonal(u)
        log_u = np.array([float(mpmath.log(value)) for value in u])
        ratio = np.array([float(a / b) for a, b in zip(s, u, strict=True)])
    assert log_u[-1] < -1900 and found.success[-1, 0] == 0.0
    np.testing.assert_allclose(found.log_success[1:, 0], log_u, rtol=1e-14)
    np.testing.assert_allclose(found.time_given_success[1:, 0], ratio, rtol=1e-13)
    np.testing.assert_allclose(found.steps_given_success[1:, 0], 4 * ratio, rtol=1e-13)


def _tridiagonal(rhs: list[mpmath.mpf]) -> list[mpmath.mpf]:
    """4 x_k - x_{k-1} - x_{k+1} = b_k, by Thomas's algorithm."""
    pivot, value = [mpmath.mpf(4)], [rhs[0]]
    for b in rhs[1:]:
        value.append(b + value[-1] / pivot[-1])
        pivot.append(4 - 1 / pivot[-1])
    x = [value[-1] / pivot[-1]]
    for p, v in zip(pivot[-2::-1], value[-2::-1], strict=True):
        x.append((v + x[-1]) / p)
    return x[::-1]


def test_expected_times_are_proportional_to_the_neumann_potential() -> None:
    cell = np.zeros((9, 9), dtype=np.uint8)
    cell[4, 1:8], cell[0, 0] = 1, 2
    cell[0, 8], cell[1, 8], cell[1, 7], cell[0, 7] = 0, 1, 1, 1
    point = rg.solve(rg.compile_space(space_of(cell), boundary="neumann"))
    potential, found = rg.field(point).potential, rg.planning.collision_probability(point)
    inside = space_of(cell).goal_connected
    np.testing.assert_allclose(found.time[inside] / found.time[inside].max(), potential[inside], rtol=1e-12)
    np.testing.assert_allclose(found.time_given_success[inside], found.time[inside], rtol=1e-12)
    assert np.all(found.success[inside] == 1.0)
    assert (found.success[0, 8], found.time[0, 8]) == (0.0, np.inf)


def test_components_with_a_single_rail_have_probabilities() -> None:
    """A closed component without a goal, and one whose only contact is the goal."""
    cell = np.array([[0, 1, 0, 1], [2, 1, 1, 0], [0, 1, 0, 2]])
    found = rg.planning.collision_probability(rg.compile_space(space_of(cell), edge="open"))
    assert found.success[0, 2] == 0.0 and found.steps[0, 2] == 1.0 and np.isnan(found.time_given_success[0, 2])
    closed = rg.planning.collision_probability(
        rg.compile_space(space_of([[0, 0, 2], [1, 1, 1], [0, 0, 2]]), edge="open")
    )
    alone = rg.planning.collision_probability(rg.compile_space(space_of([[0, 2, 1, 0, 2]]), edge="open"))
    assert alone.success[0, 0] == 1.0 and alone.steps[0, 0] == 1.0
    assert 0 < closed.success[0, 0] < 1


def test_a_random_walk_object_is_reused() -> None:
    walk = rg.planning.random_walk(rg.compile_space(space_of([[0, 0, 2], [0, 1, 0]])))
    assert rg.planning.random_walk(walk) is walk
    np.testing.assert_array_equal(
        rg.planning.hitting_probability(walk).probability[0], rg.planning.collision_probability(walk).success
    )


def test_basins_and_likeliest_goals_follow_the_symmetry() -> None:
    """By symmetry each half belongs to its own goal, for streamlines and for random walks."""
    cell = np.zeros((12, 5), dtype=np.uint8)
    cell[1, 2], cell[10, 2] = 2, 2
    space = space_of(cell)
    point = rg.solve(rg.compile_space(space))
    expected = np.repeat([0] * 6 + [1] * 6, 5).reshape(12, 5)
    np.testing.assert_array_equal(rg.basins(rg.field(point)), expected)
    absorbed = rg.planning.hitting_probability(point)
    np.testing.assert_array_equal(absorbed.likeliest, expected)
    np.testing.assert_allclose(absorbed.probability[0], absorbed.probability[1][::-1], rtol=1e-12)


@pytest.mark.slow
@settings(max_examples=100)
@given(spaces(max_cells=8), st.sampled_from(BOUNDARIES))
def test_basins_equal_the_goals_of_streamlines(space: rg.ConfigurationSpace, options: dict[str, object]) -> None:
    assume(space.goal_connected.any())
    try:
        field = rg.field(rg.solve(compiled(space, **options)))
    except rg.CircuitError:
        assume(False)
        raise
    found = rg.basins(field)
    for cell in np.argwhere(space.cell != 1)[:40]:
        goal = rg.streamline(field, cell=cell.tolist()).goal
        assert found[tuple(cell)] == (-1 if goal is None else goal)
    assert np.all(found[space.cell == 1] == -1)
    assert np.all(
        rg.planning.hitting_probability(rg.compile_space(space)).likeliest[~space.goal_connected & (space.cell == 0)]
        == -1
    )


def test_circuits_without_a_random_walk_raise_input_error() -> None:
    with pytest.raises(rg.InputError, match="not compiled from a space"):
        rg.planning.collision_probability(rg.Netlist(2, [[0, 1]], [1.0]))
    space = space_of([[0, 0, 2]])
    with pytest.raises(rg.InputError, match="uniform"):
        rg.planning.collision_probability(rg.compile_space(space, boundary="neumann", drive="start", start=(0, 0)))
    with pytest.raises(rg.InputError, match="no free cell"):
        rg.planning.collision_probability(rg.compile_space(space_of([[2, 1]])))


@pytest.mark.parametrize(("boundary", "time"), [("dirichlet", 0.4), ("neumann", 2.0)])
def test_a_leak_ends_the_walk_in_a_space_without_a_free_cell_at_a_goal(
    boundary: Literal["dirichlet", "neumann"], time: float
) -> None:
    """The conductance to the rail is 2 / R, and that of the leak 0.5 / R."""
    space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 3.0, 3)], [2, 1, 0])
    netlist = rg.compile_space(space, boundary=boundary, leak=0.5)
    walk, hits = rg.planning.collision_probability(netlist), rg.planning.hitting_probability(netlist)
    assert walk.success.tolist() == hits.probability[0].tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_allclose(walk.steps, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(walk.time, [0.0, 0.0, time])
